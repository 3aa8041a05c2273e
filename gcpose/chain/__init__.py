"""Kinematic chains: joints, priors from declared knowledge, and fits to part motions."""

from __future__ import annotations

from .articulation import (
    Articulation,
    Cloud,
    Hypothesis,
    axis_bases,
    displaced,
    distinct,
    middles,
)
from .beam_search import Beam, Grid, axes, beamed, directions, spread, unlike
from .chain_fit import Chains, Goal, fit_chains, fit_displacements, misfit
from .hinges import extent, hinges, thinned
from .kernels import add_normal
from .kinematics import (
    axis_basis,
    carriers,
    displace_axis,
    relative,
    screws_of,
)
from .priors import Known, about, axis_from, knowledge, spaces
from .settings import ChainSettings
from .weak_prior import Hinges, Normal, closeness, from_axis, smoothness

__all__ = [
    "Articulation",
    "Beam",
    "ChainSettings",
    "Chains",
    "Cloud",
    "Goal",
    "Grid",
    "Hinges",
    "Hypothesis",
    "Known",
    "Normal",
    "about",
    "add_normal",
    "axes",
    "axis_bases",
    "axis_basis",
    "axis_from",
    "beamed",
    "carriers",
    "closeness",
    "directions",
    "displace_axis",
    "displaced",
    "distinct",
    "extent",
    "fit_chains",
    "fit_displacements",
    "from_axis",
    "hinges",
    "knowledge",
    "middles",
    "misfit",
    "relative",
    "screws_of",
    "smoothness",
    "spaces",
    "spread",
    "thinned",
    "unlike",
]
