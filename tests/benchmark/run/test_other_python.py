"""Methods in a Python that has neither gcbench nor PyTorch."""

from __future__ import annotations

import ast
import stat
import sys
import venv
from pathlib import Path

import numpy as np
import pytest
from gcbench import ConfigError, MethodError
from gcbench.benchmark.methods import standalone
from gcbench.benchmark.protocol import shape_of
from gcbench.benchmark.results.estimates import read_stored
from gcbench.benchmark.results.rows import Attribution
from gcbench.benchmark.results.runs import RUN, Results, read_run
from gcbench.benchmark.run.driver import EvalConfig, evaluate
from gcbench.benchmark.run.other_python import OtherPython
from gcbench.renderer.dataset import open_dataset
from gcbench.robots.files.atomic import is_alive

from ...support import bench_data, methods_elsewhere

METHODS = Path(__file__).parents[2] / "support/methods_elsewhere.py"


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of a virtual environment with NumPy and the module `only_there`."""
    folder = tmp_path_factory.mktemp("other")
    venv.EnvBuilder().create(folder)
    (site,) = folder.glob("lib/python*/site-packages")
    packages = folder / "packages"
    packages.mkdir()
    for path in Path(np.__file__).parents[1].glob("numpy*"):
        (packages / path.name).symlink_to(path)
    (packages / "only_there.py").write_text("FACTOR = 0.25\n")
    (site / "packages.pth").write_text(str(packages))
    return folder / "bin/python"


def script(path: Path, text: str) -> Path:
    path.write_text("#!/bin/sh\n" + text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def run(
    data: Path, results: Path, python: Path, *names: str, timeout: float = 300.0, **options: str
) -> Results:
    methods = tuple(name if name == "icp" else f"{METHODS}:{name}" for name in names)
    config = EvalConfig(
        method=methods, data=(data,), results=results, workers=1, timeout=timeout,
        python=str(python), **options)  # type: ignore[arg-type]
    return evaluate(config, progress=False)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bench_data.make_dataset(tmp_path_factory.mktemp("data") / "arm", 2)


def test_a_method_runs_there(
    data: Path, tmp_path: Path, python: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """PYTHON may be a script; what this Python has is not passed on. It continues, too."""
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "numpy.py").write_text("raise RuntimeError")  # hides no module
    wrapper = script(tmp_path / "wrapper", f'exec {python} "$@"\n')
    outcome = run(data, tmp_path / "results", wrapper, "Here", weights=("mine",))
    (folder,) = outcome.runs
    assert folder.run.row.name == "here mine" and folder.run.row.version == "2"
    shape = shape_of(open_dataset(data)["000001"])
    stored = read_stored(folder.estimate_path("000001"), shape)
    assert (outcome.estimated, stored.reason, outcome.failures) == (2, "", ())
    steps = np.arange(4)[:, None] * [1, 1]
    np.testing.assert_array_equal(stored.estimate.displacement, 0.25 * steps)
    assert stored.estimate.part.dtype == np.uint8
    assert 0 < stored.seconds < 10 and 5 < stored.peak_memory < 500
    told = read_run(folder.path / RUN)
    assert told.environments[0]["method"] == {
        "python": ".".join(map(str, sys.version_info[:3])), "numpy": np.__version__}
    assert told.attribution == Attribution("A. Author", "https://example.org/@a", "2024-05-01")
    assert told.source == f"{METHODS}:Here?weights=mine"
    folder.estimate_path("000001").unlink()
    assert run(data, tmp_path / "results", python, "Here", weights=("mine",)).estimated == 1


EXPECTED = [
    ("ok", ""), ("raised", "ZeroDivisionError: of the method \\ud800"),
    ("crashed", "was killed by SIGSEGV"), ("crashed", "exited with 7; it said:\nout of luck"),
    ("crashed", "exited with 0"), ("timeout", "no estimate within 4 s"),
    ("invalid", "float64 [4, 1], expected real numbers [T J] = [4 2]"),
    ("invalid", "returned str, expected gcbench.Estimate"),
    ("invalid", "displacement is complex128 [4, 2], expected numbers"),
    ("invalid", "displacement is object [1], expected numbers"),
    ("invalid", "reading what it returned raised SystemExit: 0"),
    ("ok", ""),
    ("crashed", "sent no answer, but 4294967295 bytes"),
    ("crashed", "its answer: not JSON"),
    ("crashed", "it returned more than 268435456 bytes"),
    ("crashed", "its answer has an array 'displacement' of 2 dimensions and type '|O8'"),
    ("crashed", "its answer has an array '__class__'"),
    ("crashed", "expected int >= 0"),
    ("crashed", "$.status: expected one of ok, raised, invalid, got 'perfect'"),
    ("crashed", "$.seconds: expected float >= 0"),
    ("invalid", "displacement is None"),
]


@pytest.mark.ci
def test_whatever_happens_costs_one_sequence(
    tmp_path: Path, python: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = bench_data.make_dataset(tmp_path / "arm", len(methods_elsewhere.ACCIDENTS))
    monkeypatch.setenv("COPY", str(tmp_path / "copy"))
    outcome = run(data, tmp_path / "results", python, "Accidents", timeout=4.0)
    (folder,) = outcome.runs
    dataset = open_dataset(data)
    shape = shape_of(dataset["000000"])
    for name, (status, reason) in zip(dataset.names, EXPECTED, strict=True):
        stored = read_stored(folder.estimate_path(name), shape)
        assert (stored.status, reason in stored.reason) == (status, True), (name, stored)
        assert stored.seconds is None or stored.seconds < 10
    assert not is_alive(int((tmp_path / "copy").read_text()))
    covered = [r.value for r in folder.results() if r.metric == "covered"]
    assert covered == [1, 1] + 40 * [0]  # NaN is no answer


def test_it_ends_with_its_input_also_while_a_method_hangs(python: Path, tmp_path: Path) -> None:
    """So a container ends, of which only the pipes are in our hands."""
    other = OtherPython(str(python), f"{METHODS}:Accidents", 1)
    image = np.full((4, 1, 1, 3), EXPECTED.index(("timeout", "no estimate within 4 s")), np.uint8)
    other._send({"times": [0.0] * 4, "n_joints": 1}, {"rgb": image})
    assert other._process.poll() is None and other._process.stdin is not None
    other._process.stdin.close()
    assert other._process.wait(20) == 0
    other._process.stdout.close()


def test_memory_is_limited_there(data: Path, tmp_path: Path, python: Path) -> None:
    method = tmp_path / "method.py"
    method.write_text(METHODS.read_text() + "ACCIDENTS = (lambda good: np.ones(2**31, 'u1'),) * 2")
    config = EvalConfig(method=(f"{method}:Accidents",), data=(data,), workers=1, memory=1.5,
                        results=tmp_path / "results", python=str(python))
    assert "Unable to allocate 2.00 GiB" in evaluate(config, progress=False).failures[0]


@pytest.mark.parametrize(("name", "reason"), [
    ("Nowhere", r"--python .*python: .*has no 'Nowhere'; it has .*Here, "),
    ("SendsNoDeclaration", r"methods_elsewhere.py:SendsNoDeclaration in .*: not a JSON object"),
    ("NoVersion", r"version is 3, expected one line"),
    ("NeedsModel", r"needs the articulated model, which only"),
    ("NeedsTorch", r"ModuleNotFoundError: No module named 'torch'"),
])
def test_a_method_that_cannot_be_loaded_is_told(
    data: Path, tmp_path: Path, python: Path, name: str, reason: str
) -> None:
    with pytest.raises(MethodError, match=reason):
        run(data, tmp_path / "results", python, name)
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(("text", "reason"), [
    ("echo gcbench-method 3.7.17", "Python 3.7.17 is too old; methods need 3.8 or newer"),
    ("echo one; echo; echo two", "not a Python interpreter; it said 'one'"),
    ("yes", "not a Python interpreter; it said 'y'"),
    ("echo Usage: tool", "not a Python interpreter; it said 'Usage: tool'"),
    ("echo docker: no such image >&2; exit 125", "exited with 125 while it loaded; it said:\ndock"),
])
def test_what_is_no_interpreter_is_told(
    data: Path, tmp_path: Path, text: str, reason: str
) -> None:
    with pytest.raises(MethodError) as error:
        run(data, tmp_path / "results", script(tmp_path / "python", text), "Here")
    assert reason in str(error.value)


def test_a_script_may_print_before_it_runs_python(
    data: Path, tmp_path: Path, python: Path
) -> None:
    text = f'echo module load done; echo; exec {python} "$@"'
    outcome = run(data, tmp_path / "results", script(tmp_path / "wrapper", text), "Here")
    assert outcome.usable == outcome.estimated > 0


def test_no_interpreter_and_no_numpy_are_told(data: Path, tmp_path: Path) -> None:
    with pytest.raises(MethodError, match=r"--python .*/nothing: No such file or directory$"):
        run(data, tmp_path / "results", tmp_path / "nothing", "Here")
    venv.EnvBuilder().create(tmp_path / "empty")
    with pytest.raises(MethodError, match=r"--python .*python: there is no NumPy; install it"):
        run(data, tmp_path / "results", tmp_path / "empty/bin/python", "Here")


@pytest.mark.ci
def test_methods_of_gcbench_run_here_beside_it(
    data: Path, tmp_path: Path, python: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    outcome = run(data, tmp_path / "results", python, "Here", "icp")
    assert {folder.run.row.name for folder in outcome.runs} == {"here", "icp"}
    with pytest.raises(ConfigError, match="--python is for methods that are not gcbench's"):
        run(data, tmp_path / "results", python, "icp")


def test_the_program_is_one_that_old_pythons_read() -> None:
    tree = ast.parse(Path(standalone.__file__).read_text(), feature_version=(3, 8))
    imported = {alias.name.split(".")[0] for node in ast.walk(tree)
                if isinstance(node, ast.Import | ast.ImportFrom)
                for alias in (node.names if isinstance(node, ast.Import)
                              else [ast.alias(node.module or "?")])}
    assert imported - {"numpy"} <= sys.stdlib_module_names
