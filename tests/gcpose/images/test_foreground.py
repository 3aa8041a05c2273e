"""The foreground of a still camera: what the network sees, what it finds, and its files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from gcbench.errors import ConfigError
from gcbench.gcpose.images.foreground import (
    _compare_with_background,
    _from_the_edge,
    find_foreground,
    subtract_background,
)
from gcbench.gcpose.images.foreground_input import (
    FOREGROUND_CHANNELS,
    FOREGROUND_SIDE,
    Square,
    changing_square,
    color_and_change,
    cut_square,
    paste_square,
    usual_color,
)
from gcbench.gcpose.images.foreground_network import FOREGROUND_WEIGHTS, load_foreground
from gcbench.gcpose.images.settings import ImageSettings
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file

from ...support.ray_scenes import texture

SETTINGS = ImageSettings()


def plain_door() -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """A plain door before a wall, which turns so slowly that its middle looks the same, and where
    it is."""
    rng = np.random.default_rng(1)
    wall = texture(rng, 240, 320, 3.0)
    panel = np.full((110, 90, 3), rng.integers(90, 220, 3), np.uint8)
    panel[8:102, 8:82] = rng.integers(30, 200, 3)
    panel[20:26, 20:70] = 240
    frames, true = [], []
    for t in range(15):
        c, s = np.cos(np.radians(4 + 3 * t)), np.sin(np.radians(4 + 3 * t))
        across = np.array([0.0, 0.45, 0.45, 0.0])
        depth, y = 1.2 - across * s, np.array([-0.25, -0.25, 0.25, 0.25])
        corner = np.stack([300 * (across * c - 0.1) / depth + 160, 300 * y / depth + 120], axis=1)
        source = np.array([[0, 0], [89, 0], [89, 109], [0, 109]], np.float32)
        h = cv2.getPerspectiveTransform(source, corner.astype(np.float32))
        mask = cv2.warpPerspective(np.full((110, 90), 255, np.uint8), h, (320, 240)) > 127
        moved = cv2.warpPerspective(panel, h, (320, 240))
        frames.append(np.where(mask[..., None], moved, wall))
        true.append(mask)
    return np.stack(frames), np.stack(true)


def overlap(found: NDArray[np.bool_], true: NDArray[np.bool_]) -> float:
    return float((found & true).sum() / (found | true).sum())


@pytest.mark.ci
def test_the_network_finds_the_plain_middle_of_a_door() -> None:
    rgb, true = plain_door()
    by_color = overlap(subtract_background(rgb, SETTINGS), true)
    learned = overlap(find_foreground("network", SETTINGS)(rgb), true)
    assert by_color < 0.3
    assert learned > 0.6


def test_edges_are_those_of_the_images() -> None:
    rng = np.random.default_rng(7)
    wall, panel = texture(rng, 240, 320, 3.0), texture(rng, 60, 80)
    rgb, true = np.repeat(wall[None], 4, axis=0), np.zeros((4, 240, 320), bool)
    for t in range(4):
        rgb[t, 40 + 45 * t : 100 + 45 * t, 60:140] = panel
        true[t, 40 + 45 * t : 100 + 45 * t, 60:140] = True
    coarse = np.stack([cv2.GaussianBlur(m.astype(np.float32), (0, 0), 2) for m in true]) - 0.3
    found = _compare_with_background(rgb, coarse, 5, SETTINGS)
    assert overlap(coarse > 0, true) < 0.96 < 0.99 < overlap(found, true)
    always = np.ones((4, 20, 20), np.float32)  # no background is seen: the network decides
    assert _compare_with_background(np.zeros((4, 20, 20, 3), np.uint8), always, 1, SETTINGS).all()


def test_nothing_moves_in_a_still_video() -> None:
    wall = texture(np.random.default_rng(1), 60, 80)
    still = np.repeat(wall[None], 4, axis=0)
    for name in ("network", "no-people", "background"):
        found = find_foreground(name, SETTINGS)(still)
        assert found.shape == still.shape[:3] and found.dtype == bool and not found.any()


def test_the_square_is_about_what_changes() -> None:
    rgb = np.zeros((3, 100, 200, 3), np.uint8)
    rgb[1, 20:80, 50:90] = 200
    square = changing_square(rgb, SETTINGS)
    assert square is not None
    assert square.side == round(60 * (1 + 2 * SETTINGS.foreground_margin))
    assert abs(square.left + square.side / 2 - 70) <= 1
    assert abs(square.top + square.side / 2 - 50) <= 1


@pytest.mark.parametrize("square", [Square(10, 20, 60), Square(-30, -20, 90), Square(60, 30, 300)])
def test_a_square_is_put_back_where_it_was_cut(square: Square) -> None:
    image = cv2.GaussianBlur(texture(np.random.default_rng(2), 100, 150), (0, 0), 3)
    cut = cut_square(image[None], square)
    assert cut.shape == (1, FOREGROUND_SIDE, FOREGROUND_SIDE, 3)
    values = cut[0, ..., 0].astype(np.float32) + 1000
    back = paste_square(values, square, 100, 150)
    rows = slice(max(0, square.top) + 3, min(100, square.top + square.side) - 3)
    columns = slice(max(0, square.left) + 3, min(150, square.left + square.side) - 3)
    assert np.abs(back[rows, columns] - 1000 - image[rows, columns, 0]).mean() < 2.0
    outside = np.ones((100, 150), bool)
    outside[max(0, square.top) : square.top + square.side,
            max(0, square.left) : square.left + square.side] = False
    assert (back[outside] == values.min()).all()


def test_the_usual_color_is_the_most_frequent() -> None:
    rgb = np.zeros((5, 3, 1, 3), np.uint8)
    rgb[:, :, 0, 0] = np.array([9, 9, 9, 50, 70])[:, None]
    rgb[:, :, 0, 1] = np.array([9, 70, 70, 50, 70])[:, None]
    rgb[:, :, 0, 2] = np.array([20, 60, 100, 140, 19])[:, None]
    usual = usual_color(rgb, SETTINGS)
    assert usual[:, 0, :2].tolist() == [[9, 70]] * 3
    assert usual[0, 0, 2] in (19, 20)


def test_the_background_of_a_long_video_is_its_usual_color() -> None:
    rgb = np.full((200, 120, 160, 3), 100, np.uint8)
    rgb[::40, 30:90, 40:110] = 200
    found = subtract_background(rgb, SETTINGS)
    assert found[::40, 40:80, 50:100].all()
    assert not found[1:40].any()


def test_channels_are_color_and_change() -> None:
    rgb = np.full((4, 6, 6, 3), 100, np.uint8)
    rgb[2, 3, 3] = (110, 100, 60)
    channel = color_and_change(rgb, SETTINGS)
    assert channel.shape == (4, FOREGROUND_CHANNELS, 6, 6)
    level = np.log1p([10, 40]) / np.log(256)
    color = np.array([110, 100, 60]) / 255 - 0.5
    np.testing.assert_allclose(channel[2, :3, 3, 3], color, atol=1e-6)
    np.testing.assert_allclose(channel[2, 3:6, 3, 3], [level[0], 0, -level[1]], atol=1e-6)
    np.testing.assert_allclose(channel[:, 6, 3, 3], [0, 0, level[1], level[1]], atol=1e-6)
    np.testing.assert_allclose(channel[:, 7, 3, 3], [0, level[1], level[1], 0], atol=1e-6)
    np.testing.assert_allclose(channel[:, 8, 3, 3], level[1], atol=1e-6)
    np.testing.assert_allclose(channel[:, 9, 3, 3], 0.75)
    assert (channel[:, 9, :3] == 1).all() and (channel[:, 3:9, :3] == 0).all()


def test_numpy_computes_what_pytorch_does() -> None:
    torch = pytest.importorskip("torch", reason="the network needs PyTorch")
    from gcbench.gcpose.networks.foreground import ForegroundNet
    from gcbench.gcpose.networks.weights import read_weights

    network = ForegroundNet(FOREGROUND_CHANNELS).eval()
    network.load_state_dict(
        read_weights(FOREGROUND_WEIGHTS, network.state_dict(), "the foreground"))
    frames = color_and_change(plain_door()[0][::4, :96, 64:192], SETTINGS)
    with torch.no_grad():
        expected = network(torch.from_numpy(frames)[None])[0].numpy()
    np.testing.assert_allclose(load_foreground()(frames), expected, atol=2e-3)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("networks", "perhaps you meant network"),
        ("network:", "no foreground 'network:'"),
        ("network:missing.safetensors", "there is no such file"),
        ("no-people:", "no foreground 'no-people:'"),
        ("no-people:{0}/shape.safetensors", r"bottom.filter.weight is \[1\]"),
        ("network:{0}/other.safetensors", "enter.0.filter.weight is missing"),
        ("network:{0}/shape.safetensors", r"bottom.filter.weight is \[1\]"),
        ("network:{0}/nan.safetensors", "out.bias is not finite"),
        ("network:{0}/text.safetensors", "no safetensors file"),
    ],
)
def test_wrong_names_and_files_are_refused(tmp_path: Path, name: str, said: str) -> None:
    tensors = load_file(FOREGROUND_WEIGHTS)
    one = np.ones(1, np.float32)
    save_file({"a": one}, tmp_path / "other.safetensors")
    save_file({**tensors, "bottom.filter.weight": one}, tmp_path / "shape.safetensors")
    unknown = np.full(4, np.nan, np.float32)
    save_file({**tensors, "out.bias": unknown}, tmp_path / "nan.safetensors")
    (tmp_path / "text.safetensors").write_text("these are no tensors")
    with pytest.raises(ConfigError, match=said):
        find_foreground(name.format(tmp_path), SETTINGS)


def test_people_come_from_the_edge_of_the_image() -> None:
    mask = np.zeros((60, 80), bool)
    mask[40:, 10:20] = mask[10:20, 70:] = mask[20:30, 30:40] = True
    found = _from_the_edge(mask)
    assert found[40:, 10:20].all() and found[10:20, 70:].all()
    assert found.sum() == mask.sum() - 100
    assert not _from_the_edge(np.zeros((60, 80), bool)).any()
