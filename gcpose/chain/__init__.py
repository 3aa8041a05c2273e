"""Kinematic chains: joints, priors from declared knowledge, and fits to part motions."""

from __future__ import annotations

from .articulation import Articulation, axis_bases, extrapolate_to, take_step
from .beam import (
    Beam,
    StepCosts,
    StepGrid,
    axis_directions,
    axis_twists,
    beam_search,
    merge_beams,
    select_by_steps,
    spread_places,
)
from .chain_fit import Chains, Goal, fit_chains, fit_displacements, misfit
from .kernels import add_normal_equations
from .kinematics import ancestors, displace_axis, relative_derivatives, screws_of
from .priors import (
    JointPriors,
    axis_from_twist,
    joint_priors,
    scale_axes,
    scale_twists,
    twist_about,
    twist_spaces,
)
from .settings import ChainSettings
from .weak_prior import HingePrior, extent, locate_hinges, offset_from_axis, prior_equations

__all__ = [
    "Articulation", "Beam", "ChainSettings", "Chains", "Goal", "HingePrior", "JointPriors",
    "StepCosts", "StepGrid", "add_normal_equations", "ancestors", "axis_bases", "axis_directions",
    "axis_from_twist", "axis_twists", "beam_search", "displace_axis", "extent", "extrapolate_to",
    "fit_chains", "fit_displacements", "joint_priors", "locate_hinges", "merge_beams", "misfit",
    "offset_from_axis", "prior_equations", "relative_derivatives", "scale_axes", "scale_twists",
    "screws_of", "select_by_steps", "spread_places", "take_step", "twist_about", "twist_spaces",
]
