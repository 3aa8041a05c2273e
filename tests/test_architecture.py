"""The rules of the house: who imports whom, what is imported when, what ships."""

from __future__ import annotations

import ast
import importlib
import importlib.metadata
import os
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import gcbench
import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PACKAGE = Path(str(gcbench.__file__)).resolve().parent
CHECKOUT = Path(__file__).resolve().parent.parent
ROOMS = ("robots", "renderer", "gcpose", "benchmark")
FILES = sorted(
    [*PACKAGE.glob("*.py"), *(f for room in ROOMS for f in PACKAGE.glob(f"{room}/**/*.py"))]
)
HEAVY = {
    "numpy",
    "scipy",
    "cv2",
    "torch",
    "trimesh",
    "tyro",
    "OpenGL",
    "pyrender",
    "yourdfpy",
    "fcl",
    "tqdm",
    "fsspec",
    "s3fs",
}

LAYERS = {
    "robots": (
        "geometry",
        "model",
        "files",
        "motion",
        "meshes appliances",
        "gltf generated",
        "urdf",
        "catalog",
        "commands",
    ),
    "renderer": (
        "types runtime",
        "scene cluster",
        "gl dataset",
        "truth verify show",
        "generate export",
        "doctor observation torch_dataset",
        "commands",
    ),
    "gcpose": (
        "numerics networks", "chain images", "estimator", "rgbd", "rgb", "fusion",
        "paper training learned", "settings input_checks", "method", "video", "commands",
    ),
    "benchmark": ("results", "protocol", "methods report", "run", "commands"),
}
"""The sub-packages of each room, lowest first: each imports only from those above it here."""

BETWEEN_ROOMS = {
    "robots": {},
    "renderer": {"robots": LAYERS["robots"]},
    "gcpose": {"robots": ("geometry model motion files",), "renderer": ("types",)},
    "gcpose/commands": {"renderer": ("runtime",)},
    "gcpose/learned": {
        "robots": ("geometry model motion files catalog",), "renderer": ("types runtime dataset",),
    },
    "gcpose/training": {
        "robots": ("geometry model motion files catalog appliances",),
        "renderer": ("types dataset generate scene runtime",),
    },
    "benchmark": {
        "robots": LAYERS["robots"],
        "renderer": ("types runtime dataset scene cluster generate show export",),
    },
}
"""What a room, or one of its sub-packages, imports from other rooms; `errors` is for everyone."""


def name_of(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


def room_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE).parts
    return parts[0] if len(parts) > 1 else ""


def imports(path: Path) -> Iterator[str]:
    """Dotted absolute names of what a file imports, at any depth."""
    package = ["gcbench", *path.relative_to(PACKAGE).parts[:-1]]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) + 1 - node.level] if node.level else []
            module = ".".join([*base, *filter(None, [node.module])])
            yield from (f"{module}.{alias.name}" for alias in node.names)


def ours(path: Path) -> Iterator[tuple[str, str]]:
    """(room, the rest) of what a file imports of this package; the root's room is ""."""
    for name in imports(path):
        if name.split(".")[0] == "gcbench":
            _, _, rest = name.partition(".")
            room = rest.split(".")[0]
            yield (room, rest.partition(".")[2]) if room in ROOMS else ("", rest)


# -- who imports whom -------------------------------------------------------------------------


def floors(room: str) -> dict[str, int]:
    return {name: k for k, names in enumerate(LAYERS[room]) for name in names.split()}


def package_of(path: Path) -> str:
    """The sub-package of a file, or the module that stands beside the sub-packages."""
    return path.relative_to(PACKAGE).with_suffix("").parts[1]


def may_import(path: Path, room: str, rest: str) -> bool:
    """Whether LAYERS and BETWEEN_ROOMS let a file import `rest` of a room."""
    here, package, target = room_of(path), package_of(path), rest.split(".")[0]
    if room == "":
        of_api = package == "commands" and rest in gcbench.__all__
        return rest.startswith("errors.") or rest == "__version__" or of_api
    if room != here:
        allowed = BETWEEN_ROOMS.get(f"{here}/{package}", BETWEEN_ROOMS[here])
        return target in " ".join(allowed.get(room, ())).split()
    if package in ("__init__", target):
        return True
    floor = floors(room)
    return floor[target] < floor[package]


