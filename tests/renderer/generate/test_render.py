"""Whole sequences of a small crane: reasons, repeatability, odd sizes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.renderer.generate.rendered_sequence import RenderedSequence
from gcbench.renderer.generate.sequence_renderer import SequenceRenderer, depth_unit
from gcbench.renderer.scene.config import STUDIO, MotionConfig, RandomizationConfig, RenderConfig
from gcbench.renderer.truth.rejection import MAX_DRAWS
from gcbench.renderer.types.sequence import Frame, Meta, State

pytestmark = pytest.mark.gl

LINK = """<link name="{}"><visual><origin xyz="{}"/><geometry><box size="{}"/></geometry></visual>
  </link>"""
JOINT = """<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/><origin xyz="{}"/>
  <axis xyz="{}"/><limit lower="{}" upper="{}" effort="1" velocity="1"/></joint>"""
CRANE = "\n".join([
    LINK.format("foot", "0 0 0.05", "0.3 0.3 0.1"),
    LINK.format("mast", "0 0 0.3", "0.1 0.1 0.5"),
    LINK.format("boom", "0.35 0 0", "0.6 0.08 0.08"),
    LINK.format("jib", "0.2 0 0", "0.3 0.05 0.05"),
    JOINT.format("turn", "revolute", "foot", "mast", "0 0 0.11", "0 0 1", -3, 3),
    JOINT.format("lift", "revolute", "mast", "boom", "0.06 0 0.5", "0 -1 0", -0.2, 1.2),
    JOINT.format("reach", "prismatic", "boom", "jib", "0.6 0 0", "1 0 0", 0, 0.4),
])
SMALL = RenderConfig(frames=4, width=160, height=120, randomization=replace(
    RandomizationConfig(), motion=MotionConfig(total=(15, 30), max_step=12)))


@pytest.fixture(scope="module")
def crane(tmp_path_factory: pytest.TempPathFactory) -> str:
    return write(tmp_path_factory.mktemp("crane"), CRANE)


def write(folder: Path, body: str) -> str:
    path = folder / "crane.urdf"
    path.write_text(f'<robot name="crane">{body}</robot>')
    return str(path)


@contextmanager
def renderer(config: RenderConfig) -> Iterator[SequenceRenderer]:
    opened = SequenceRenderer(config)
    try:
        yield opened
    finally:
        opened.close()


def whole(rendered: RenderedSequence) -> tuple[list[Frame], Meta, State]:
    frames = list(rendered.frames)
    return frames, *rendered.finish()


def assert_equal(one: list[Frame], two: list[Frame], names: tuple[str, ...] = ()) -> None:
    for a, b in zip(one, two, strict=True):
        for name, value in vars(a).items():
            if not names or name in names:
                np.testing.assert_array_equal(value, getattr(b, name))


def test_a_sequence_depends_on_config_and_index_alone(crane: str) -> None:
    config = replace(SMALL, robot=crane)
    with renderer(config) as first:
        a = [whole(first.render(i)) for i in (0, 1, 2)]
        again = whole(first.render(1))
    with renderer(config) as second:
        b = whole(second.render(1))
    for other in (again, b):
        assert_equal(a[1][0], other[0])
        assert a[1][1] == other[1]
        for name, value in vars(a[1][2]).items():
            np.testing.assert_array_equal(value, getattr(other[2], name))
    assert not np.array_equal(a[0][0][0].rgb, a[1][0][0].rgb)


def test_frames_have_the_shapes_and_gaps_of_the_contract(crane: str) -> None:
    with renderer(replace(SMALL, robot=crane)) as opened:
        frames, meta, state = whole(opened.render(0))
    assert len(frames) == meta.frames == 4
    for t, frame in enumerate(frames):
        assert frame.rgb.shape == (120, 160, 3)
        assert frame.depth.dtype == np.float32
        assert frame.part.dtype == np.uint16
        assert (frame.flow is None) == (frame.visibility is None) == (t == 3)
        assert (frame.flow_backward is None) == (t == 0)
        assert ((frame.depth > 0) >= (frame.part > 0)).all()
        if frame.flow is not None:
            np.testing.assert_array_equal(np.isnan(frame.flow[..., 0]), frame.depth == 0)
            np.testing.assert_array_equal(frame.visibility > 0, frame.part > 0)
        counts = np.bincount(frame.part.ravel(), minlength=5)[1:]
        np.testing.assert_array_equal(counts, state.part_pixels[t])
    assert set(meta.observability["joints"]) == {"turn", "lift", "reach"}


def test_forward_and_backward_flow_undo_each_other(crane: str) -> None:
    with renderer(replace(SMALL, robot=crane)) as opened:
        frames, _, _ = whole(opened.render(0))
    for now, then in pairwise(frames):
        v, u = np.nonzero((now.visibility == 1) & (now.part > 1))
        target = np.stack([u, v], 1) + now.flow[v, u]
        near = np.round(target).astype(int)
        same = then.part[near[:, 1], near[:, 0]] == now.part[v, u]
        back = then.flow_backward[near[:, 1], near[:, 0]]
        error = np.linalg.norm(now.flow[v, u] + back, axis=1)[same]
        assert np.median(error) < 0.15  # the pixel nearest to the target is not the target


def test_a_joint_that_moves_too_little_is_refused_and_marked(crane: str) -> None:
    motion = MotionConfig(total=(1, 2), total_prismatic=(0, 0.01))
    slow = replace(SMALL.randomization, motion=motion)
    with renderer(replace(SMALL, robot=crane, randomization=slow)) as opened:
        _, meta, _ = whole(opened.render(0))
    seen = meta.observability
    assert not seen["observable"]
    assert seen["reason"] == "displacement"
    assert sum(seen["refused"].values()) == MAX_DRAWS - 1
    assert seen["refused"]["displacement"] > MAX_DRAWS / 2


def test_a_hidden_joint_is_a_reason(tmp_path: Path) -> None:
    shell = LINK.format("foot", "0 0 0.5", "2 2 1").replace(
        "</link>", LINK.format("", "0 0 0.5", "2 2 1.4").partition(">")[2])
    body = CRANE.replace(LINK.format("foot", "0 0 0.05", "0.3 0.3 0.1"), shell)
    config = replace(SMALL, robot=write(tmp_path, body), keep_unobservable=True)
    with renderer(config) as opened:
        _, meta, _ = whole(opened.render(0))
    assert meta.observability["reason"] in ("hidden", "collision")
    assert min(joint["pixels"] for joint in meta.observability["joints"].values()) < 25


def test_collisions_are_refused_and_counted(tmp_path: Path) -> None:
    foot = LINK.format("foot", "0 0 0.05", "0.3 0.3 0.1")
    posts = foot.removesuffix("</link>").rstrip()
    for angle in np.radians([40, 110, 180, 250, 320]):  # the boom stands at 0 and turns by 15-30
        at = f"{0.4 * np.cos(angle):.3f} {0.4 * np.sin(angle):.3f} 0.6"
        posts += LINK.format("", at, "0.02 0.02 1.1").partition(">")[2].removesuffix("</link>")
    body = CRANE.replace(foot, posts + "</link>")
    with renderer(replace(SMALL, robot=write(tmp_path, body))) as opened:
        found = [whole(opened.render(i)) for i in range(8)]
        refused = [meta.observability["refused"] for _, meta, _ in found]
        assert sum(r.get("collision", 0) for r in refused) > 0
        for _, meta, state in found[:2]:
            checker = opened._sampler.motions.checker
            floor = meta.randomization["floor"]
            touches = checker.first_contact(state.world_from_part, floor) is not None
            assert touches == (meta.observability["reason"] == "collision")


def test_keep_unobservable_takes_the_first_draw(crane: str) -> None:
    config = replace(SMALL, robot=crane, keep_unobservable=True)
    with renderer(config) as opened:
        for i in range(3):
            assert whole(opened.render(i))[1].observability["refused"] == {}


@pytest.mark.parametrize("factor", ["lights", "materials", "background", "image"])
def test_vary_changes_one_factor_only(crane: str, factor: str) -> None:
    noisy = replace(SMALL.randomization.image, noise=(5.0, 5.0))
    config = replace(SMALL, robot=crane, vary=(factor,),
                     randomization=replace(SMALL.randomization, image=noisy))
    with renderer(config) as opened:
        zero, meta_zero, _ = whole(opened.render(0))
        one, meta_one, _ = whole(opened.render(1))
    assert_equal(zero, one, ("part",))
    assert any(not np.array_equal(a.rgb, b.rgb) for a, b in zip(zero, one, strict=True))
    if factor != "background":
        assert_equal(zero, one, ("depth", "flow", "visibility"))
    changed = {key for key, value in meta_zero.randomization.items()
               if value != meta_one.randomization[key]}
    assert changed <= {factor, *(["ambient"] if factor == "lights" else [])}


def test_one_frame_is_a_sequence(crane: str) -> None:
    with renderer(replace(SMALL, robot=crane, frames=1)) as opened:
        (frame,), meta, state = whole(opened.render(0))
    assert frame.flow is frame.flow_backward is frame.visibility is None
    assert meta.frames == len(state.times) == 1


def test_a_model_without_joints_renders(tmp_path: Path) -> None:
    config = replace(SMALL, robot=write(tmp_path, LINK.format("block", "0 0 0.2", "0.2 0.3 0.4")))
    with renderer(config) as opened:
        frames, meta, _ = whole(opened.render(0))
    assert meta.observability["observable"]
    assert meta.scored_joints == ()
    part = frames[0].part > 0
    assert part.any()
    assert (frames[0].flow[part] == 0).all()
    assert (frames[0].visibility[part] == 1).all()


def test_a_model_without_a_surface_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(GcbenchError, match="no visible geometry"):
        SequenceRenderer(replace(SMALL, robot=write(tmp_path, '<link name="nothing"/>')))


def test_an_unknown_joint_is_an_error_that_lists_the_joints(crane: str) -> None:
    with pytest.raises(GcbenchError, match=r"turn.*lift.*reach"):
        SequenceRenderer(replace(SMALL, robot=crane, scored_joints=("elbow",)))


def test_the_studio_is_plain_and_still(crane: str) -> None:
    with renderer(replace(SMALL, robot=crane, randomization=STUDIO)) as opened:
        frames, meta, _ = whole(opened.render(0))
    outside = frames[0].rgb[frames[0].depth == 0]
    colors, counts = np.unique(outside.reshape(-1, 3), axis=0, return_counts=True)
    assert counts.max() > 0.9 * counts.sum()
    assert colors[counts.argmax()].tolist() == [217, 217, 217]
    assert meta.randomization["background"] == "plain"


@pytest.mark.parametrize(("far", "unit"), [
    (1.0, 1e-4), (6.5, 1e-4), (6.6, 2e-4), (13.1, 5e-4), (32.6, 1e-3), (65.1, 2e-3), (1e4, 0.2),
    (0.31, 1e-4), (0.29, 1e-5), (0.0301, 1e-5), (0.0299, 1e-6)])
def test_the_depth_unit_grows_in_steps_of_1_2_5(far: float, unit: float) -> None:
    assert depth_unit(far) == unit
    assert far <= 65535 * unit


def test_lens_effects_touch_the_image_only(crane: str) -> None:
    image = replace(SMALL.randomization.image, noise=(8.0, 8.0), blur=(1.0, 1.0),
                    exposure=(0.5, 0.5))
    with renderer(replace(SMALL, robot=crane)) as opened:
        sharp, _, _ = whole(opened.render(0))
    changed = replace(SMALL.randomization, image=image)
    with renderer(replace(SMALL, robot=crane, randomization=changed)) as opened:
        frames, meta, _ = whole(opened.render(0))
    assert_equal(sharp, frames, ("depth", "part", "flow", "visibility"))
    assert frames[0].rgb.mean() > sharp[0].rgb.mean()
    assert meta.randomization["image"] == {
        "noise": 8.0, "blur": 1.0, "exposure": 0.5, "exposure_drift": 0.0}
    still = (frames[0].part == 0) & (frames[1].part == 0)
    still &= (frames[0].rgb.max(axis=2) < 220) & (frames[0].rgb.min(axis=2) > 35)  # unclipped
    apart = frames[0].rgb[still].astype(int) - frames[1].rgb[still]
    assert still.sum() > 1000 and apart.std() == pytest.approx(8 * 2**0.5, rel=0.1)


def test_a_drift_of_exposure_brightens_frame_by_frame_and_changes_no_other_draw(crane: str) -> None:
    image = replace(SMALL.randomization.image, noise=(0.1, 0.2), exposure_drift=(1.1, 1.1))
    found = []
    for drawn in (replace(image, exposure_drift=(0.0, 0.0)), image):
        changed = replace(SMALL.randomization, image=drawn)
        with renderer(replace(SMALL, robot=crane, randomization=changed)) as opened:
            found.append(whole(opened.render(0))[:2])
    (steady, without), (drifting, meta) = found
    assert meta.randomization["image"] == {
        **without.randomization["image"], "exposure_drift": 1.1}
    for t, (a, b) in enumerate(zip(steady, drifting, strict=True)):
        factor = 2 ** (1.1 / 2.2 * t / (len(steady) - 1))
        inside = (a.rgb > 40) & (a.rgb < 150)
        assert np.median(b.rgb[inside] / a.rgb[inside]) == pytest.approx(factor, rel=0.01)
