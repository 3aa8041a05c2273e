"""Settings of the estimator on plain video.

Lengths are in units of the distance to the object (scale is free without depth); turns are in rad,
displacements in rad, or in that unit where a joint slides.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from ..chain import ChainSettings
from ..numerics import DEGREE, Count, NonNegative, Positive, Scales, Share


@dataclass(frozen=True)
class DeviationSettings:
    """What turns formal standard deviations into those that are reported."""

    factor: Positive = 10.0  # Reported by formal standard deviations of `formal` at `cost`.
    formal: Positive = 0.1 * DEGREE  # Formal deviation at which that factor holds, rad or length.
    power: Positive = 1.0  # Exponent of the formal deviation.
    cost: NonNegative = 3.0  # Cost of patches and tracks at which that factor holds.
    misfit: NonNegative = 0.8  # Growth of the factor's logarithm by that cost.
    excess: Positive = 0.1  # Score above the best at which another motion weighs 1/e.
    spread: NonNegative = 0.35  # Reported by the standard deviation of other motions.
    floor: NonNegative = 0.3 * DEGREE  # Least standard deviation that is reported, rad.
    alone: Positive = 1.0  # Factor of all where no other search has found the motion.


@dataclass(frozen=True)
class RgbSettings:
    """Every tuned number of `gcpose.rgb`, in the order of the stages."""

    chain: ChainSettings = field(default_factory=ChainSettings)

    # sampled pixels
    sweep_points: Count = 220  # Pixels of frame 0 that first steps are searched on.
    min_points: Count = 20  # Moving pixels of frame 0 below which no motion is estimated.
    tracking_points: Count = 100  # Pixels of each key frame while hypotheses are tracked.
    max_points: Count = 130  # Pixels of each key frame while hypotheses are refined.
    final_points: Count = 300  # Pixels of each key frame in the last refinement.
    rim_width: Count = 4
    """Distance from the outline up to which brightness is not followed, px, where points on round
    outlines are followed."""
    rim_width_search: Count = 2  # The same elsewhere.
    edge_radius: NonNegative = 0.004
    """Radius of the rounding of a door's edges in the last refinement, in units of the distance."""
    edge_reach: Positive = 15.0  # Distance from the outline up to which patches show an edge, px.
    label_neighbors: Count = 12  # Nearest sampled pixels over which label costs are averaged.
    same_pixel_cells: NonNegative = 1.5  # Reach of a pixel in other key frames, cells.

    # noise of flow and patches
    flow_sigma: Positive = 0.5  # Standard deviation of flow, px.
    flow_rate: NonNegative = 0.05  # Standard deviation of flow, as a share of its length.
    flow_share: Share = 0.2  # Share of the sampled pixels whose flow errors are independent.
    patch_weight: NonNegative = 3.0  # Weight of patches against the priors in bundle adjustment.
    patch_reach: Positive = 3.0  # Search radius around a patch's predicted place, px.
    patch_reach_new: Positive = 10.0  # The same in a frame that was just added, px.
    patch_reach_first: Positive = 6.0  # The same in the first refinement of a hypothesis, px.
    patch_span: Count = 3  # Frames before and after a patch's own frame in which it is searched.
    patch_span_first: Count = 2  # The same in the first round of a refinement.
    outline_span: Count = 5  # The same in later rounds where points on round outlines are followed.

    # tracks: flow chained from a pixel of a key frame
    track_span: Count = 5  # Frames before and after the pixel's own frame that tracks reach.
    track_sigma: Positive = 0.15  # Standard deviation of a step where the texture is sharp, px.
    track_texture: Positive = 0.01  # Confidence by texture that a plain surface has.
    track_return: NonNegative = 1.0  # Deviation of a step, by the length of flow there and back.
    track_limit: Positive = 2.0  # Length of flow there and back at which a track ends, px.
    track_share: Share = 0.0
    """Share of the tracks whose errors are independent: those of a part err together. 0: no tracks,
    unless the flow is the true one. About 0.05 for DIS."""

    # inverse depths, about 1
    depth_sigma: Positive = 0.3  # Standard deviation about 1 in label costs and sweeps.
    depth_sigma_patch: Positive = 0.1  # The same about the depth by flow, for patches.
    depth_sigma_bundle: Positive = 0.5
    """Standard deviation about the expected depth in bundle adjustment: inverse depths err
    together, so that it is loose."""
    depth_sigma_tracking: Positive = 0.3  # The same while tracking.
    depth_sigma_exchange: Positive = 0.2  # The same where parallel axes exchange turns.
    depth_sigma_measured: Positive = 0.05
    """What takes the place of each of these where depth is measured, about the measured depth."""
    min_inverse_depth: Positive = 0.4  # Least inverse depth.
    max_inverse_depth: Positive = 2.5  # Largest inverse depth.
    max_depth_step: Positive = 0.1  # Largest change of an inverse depth in an iteration.
    neighbor_depth_sigma: Positive = 0.1  # Deviation from the neighbors on the part.
    plane_depth_sigma: Positive = 0.03  # Deviation from the plane through these neighbors.
    slope_sigma: Positive = 2.0  # Standard deviation of the slope of inverse depth by ray.
    max_slope: Positive = 4.0  # Largest slope of inverse depth by ray.

    # label costs
    outlier_width: Positive = 3.0  # Robust scale of flow and patches, standard deviations.
    background_cost: NonNegative = 1.5  # Cost of a place on the background, in outliers.
    depth_rounds: tuple[int, ...] = (4, 0)
    """Iterations of each point's depth in each evaluation of label costs; neighbors share their
    depths after all but the last."""
    patch_label_weight: NonNegative = 2.0  # Weight of patches against flow in label costs.
    order_cost: NonNegative = 0.2  # Cost of a part that is out of order from the base.

    # bundle adjustment
    max_step: Positive = 0.15  # Largest change of an unknown in an iteration, rad or length.
    damping: NonNegative = 1e-6  # Share of the diagonal that is added to it.
    hinge_slack: Positive = 0.1  # Standard deviation of an axis' distance from its hinge.
    tracking_prior: NonNegative = 4.0  # Weight of the priors while tracking (else 1).
    tracking_scales_first: Scales = (6.0, 4.0)
    """Robust scales of the first round of tracking, in standard deviations; one iteration for
    each."""
    tracking_scales: Scales = (3.0, 3.0)  # Robust scales of the second round of tracking.
    refine_scales: Scales = (6.0, 4.0, 3.0)  # Robust scales of the first round of a refinement.
    final_scales: Scales = (3.0, 3.0, 3.0)  # Robust scales of the other rounds.
    drop_at_rest: bool = False  # Whether points at rest do not count, on parts on the base.
    exchange_scales: Scales = (8.0, 6.0)  # Robust scales after turns are exchanged.
    settle_scales: Scales = (6.0, 4.0)  # Robust scales of the adjustment to flow that follows.

    # last refinement of several joints
    last_scales: Scales = (2.0,) * 8
    """`final_scales` there: more, since joints that trade their turns converge slowly."""
    last_hinge_slack: Positive = 0.02  # `hinge_slack` there.
    continued_kept: Count = 3  # Hypotheses with which it goes on for as many rounds again.

    # sweep: a beam search over first steps
    sweep_spans: tuple[Count, ...] = (2, 3)  # Frames between the two frames of each sweep.
    max_turn: Positive = 6.5 * DEGREE  # Largest turn in a frame, rad.
    max_slide: Positive = 0.06  # Largest slide in a frame.
    max_step_frames: Positive = 2.0  # Frames' worth of these steps that is searched at most.
    hinge_places: Count = 14  # Places in the image where a hinge may be.
    hinge_depths: Scales = (0.85, 1.15)  # Depths of those places.
    root_depths: Scales = (0.8, 0.95, 1.1, 1.3, 1.6)  # Depths of the first hinge.
    hinge_depths_measured: Scales = (1.0, 1.05)
    """Depths of all hinges by the measured depth, where there is one."""
    spread_points: Count = 400  # Points from which such places are chosen.
    sweep_scales: Scales = (0.7, 1.0, 1.4)
    """Units of length that are tried where axes are known, in the distance by these axes."""
    beam_width: Count = 1200  # Chains that are extended by the next joint.
    sweep_limit: Positive = 9.0  # Cost at which flow counts as an outlier, in variances.
    outside_cost: NonNegative = 0.5  # Cost of a place outside of the image, in costs of an outlier.
    min_sweep_inverse_depth: Positive = 0.5  # Least inverse depth in a sweep.
    max_sweep_inverse_depth: Positive = 2.0  # Largest inverse depth in a sweep.
    min_texture: NonNegative = 1e-3  # Smallest confidence of flow in a direction.

    # strategies
    sweep_kept: Count = 30  # Chains of each sweep that become hypotheses.
    first_kept: Count = 40  # Distinct hypotheses after the sweeps.
    half_kept: Count = 24  # Distinct hypotheses that are tracked to frame `half_frame`.
    tracked_kept: Count = 10  # Distinct hypotheses that are tracked through the whole video.
    half_frame: Count = 8  # Frame to which these are tracked first.
    distinct_motion_first: NonNegative = 0.07
    """Difference of a displacement that makes hypotheses distinct, rad or length, before
    tracking."""
    distinct_motion: NonNegative = 0.2  # The same afterwards.
    distinct_opposite: NonNegative = 0.2  # The same of displacements in opposite directions.
    distinct_opposite_door: NonNegative = 1 * DEGREE  # The same of a door, without depth.
    distinct_labels: NonNegative = 0.05  # Share of the labels that makes hypotheses distinct.
    key_frame_step: Count = 3  # Frames from one key frame to the next while tracking.
    final_key_frame_step: Count = 2  # The same in refinements.
    base_slow_share: Share = 0.04  # Share of the pixels, the slowest, where the base may be.
    base_end_share: Share = 0.03  # Share of the pixels, at an end, that are averaged.
    base_frames: Count = 3  # Frames before and after over which speeds are averaged for it.
    tilts: Count = 8  # Planes through a door's axis that are tried.
    min_tilt_scale: Positive = 0.3  # Least mean depth of a door in a plane.
    max_tilt_scale: Positive = 3.0  # Largest mean depth of a door in a plane.
    min_tilt_share: Share = 0.8  # Share of the points that must have a possible depth in a plane.
    max_door_turn: Positive = 112 * DEGREE  # Largest turn of a door that is tried, rad.
    door_turn_step: Positive = 16 * DEGREE  # Difference between two such turns, rad.
    door_axis_reach: Scales = (0.3, 3.0)
    """Least and largest place of the axis beside the plane that is fitted to such a turn: 1 on the
    plane, 0 at the camera."""
    exchange_limit: Positive = 3.0  # Error above which a place counts less in these fits, px.
    plane_tilts: Count = 4  # Directions of the planes on which a door's points are searched.
    plane_depths: Scales = (0.75, 0.87, 1.0, 1.15, 1.35)
    """Distances of these planes from the camera, in that of the plane through the door's center."""

    edge_on_share: Share = 0.75
    """Share of the median area of the foreground below which a frame shows a door edge-on."""
    edge_on_shifts: Scales = (2.5 * DEGREE, 6.0 * DEGREE)
    """Changes of the turn across such a frame that are tried, in both directions, rad."""
    edge_on_paces: Scales = (0.6, 1.0, 1.5)
    """Paces of one side of such a frame that are tried, as multiples of that of the other side."""
    edge_on_rounds: Count = 4  # Rounds in which they are tried at most.

    # lost frames of one part
    link_reach: Positive = 30 * DEGREE  # Difference of displacements of linked frames at most.
    link_points: Count = 30  # Patches of one that are predicted in the other, at least.
    link_cost: NonNegative = 2.9  # Mean cost of these up to which they are linked.
    max_rest: Share = 0.5
    """Cost of a point's patches at its own pixel, by that where it should be, up to which it is at
    rest and links nothing."""
    link_edges: Count = 3  # Edges of a door in each of two frames that they link, at least.
    link_misfit: Share = 0.5  # Share of these that may not be explained.
    contrary_misfit: Share = 0.8
    """Share of the edges of a frame from which on, if not explained, they say otherwise."""
    relocalization_step: Positive = 2 * DEGREE  # Between displacements that are tried.
    relocalization_lead: Positive = 2.5
    """Information of the patches that are found at the best of them, in that at most of them."""
    edge_relocalization_step: Positive = 0.5 * DEGREE  # The same by the edges of a door.
    edge_relocalization_width: Positive = 2 * DEGREE
    """Difference from the best of these above which no other one may explain the edges."""
    relocalization_rounds: Count = 3  # Rounds of relocalization at most.
    revisits: bool = False
    """Whether patches are also searched in all frames that may be linked with their own."""
    lost_deviation: Positive = 20 * DEGREE  # Standard deviation of a lost frame, rad or length.

    # straight edges of a door
    edge_weight: NonNegative = 20.0  # Weight against the patches; 0: they are not looked for.
    edge_end_sigma: Positive = 0.35  # Standard deviation of the places of their ends, px.
    edge_tilt_sigma: Positive = 0.1 * DEGREE
    """Standard deviation of the tilt that an edge shows, besides that, rad."""
    edge_frame_sigma: NonNegative = 0.05 * DEGREE  # That of what the edges of a frame share, rad.
    max_tilt_sigma: Positive = 6 * DEGREE  # Standard deviation above which no tilt is shown, rad.
    min_edge_sine: Share = 0.05
    """Sine of the angle between the axis and the plane of camera and edge, below which none is."""
    max_edge_step: Positive = 10 * DEGREE  # Largest turn in a frame by edges alone, rad.
    edge_jerk_cost: NonNegative = 0.02
    """Cost of a change of this turn by 1 degree, in edges of a frame."""
    min_edge_frames: Share = 0.25  # Share of the frames with edges below which these do not count.
    max_edge_misfit: Share = 0.48
    """Share of the edges that the best turns by edges alone do not explain, above which edges do
    not count: they are not across the axis."""
    min_edge_turn: Positive = 2 * DEGREE  # Largest turn below which these turns are not tried, rad.

    # axis of a door whose direction is not known, by these edges
    axes_tried: Count = 10  # Directions of each kind from which the best is searched.
    distinct_axis: Positive = 4 * DEGREE  # Angle between any two of them, rad.
    axis_rounds: Count = 8  # Iterations for each of them.
    max_axis_step: Positive = 0.1  # Largest turn of it in an iteration, rad.
    min_axis_share: Share = 0.75  # Share of the edges that it must explain.
    min_axis_lead: Share = 0.08  # By how much more it must explain than any other direction.
    max_axis_sigma: Positive = 2 * DEGREE  # Standard deviation above which it is not known, rad.
    axis_deviation: NonNegative = 2.0
    """Reported deviation of a turn by that which the axis adds: edges err together."""

    min_box_share: Share = 0.75  # Share of the edges that the directions of a box must explain.
    min_box_second: Share = 0.02  # Share of those that have another one than most of them.

    # focal length, where it is not known, by the same edges
    axes_tried_by_focal: Count = 4  # `axes_tried` for each focal length.
    focals_kept: Count = 3  # Focal lengths that are refined.
    focal_apart: Positive = 0.15  # Logarithm of another one, which must explain fewer edges.
    min_focal_lead: Share = 0.01  # By how much.
    still_edge_weight: NonNegative = 0.5  # Of edges that stand still, for a drawer.
    min_box_focal_share: Share = 0.9  # Share of the edges that must be explained, for a drawer.

    # one part that slides
    slides_tried: tuple[float, ...] = (-0.25, -0.1, 0.1, 0.25)
    """Slides at the last frame that are tried with a constant pace."""
    slides_from: Count = 3  # Motions whose directions they have.
    distinct_slide: NonNegative = 0.03  # `distinct_motion` of slides.
    box_lead: NonNegative = 0.15
    """Score by which another direction must be better than that of a straight edge."""

    # parallel axes
    exchange_points: Count = 220  # Pixels of the key frame on which turns are exchanged.
    parallel_cosine: Share = 0.98  # Cosine above which axes count as parallel.
    exchange_places: Count = 16  # Places of the second axis that are tried.
    exchange_feet: Count = 3  # Places of the first axis that are tried for each.
    exchange_shares: tuple[float, ...] = (-1.5, -0.75, 0.0, 0.5, 1.0, 1.75, 2.5)
    """Shares of the total turn that the first axis is given."""
    min_axis_distance: NonNegative = 0.03  # Least distance between parallel axes.

    # choice among hypotheses
    tilted_kept: Count = 3  # Distinct hypotheses for which a door's planes are tried.
    refined_kept: Count = 6  # Distinct hypotheses in the second refinement.
    door_rounds: Count = 2
    """Rounds in which other turns and depths of a door are tried; 1 where its edges count."""
    turned_kept: Count = 3  # Distinct hypotheses that are given the turns by the edges alone.
    doors_kept: tuple[Count, ...] = (8, 5, 3)
    """Distinct hypotheses of a door in the rounds that search its depths."""
    exchanged_from: Count = 3
    """Distinct motions whose turns are exchanged, if several pairs of neighboring axes are
    parallel; else only those of the best."""
    exchanged_kept: Count = 3  # Distinct hypotheses of each with turns shared otherwise.
    final_kept: Count = 3  # Distinct hypotheses in the last refinement.
    patch_outlier_cost: NonNegative = 9.0  # Score of a patch that is found elsewhere.
    patch_missing_cost: NonNegative = 4.0  # Score of a patch that is not found.
    score_tracks: NonNegative = 1.0  # Weight of the cost of tracks against the patches'.
    score_flow: NonNegative = 0.2  # Weight of the flow cost against the patches'.
    score_flow_pair: NonNegative = 0.7  # The same where there are two flows.
    score_agreement: NonNegative = 0.1  # Subtracted for each other search that agrees.
    agreement: NonNegative = 3 * DEGREE
    """Difference of a last displacement up to which motions of two searches agree, rad or
    length."""
    score_jerk: NonNegative = 30.0  # Weight of the RMS second difference, 1/rad.
    score_inversions: NonNegative = 1.5  # Weight of the share of labels out of order.
    score_offset: NonNegative = 0.1  # Weight of an axis that passes far from its hinge.
    axis_offset: Positive = 0.2  # Distance of an axis from its hinge that counts half.
    score_edges: NonNegative = 1.0  # Weight of the share of a door's edges that is not explained.
    edge_scale: Positive = 3.0  # Robust scale of edges in this share, standard deviations.
    score_sigma: NonNegative = 0.1  # Weight of the logarithm of a standard deviation.
    min_sigma: Positive = 0.004  # Least standard deviation in a score, rad.

    # estimate
    deviation: DeviationSettings = field(default_factory=DeviationSettings)
    """The reported deviations."""
    deviation_pair: DeviationSettings = DeviationSettings(
        power=1.5, misfit=0.0, excess=0.05, floor=0.1 * DEGREE, alone=1.5)
    """The same where there are two flows."""
    deviation_free: DeviationSettings = DeviationSettings(
        factor=17.0, spread=0.6, floor=0.5 * DEGREE)
    """The same of several joints of whose axes nothing is known."""
    deviation_edges: DeviationSettings = DeviationSettings(
        factor=7.0, misfit=0.4, floor=0.1 * DEGREE)
    """The same of a door whose edges count."""
    deviation_slide: DeviationSettings = DeviationSettings(floor=0.001)
    """The same of one part that slides."""
    object_depth_deviation: NonNegative = 0.025
    """Reported deviation of a slide by itself, where its unit is the known depth of what moves:
    that of the points may differ."""
    box_deviation: NonNegative = 1.0
    """Reported deviation of a slide by that of its direction, where straight edges show it."""
    shadow_deviation: NonNegative = 4 * DEGREE
    """Reported deviation of a turn where much that stays under shadows was left out, rad."""
    sigma_unknown: Positive = 1.0  # Largest standard deviation reported, rad or m.
    part_stride: Count = 2  # Pixels from one to the next whose part is looked up.


