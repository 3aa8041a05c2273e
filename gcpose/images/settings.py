"""Settings of what is measured in images: foreground, texture, patches, surfaces."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..numerics import Count, NonNegative, Positive, Scales, Share, Whole


@dataclass(frozen=True)
class FlowSettings:
    """Settings of optical flow, by the names of `--flow`."""

    fine_scale: Whole = 0  # Finest scale of `dis-fine`; 0 is the full resolution.
    fine_stride: Count = 2  # Distance between the patches of `dis-fine`, px.
    fine_iterations: Count = 40  # Gradient descent steps of each patch of `dis-fine`.
    raft_iterations: Count = 6  # Corrections that `raft` makes.
    raft_side: Count = 320
    """Smaller side of the images that `raft` sees, px. It was trained on images of 0.75 to 1.6
    times 240 px, and its errors are least at this size."""
    raft_rate: Positive = 1e-4
    """Learning rate at which `raft` and the networks of torchvision are tuned to a video."""
    flownet2_rate: Positive = 5e-7  # The same of `flownet2` (Sec. 4.1).

    def raft_reduction(self, height: int, width: int) -> float:
        """Return the factor by which `raft` reduces images of a size, px."""
        return max(1.0, min(height, width) / self.raft_side)


@dataclass(frozen=True)
class ImageSettings:
    """Every tuned number of `gcpose.images`. Grey levels are of 255."""

    flow: FlowSettings = field(default_factory=FlowSettings)

    # moving foreground of a still camera
    foreground_margin: Positive = 0.15
    """Margin around what changes in the square that the network sees, by its side."""
    foreground_edge: Positive = 1.5
    """Distance from the network's mask up to which pixels may move, pixels of the network."""
    person_probability: Share = 0.3  # Probability of a person above which a pixel is left out.
    foreground_frames: Count = 30  # Frames at most in which the usual color is searched.
    change_threshold: Count = 3  # Change of a pixel that may move, grey levels.
    background_threshold: Count = 6  # The same of the foreground from the background.
    same_threshold: Count = 1  # Grey levels within which a pixel shows the same in two frames.
    min_foreground: Count = 150  # Area below which a piece of foreground is noise, px.
    max_gap: Count = 300  # Area below which a gap in the foreground is filled, px.
    max_static_gap: Count = 1500  # The same for a gap that does not change, px.
    static_gap_share: Share = 0.3  # Share of a gap's pixels that must not change.
    crop_margin: Count = 24  # Margin of the crop around what moves, px.

    # noise of the camera
    noise_blur: Positive = 1.5  # Standard deviation of the blur before changes are measured, px.
    noise_shares: Scales = (0.5, 0.3)
    """Quantiles of the changes of all pixels, of which the first that is small enough is the noise:
    where an object moves over most of the image, the median is too large. There is no noise if the
    last one is 0."""
    max_noise: Positive = 4.0  # Noise up to which a quantile is small enough, grey levels.
    most_noise: Positive = 8.0  # Noise up to which the last one counts if none is small enough.
    weak_change: tuple[NonNegative, NonNegative] = (1.5, 2.0)
    """Change above which a pixel may move, grey levels: without noise, and more for each grey level
    of noise."""
    strong_change: tuple[NonNegative, NonNegative] = (4.0, 3.0)
    """The same above which it moves: these pixels take connected ones that may move with them."""
    min_strong: Count = 20  # Such pixels in a region that moves.

    # texture that stays where it is, in spite of shadows
    still_window: Positive = 2.5  # Standard deviation of the window that is compared, px.
    still_contrast: Positive = 3.0  # Least standard deviation in it, grey levels.
    still_correlation: Share = 0.9  # Least correlation of a texture with its median over time.
    still_frames_share: Share = 0.8  # Share of the frames in which such a texture is the same.
    max_still_texture: Share = 0.2
    """Share of the texture in what is taken for moving that stays, above which it is left out for
    one joint that turns, and no slide in a video file is reliable."""

    # motion of the camera
    still_distance: Positive = 0.5  # Distance from its place at which a feature is still, px.
    still_share: Share = 0.2
    """Share of the features that are still, in the median of the frames, below which the camera
    moves."""
    max_background_error: Positive = 4.0
    """Distance from its place up to which a feature stands still, px."""
    background_share: Share = 0.5  # Share of such features below which the camera moves too much.
    sure_background_error: Positive = 1.2
    """Distance from its place of nine tenths of what stands still above which no joint is reliable,
    px."""
    sure_parallax: Count = 20
    """Features whose parallax must agree, if there is any, or no joint is reliable."""
    max_camera_shift: Share = 0.15
    """Motion of the background above which the camera moves too much, in sides of the image."""
    aligned_margin: Count = 6  # Distance from what a frame does not show where nothing moves, px.
    level_step: Positive = 1.0  # Largest shift from one inverse depth to the next, px.
    max_levels: Count = 10  # Inverse depths at which a pixel may stand still.
    level_window: Positive = 15.0  # Side of the square in which one fits best, px.
    level_rest: NonNegative = 3.0
    """Grey levels by which a pixel changes more than at the best of them where others fit too."""
    min_noise_aligned: NonNegative = 2.0  # Least noise of aligned frames, grey levels.
    min_strong_aligned: Count = 100  # `min_strong` after frames are aligned: edges stay.
    moving_gap: Count = 5  # Half of the gap that is closed between pixels that move, px.
    slight_change: NonNegative = 1.0
    """Change above which a pixel moves where something moves in any frame, grey levels."""

    # exposure of the camera
    exposure_knots: Count = 9  # Knots of a tone curve.
    exposure_smoothness: Positive = 5e-4  # Weight of its bends, by the squared scale.
    exposure_ridge: Positive = 1e-5  # Weight of its difference from a factor, squared grey levels.
    exposure_scales: Scales = (16.0, 16.0, 8.0, 8.0, 4.0, 4.0, 2.0, 2.0)
    """Scales of the robust weights by which it is fitted in turn, grey levels."""
    min_exposure_change: NonNegative = 1.0
    """Mean change of the image below which the exposure is constant, grey levels."""

    # appearance
    brightness_blur: Positive = 0.8  # Standard deviation of the blur of brightness, px.
    outline_blur: Positive = 1.0  # Standard deviation of the blur of the outline, px.
    outline_contrast: Positive = 60.0  # Grey levels of the outline's channel inside of what moves.
    sharp_distance: Positive = 3.0  # Distance from what moves at which a background is known, px.
    sharp_contrast: NonNegative = 20.0
    """Least difference of what moves from the background at a sharp outline, grey levels."""
    sharp_rest: NonNegative = 4.0  # Largest difference beside it, grey levels.
    texture_blur: Positive = 1.0  # Standard deviation of the blur before gradients, px.
    texture_window: Positive = 2.0  # Standard deviation of the structure tensor's window, px.
    texture_scale: Positive = 60.0
    """Eigenvalue of the structure tensor at which confidence is 1/2, squared grey levels by
    px^2."""
    min_relative_depth: NonNegative = 0.5  # Least inverse depth, by the median.
    max_relative_depth: Positive = 2.0  # Largest inverse depth, by the median.

    # straight edges
    min_edge_length: Positive = 0.25
    """Least length of a straight edge, in sides of a square as large as the foreground."""
    edge_margin: Whole = 3  # Distance from the foreground up to which an edge may be, px.
    min_edge_share: Share = 0.8  # Least share of an edge in or near the foreground.
    still_edge_frames: Count = 12  # Distant frames in which a still edge is looked for at most.
    still_edge_share: Share = 0.4  # Share of these frames that a still edge is seen in.
    still_edge_distance: Positive = 1.5  # Distance at which an edge is the same, px.
    still_edge_overlap: Share = 0.4  # Share of its length that must be the same.

    # patches
    patch_radius: Count = 3  # Radius of patches, px; larger patches cover more than one part.
    patch_sigma: Positive = 0.1  # Error of a patch's model, px.
    patch_rate: NonNegative = 0.02  # Error of a patch's model for each frame between, px.
    outline_sigma: Positive = 0.05  # Error of an outline's model, px.
    outline_rate: NonNegative = 0.01  # The same for each frame between, px.
    vague_outline_share: Share = 0.3
    """Share of its information that the outline of a round link has where it is not sharp."""
    patch_floor: Positive = 30.0  # Variance of a pixel, squared grey levels.
    patch_gain: NonNegative = 8.0  # Share of the remaining squared difference that is added to it.
    patch_ridge: NonNegative = 0.01  # Damping of the Gauss-Newton steps, as a share of the trace.
    patch_ridge_floor: NonNegative = 20.0  # Damping that is added, squared grey levels by px^2.
    patch_iterations: Count = 10  # Gauss-Newton steps at most.
    max_patch_step: Positive = 1.5  # Largest step of an iteration, px.
    min_patch_step: NonNegative = 0.02  # Step below which iterations end, px.
    min_patch_area: NonNegative = 0.3  # Least factor of a patch's area.
    max_patch_area: Positive = 3.0  # Largest factor of a patch's area.
    texture_floor: NonNegative = 2.0  # Gradient that counts as shading, grey levels by px.

    # neighborhoods
    label_window: Count = 5  # Side of the window over which label costs are averaged, candidates.
    noisy_label_sigma: Positive = 5.0  # Its deviation where depth is noisy, candidates.
    rank_points: Count = 500  # Points of the graph of paths from the base.
    rank_static_points: Count = 1000  # Static points from which distances are taken.
    rank_source_share: Share = 0.02  # Share of the points where paths begin.

    # surfaces of depth images
    min_normal_cosine: Share = 0.12  # Least cosine between a normal and the ray.
    max_curvature: Positive = 2.0
    """Second difference of inverse depth above which a pixel is at an edge, by its value and the
    focal length."""
    static_pixels: NonNegative = 0.5  # Tolerance of a static surface's depth, footprints.
    static_depth: NonNegative = 5e-4  # Tolerance that is added to it, m.
    static_noise: NonNegative = 5.0  # The same, standard deviations of the depth.

    # planes fitted to noisy depth
    plane_radius: Count = 8  # Radius of the windows from which slopes are fitted, px.
    plane_center_radius: Count = 4
    """Radius of the windows from which depths are fitted, px: curved surfaces are flattened with
    its square."""
    rim_width: Count = 5
    """Window that must be on one surface for a normal, px: at the rim of a round limb the front
    shows where a point has turned to its back."""
    rim_share: Share = 0.95  # Of that window, on the surface, up to which there is no normal.
    layer_spacing: Positive = 4.0  # Spacing of depth layers, standard deviations of the median.
    plane_ridge: NonNegative = 0.01  # Damping of slopes, as a share of the trace.
    noisy_change_threshold: Count = 2  # Change where a surface is fitted, grey levels.
    noisy_depth_radius: Count = 8  # Radius of the windows in which depth is averaged, px.
    noisy_depth_rim: Count = 2  # Distance from the outline of pixels that hardly count in it, px.
    noisy_depth_rim_weight: Positive = 1e-3  # Weight of these, by that of the others.
    noisy_margin: Count = 21  # Side of the window by which the changing region is dilated, px.
    noisy_crop_margin: Count = 16  # Margin of the crop whose flow is computed, px.
