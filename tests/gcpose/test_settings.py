"""Settings are typed, bounded, listed and stored."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest
from gcbench.benchmark.methods import method_source, with_options
from gcbench.benchmark.methods.registry import declaration_of, load_method
from gcbench.benchmark.results import read_run
from gcbench.benchmark.run.driver import EvalConfig, evaluate
from gcbench.errors import ConfigError, GcbenchError
from gcbench.gcpose.method import GCPose
from gcbench.gcpose.settings import Settings

from ..support import bench_data


def test_an_override_is_parsed_to_the_type_of_its_field() -> None:
    changed = Settings().override({"rgbd.candidates": "800", "rgbd.final_scales": "1,0.5"})
    assert changed.rgbd.candidates == 800
    assert changed.rgbd.final_scales == (1.0, 0.5)
    assert changed.changes() == {"rgbd.candidates": "800", "rgbd.final_scales": "1,0.5"}
    assert changed.as_dict()["rgbd"]["candidates"] == 800
    stage = changed.override({"rgbd.free_flow.stages.1.kept": "5"}).rgbd.free_flow.stages[1]
    assert (stage.kept, stage.until) == (5, 4)
    fixed = changed.override({"rgbd.free_flow.stages.1.fixed_axes": "true"})
    assert fixed.changes()["rgbd.free_flow.stages.1.fixed_axes"] == "true"
    assert changed.override({"rgbd.candidates": "1500"}).rgbd.final_scales == (1.0, 0.5)


def test_the_tree_of_settings_makes_the_same_settings() -> None:
    settings = Settings()
    assert msgspec.convert(settings.as_dict(), Settings) == settings  # defaults are in bounds
    assert settings.changes() == {}


@pytest.mark.parametrize(("name", "value", "message"), [
    ("rgbd.nothing", "1", "no setting 'rgbd.nothing'; there are rgbd.candidates, "),
    ("video.points", "1", "no setting 'video.points'; there are rgbd.candidates, "),
    ("rgbd", "1", "no setting 'rgbd'; there are rgbd.candidates, "),
    ("rgbd.candidates.x", "1", "no setting 'rgbd.candidates.x'"),
    ("rgbd.sweep.turn", "1", "no setting 'rgbd.sweep.turn'; there are rgbd.sweep.max_turn, "),
    ("rgbd.known_lines.stages.9.kept", "1", "no setting 'rgbd.known_lines.stages.9.kept'"),
    ("rgbd.candidates", "1.5", "rgbd.candidates=1.5: expected int$"),
    ("rgbd.candidates", "0", "rgbd.candidates=0: expected int >= 1$"),
    ("rgbd.sigma_static", "nan", "expected float > 0.0$"),
    ("rgbd.sigma_static", "inf", "expected a finite number$"),
    ("rgbd.final_scales", "1,-1", "expected float > 0.0$"),
    ("rgbd.final_scales", "", "expected float$"),
])
def test_what_is_no_setting_is_refused(name: str, value: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Settings().override({name: value})


def records(record: Any) -> list[Any]:
    inner = [v for f in fields(record) for v in flat(getattr(record, f.name))]
    return [record, *(r for i in inner if is_dataclass(i) for r in records(i))]


def flat(value: Any) -> list[Any]:
    return [w for v in value for w in flat(v)] if isinstance(value, tuple) else [value]


def is_number(value: Any) -> bool:
    return is_dataclass(value) or type(value) in (int, float, bool)


@pytest.mark.parametrize("record", records(Settings()), ids=lambda r: type(r).__name__)
def test_settings_are_frozen_and_hold_numbers_only(record: Any) -> None:
    assert type(record).__dataclass_params__.frozen
    for f in fields(record):
        value = getattr(record, f.name)
        assert is_dataclass(value) or all(is_number(n) for n in flat(value)), f.name


def test_a_method_is_made_with_settings_and_declares_them() -> None:
    source = with_options(method_source("gcpose"), {"set": "rgbd.candidates=800"})
    declared = declaration_of(load_method(source), source)
    assert declared.name == "gcpose rgbd.candidates=800"
    assert declared.settings["rgbd"]["candidates"] == 800
    assert GCPose().name == "gcpose"
    with pytest.raises(ConfigError, match="expected NAME=VALUE"):
        load_method(with_options(method_source("gcpose"), {"set": "rgbd.candidates"}))


def test_a_method_without_settings_takes_no_set() -> None:
    with pytest.raises(GcbenchError, match=r"has no option --set; leave it out$"):
        load_method(with_options(method_source("hold-still"), {"set": "rgbd.candidates=800"}))


def test_a_run_stores_the_settings(tmp_path: Path) -> None:
    data = bench_data.make_dataset(tmp_path / "arm", 1)
    config = EvalConfig(method=("gcpose",), set=("rgbd.min_moving_pixels=1000000",), data=(data,),
                        inputs=("rgbd",), knowledge=("axes",), results=tmp_path / "results")
    (run,) = evaluate(config, progress=False).runs
    stored = read_run(run.path / "run.json")
    assert stored.settings["rgbd"]["min_moving_pixels"] == 1000000
    assert stored.row.method == "gcpose rgbd.min_moving_pixels=1000000"
    (line,) = [r for r in run.results() if r.metric == "final_error" and r.joint_index == 1]
    (size,) = [r for r in run.results() if r.metric == "displacement" and r.joint_index == 1]
    assert line.value == pytest.approx(size.value)  # so many pixels never move: all is static


def test_a_run_of_an_earlier_version_has_no_settings(tmp_path: Path) -> None:
    data = bench_data.make_dataset(tmp_path / "arm", 1)
    config = EvalConfig(method=("hold-still",), data=(data,), results=tmp_path / "results")
    (run,) = evaluate(config, progress=False).runs
    path = run.path / "run.json"
    tree = msgspec.json.decode(path.read_bytes())
    del tree["settings"]
    path.write_bytes(msgspec.json.encode(tree))
    assert read_run(path).settings == {}
    (again,) = evaluate(config, progress=False).runs
    assert again.results() == run.results()
