"""Settings of the estimator with depth.

A footprint is the size of a pixel on the surface at a point's depth. Robust scales are tuples with
one number for each iteration, in footprints. A field that ends in `_noisy` takes the place of the
field without the ending where the depth has noise.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from ..chain import ChainSettings
from ..numerics import DEGREE, Count, NonNegative, Positive, Scales, Share
from . import strategies
from .strategies import Strategy


@dataclass(frozen=True)
class LabelSettings:
    """Settings of moving pixels and of label costs."""

    static_depth: NonNegative = 1.5e-4  # Difference between two measurements of a static point, m.
    static_noise: NonNegative = 5.0  # Added to it, standard deviations of the depth.
    static_votes: Count = 3
    """Frames that must show a pixel unchanged for it to be static; a frame just before or after
    counts for all."""
    static_color: NonNegative = 2.0  # Color change of a static pixel under noise, grey levels.
    static_window: Count = 3  # Side of the window over which colors are averaged, px.
    seen_through_noise: NonNegative = 20.0
    """Standard deviations of the depth by which a pixel is behind a static one at least."""
    moving_window: Count = 9  # Side of the window by which changing pixels are dilated, px.

    # costs of a point in a frame, in variances of its distance
    cost_seen_through: NonNegative = 9.0  # The frame shows a surface behind the point.
    cost_hidden: NonNegative = 3.0  # A surface in front hides the point.
    cost_hidden_static: NonNegative = 1.0  # A surface in front hides a point of the static part.
    cost_outside: NonNegative = 2.0  # The point is outside the image.
    cost_turned_away: NonNegative = 2.0  # The point's own part hides it.
    cost_other_surface: NonNegative = 1.0  # The surface has another normal.
    surface_gap: Positive = 20.0  # Depth gap within one surface, standard deviations.


@dataclass(frozen=True)
class BundleSettings:
    """Settings of bundle adjustment."""

    min_normal_cosine: Share = 0.6  # Least cosine between normals of one surface.
    max_step: Positive = 0.15  # Largest change of an unknown in an iteration, rad or m.
    damping: NonNegative = 1e-6
    """Share of the diagonal that is added to it; with more, flat valleys take hundreds of steps."""
    damping_floor: NonNegative = 1.0  # Number that is added to the diagonal, 1/rad^2 or 1/m^2.
    min_part_points: Count = 6  # Points of a frame that a part must have to count.
    flow_sigma: Positive = 1.0  # Robust scale of flow, px.
    flow_share: Share = 0.05  # Share of the pixels whose flow errors are independent.
    flow_stride: Count = 2  # One in this number of points is compared: neighbors err alike.
    flow_depth_noise: Positive = 15.0
    """Distance from the measured surface within which flow is of the point, standard deviations of
    the depth."""


@dataclass(frozen=True)
class TrackerSettings:
    """Settings of EM over frames."""

    key_frame_step: Count = 3  # Frames from one key frame to the next.
    hinge_slack: Positive = 0.08  # Standard deviation of an axis from its hinge, by the extent.
    extend_scales: Scales = (8.0, 4.0)  # Robust scales for a frame that was just added.
    track_scales: Scales = (3.0, 1.5)  # Robust scales for all frames after that.
    em_scales: Scales = (4.0, 2.0, 1.0)  # Robust scales of a round of EM.
    unexplained_cost: Positive = 2.0  # Label cost by frame of an unexplained point, variances.

    # base point
    moving_cost: Positive = 0.9  # Cost by frame at rest above which a point moves, variances.
    base_stride: Count = 4  # Pixels from one to the next that are sampled for the base.
    min_base_points: Count = 20  # Static points of frame 0 below which the base counts as hidden.
    base_share: Share = 0.03  # Share of the points, the nearest, averaged to the base point.
    base_candidates: Count = 3  # Ends of what moves that are tried as the base.
    far_rank: Share = 0.98  # Geodesic rank above which a point is at the other end.
    max_rank_correlation: Share = 0.9  # Above this, two geodesic ranks are alike.


@dataclass(frozen=True)
class SweepSettings:
    """Settings of starts from depth: a beam search over first steps."""

    max_turn: Positive = 6.5 * DEGREE  # Largest turn in a frame, rad.
    max_slide: Positive = 0.06  # Largest slide in a frame, m.
    max_step_frames: Positive = 2.0  # Frames' worth of steps that is searched at most.
    places: Count = 14  # Places where a hinge may be.
    spread_points: Count = 400  # Points from which the places are chosen.
    points: Count = 120  # Points of frame 0 that are compared.
    beam_width: Count = 2500  # Chains that are extended by the next joint.
    pixel_sigma: Positive = 6.0  # Standard deviation of a place due to the grid of steps, px.
    noise_factor: Positive = 2.0  # Standard deviation due to noise, by that of the depth.


@dataclass(frozen=True)
class StartSettings:
    """Settings of starts from optical flow and depth."""

    cuts: Scales = (0.06, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9)
    """Geodesic ranks where one part may end and the next may begin."""
    hinge_slacks: Scales = (0.0075, 0.0015)
    """Standard deviations of a hinge's displacement, by the object's extent; where the axes' lines
    are known only the first is used."""
    turn_sigma: Positive = 0.15  # Standard deviation of a joint's turn, rad.
    rounds: Count = 5  # Rounds of EM.
    min_turn: Positive = 0.3 * DEGREE  # Below this turn an axis is put through its hinge, rad.

    # correspondences
    flow_sigma: Positive = 1.5  # Standard deviation of flow, px.
    flow_rate: NonNegative = 0.1  # Added to it, as a share of the flow's length.
    surface_sigma: Positive = 1.5  # Standard deviation from the surface, footprints.
    surface_rate: NonNegative = 0.03  # Added to it, as a share of the flow's length on the surface.
    gate_rate: NonNegative = 3.0
    """A match is valid within this share of the flow's length on the surface."""
    gate_sigma: NonNegative = 20.0  # Added to it, standard deviations.
    gate_distance: NonNegative = 0.05  # Added to it, m.
    robust_scales: Scales = (20.0, 6.0, 3.0, 3.0)  # Of each iteration, standard deviations.

    # label costs in variances
    max_surface_cost: Positive = 16.0  # Largest cost of a distance from the surface.
    missing_surface_cost: NonNegative = 8.0  # Its cost where there is no match.
    max_flow_cost: Positive = 9.0  # Largest cost of flow.
    missing_flow_cost: NonNegative = 4.0  # Its cost where the flow leaves the image.
    flow_weight: Positive = 0.5  # Weight of the cost of flow.


