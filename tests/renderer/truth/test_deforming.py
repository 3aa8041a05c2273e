"""Surfaces that deform: a bar that bends, in closed form."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.benchmark.run.datasets import from_folders
from gcbench.renderer.dataset.provenance import new_provenance, write_provenance
from gcbench.renderer.dataset.reader import open_dataset
from gcbench.renderer.dataset.storage import SequenceWriter
from gcbench.renderer.generate.sequence_renderer import SequenceRenderer
from gcbench.renderer.scene import models
from gcbench.renderer.scene.config import MotionConfig, RandomizationConfig, RenderConfig
from gcbench.renderer.scene.motion import animation_times, find_animation
from gcbench.renderer.scene.posed_model import pose_parts, rest_in_part
from gcbench.renderer.show.driver import show
from gcbench.renderer.truth.deforming import weights
from gcbench.renderer.types.sequence import Sequence
from gcbench.renderer.verify.driver import verify_dataset, verify_sequence
from gcbench.robots.geometry import apply, inverse
from gcbench.robots.model import ArticulatedModel, forward_kinematics

from ...support import bent_bar

CONFIG = RenderConfig(
    robot="bar.urdf", frames=4, width=200, height=150, seed=2,
    randomization=replace(RandomizationConfig(), motion=MotionConfig(total=(20, 40), max_step=14)))

HELD = replace(CONFIG.randomization, camera=replace(
    CONFIG.randomization.camera, shake_turn=(0.5, 0.5), shake_shift=(0.01, 0.01)))


@contextmanager
def renderer(model: ArticulatedModel, monkeypatch: pytest.MonkeyPatch, **changes: object
             ) -> Iterator[SequenceRenderer]:
    """A renderer of that model."""
    with monkeypatch.context() as patch:
        patch.setattr(models, "load_robot", lambda *_, **__: model)
        opened = SequenceRenderer(replace(CONFIG, **changes))
    try:
        yield opened
    finally:
        opened.close()


def whole(opened: SequenceRenderer, index: int = 0) -> Sequence:
    return opened.render(index).in_memory()


def angles(s: Sequence) -> np.ndarray:
    """[T] rad of the bend, from the poses of the two parts."""
    low_from_high = inverse(s.state.world_from_part[:, 0]) @ s.state.world_from_part[:, 1]
    return np.arctan2(low_from_high[:, 0, 2], low_from_high[:, 0, 0])


def project(s: Sequence, t: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [N 2] and depth [N] of points in the frame of "low"."""
    cam = apply(s.state.cam_from_world[t] @ s.state.world_from_part[t, 0], points)
    uvw = cam @ s.state.intrinsics.T
    return uvw[:, :2] / uvw[:, 2:], cam[:, 2]


