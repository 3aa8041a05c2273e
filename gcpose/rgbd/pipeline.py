"""GC-Pose on RGB-D video: the stages of the paper (Fig. 2) with depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...renderer.types import Estimate, Observation
from ...robots.geometry import Array
from ..chain import Articulation, ChainSettings, JointPriors, extent, screws_of
from ..estimator import Adjustment, adjust, calibrate_deviation
from ..images import Flow, ImageSettings, Surfaces, surfaces_from_depth, surfaces_from_noisy_depth
from ..numerics import thread_map
from .evidence import DepthHypothesis, RgbdEvidence
from .labels import moving_mask
from .search import is_unreliable, search_hypotheses
from .settings import RgbdSettings


@dataclass(frozen=True)
class DepthVideo:
    """A video with depth."""

    rgb: NDArray[np.uint8]
    """[T H W 3]"""
    surfaces: Surfaces
    moving: NDArray[np.bool_]
    """[T H W] what may move"""

    def noise_share(self, joints: int, settings: ChainSettings) -> float:
        """Return the noise of the surfaces by the size of a part: the extent of what moves in frame
        0 by the number of joints."""
        v, u = np.nonzero(self.moving[0])
        size = extent(self.surfaces.points(0, np.column_stack([u, v])), settings) / joints
        return self.surfaces.noise / max(1e-9, size)


def depth_video(
    observation: Observation, flow: Flow, settings: RgbdSettings, images: ImageSettings
) -> DepthVideo | None:
    """Return what an observation with depth shows; None where nothing moves. The flow is for noisy
    depth."""
    rgb, depth, noise = observation.rgb, observation.depth, observation.depth_noise
    if rgb is None or depth is None or len(depth) < 2:
        return None
    surfaces = (
        surfaces_from_noisy_depth(depth, rgb, observation.intrinsics, noise, flow, images)
        if noise > 0 else surfaces_from_depth(depth, observation.intrinsics, images))
    moving = moving_mask(surfaces, rgb, settings.labels)
    if np.count_nonzero(moving[0]) < settings.min_moving_pixels:
        return None
    return DepthVideo(rgb, surfaces, moving)


def estimate_rgbd(
    video: DepthVideo, priors: JointPriors, flow: Flow, settings: RgbdSettings
) -> Estimate:
    """Estimate the motion of one sequence with depth (Sec. 3.2 to 3.4). The flow is for starts."""
    evidence, best, final = search_depth(video, priors, flow, settings)
    state, noisy = final.state, video.surfaces.noise > 0
    return Estimate(state.angle, screws_of(state.twist, state.prismatic),
                    label_frames(evidence, state),
                    calibrate_sigma(final.deviation(), priors.axis_dof, noisy,
                                    is_unreliable(evidence, best), settings))


def search_depth(
    video: DepthVideo, priors: JointPriors, flow: Flow, settings: RgbdSettings
) -> tuple[RgbdEvidence, DepthHypothesis, DepthHypothesis]:
    """Return the evidence of a video with depth, the best hypothesis of the search, and the same
    after the last bundle adjustment."""
    surfaces = video.surfaces
    evidence = RgbdEvidence(surfaces, video.rgb, video.moving, priors, settings)
    best = search_hypotheses(evidence, flow)
    scales = settings.final_scales_noisy if surfaces.noise else settings.final_scales
    return evidence, best, adjust(evidence.without_flow(), best, Adjustment(scales))


def calibrate_sigma(
    formal: Array, axis_dof: int, noisy: bool, unreliable: bool, settings: RgbdSettings
) -> Array:
    """Return the reported standard deviations [T J] for formal ones [T-1 J]; see
    `JointPriors.axis_dof`."""
    s = settings
    factors = {0: s.sigma_factor_known_lines, 2: s.sigma_factor_known_directions,
               4: s.sigma_factor_free}
    factor, floor = factors[axis_dof], 0.0
    if noisy:
        vague = axis_dof == 4 or (axis_dof > 0 and formal.shape[1] == 1)
        factor = s.sigma_factor_noisy_vague if vague else s.sigma_factor_noisy
        floor = s.sigma_floor_noisy
    if unreliable:
        floor = s.sigma_unreliable
    return calibrate_deviation(formal, factor, floor, s.sigma_static)


def label_frames(evidence: RgbdEvidence, state: Articulation) -> NDArray[np.uint8]:
    """Return labels [T H W] of all frames; pixels without a candidate are static."""
    surfaces = evidence.surfaces
    height, width = surfaces.depth[0].shape
    out = np.zeros((surfaces.frames, height, width), np.uint8)
    motion = state.motions(len(state.angle))

    def fill(frame: int) -> None:
        grid = evidence.grid(frame)
        if not len(grid.point):
            return
        cloud, _ = evidence.label_frame(motion, frame)
        step = grid.stride
        small = np.zeros((height // step + 1, width // step + 1), np.uint8)
        small[grid.pixel[:, 1] // step, grid.pixel[:, 0] // step] = cloud.label
        out[frame] = small.repeat(step, axis=0).repeat(step, axis=1)[:height, :width]

    thread_map(fill, range(surfaces.frames))
    return out
