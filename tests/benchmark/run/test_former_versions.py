"""Datasets, configurations and results that earlier versions wrote open, continue and score."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from gcbench.benchmark.methods import registry as methods
from gcbench.benchmark.report.page import report
from gcbench.benchmark.results.rows import Result
from gcbench.benchmark.results.runs import Results, RunFolder, find_runs
from gcbench.benchmark.run.driver import EvalConfig, evaluate
from gcbench.renderer.dataset.reader import open_dataset
from gcbench.renderer.scene.config_files import read_config

from ...support import bench_data

CONFIG = json.loads("""{
 "robot": "arm", "package": [], "seed": 3, "stream": "test", "frames": 4, "width": 48,
 "height": 36, "animation": "", "scored_joints": [],
 "vary": ["motion", "camera", "lights", "materials", "textures", "background", "image", "instance"],
 "keep_unobservable": false, "allow_missing": false, "layers": [], "track_points": 256,
 "samples": 4,
 "randomization": {
  "motion": {"total": [10.0, 70.0], "total_prismatic": [0.1, 0.9], "max_step": 6.0, "fps": 30.0},
  "camera": {"azimuth": [-180.0, 180.0], "elevation": [5.0, 50.0], "fov": [35.0, 55.0],
             "fill": [0.5, 0.9], "jitter": 0.08, "roll": [-5.0, 5.0]},
  "lights": {"number": [1, 3], "elevation": [20.0, 80.0], "intensity": [2.0, 5.0],
             "warmth": [-0.15, 0.15], "ambient": [0.15, 0.4], "shadows": false},
  "materials": {"probability": 1.0, "hue": 0.03, "value": [0.8, 1.2], "roughness": [0.35, 0.9],
                "metallic": [0.0, 0.4]},
  "textures": {"probability": 0.0, "kinds": ["noise", "checker", "stripes", "wood"],
               "folder": "", "size": 512, "scale": [0.15, 0.4]},
  "background": {"room": 0.5, "kinds": ["noise", "checker", "stripes", "wood", "clutter"],
                 "folder": "", "color": [0.85, 0.85, 0.85], "room_size": [0.2, 1.5]},
  "image": {"noise": [0.0, 0.0], "blur": [0.0, 0.0], "exposure": [0.0, 0.0]}}}""")
ASSET = {"name": "arm", "source": "arm: generated", "licence": "MIT", "sha256": "", "notes": []}
INSTALLED = {
    "dependencies": {"python": "3.11.7", "numpy": "2.4.6"},
    "platform": {"system": "Linux", "machine": "x86_64"},
}
DATASET = {
    "format": "gcbench/1", "generator": {"name": "gcbench", "version": "0.1.0"}, "seed": 3,
    "config": CONFIG, "assets": [ASSET],
    "counts": {"sequences": 3, "frames": 12, "unobservable": 0, "refused": {}},
    **INSTALLED, "other_environments": [],
}
SOURCES = {
    "gcbench.gcpose.method:GCPose": "gcpose",
    "gcbench.gcpose.published:FlowOnly": "gcpose-flow",
    "gcbench.gcpose.published:Epipolar": "gcpose-epipolar",
    "gcbench.gcpose.published:WithDepth": "gcpose-depth",
    "gcbench.benchmark.icp:Icp": "icp",
    "gcbench.benchmark.icp:IcpFirst": "icp-first",
    "gcbench.benchmark.baselines:HoldStill": "hold-still",
    "gcbench.benchmark.baselines:ConstantVelocity": "constant-velocity",
}


def former_run(source: str, method: str) -> dict[str, Any]:
    """`run.json` as version 0.1.0 wrote it before the modules moved."""
    return {
        "format": "gcbench-results/1",
        "row": {"method": method, "version": "1", "inputs": "none", "knowledge": "none",
                "training": "none", "oracles": []},
        "source": source, "dataset": "arm", "data": "data/arm", "config": CONFIG,
        "assets": [ASSET], "sequences": ["000000", "000001", "000002"], "left_out": 0,
        "limits": {"seconds_per_sequence": 300.0, "workers": 1, "threads": 2},
        "environments": [{"gcbench": "0.1.0", **INSTALLED, "cpu": "a CPU", "cores": 2}],
    }


@pytest.fixture
def data(tmp_path: Path) -> Path:
    folder = bench_data.make_dataset(tmp_path / "arm", 3)
    (folder / "dataset.json").write_text(json.dumps(DATASET))
    return folder


def hold_still(data: Path, results: Path) -> Results:
    return evaluate(EvalConfig(method=("hold-still",), data=(data,), results=results), False)


def errors_of(folder: RunFolder) -> list[Result]:
    return [r for r in folder.results() if r.joint]


def test_a_dataset_opens_and_its_configuration_is_read(data: Path) -> None:
    dataset = open_dataset(data)
    assert len(dataset) == 3
    assert dataset.config.seed == 3
    assert dataset.config == read_config(data / "dataset.json")


@pytest.mark.parametrize(("source", "name"), SOURCES.items())
def test_a_method_keeps_its_identity_where_its_module_moved(source: str, name: str) -> None:
    assert methods.method_identity(source) == methods.method_identity(name) == name
    assert methods.method_identity(methods.method_source(name)) == name
    assert methods.method_source(source) == methods.METHODS[name]
    assert methods.method_identity(f"{source}?flow=dis") == f"{name}?flow=dis"


def test_a_method_that_is_not_registered_is_where_it_stands() -> None:
    for source in ("their.module:Method?flow=dis", "folder/my.py:Method", "predictions"):
        assert methods.method_identity(source) == source


def test_results_continue_and_are_reported(data: Path, tmp_path: Path) -> None:
    results = tmp_path / "results"
    (folder,) = hold_still(data, results).runs
    written = folder.path / "run.json"
    assert json.loads(written.read_text())["source"] == "hold-still"
    scores = errors_of(folder)
    former = former_run("gcbench.benchmark.baselines:HoldStill", "hold-still")
    written.write_text(json.dumps(former))
    (found,) = find_runs(results)
    assert found.run.source == former["source"]
    before = report([results], tmp_path / "before", pictures=False)

    folder.estimate_path("000001").unlink()
    outcome = hold_still(data, results)
    assert outcome.estimated == 1
    (folder,) = outcome.runs
    assert len(folder.run.environments) == 2  # what ran the first part is not forgotten
    assert scores == errors_of(folder)
    after = report([results], tmp_path / "after", pictures=False)
    tex = [p for p in (*before, *after) if p.suffix == ".tex"]
    assert tex[0].read_text() == tex[1].read_text()
