"""The public API: complete, lazy, documented, and its examples run."""

from __future__ import annotations

import doctest
import importlib
import inspect
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import gcbench as gb
import pytest

OBJECTS = [name for name in gb.__all__ if callable(getattr(gb, name))]


def test_what_is_public() -> None:
    """A change of this list is a change for every user: tell it in the CHANGELOG."""
    assert set(gb.__all__) == {
        "ArticulatedModel", "Camera", "ConfigError", "Dataset", "DatasetError", "Estimate",
        "EvalConfig", "Frame", "GCPose", "GcbenchError", "JointTrajectory", "JointType", "Link",
        "Method", "MethodError", "ModelError", "Observation", "RayWorkers", "RenderConfig",
        "RenderError", "ReportOptions", "Results", "Sequence", "Shard", "StorageError",
        "VerifyReport", "doctor",
        "evaluate", "export_dataset", "export_observations", "fetch_robot", "list_methods",
        "list_robots", "list_suites", "load_robot", "merge_verification", "open_dataset",
        "render_dataset", "render_sequence", "report", "score", "show", "stream", "verify_dataset",
        "verify_shard",
    }
    assert set(gb.__all__) <= set(dir(gb))


def test_there_is_no_other_name() -> None:
    with pytest.raises(AttributeError, match="no attribute 'render'"):
        gb.render  # noqa: B018


def test_errors_have_one_base() -> None:
    kinds = [gb.ConfigError, gb.ModelError, gb.DatasetError, gb.MethodError, gb.RenderError]
    kinds.append(gb.StorageError)
    assert all(issubclass(kind, gb.GcbenchError) for kind in kinds)
    assert len({*kinds}) == 6


@pytest.mark.slow
def test_a_type_checker_knows_the_names_and_what_a_method_is(tmp_path: Path) -> None:
    pytest.importorskip("pyright", reason="pyright is in the extra lint")
    readme = (Path(__file__).parents[1] / "README.md").read_text()
    code = readme.partition("# my_method.py\n")[2].partition("```")[0]
    (tmp_path / "my_method.py").write_text(f"{code}\nmethod: gb.Method = MyMethod()\n")
    (tmp_path / "misspelt.py").write_text("import gcbench as gb\n\ngb.open_datset\n")
    (tmp_path / "pyrightconfig.json").write_text(json.dumps({
        "typeCheckingMode": "strict", "extraPaths": [str(Path(gb.__file__).parents[1])]}))
    done = subprocess.run(
        [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "--outputjson"],
        cwd=tmp_path, capture_output=True, text=True)
    found = [(Path(d["file"]).name, d["rule"])
             for d in json.loads(done.stdout)["generalDiagnostics"] if d["severity"] == "error"]
    assert ("misspelt.py", "reportAttributeAccessIssue") in found
    assert not [rule for file, rule in found if file == "my_method.py"], done.stdout


def test_import_loads_nothing() -> None:
    code = "import sys, gcbench; print(*(m for m in sys.modules if m.startswith('gcbench')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == {"gcbench", "gcbench.errors"}


@pytest.mark.parametrize("name", OBJECTS)
def test_a_public_name_is_documented(name: str) -> None:
    """Functions in Google style, with an example; types with their fields."""
    public = getattr(gb, name)
    doc = inspect.getdoc(public) or ""
    summary = doc.partition("\n")[0]
    assert summary.endswith("."), f"{name}: {summary!r}"
    if not inspect.isfunction(public):
        return
    parameters = [p for p in inspect.signature(public).parameters if not p.startswith("_")]
    if parameters:
        section = re.search(r"\nArgs:\n(.*?)(\n\n|\Z)", doc, re.DOTALL)
        assert section, f"{name} has no Args"
        for parameter in parameters:
            assert re.search(rf"^ +{parameter}: ", section[1], re.MULTILINE), parameter
    assert "\nReturns:\n" in doc or "Yields:" in doc or parameters == [] or name == "fetch_robot"
    assert ">>>" in doc, f"{name} has no example"


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the examples read: a dataset, results and predictions."""
    folder = tmp_path_factory.mktemp("work")
    config = gb.RenderConfig(robot="owi535", frames=3, width=64, height=48)
    gb.render_dataset(config, 1, folder / "data/ur5", 1, progress=False)
    gb.evaluate(gb.EvalConfig(method=("hold-still",), data=(folder / "data/ur5",),
                              results=folder / "results"), progress=False)
    (sequence,) = gb.open_dataset(folder / "data/ur5")
    lines = ["# method: mine", "# inputs: rgb", "# knowledge: free", "# training: none",
             "sequence,frame,joint,displacement"]
    lines += [f"000000,{frame},{joint},0.0" for frame in (1, 2)
              for joint in range(1, 1 + len(sequence.meta.scored_joints))]
    (folder / "mine.csv").write_text("\n".join(lines) + "\n")
    return folder


@pytest.mark.gl
@pytest.mark.parametrize("name", OBJECTS)
def test_the_examples_run(
    name: str, work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name == "stream":
        pytest.importorskip("torch", reason="PyTorch is in the extra learn")
    shutil.copytree(work, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    public = getattr(gb, name)
    module = importlib.import_module(public.__module__)
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    runner = doctest.DocTestRunner(optionflags=flags)
    for test in doctest.DocTestFinder(recurse=False).find(public, name, module, globs={"gb": gb}):
        runner.run(test)
    assert not runner.failures


@pytest.mark.parametrize(
    ("old", "names"),
    [
        ("gcbench.renderer.observation", ["Observation", "Estimate", "Method"]),
        ("gcbench.renderer.torch_dataset", ["TorchDataset"]),
    ],
)
def test_places_of_the_first_edition_still_work(old: str, names: list[str]) -> None:
    if "torch" in old:
        pytest.importorskip("torch", reason="PyTorch is in the extra learn")
    sys.modules.pop(old, None)
    with pytest.warns(DeprecationWarning, match="moved"):
        module = importlib.import_module(old)
    assert all(hasattr(module, name) for name in names)
