"""Checks of what `meta.json` says against the model and against `dataset.json`."""

from __future__ import annotations

import numpy as np

from ...robots.model import ArticulatedModel
from ..scene import RenderConfig
from ..types import Sequence
from .checks import CheckResult, check


def check_model_fields(sequence: Sequence, model: ArticulatedModel, scale: float) -> CheckResult:
    """Joints are of the model's types and limits and between its parts, which deform as there."""
    meta, s, wrong = sequence.meta, sequence.state, list[str]()
    parts = ("", *meta.part_names)
    followed = np.bincount(model.joint[model.joint >= 0], minlength=len(model.joint_names)) > 1
    for j, name in enumerate(meta.joint_names):
        if name not in model.joint_names:
            wrong.append(f"joint {name}")
            continue
        k = model.joint_names.index(name)
        child = int(model.joint_child[k])
        low, high = model.limits[k] if np.isfinite(model.limits[k]).all() else (-np.inf, np.inf)
        least, most = meta.joint_limits[j] or (-np.inf, np.inf)
        # Earlier versions stored wider limits of joints that others follow, and of scaled models.
        wider = (followed[k] or scale != 1) and least <= low and high <= most
        said = {
            "type": meta.joint_types[j] == model.joint_types[k],
            "limits": (least, most) == (low, high) or wider,
            "parent part": parts[s.joint_parent_part[j]] == (
                model.part_names[model.parent[child]] if model.parent[child] >= 0 else ""),
            "child part": parts[s.joint_child_part[j]] == model.part_names[child]}
        wrong += [f"{field} of joint {name}" for field, right in said.items() if not right]
    deforming = {model.part_names[v.part] for v in model.visuals if v.deforms}
    wrong += [f"deforming part {name}" for name in sorted(deforming ^ {*meta.deforming_parts})]
    return check("joints and parts of the model", len(wrong), 0, "fields", ", ".join(wrong),
                 samples=4 * len(meta.joint_names) + len(meta.part_names))


def check_config_fields(sequence: Sequence, config: RenderConfig) -> CheckResult:
    """Size, times, layers and omitted images are those that the dataset's configuration asks for.
    """
    meta, fps = sequence.meta, config.randomization.motion.fps
    late = np.abs(sequence.state.times * fps - np.arange(len(sequence.state.times)))
    said = {name: getattr(meta, name) == getattr(config, name)
            for name in ("width", "height", "frames")}
    said |= {"layers": {*meta.layers} == {*config.layers},
             "omitted": {*meta.omitted} == {*config.omitted_images},
             f"times at {fps:g} fps": late.max() < 1e-6}
    wrong = [name for name, right in said.items() if not right]
    return check("as dataset.json says", len(wrong), 0, "fields", ", ".join(wrong),
                 samples=len(said))
