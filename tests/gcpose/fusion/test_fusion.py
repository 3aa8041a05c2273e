"""Noisy depth and images at once: units of length, the choice of the motion, and its deviation."""

from __future__ import annotations

from dataclasses import replace

import gcbench.gcpose.fusion.pipeline as pipeline
import numpy as np
import pytest
from gcbench.gcpose.chain.articulation import Articulation, axis_bases, take_step
from gcbench.gcpose.chain.priors import joint_priors
from gcbench.gcpose.estimator import BundleEquations
from gcbench.gcpose.fusion.evidence import FusedHypothesis, FusedPoints, FusedResiduals, in_unit
from gcbench.gcpose.fusion.pipeline import deviation_by_fusion
from gcbench.gcpose.fusion.settings import FusionSettings
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.surfaces import surfaces_from_depth
from gcbench.gcpose.method import GCPose, fusion_pays
from gcbench.gcpose.rgb.residuals import RayResiduals
from gcbench.gcpose.rgb.settings import RgbSettings
from gcbench.gcpose.rgbd.labels import Clouds
from gcbench.gcpose.rgbd.residuals import SurfaceResiduals
from gcbench.gcpose.rgbd.settings import BundleSettings
from gcbench.gcpose.settings import Settings
from gcbench.renderer.types.observation import Observation

from ...support.boxes import scene, told
from ...support.ray_scenes import INTRINSICS, chain, measured

SETTINGS = FusionSettings()


def with_slide() -> tuple[Articulation, np.ndarray]:
    """`chain`, whose second joint slides."""
    state, at = chain()
    twist, angle = state.twist.copy(), state.angle.copy()
    twist[1], angle[:, 1] = [0, 0, 0, 0.6, 0.0, 0.8], 0.1 * angle[:, 1]
    return replace(state, twist=twist, angle=angle, prismatic=np.array([False, True, False])), at


def test_another_unit_of_length_is_the_same_motion() -> None:
    state, _ = with_slide()
    here, there = state.motions(9), in_unit(state, 2.5).motions(9)
    assert np.allclose(here[..., :3, :3], there[..., :3, :3])
    assert np.allclose(here[..., :3, 3], 2.5 * there[..., :3, 3])
    assert np.abs(here[..., :3, 3]).max() > 0.01


@pytest.mark.parametrize("axis_dof", [0, 4])
def test_steps_by_images_do_not_depend_on_the_unit(axis_dof: int) -> None:
    """The images see all in units; a motion in metres takes the same steps."""
    true, at = with_slide()
    points = measured(true, 1.0, 0.0, steps=False)
    by_images = RayResiduals(points, INTRINSICS, 0.3, [(np.arange(240), np.zeros((240, 240)))],
                             RgbSettings())
    exact = surfaces_from_depth(np.ones((9, 24, 32), np.float32), INTRINSICS, ImageSettings())
    no_depth = SurfaceResiduals(exact, Clouds([]), (), BundleSettings())

    def after_steps(unit: float) -> Articulation:
        off = 0.02 * np.random.default_rng(1).standard_normal(true.angle.shape)
        start = replace(true, angle=true.angle + off * (np.arange(9) > 0)[:, None])
        state = in_unit(start, 1 / unit)
        residuals = FusedResiduals(no_depth, by_images, unit, SETTINGS)
        for _ in range(3):
            basis = axis_bases(state, unit * at, axis_dof)
            size = state.angle[1:].size + sum(b.shape[1] for b in basis)
            prior = np.zeros((size, size)), np.zeros(size)
            equations, after = residuals.linearize(state, basis, 3.0, prior)
            step = np.linalg.lstsq(equations.matrix, equations.vector, rcond=1e-9)[0]
            state, residuals = take_step(state, basis, step), after(step)
        return in_unit(state, unit)

    one, other = after_steps(1.0), after_steps(2.5)
    assert np.abs(one.angle - true.angle).max() < 0.02  # they have moved towards the truth
    assert np.allclose(one.angle, other.angle, atol=1e-5)
    assert np.allclose(one.twist, other.twist, atol=1e-4)


def noisy_arm() -> tuple[np.ndarray, np.ndarray, Observation]:
    observation, angle, screw, _ = scene("arm")
    assert observation.depth is not None
    noise = np.random.default_rng(0).normal(0, 0.02, observation.depth.shape)
    depth = (observation.depth + noise).astype(np.float32)
    return angle, screw, replace(told(observation, "free"), depth=depth, depth_noise=0.02)


@pytest.mark.parametrize("wrong", ["images", "depth"])
def test_one_search_that_finds_the_motion_suffices(
    wrong: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    angle, screw, observation = noisy_arm()
    by_images, by_depth = pipeline.motions_by_images, pipeline.search_depth

    def backwards(state: Articulation) -> Articulation:
        return replace(state, angle=-state.angle)

    if wrong == "images":
        monkeypatch.setattr(pipeline, "motions_by_images",
                            lambda *args: [backwards(state) for state in by_images(*args)])
    else:
        monkeypatch.setattr(pipeline, "search_depth", lambda *args: tuple(
            replace(h, state=backwards(h.state)) if hasattr(h, "state") else h
            for h in by_depth(*args)))
    found = GCPose().estimate(observation)
    assert found.screw is not None
    sign = np.where(np.sum(found.screw[:, :3] * screw[:, :3], axis=1) < 0, -1, 1)
    assert np.abs(sign * found.displacement[-1] - angle[-1]).max() < np.radians(8)


@pytest.mark.parametrize(("share", "unreliable"), [("1", False), ("0", True)])
def test_surfaces_that_the_motion_does_not_explain_make_it_unreliable(
    share: str, unreliable: bool
) -> None:
    _, _, observation = noisy_arm()
    settings = Settings().override({"rgbd.search.unreliable_noisy": share})
    found = GCPose(settings=settings).estimate(observation)
    assert found.sigma is not None
    assert ((found.sigma[1:] >= settings.rgbd.sigma_unreliable) == unreliable).all()


def test_it_is_for_several_joints_with_noise_and_unknown_axes() -> None:
    _, _, noisy = noisy_arm()
    slide = replace(told(scene("slide")[0], "free"), depth_noise=0.02)
    known = replace(scene("arm")[0], depth_noise=0.02)
    exact = replace(noisy, depth_noise=0.0)
    assert fusion_pays(noisy, joint_priors(noisy))
    for other in (slide, known, told(known, "axes"), exact):
        assert not fusion_pays(other, joint_priors(other))


def test_another_motion_that_explains_as_much_widens_the_deviation() -> None:
    state, at = chain()
    eye = 1e6 * np.eye(state.angle[1:].size)
    points = FusedPoints(Clouds([]), measured(state, 1.0, 0.0, steps=False))
    best = FusedHypothesis(state, points, at[0], 1.0, BundleEquations(eye, eye[0], eye))
    other = replace(best, state=replace(state, angle=0.5 * state.angle))
    near, far = (deviation_by_fusion([best, replace(other, cost=cost)], SETTINGS)
                 for cost in (1.0, 9.0))
    assert (near[0] == 0).all()
    assert far[-1] == pytest.approx(np.hypot(SETTINGS.floor, SETTINGS.factor * 1e-3), rel=1e-3)
    half = np.abs(0.5 * state.angle[-1])
    assert near[-1] == pytest.approx(np.hypot(far[-1], half / np.sqrt(2)), rel=1e-3)
