"""Settings of the published pipeline."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..images import ImageSettings
from ..numerics import DEGREE, Count, NonNegative, Positive, Scales, SettingsRecord, Share
from ..rgb import RgbSettings


@dataclass(frozen=True)
class PaperSettings:
    """Every tuned number of `gcpose.paper`."""

    # parts between two frames (Sec. 3.2 and 3.3)
    max_points: Count = 400  # Pixels of each frame.
    inlier: Positive = 1.0  # Sampson distance of a match that fits an essential matrix, px.
    outlier_cost: NonNegative = 9.0  # Squared Sampson distance at which the cost levels off, px^2.
    max_rounds: Count = 10  # Rounds of EM.
    min_points: Count = 8  # Points of a part below which it has no motion.
    ransac_confidence: Share = 0.999  # That RANSAC finds an essential matrix of inliers only.
    oracle_inlier: Positive = 1e-4  # Sampson distance of a fit to a given part, focal lengths.
    pnp_inlier: Positive = 3.0  # Reprojection error of a point that fits a motion, px.

    # angles from the parts' rotations
    max_left_out: Count = 2  # Parts that may belong to no joint.
    max_deviation: Positive = 3.0 * DEGREE  # Deviation at which its cost levels off, rad.
    turn_cost: NonNegative = 5e-3
    """Cost of a turn by `max_deviation`: of joints that explain a part equally well, those that
    turn less are chosen."""

    # tuning of the flow network
    tuning_rounds: Count = 10
    settled_share: Share = 0.99  # Share of points that keep their part when tuning ends.
    color_scale: Positive = 10.0
    """Difference in brightness that costs as much as a pixel of Sampson distance, grey levels."""
    tuning_iterations: Count = 3  # Corrections of the network while it is tuned.
    tuning_side: Count = 240  # Smaller side of the images that it sees, px.

    # bundle adjustment with depth (Sec. 3.4)
    bundle_scales: Scales = (20.0, 20.0, 10.0, 10.0, 6.0, 6.0, 4.0, 4.0)
    """Robust scales, in standard deviations; one iteration for each."""
    estimated_depth_sigma: Positive = 0.1  # Of a network's inverse depths, about 1.
    measured_depth_sigma: Positive = 0.01  # Of measured ones; the sensor's noise is added.


@dataclass(frozen=True)
class PublishedSettings(SettingsRecord):
    """The tuned numbers of the methods `gcpose-flow`, `gcpose-epipolar` and `gcpose-depth`."""

    paper: PaperSettings = field(default_factory=PaperSettings)
    rgb: RgbSettings = field(default_factory=RgbSettings)
    images: ImageSettings = field(default_factory=ImageSettings)
