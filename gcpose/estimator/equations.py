"""Normal equations of a bundle adjustment, and the covariance that they show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...robots.geometry import Array


@dataclass(frozen=True)
class BundleEquations:
    """Normal equations of U unknowns: displacements of frames 1.. (rad or m), then of the axes.

    All other unknowns are eliminated. Residuals are in standard deviations, so that the inverse
    matrix is a covariance.
    """

    matrix: Array
    """[U U]"""
    vector: Array
    """[U]"""
    scatter: Array | None = None
    """[U U] covariance of `vector`, if the errors of a part in a frame are the same; None: each
    residual has an error of its own, and it is `matrix`."""
    diagonal: Array | None = None
    """[U] of the matrix before other unknowns are eliminated, if it differs"""

    def deviation(self, frames: int, joints: int) -> Array:
        """Return the standard deviations [T-1 J] of the displacements, rad or m.

        With scatter S the covariance is the sandwich H^-1 S H^-1, which holds where residuals are
        correlated within clusters (Huber, The behavior of maximum likelihood estimates under
        nonstandard conditions, 1967; Liang and Zeger, 1986).
        """
        covariance = np.linalg.inv(self.matrix + 1e-6 * np.eye(len(self.matrix)))
        if self.scatter is not None:
            covariance = covariance @ self.scatter @ covariance
        variance = np.diag(covariance)[: (frames - 1) * joints]
        return np.sqrt(np.maximum(variance, 0.0)).reshape(frames - 1, joints)