@dataclass(frozen=True)
class RefineSettings:
    """Settings of EM until nothing changes."""

    rounds: Count = 10  # Rounds at most.
    sharp_rounds: Count = 40  # Rounds at most with the sharp scales.
    sharp_scales: Scales = (0.5, 0.25, 0.12, 0.12)  # Robust scales of a round where depth is exact.
    sharp_width: Positive = 0.12  # Width of label costs where depth is exact, footprints.
    noisy_scales: Scales = (1.0, 1.0, 1.0, 1.0)
    """Robust scales of a round by depth alone, at the end, where depth has noise."""
    creep: Positive = 0.1 * DEGREE  # Change in a round that is extrapolated, rad or m.
    stop: Positive = 0.01 * DEGREE  # Change in a round below which EM ends, rad or m.
    noisy_factor: Positive = 6.0  # Factor of both changes where depth has noise.
    leap: Positive = 4.0  # Length of an extrapolation, in changes of a round.


@dataclass(frozen=True)
class MotionSettings:
    """Settings of chains that are fitted to part motions."""

    scales: Scales = (8.0, 6.0, 4.0, 4.0, 2.0, 2.0, 1.0, 1.0)
    """Robust scale of each alignment of the parts without the chain."""
    damping: NonNegative = 1e-4  # Share of the diagonal that is added to it.
    max_step: Positive = 0.2  # Largest change of an unknown in an iteration, rad or m.
    starts: Count = 600  # Random chains.
    places: Count = 24  # Places where their hinges may be.
    kept_directions: Share = 0.3  # Share of the axes that keep the hypothesis' direction.
    fitted: Count = 180  # Chains whose axes are freed.
    max_misfit: Positive = 1e-3  # Weighted error of a chain that makes a motion, rad and m.
    misfit_factor: Positive = 2.0  # Or that error by the smallest, where it is more.
    min_difference: NonNegative = 2.0 * DEGREE  # Least difference of last displacements, rad or m.


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the choice among hypotheses."""

    coarse_candidates: Count = 500  # Points of a frame for most hypotheses where axes are free.
    relabeled: Count = 4  # Distinct hypotheses of a strategy that all points label again.
    polished: Count = 3  # Distinct hypotheses that are tracked to the last frame.
    refined: Count = 3  # Distinct hypotheses of these that are refined.

    # shares of the points that no part explains
    doubtful: Share = 0.025  # Above this, chains that move the surest part alike are tried.
    poor_known_lines: Share = 0.045  # Above this, other starts are tried, if axes are known.
    poor_known_lines_noisy: Share = 0.03
    poor: Share = 0.08  # The same if they are not.
    poor_noisy: Share = 0.05
    unreliable: Share = 0.11  # Above this, an estimate is unreliable.
    unreliable_noisy: Share = 0.09

    # other chains
    jumps: Count = 3  # Changes to another chain at most.
    jump_cost: Positive = 0.99  # Relative cost of another chain that is worth the change.
    tried: Count = 10  # Other chains that are refined on few points.
    tried_rounds: Count = 2  # Rounds of EM on few points.
    tried_fully: Count = 4  # Other chains that are refined on all points.
    tried_fully_rounds: Count = 5  # Rounds of EM on all points.
    tried_sharply: Count = 3  # Other chains that are refined with the sharp scales.
    promising_cost: Positive = 1.3  # Cost above which they are not, by the cost of the present one.
    distinct_angle: NonNegative = 12.0 * DEGREE  # Least difference of distinct chains, rad.
    same_angle: NonNegative = 1.0 * DEGREE  # Largest difference of equal solutions, rad.
    static_angle: NonNegative = 5.0 * DEGREE  # Largest displacement of a static joint, rad.
    static_penalty: NonNegative = 0.05  # Share of its cost added for a static joint.


@dataclass(frozen=True)
class RgbdSettings:
    """Settings of the estimator with depth."""

    candidates: Count = 1500  # Sampled points of a frame.
    candidates_noisy: Count = 900
    max_noise_share: Positive = 0.06
    """Noise of the surfaces, by the size of a part, above which images are better evidence than
    depth."""
    min_moving_pixels: Count = 30  # If fewer pixels of frame 0 may move, all joints are static.
    final_scales: Scales = (0.25, 0.12, 0.12)  # Robust scales of the last bundle adjustment.
    final_scales_noisy: Scales = (1.0, 0.6, 0.4, 0.4)

    # reported standard deviations
    sigma_factor_known_lines: Positive = 2.7  # Reported by formal ones where axes are known.
    sigma_factor_known_directions: Positive = 2.9  # The same where directions are known.
    sigma_factor_free: Positive = 2.5  # The same where nothing is known.
    sigma_factor_noisy: Positive = 8.2  # The same where depth has noise.
    sigma_factor_noisy_vague: Positive = 16.5
    """The same where depth has noise and little is known of the axes: nothing, or only the
    direction of a single one."""
    sigma_floor_noisy: NonNegative = 0.1 * DEGREE  # Least one there, rad or m.
    sigma_unreliable: NonNegative = 10.0 * DEGREE  # Least one of an unreliable estimate.
    sigma_static: Positive = 1.0  # Largest one, also where nothing was seen to move, rad or m.

    # stages
    labels: LabelSettings = field(default_factory=LabelSettings)
    bundle: BundleSettings = field(default_factory=BundleSettings)
    tracker: TrackerSettings = field(default_factory=TrackerSettings)
    sweep: SweepSettings = field(default_factory=SweepSettings)
    start: StartSettings = field(default_factory=StartSettings)
    refine: RefineSettings = field(default_factory=RefineSettings)
    motion: MotionSettings = field(default_factory=MotionSettings)
    search: SearchSettings = field(default_factory=SearchSettings)
    chain: ChainSettings = field(default_factory=ChainSettings)

    # strategies, in the order in which they are tried
    known_lines: Strategy = strategies.KNOWN_LINES  # Where the axes' lines are known.
    known_lines_more: Strategy = strategies.KNOWN_LINES_MORE
    free_sweeps: Strategy = strategies.FREE_SWEEPS  # Where they are not: depth and flow.
    free_flow: Strategy = strategies.FREE_FLOW  # Then flow alone, with free axes.
    free_sweeps_more: Strategy = strategies.FREE_SWEEPS_MORE  # Then more from depth.
