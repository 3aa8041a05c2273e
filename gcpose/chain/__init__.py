"""Kinematic chains: joints, priors from declared knowledge, and fits to part motions."""

from __future__ import annotations

from .articulation import (
    Articulation,
    Cloud,
    Hypothesis,
    axis_bases,
    displace_axes,
    part_centers,
    select_by_labels,
)
from .beam import (
    Beam,
    StepGrid,
    axis_directions,
    axis_twists,
    beam_search,
    select_by_steps,
    spread_places,
)
from .chain_fit import Chains, Goal, fit_chains, fit_displacements, misfit
from .hinges import extent, locate_hinges, subsample
from .kernels import add_normal_equations
from .kinematics import (
    ancestors,
    axis_basis,
    displace_axis,
    relative_derivatives,
    screws_of,
)
from .priors import JointPriors, axis_from_twist, joint_priors, twist_about, twist_spaces
from .settings import ChainSettings
from .weak_prior import (
    HingePrior,
    NormalEquations,
    hinge_equations,
    offset_from_axis,
    smoothness_equations,
)

__all__ = [
    "Articulation",
    "Beam",
    "ChainSettings",
    "Chains",
    "Cloud",
    "Goal",
    "HingePrior",
    "Hypothesis",
    "JointPriors",
    "NormalEquations",
    "StepGrid",
    "add_normal_equations",
    "ancestors",
    "axis_bases",
    "axis_basis",
    "axis_directions",
    "axis_from_twist",
    "axis_twists",
    "beam_search",
    "displace_axes",
    "displace_axis",
    "extent",
    "fit_chains",
    "fit_displacements",
    "hinge_equations",
    "joint_priors",
    "locate_hinges",
    "misfit",
    "offset_from_axis",
    "part_centers",
    "relative_derivatives",
    "screws_of",
    "select_by_labels",
    "select_by_steps",
    "smoothness_equations",
    "spread_places",
    "subsample",
    "twist_about",
    "twist_spaces",
]