def test_there_is_something_to_check() -> None:
    assert {room_of(f) for f in FILES} == {"", *ROOMS}
    scene = PACKAGE / "renderer/scene/scene.py"
    assert ("robots", "model.ArticulatedModel") in set(ours(scene))
    assert ("", "errors.ConfigError") in set(ours(PACKAGE / "renderer/scene/config.py"))


@pytest.mark.parametrize("room", ROOMS)
def test_imports_go_down(room: str) -> None:
    wrong = [
        f"{name_of(f)} imports {r}.{rest}"
        for f in FILES
        if room_of(f) == room
        for r, rest in ours(f)
        if not may_import(f, r, rest)
    ]
    assert not wrong


@pytest.mark.parametrize("room", ROOMS)
def test_every_subpackage_has_a_floor(room: str) -> None:
    there = {package_of(f) for f in FILES if room_of(f) == room} - {"__init__"}
    assert there == set(floors(room))


def subpackages() -> list[Path]:
    return sorted(f for f in FILES if f.name == "__init__.py" and len(name_of(f).split("/")) == 3)


LOADED_BY_NAME = {
    "gcpose.networks", "gcpose.training", "gcpose.learned", "gcpose.images.network_flow",
    "renderer.dataset.torch", "renderer.generate.torch_stream",
}
"""What needs an extra: its modules are imported where they are used."""


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_other_subpackages_are_seen_through_their_public_names(path: Path) -> None:
    public = {
        ".".join(name_of(f).split("/")[:2]): importlib.import_module(
            ".".join(["gcbench", *name_of(f).split("/")[:2]])
        ).__all__
        for f in subpackages()
    }
    here = ".".join(name_of(path).split("/")[:2])
    for room, rest in ours(path):
        package, _, name = f"{room}.{rest}".strip(".").rpartition(".")
        target = ".".join(package.split(".")[:2])
        module = PACKAGE / f"{target.replace('.', '/')}.py"
        if target in ("", "errors", here, *ROOMS) or module.is_file():
            continue
        if any(f"{package}.".startswith(f"{lazy}.") for lazy in LOADED_BY_NAME):
            continue
        assert package in public, f"imports {name} from the inside of another: {package}"
        is_module = (PACKAGE / package.replace(".", "/") / f"{name}.py").is_file()
        assert name in public[package] or is_module, f"{name} is not public in {package}"


@pytest.mark.parametrize("path", subpackages(), ids=name_of)
def test_a_subpackage_lists_its_public_names(path: Path) -> None:
    module = importlib.import_module(".".join(["gcbench", *name_of(path).split("/")[:-1]]))
    assert module.__doc__
    assert sorted(module.__all__) == sorted(set(module.__all__))
    assert all(hasattr(module, name) for name in module.__all__)


def test_no_file_imports_itself_through_others() -> None:
    modules = {name_of(f)[:-3].removesuffix("/__init__").replace("/", "."): f for f in FILES}
    arrows: dict[str, set[str]] = {}
    for name, path in modules.items():
        targets = {f"{r}.{rest}".strip(".") for r, rest in ours(path)}
        targets |= {t.rpartition(".")[0] for t in targets - set(modules)}
        arrows[name] = (targets & set(modules)) - {name, "", "__main__"}
    try:
        TopologicalSorter(arrows).prepare()
    except CycleError as circle:
        pytest.fail(" -> ".join(circle.args[1]))


def test_imports_of_ours_are_relative() -> None:
    """An absolute one would find another installation's, when two are about.

    `__main__` is run as a part of `gcbench`, which Python has found and imported before it.
    """
    wrong = [
        f"{name_of(f)}:{node.lineno}"
        for f in FILES
        if f.name != "__main__.py"
        for node in ast.walk(ast.parse(f.read_text()))
        if (
            isinstance(node, ast.ImportFrom)
            and not node.level
            and (node.module or "").split(".")[0] in {"gcbench", *ROOMS}
        )
        or (
            isinstance(node, ast.Import)
            and any(a.name.split(".")[0] in {"gcbench", *ROOMS} for a in node.names)
        )
    ]
    assert not wrong