# -- closed form ------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 0.7, -1.1])
def test_vertices_are_where_the_closed_form_says(angle: float) -> None:
    bar = bent_bar.bar()
    posed = pose_parts(bar, forward_kinematics(bar, [[angle]]))
    straight = bent_bar.grid()[0]
    expected = bent_bar.bent(straight, angle)
    for vertices, normals in posed.surfaces(0):
        np.testing.assert_allclose(vertices, expected, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(posed.vertices(0), np.concatenate([expected] * 2), atol=1e-12)
    np.testing.assert_allclose(posed.bounds.min(0), expected.min(0))


def test_at_rest_each_vertex_is_in_the_frame_of_its_part() -> None:
    straight = bent_bar.grid()[0]
    n = len(straight)
    found = rest_in_part(bent_bar.bar(block=True))
    np.testing.assert_allclose(found[:n], straight, atol=1e-12)
    np.testing.assert_allclose(found[n : 2 * n], straight - bent_bar.HINGE, atol=1e-12)
    np.testing.assert_array_equal(found[2 * n :], bent_bar.bar(block=True).visuals[2].vertices)


def test_weights_give_the_point_back_on_the_triangle_and_stay_inside_it() -> None:
    rng = np.random.default_rng(0)
    corners = rng.normal([0, 0, 5], 1, (500, 3, 3))
    share = rng.dirichlet([1, 1, 1], 500)
    points = np.einsum("nk,nki->ni", share, corners)
    np.testing.assert_allclose(weights(points * 0.3, corners), share, atol=1e-9)
    beside = points + rng.normal(size=(500, 3))
    assert weights(beside, corners).min() >= 0
    np.testing.assert_allclose(weights(beside, corners).sum(1), 1)
    flat = np.full((1, 3, 3), 2.0)
    np.testing.assert_allclose(weights(np.array([[0, 0, 1.0]]), flat), 1 / 3)


@pytest.mark.gl
@pytest.mark.parametrize(("animated", "shaken"), [(False, False), (True, False), (False, True)])
def test_flow_is_that_of_the_projected_vertices(
    animated: bool, shaken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Corners from the closed form, cut with pixel centers in the image: an independent truth."""
    bar = bent_bar.bar((bent_bar.Swing(),) if animated else ())
    with renderer(bar, monkeypatch, randomization=HELD if shaken else CONFIG.randomization
                  ) as opened:
        s = whole(opened)
    assert (np.ptp(s.state.cam_from_world, axis=0).max() > 1e-3) == shaken
    straight, faces, _ = bent_bar.grid()
    angle = angles(s)
    worst = []
    for t, other, flow in [(t, t + 1, s.flow[t]) for t in range(3)] + [
            (t + 1, t, s.flow_backward[t]) for t in range(3)]:
        here, z = project(s, t, bent_bar.bent(straight, angle[t]))
        there, z_there = project(s, other, bent_bar.bent(straight, angle[other]))
        v, u = np.nonzero(s.part[t] > 0)
        for y, x in zip(v[::7], u[::7], strict=True):
            # The triangle before all others that holds the pixel's center, in 2D.
            a, b, c = (here[faces[:, k]] - [x, y] for k in range(3))
            cross = np.stack([b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0],
                              c[:, 0] * a[:, 1] - c[:, 1] * a[:, 0],
                              a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]], 1)
            share = cross / cross.sum(1, keepdims=True)
            hit = np.flatnonzero((share > -0.01).all(1))
            inverse_z = (share[hit] / z[faces[hit]]).sum(1)
            first = hit[inverse_z.argmax()]
            if share[first].min() < 0.01:  # the rasterizer may see the edge elsewhere
                continue
            bary = share[first] / z[faces[first]] / inverse_z.max()
            assert s.depth[t][y, x] == pytest.approx(1 / inverse_z.max(), abs=2e-5)
            ends = there[faces[first]] * z_there[faces[first]][:, None]
            target = bary @ ends / (bary @ z_there[faces[first]])
            worst.append(np.linalg.norm(flow[y, x] - (target - [x, y])))
    assert len(worst) > 500
    assert max(worst) < 1e-3, max(worst)


@pytest.mark.gl
def test_a_rigid_motion_of_the_skin_is_that_of_its_part(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where one bone has all the weight, flow follows from depth and the part's poses."""
    with renderer(bent_bar.bar(), monkeypatch) as opened:
        s = whole(opened)
    k = s.state.intrinsics
    v, u = np.nonzero(s.part[0] == 2)
    cam = np.stack([u, v, np.ones_like(u)], 1) @ np.linalg.inv(k).T * s.depth[0][v, u][:, None]
    pose = s.state.cam_from_world[:, None] @ s.state.world_from_part
    local = apply(inverse(pose[0, 1]), cam)
    rigid = local[:, 0] > 0.101  # of x > 0.6
    there = apply(pose[1, 1], local) @ k.T
    expected = there[:, :2] / there[:, 2:] - np.stack([u, v], 1)
    error = np.linalg.norm(s.flow[0][v, u] - expected, axis=1)
    assert rigid.sum() > 100 and error[rigid].max() < 1e-3
    assert error[~rigid].max() > 0.05  # or the rule for rigid parts would do


# -- what is rendered -------------------------------------------------------------------------


@pytest.mark.gl
@pytest.mark.parametrize("kind", ["bend", "block", "morph", "textured", "shadows"])
def test_deforming_sequences_pass_verify(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    swing = bent_bar.Swing(bulge=1.0)
    bar = bent_bar.bar((swing,) if kind == "morph" else (), kind == "morph", kind == "block")
    ranges = CONFIG.randomization
    if kind == "textured":
        ranges = replace(ranges, textures=replace(ranges.textures, probability=1.0))
    if kind == "shadows":
        ranges = replace(ranges, lights=replace(ranges.lights, shadows=True))
    with renderer(bar, monkeypatch, randomization=ranges) as opened:
        sequences = [whole(opened, i) for i in range(3)]
    for s in sequences:
        report = verify_sequence(s, bar)
        assert report.ok, report.table()
        checks = {c.name: c for c in report.checks}
        assert checks["deforming: visibility"].samples > 3000
        assert s.meta.deforming_parts == ("low", "high")
        for frame in s:
            assert ((frame.depth > 0) >= (frame.part > 0)).all()


@pytest.mark.gl
def test_what_stands_still_has_no_flow_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    with renderer(bent_bar.bar((bent_bar.Swing(duration=0.0),)), monkeypatch) as opened:
        s = whole(opened)
    assert (s.flow[0][s.part[0] > 0] == 0).all()
    assert s.meta.randomization["animation"]["duration"] == 0


@pytest.mark.gl
def test_an_animation_moves_the_model_and_nothing_is_scored(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    swing = bent_bar.Swing()
    bar = bent_bar.bar((bent_bar.Swing("other"), swing))
    with renderer(bar, monkeypatch, animation="swing") as opened:
        first, again, second = whole(opened), whole(opened), whole(opened, 1)
    assert first.meta.joint_names == first.meta.scored_joints == ()
    assert first.state.joint_positions.shape == (4, 0)
    assert first.meta.observability["observable"] is None
    drawn = first.meta.randomization["animation"]
    assert drawn["name"] == "swing" and 0 <= drawn["start"] <= 1 - 0.1
    np.testing.assert_allclose(angles(first), swing.angle(drawn["start"] + np.arange(4) / 30))
    assert second.meta.randomization["animation"]["start"] != drawn["start"]
    for a, b in zip(first, again, strict=True):
        for name, value in vars(a).items():
            np.testing.assert_array_equal(value, getattr(b, name))
    assert verify_sequence(first, bar).ok
    for wrong, name in (({"start": drawn["start"] + 0.01}, "poses from the animation: rotation"),
                        ({"name": "sway"}, "animation known to the model")):
        said = {**first.meta.randomization, "animation": {**drawn, **wrong}}
        other = replace(first, meta=replace(first.meta, randomization=said))
        assert name in verify_sequence(other, bar).failures


@pytest.mark.gl
def test_an_animated_model_can_move_its_joints_instead(monkeypatch: pytest.MonkeyPatch) -> None:
    bar = bent_bar.bar((bent_bar.Swing(),))
    with renderer(bar, monkeypatch, animation="none") as opened:
        s = whole(opened)
    assert s.meta.scored_joints == ("bend",)
    np.testing.assert_allclose(angles(s), s.state.joint_positions[:, 0])
    with pytest.raises(GcbenchError, match="--animation none"), renderer(
            bar, monkeypatch, scored_joints=("bend",)):
        pass


def test_an_unknown_animation_is_told_those_that_exist() -> None:
    bar = bent_bar.bar((bent_bar.Swing("walk"), bent_bar.Swing("run")))
    with pytest.raises(GcbenchError, match=r"'jump'.*'walk', 'run'"):
        find_animation(bar, "jump")
    with pytest.raises(GcbenchError, match="none in this model"):
        find_animation(bent_bar.bar(), "jump")
    assert find_animation(bar, "").name == "walk"
    assert find_animation(bar, "run").name == "run"
    assert find_animation(bent_bar.bar(), "") is find_animation(bar, "none") is None


def test_an_animation_is_looped_only_where_it_is_too_short() -> None:
    times = np.arange(4) / 10
    np.testing.assert_allclose(animation_times(times, 0.7, 1.0), [0.7, 0.8, 0.9, 1.0])
    np.testing.assert_allclose(animation_times(times, 0.1, 0.25), [0.1, 0.2, 0.05, 0.15])
    assert (animation_times(times, 0.0, 0.0) == 0).all()


# -- what verify must find --------------------------------------------------------------------


def swapped(values: list[np.ndarray]) -> list[np.ndarray]:
    return [np.ascontiguousarray(v[..., ::-1]) for v in values]


CORRUPTIONS = {
    "rigid flow": (lambda s: replace(s, flow=[f * np.float32(1.1) for f in s.flow]),
                   "deforming: there and back"),
    "flow axes swapped": (lambda s: replace(s, flow=swapped(s.flow)), "deforming: there and back"),
    "backward stored as forward": (lambda s: replace(s, flow_backward=s.flow),
                                   "deforming: there and back"),
    "flow unknown": (lambda s: replace(s, flow=[np.full_like(f, np.nan) for f in s.flow]),
                     "deforming: flow known"),
    "backward unknown": (
        lambda s: replace(s, flow_backward=[np.full_like(f, np.nan) for f in s.flow]),
        "deforming: flow back known"),
    "all hidden": (lambda s: replace(s, visibility=[np.minimum(v * 2, 2) for v in s.visibility]),
                   "deforming: hidden where it is seen"),
    "all out": (lambda s: replace(s, visibility=[np.minimum(v * 3, 3) for v in s.visibility]),
                "deforming: visibility"),
    "not marked as deforming": (
        lambda s: replace(s, meta=replace(s.meta, deforming_parts=())), "flow forward"),
}


@pytest.fixture(scope="module")
def right() -> Sequence:
    with pytest.MonkeyPatch.context() as patch, renderer(bent_bar.bar(), patch) as opened:
        return whole(opened)


@pytest.fixture(scope="module")
def tiny() -> Sequence:
    """Pictures of so few pixels of the bar that the bounds of shares allow less than one."""
    with pytest.MonkeyPatch.context() as patch, renderer(
            bent_bar.bar(), patch, width=64, height=48) as opened:
        return whole(opened)


@pytest.mark.gl
@pytest.mark.parametrize("name", CORRUPTIONS)
def test_corruption_fails_its_check(right: Sequence, name: str) -> None:
    corrupt, expected = CORRUPTIONS[name]
    report = verify_sequence(corrupt(right))
    assert expected in report.failures, report.table()


@pytest.mark.gl
@pytest.mark.parametrize("name", sorted({*CORRUPTIONS} - {"rigid flow"}))  # too small there
def test_corruption_of_a_tiny_picture_fails_its_check(tiny: Sequence, name: str) -> None:
    corrupt, expected = CORRUPTIONS[name]
    report = verify_sequence(corrupt(tiny))
    assert expected in report.failures, report.table()


@pytest.mark.gl
def test_one_pixel_of_a_tiny_picture_may_be_wrong_and_a_tenth_may_not(tiny: Sequence) -> None:
    for share, ok in ((0.0, True), (0.1, False)):
        seen = [v.copy() for v in tiny.visibility]
        pixels = np.flatnonzero((seen[0] == 1) & (tiny.part[0] > 0))
        wrong = pixels[: max(1, int(share * len(pixels)))]
        seen[0].flat[wrong] = 3  # said to leave the picture
        report = verify_sequence(replace(tiny, visibility=seen))
        assert report.ok is ok, report.table()
        (result,) = (c for c in report.checks if c.name == "deforming: visibility")
        assert result.worst > 1e-3 and result.ok is ok


@pytest.mark.gl
def test_forward_and_backward_flow_undo_each_other(right: Sequence) -> None:
    for t, (now, _) in enumerate(pairwise(right)):
        v, u = np.nonzero(now.visibility == 1)
        target = np.rint(np.stack([u, v], 1) + now.flow[v, u]).astype(int)
        back = right.flow_backward[t][target[:, 1], target[:, 0]]
        assert np.nanmedian(np.linalg.norm(now.flow[v, u] + back, axis=1)) < 0.15


@pytest.mark.gl
def test_a_dataset_without_joints_is_shown_and_refused_by_the_benchmark(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with renderer(bent_bar.bar((bent_bar.Swing(),)), monkeypatch) as opened:
        config = opened.config
        rendered = opened.render(0)
        with SequenceWriter(tmp_path, 0, rendered.depth_unit) as writer:
            for frame in rendered.frames:
                writer.add(frame)
            meta, state = rendered.finish()
            writer.finish(meta, state)
    write_provenance(tmp_path, new_provenance(config))
    (stored,) = open_dataset(tmp_path)
    assert stored.meta == meta
    report = verify_dataset(tmp_path, progress=False)
    assert report.ok, report.table()
    written = show(tmp_path, tmp_path / "p.html", tmp_path / "s.png", tmp_path / "f.gif")
    assert all(path.stat().st_size > 1000 for path in written)
    with pytest.raises(GcbenchError, match="--animation none"):
        from_folders([tmp_path])
