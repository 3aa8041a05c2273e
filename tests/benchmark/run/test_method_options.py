"""Options go to the methods that take them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from gcbench import GcbenchError
from gcbench.benchmark.run.driver import EvalConfig, evaluate

from ...support import bench_data


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bench_data.make_dataset(tmp_path_factory.mktemp("data") / "arm", 1)


METHODS_WITH_OPTIONS = """
import numpy as np
from gcbench import Estimate

class Plain:
    name, version, training = "plain", "1", "none"
    inputs, knowledge = ("rgb",), ("free",)

    def estimate(self, observation):
        return Estimate(np.zeros((len(observation.times), observation.n_joints)))

class Learned(Plain):
    name = "learned"

    def __init__(self, weights="", flow=""):
        if weights == "none":
            raise FileNotFoundError(weights)
        self.name += f" {weights or 'default'}" + f" flow={flow}" * bool(flow)

class Other(Learned):
    name = "other"

class Namesake(Plain):
    version = "2"
"""


def options(data: Path, folder: Path, *methods: str, **given: object) -> list[str]:
    """The names of the rows; of a method of the file by its class."""
    file = folder / "options.py"
    file.write_text(METHODS_WITH_OPTIONS)
    sources = {name: f"{file}:{name}" for name in ("Plain", "Learned", "Other", "Namesake")}
    if "weights" in given:
        given["weights"] = tuple(
            f"{sources[head]}={tail}" if head in sources else f"{head}{'=' * bool(tail)}{tail}"
            for head, _, tail in (text.partition("=") for text in given["weights"]))  # type: ignore[attr-defined]
    config = EvalConfig(
        method=tuple(sources.get(name, name) for name in methods), data=(data,), limit=1,
        results=folder / "results", workers=1, **given)  # type: ignore[arg-type]
    return [run.run.row.name for run in evaluate(config, progress=False).runs]


def test_options_go_to_the_methods_that_take_them(data: Path, tmp_path: Path) -> None:
    rows = options(data, tmp_path, "Plain", "Learned", "hold-still", flow="dis")
    assert sorted(rows) == ["hold-still", "learned default flow=dis", "plain"]
    (plain,) = (tmp_path / "results").glob("plain*/arm/run.json")
    assert json.loads(plain.read_text())["source"] == f"{tmp_path}/options.py:Plain"


@pytest.mark.ci
def test_each_of_the_weights_makes_a_row_of_its_method(data: Path, tmp_path: Path) -> None:
    given = ("Learned=a", "Learned=b=c", "Other=x", "all")
    rows = options(data, tmp_path, "Plain", "Learned", "Other", weights=given)
    assert sorted(rows) == ["learned a", "learned all", "learned b=c", "other all", "other x",
                            "plain"]


@pytest.mark.parametrize(("given", "said"), [
    ({"flow": "dis"}, "no method here has the option --flow (for dis); leave it out"),
    ({"weights": ("Plain=w",)}, "no method here has the option --weights (for w); leave it out"),
])
def test_an_option_that_no_method_takes_is_refused(
    data: Path, tmp_path: Path, given: dict[str, object], said: str
) -> None:
    methods_here = ("Plain", "Learned") if "weights" in given else ("Plain", "hold-still")
    with pytest.raises(GcbenchError) as error:
        options(data, tmp_path, *methods_here, **given)
    assert said in str(error.value)
    assert not (tmp_path / "results").exists()


def test_estimates_by_other_weights_of_the_same_file_are_refused(
    data: Path, tmp_path: Path
) -> None:
    file = tmp_path / "w.safetensors"
    for option, value in ("weights", (f"Learned={file}",)), ("flow", f"mean+own:{file}"):
        file.write_bytes(b"one")
        options(data, tmp_path, "Learned", **{option: value})
        options(data, tmp_path, "Learned", **{option: value})
        file.write_bytes(b"two")
        with pytest.raises(GcbenchError, match=f"content of the file.--{option}: .*--retry ok"):
            options(data, tmp_path, "Learned", **{option: value})


def test_a_request_concerns_the_methods_that_can_follow_it(data: Path, tmp_path: Path) -> None:
    rows = options(data, tmp_path, "Plain", "hold-still", "icp", inputs=("rgb",))
    assert sorted(rows) == ["hold-still", "plain"]
    with pytest.raises(GcbenchError, match="icp does not support inputs rgb;"):
        options(data, tmp_path, "icp", inputs=("rgb",))


def test_two_methods_do_not_make_one_row(data: Path, tmp_path: Path) -> None:
    """Their estimates would be in one folder, also where only the version tells them apart."""
    with pytest.raises(GcbenchError) as error:
        options(data, tmp_path, "Plain", "Namesake")
    assert str(error.value).startswith(
        f"{tmp_path}/options.py:Plain and {tmp_path}/options.py:Namesake both make the row plain ")
    assert not (tmp_path / "results").exists()
    assert options(data, tmp_path, "Plain", "Plain") == ["plain"], "one method, named twice"
    with pytest.raises(GcbenchError, match="holds estimates of something else"):
        options(data, tmp_path, "Namesake")