def test_one_module_touches_opengl() -> None:
    users = {
        name_of(f)
        for f in FILES
        if any(name.split(".")[0] in ("OpenGL", "pyrender") for name in imports(f))
    }
    assert users == {"renderer/gl/context.py"}


def test_one_module_parses_xml() -> None:
    """The door through which untrusted files come is one."""
    users = {
        name_of(f)
        for f in FILES
        if any(name.startswith(("xml.", "lxml", "defusedxml")) for name in imports(f))
    }
    assert users <= {"robots/files/xml.py", "robots/meshes/collada.py"}, users
    dae = set(imports(PACKAGE / "robots/meshes/collada.py"))
    assert any(name.startswith("gcbench.robots.files.") for name in dae)


# -- what is imported when --------------------------------------------------------------------


def test_the_root_imports_nothing() -> None:
    tree = ast.parse((PACKAGE / "__init__.py").read_text())
    modules = {node.module for node in tree.body if isinstance(node, ast.ImportFrom)}
    assert modules == {"__future__", "typing", "errors"}
    assert not any(isinstance(node, ast.Import) for node in tree.body)


@pytest.mark.parametrize(
    "code",
    [
        "import gcbench",
        "from gcbench.__main__ import main; main(['--help'])",
        "from gcbench.__main__ import main; main(['--version'])",
    ],
)
def test_light_things_load_no_heavy_module(code: str) -> None:
    code += f"""
import sys
ours = {{m for m in sys.modules if m.startswith("gcbench.") and m.count(".") > 1}}
heavy = {HEAVY!r} & set(sys.modules) | {{m for m in ours if not m.endswith(".commands")}}
sys.exit(" ".join(sorted(heavy)) or 0)"""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_the_base_install_needs_no_extra() -> None:
    """Every public name is there without what the extras bring."""
    code = """
import sys
for name in ("torch", "sapien", "pycocotools", "rerun", "h5py", "webdataset",
             "submitit", "ray", "fsspec", "s3fs"):
    sys.modules[name] = None
import gcbench as gb
assert all(getattr(gb, name) is not None for name in gb.__all__)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.gl
def test_a_run_of_this_machine_imports_no_cluster_and_no_cloud(tmp_path: Path) -> None:
    """Neither in the command nor in its processes, although `find_spec` finds them."""
    (tmp_path / "extras").mkdir()
    marker = tmp_path / "imported"
    for name in ("ray", "submitit", "fsspec", "s3fs"):
        code = f"from pathlib import Path; Path({str(marker)!r}).write_text({name!r})"
        (tmp_path / f"extras/{name}.py").write_text(code)
    path = os.pathsep.join([str(tmp_path / "extras"), os.environ.get("PYTHONPATH", "")])
    for args in (
        ["render", "--robot", "owi535", "--n", "1", "--frames", "2", "--width", "64", "--height",
         "48", "--out", "data", "--executor", "local", "--keep-unobservable"],
        ["eval", "--method", "hold-still", "--data", "data", "--keep-unobservable", "--executor",
         "local"],
    ):
        done = subprocess.run(
            [sys.executable, "-m", "gcbench", *args], cwd=tmp_path, capture_output=True, text=True,
            env={**os.environ, "PYTHONPATH": path.rstrip(os.pathsep)})
        assert done.returncode == 0, done.stderr
        assert not marker.exists(), marker.read_text()


def test_robots_are_listed_without_drawing_or_parsing() -> None:
    heavy = {"cv2", "torch", "trimesh", "OpenGL", "pyrender", "yourdfpy", "pandas", "numba"}
    code = (
        "import sys; from gcbench.__main__ import main; main(['robots'])\n"
        f"sys.exit(' '.join(sorted({heavy!r} & set(sys.modules))) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


# -- how code is written ----------------------------------------------------------------------


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_a_file_says_what_it_is(path: Path) -> None:
    doc = ast.get_docstring(ast.parse(path.read_text()))
    assert doc, f"{name_of(path)} has no docstring"
    assert doc.splitlines()[0].rstrip().endswith((".", ":", ",")) or doc.count("\n"), doc


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_nothing_runs_or_unpickles_what_it_reads(path: Path) -> None:
    forbidden = {"pickle", "cPickle", "dill", "marshal", "shelve", "joblib"}
    assert not [name for name in imports(path) if name.split(".")[0] in forbidden]
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.Call):
            continue
        if isinstance(node.func, ast.Name):
            assert node.func.id not in ("eval", "exec", "compile"), f"{path}:{node.lineno}"
        for keyword in node.keywords:
            if keyword.arg in ("allow_pickle", "shell"):
                assert isinstance(keyword.value, ast.Constant), f"{path}:{node.lineno}"
                assert keyword.value.value is False, f"{path}:{node.lineno}"


# -- what ships -------------------------------------------------------------------------------


def shipped() -> set[str]:
    """The files of the package, relative to the checkout."""
    return {"__init__.py", "__main__.py", "errors.py", "py.typed"} | {
        f.relative_to(CHECKOUT).as_posix()
        for room in ROOMS
        for f in CHECKOUT.glob(f"{room}/**/*")
        if f.is_file() and "__pycache__" not in f.parts
    }


def test_the_root_holds_no_other_python_file() -> None:
    assert {f.name for f in CHECKOUT.glob("*.py")} == {"__init__.py", "__main__.py", "errors.py"}


def test_the_versions_agree() -> None:
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["project"]
    assert project["version"] == gcbench.__version__


@pytest.mark.skipif(
    not os.environ.get("GCBENCH_TEST_INSTALLED"), reason="`make test` tests what is installed"
)
def test_what_is_tested_is_what_is_installed() -> None:
    site = {Path(sysconfig.get_path(key)).resolve() for key in ("purelib", "platlib")}
    assert PACKAGE.parent in site
    code = "import gcbench.renderer.scene.config as c; print(c.__file__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert Path(done.stdout.strip()).resolve().is_relative_to(PACKAGE)  # in workers, too

    (installed,) = importlib.metadata.distributions(name="gcbench", path=[str(PACKAGE.parent)])
    files = {f.as_posix() for f in installed.files or ()}
    there = {f for f in files if f.startswith("gcbench/") and "__pycache__" not in f}
    assert there == {f"gcbench/{name}" for name in shipped()}
    for name in shipped():
        assert (PACKAGE / name).read_bytes() == (CHECKOUT / name).read_bytes(), name


def build(kind: str, out: Path) -> set[str]:
    """The names in a new wheel or sdist of the checkout."""
    hatchling = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(out)]
    done = subprocess.run(hatchling, cwd=CHECKOUT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (built,) = out.iterdir()
    if kind == "wheel":
        return set(zipfile.ZipFile(built).namelist())
    with tarfile.open(built) as archive:
        return {name.partition("/")[2] for name in archive.getnames()}


def test_the_wheel_holds_the_package_and_nothing_else(tmp_path: Path) -> None:
    pytest.importorskip("hatchling", reason="hatchling builds the wheel")
    names = build("wheel", tmp_path)
    info = f"gcbench-{gcbench.__version__}.dist-info/"
    assert {n for n in names if not n.startswith(info)} == {f"gcbench/{n}" for n in shipped()}


def test_the_sdist_is_complete(tmp_path: Path) -> None:
    """It can be tested and built again."""
    pytest.importorskip("hatchling", reason="hatchling builds the sdist")
    names = build("sdist", tmp_path)
    tests = {f.relative_to(CHECKOUT).as_posix() for f in CHECKOUT.glob("tests/**/*.py")}
    assert shipped() | tests | {"Makefile", ".ci/environment", "pyproject.toml", "LICENSE"} <= names
