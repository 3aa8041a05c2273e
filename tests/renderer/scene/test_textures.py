"""Textures are functions of the generator, repeat without a seam, and are flat nowhere."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.renderer.scene.image_sources import ImageFolder, draw_image
from gcbench.renderer.scene.images import KINDS, draw_texture


@pytest.fixture(params=sorted(KINDS))
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.mark.parametrize("tileable", [False, True])
@pytest.mark.parametrize("size", [(96, 128), (97, 61), (240, 320), (8, 8), (1, 3)])
def test_same_generator_same_bytes(kind: str, size: tuple[int, int], tileable: bool) -> None:
    first, again, other = (draw_texture(kind, size, np.random.default_rng(s), tileable)
                           for s in (5, 5, 6))
    assert first.shape == (*size, 3)
    assert first.dtype == np.uint8
    assert first.flags.c_contiguous
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_bytes_do_not_depend_on_the_number_of_threads(kind: str) -> None:
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(4)
        many = draw_texture(kind, (256, 256), np.random.default_rng(1), True)
        cv2.setNumThreads(1)
        one = draw_texture(kind, (256, 256), np.random.default_rng(1), True)
    finally:
        cv2.setNumThreads(threads)
    assert np.array_equal(many, one)


@pytest.mark.parametrize("size", [(256, 256), (180, 240)])
def test_tileable_images_have_no_seam(kind: str, size: tuple[int, int]) -> None:
    for seed in range(8):
        image = draw_texture(kind, size, np.random.default_rng(seed), True).astype(float)
        for axis in (0, 1):
            steps = np.abs(np.diff(image, axis=axis, append=np.take(image, [0], axis)))
            steps = steps.mean((1 - axis, 2))
            # Edges of cells and planks are steps too, and the seam may be one of them.
            assert steps[-1] < 1.3 * steps[:-1].max()


def test_tileable_noise_is_as_smooth_across_the_seam_as_elsewhere() -> None:
    for seed in range(8):
        image = draw_texture("noise", (256, 256), np.random.default_rng(seed), True).astype(float)
        for axis in (0, 1):
            steps = np.abs(np.diff(image, axis=axis, append=np.take(image, [0], axis)))
            assert np.take(steps, -1, axis).mean() < 1.5 * steps.mean()


def test_tileable_checkers_alternate_across_the_seam() -> None:
    for seed in range(8):
        value = draw_texture("checker", (256, 256), np.random.default_rng(seed), True).max(axis=2)
        light = value > np.median(value)
        assert np.mean(light[:, -1] != light[:, 0]) > 0.75
        assert np.mean(light[-1] != light[0]) > 0.75


@pytest.mark.parametrize("tileable", [False, True])
def test_there_is_a_gradient_everywhere(kind: str, tileable: bool) -> None:
    for seed in range(8):
        image = draw_texture(kind, (256, 320), np.random.default_rng(seed), tileable)
        gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(float)
        blocks = gray.reshape(16, 16, 20, 16).swapaxes(1, 2)
        assert blocks.std((2, 3)).min() > 1.0
        assert np.isin(image, (0, 255)).mean() < 0.05
        assert gray.std() > 6


def test_an_unknown_kind_lists_the_known_ones() -> None:
    with pytest.raises(GcbenchError, match=r"'marble'.*checker"):
        draw_texture("marble", (8, 8), np.random.default_rng(0), False)


def _write(path: Path, size: tuple[int, int], gray: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full((*size, 3), gray, np.uint8))


def test_a_folder_is_listed_in_order_and_one_level_deep(tmp_path: Path) -> None:
    for name in ("b.PNG", "a.jpg", "sub/c.bmp", "sub/deep/d.png", ".hidden.png"):
        _write(tmp_path / name, (4, 4), 0)
    (tmp_path / "notes.txt").write_text("not an image")
    names = [p.relative_to(tmp_path).as_posix() for p in ImageFolder(tmp_path).files]
    assert names == ["a.jpg", "b.PNG", "sub/c.bmp"]


def test_images_are_cropped_to_the_aspect_not_stretched(tmp_path: Path) -> None:
    y, x = np.mgrid[:120, :300]
    ramp = np.stack([x // 2, y, 0 * x], -1).astype(np.uint8)  # blue = x / 2, green = y
    assert cv2.imwrite(str(tmp_path / "ramp.png"), ramp)
    folder = ImageFolder(tmp_path)
    image = folder.draw(np.random.default_rng(3), (60, 60)).astype(float)
    assert np.array_equal(image, folder.draw(np.random.default_rng(3), (60, 60)))
    assert image[..., 0].max() == 0  # RGB
    assert np.allclose(np.diff(image[..., 1], axis=0), 2, atol=1)
    assert np.allclose(np.diff(image[..., 2], axis=1), 1, atol=1)
    for size in ((17, 400), (400, 17), (1, 1)):
        assert folder.draw(np.random.default_rng(0), size).shape == (*size, 3)


@pytest.mark.parametrize("size", [(64, 48), (63, 47)])
def test_tileable_images_of_a_folder_are_mirrored(tmp_path: Path, size: tuple[int, int]) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (90, 90, 3), np.uint8)
    assert cv2.imwrite(str(tmp_path / "noise.png"), noise)
    image = draw_image((), ImageFolder(tmp_path), size, np.random.default_rng(0), True)
    assert image.shape == (*size, 3)
    half = (size[0] + 1) // 2
    assert np.array_equal(image[half:], image[:half][::-1][:size[0] - half])


def test_errors_name_the_folder_or_the_file(tmp_path: Path) -> None:
    with pytest.raises(GcbenchError, match="nowhere"):
        ImageFolder(tmp_path / "nowhere")
    with pytest.raises(GcbenchError, match="no images in"):
        ImageFolder(tmp_path)
    (tmp_path / "broken.png").write_bytes(b"this is no image")
    with pytest.raises(GcbenchError, match=r"broken\.png") as error:
        ImageFolder(tmp_path).draw(np.random.default_rng(0), (8, 8))
    assert "\n" not in str(error.value)
    (tmp_path / "broken.png").write_bytes(b"")
    with pytest.raises(GcbenchError, match=r"broken\.png"):
        ImageFolder(tmp_path).draw(np.random.default_rng(0), (8, 8))
