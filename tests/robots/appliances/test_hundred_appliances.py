"""A hundred of each appliance: another reader loads them, they verify, and no two look alike."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from gcbench.renderer.dataset.provenance import new_provenance, write_provenance
from gcbench.renderer.dataset.storage import SequenceWriter
from gcbench.renderer.generate.sequence_renderer import SequenceRenderer
from gcbench.renderer.scene import models as instances
from gcbench.renderer.scene.config import STUDIO, RenderConfig
from gcbench.renderer.verify.driver import verify_dataset
from gcbench.robots.appliances.generator import GENERATED, write_appliance

HOW_MANY = [3, pytest.param(100, marks=pytest.mark.slow)]
SMALL = RenderConfig(frames=4, width=160, height=120)


@pytest.fixture(autouse=True)
def in_order(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Sequence i shows instance i, not a drawn one."""
    monkeypatch.setattr(instances, "draw_instance", lambda streams, attempt=0:
                        f"{streams.config.robot}:{streams.index}")
    monkeypatch.setenv("GCBENCH_CACHE", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.mark.parametrize("category", GENERATED)
@pytest.mark.parametrize("count", HOW_MANY)
def test_yourdfpy_loads_each_folder_alone(category: str, count: int, tmp_path: Path) -> None:
    """With its own way of finding files; that a mesh is missing it only logs."""
    yourdfpy: Any = pytest.importorskip("yourdfpy")
    for number in range(count):
        folder = tmp_path / str(number)
        folder.mkdir()
        write_appliance(category, number, folder)
        model = yourdfpy.URDF.load(str(folder / "mobility.urdf"))
        names = {str(v.geometry.mesh.filename) for link in model.robot.links for v in link.visuals}
        assert {Path(name).name for name in names} == {
            path.name for path in (folder / "textured_objs").glob("*.obj")}
        groups = sum(path.read_text().count("\ng ") for path in folder.glob("textured_objs/*.obj"))
        assert len(model.scene.geometry) == groups, number
        faces = sum(path.read_text().count("\nf ") for path in folder.glob("textured_objs/*.obj"))
        assert sum(len(g.faces) for g in model.scene.geometry.values()) == faces, number
        size = np.ptp(model.scene.bounds, axis=0)  # x is depth, y width, z height
        assert (size > 0.15).all() and (size < 1.2).all(), number
        before = model.scene.bounds
        model.update_cfg([joint.limit.upper for joint in model.actuated_joints])
        assert not np.allclose(model.scene.bounds, before), number


@pytest.mark.gl
@pytest.mark.parametrize("category", GENERATED)
@pytest.mark.parametrize("count", HOW_MANY)
def test_each_verifies(category: str, count: int, tmp_path: Path) -> None:
    config = replace(SMALL, robot=category)
    renderer = SequenceRenderer(config)
    try:
        for index in range(count):
            rendered = renderer.render(index)
            with SequenceWriter(tmp_path, index, rendered.depth_unit) as writer:
                for frame in rendered.frames:
                    writer.add(frame)
                meta, state = rendered.finish()
                writer.finish(meta, state)
            assert meta.asset["instance"] == f"{category}:{index}"
        write_provenance(tmp_path, new_provenance(renderer.config))
    finally:
        renderer.close()
    report = verify_dataset(tmp_path, progress=False)
    assert report.ok, report.table()


@pytest.mark.gl
@pytest.mark.parametrize("category", GENERATED)
@pytest.mark.parametrize("count", HOW_MANY)
def test_each_looks_like_no_other(category: str, count: int) -> None:
    """Seen from one place, under one light, in one pose: colour and shape alone differ."""
    renderer = SequenceRenderer(replace(
        SMALL, robot=category, frames=3, vary=(), randomization=STUDIO, keep_unobservable=True))
    pictures = list[Any]()
    try:
        for index in range(count):
            frame = next(iter(renderer.render(index).frames))
            pictures.append(cv2.resize(frame.rgb, (40, 30), interpolation=cv2.INTER_AREA))
    finally:
        renderer.close()
    for (a, first), (b, second) in combinations(enumerate(pictures), 2):
        difference = np.abs(first.astype(float) - second)
        assert difference.max() > 25 and difference.mean() > 0.5, (a, b)