def with_two_flows(settings: RgbSettings) -> RgbSettings:
    """Return the settings for a video with two flows."""
    return replace(settings, score_flow=settings.score_flow_pair,
                   deviation=settings.deviation_pair)


def for_last_refinement(settings: RgbSettings) -> RgbSettings:
    """Return the settings for the last refinement of several joints."""
    return replace(settings, final_scales=settings.last_scales,
                   hinge_slack=settings.last_hinge_slack, drop_at_rest=True)


def for_one_joint(settings: RgbSettings, slides: bool) -> RgbSettings:
    """Return the settings for one part that turns or slides, whose depth is not measured.

    The foreground may hold much that is at rest, under the shadow of what moves or of a person.
    """
    s = replace(settings, drop_at_rest=True)
    return (replace(s, deviation=s.deviation_slide) if slides else
            replace(s, distinct_opposite=s.distinct_opposite_door))


def for_relocalization(settings: RgbSettings) -> RgbSettings:
    """Return the settings for finding lost frames again."""
    return replace(settings, revisits=True, score_jerk=0.0)


def with_measured_depth(settings: RgbSettings) -> RgbSettings:
    """Return the settings for a video whose depth is measured."""
    s, sigma = settings, settings.depth_sigma_measured
    return replace(
        s, depth_sigma=sigma, depth_sigma_patch=sigma, depth_sigma_bundle=sigma,
        depth_sigma_tracking=sigma, depth_sigma_exchange=sigma,
        hinge_depths=s.hinge_depths_measured, root_depths=s.hinge_depths_measured)
