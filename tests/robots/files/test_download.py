"""Fetching, with real pip and a folder that stands for the package index."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import textwrap
import time
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest
from gcbench import GcbenchError
from gcbench.robots.files import download as module
from gcbench.robots.files.atomic import is_alive
from gcbench.robots.files.download import WheelFiles, cache_folder, fetch, folder_of, is_fetched
from gcbench.robots.files.lock import lock_folder

MEMBERS = {
    "toy/urdf/toy.urdf": b"<robot name='toy'/>",
    "toy/meshes/a.stl": b"solid a",
    "toy/meshes/deep/b.stl": b"solid b",
    "toy/other/huge.bin": b"not wanted",
    "gcbench_toy-1.0.dist-info/LICENSE": b"do as you like",
}


def make_wheel(folder: Path, members: dict[str, bytes] = MEMBERS, project: str = "gcbench-toy",
               tag: str = "py3-none-any") -> WheelFiles:
    folder.mkdir(parents=True, exist_ok=True)
    stem = f"{project.replace('-', '_')}-1.0"
    path = folder / f"{stem}-{tag}.whl"
    info = f"{stem}.dist-info"
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
        archive.writestr(f"{info}/METADATA",
                         f"Metadata-Version: 2.1\nName: {project}\nVersion: 1.0\n")
        archive.writestr(f"{info}/WHEEL",
                         f"Wheel-Version: 1.0\nGenerator: t\nRoot-Is-Purelib: true\nTag: {tag}\n")
        archive.writestr(f"{info}/RECORD", "")
    data = path.read_bytes()
    return WheelFiles(name="toy", project=project, version="1.0", size=len(data),
                      sha256=hashlib.sha256(data).hexdigest(),
                      keep=("toy/urdf/toy.urdf", "toy/meshes/",
                            "gcbench_toy-1.0.dist-info/LICENSE"))


@pytest.fixture
def index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder where pip looks for wheels, and nowhere else; the cache is empty."""
    folder = tmp_path / "index"
    folder.mkdir()
    for name in [n for n in os.environ if n.startswith("PIP_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(folder))
    monkeypatch.setenv("GCBENCH_CACHE", str(tmp_path / "cache"))
    return folder


def leftovers() -> list[str]:
    return [path.name for path in (cache_folder() / "robots").glob("*")]


def test_only_the_named_files_come_and_only_once(index: Path) -> None:
    files = make_wheel(index)
    assert not is_fetched(files)
    folder = fetch(files)
    assert is_fetched(files) and folder == folder_of(files)
    found = {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    assert found == {k: v for k, v in MEMBERS.items() if "other" not in k}
    assert leftovers() == [folder.name]
    next(index.glob("*.whl")).unlink()
    assert fetch(files) == folder  # no second download


def test_a_wheel_with_native_code_is_the_same_on_every_machine(index: Path) -> None:
    options = ("--python-version=3.12", "--implementation=cp",
               "--platform=manylinux_2_35_x86_64")
    files = make_wheel(index, tag="cp312-abi3-manylinux_2_35_x86_64")
    make_wheel(index, {"toy/urdf/toy.urdf": b"wrong"}, tag="py3-none-any")
    assert fetch(replace(files, platform=options)).is_dir()


def test_another_wheel_than_the_pinned_one_is_refused(index: Path) -> None:
    files = replace(make_wheel(index), sha256="0" * 64)
    with pytest.raises(GcbenchError, match="pinned") as caught:
        fetch(files)
    assert "\n" not in str(caught.value)
    assert not is_fetched(files) and leftovers() == []


def test_a_wheel_that_cannot_be_had_is_one_line_that_names_the_fix(index: Path) -> None:
    files = make_wheel(index)
    next(index.glob("*.whl")).unlink()
    with pytest.raises(GcbenchError) as caught:
        fetch(files)
    message = str(caught.value)
    assert "\n" not in message
    for part in ("gcbench-toy==1.0", "gcbench robots fetch toy", str(folder_of(files))):
        assert part in message
    assert leftovers() == []


def test_missing_pip_is_one_line(index: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = make_wheel(index)
    monkeypatch.setattr(module, "find_spec", lambda name: None)  # pyright: ignore
    with pytest.raises(GcbenchError, match="python -m ensurepip"):
        fetch(files)
    assert leftovers() == []


def test_an_environment_without_pip_uses_the_copy_that_python_carries(
        index: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib.util
    bundled = importlib.util.find_spec("ensurepip")
    monkeypatch.setattr(module, "find_spec",
                        lambda name: None if name == "pip" else bundled)  # pyright: ignore
    if bundled and list(Path(str(bundled.origin)).parent.glob("_bundled/pip-*.whl")):
        assert fetch(make_wheel(index)).is_dir()
    else:  # Debian takes it out
        with pytest.raises(GcbenchError, match="python -m ensurepip"):
            fetch(make_wheel(index))


@pytest.mark.parametrize("name", ["toy/meshes/../../../escaped", "/toy/escaped",
                                  "toy/meshes/..\\escaped"])
def test_members_cannot_leave_the_folder(index: Path, tmp_path: Path, name: str) -> None:
    files = make_wheel(index, {**MEMBERS, name: b"evil"})
    rules = ("toy/meshes/",) if name.startswith("toy") else (name,)
    with pytest.raises(GcbenchError, match="refused"):
        fetch(replace(files, keep=rules))
    assert leftovers() == [] and not list(tmp_path.rglob("escaped"))


def test_a_wheel_without_the_files_is_an_error(index: Path) -> None:
    with pytest.raises(GcbenchError, match="has no toy/absent/"):
        fetch(replace(make_wheel(index), keep=("toy/absent/",)))
    assert leftovers() == []


def test_a_cache_that_cannot_be_written_names_the_setting(
        index: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (index / "file").write_text("in the way")
    monkeypatch.setenv("GCBENCH_CACHE", str(index / "file"))
    with pytest.raises(GcbenchError, match="GCBENCH_CACHE"):
        fetch(make_wheel(index))


def test_the_cache_folder_follows_the_environment(monkeypatch: pytest.MonkeyPatch,
                                                  tmp_path: Path) -> None:
    monkeypatch.setenv("GCBENCH_CACHE", str(tmp_path / "own"))
    assert cache_folder() == tmp_path / "own"
    monkeypatch.delenv("GCBENCH_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "gcbench"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder() == Path.home() / ".cache" / "gcbench"


def start_fetching(files: WheelFiles, before: str = "") -> subprocess.Popen[bytes]:
    code = textwrap.dedent(f"""
        import pathlib, time
        from gcbench.robots.files import download as module
        from gcbench.robots.files.download import WheelFiles
        {before}
        module.fetch({files!r})
    """)
    return subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_fetch_does_not_count_and_the_next_one_works(
        index: Path, tmp_path: Path, sent: signal.Signals) -> None:
    files = make_wheel(index)
    mark = tmp_path / "unpacking"
    process = start_fetching(files, f"""
        def stall(archive, member, folder, mark=pathlib.Path({str(mark)!r})):
            (folder / "half").write_text("")
            mark.touch()
            time.sleep(60)
        module._extract_member = stall""".strip().replace("\n        ", "\n        "))
    started = time.monotonic()
    while not mark.exists() and time.monotonic() - started < 60:
        time.sleep(0.05)
    assert mark.exists()
    process.send_signal(sent)
    assert process.wait(20) != 0
    assert not is_fetched(files)
    if sent == signal.SIGINT:
        assert leftovers() == []
    else:  # nobody could tidy up: the next fetch does
        (left,) = (cache_folder() / "robots").glob("*.part")
        os.utime(left, (time.time() - 10,) * 2)
    assert fetch(files).is_dir()
    assert leftovers() == [folder_of(files).name]


def test_what_another_process_fetches_stays(index: Path) -> None:
    part = cache_folder() / "robots/toy-1.part"
    part.mkdir(parents=True)
    with lock_folder(part):
        os.utime(part, (time.time() - 10,) * 2)
        fetch(make_wheel(index))
        assert part.is_dir()
    os.utime(part, (time.time() - 10,) * 2)
    fetch(replace(make_wheel(index), name="again"))
    assert not part.exists()


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends a process with its parent")
def test_pip_ends_with_a_killed_fetch(index: Path, tmp_path: Path) -> None:
    mark = tmp_path / "pid"
    code = f"import os, time; open({str(mark)!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    process = start_fetching(make_wheel(index), f"module._pip = lambda: [{sys.executable!r}, "
                             f"'-c', {code!r}]")
    started = time.monotonic()
    while not (mark.exists() and mark.read_text()) and time.monotonic() - started < 60:
        time.sleep(0.05)
    process.kill()
    process.wait(20)
    while is_alive(int(mark.read_text())) and time.monotonic() - started < 90:
        time.sleep(0.05)
    assert not is_alive(int(mark.read_text()))


def test_two_processes_may_fetch_at_once(index: Path) -> None:
    files = make_wheel(index)
    both = [start_fetching(files), start_fetching(files)]
    assert [process.wait(120) for process in both] == [0, 0]
    assert leftovers() == [folder_of(files).name]
    assert (folder_of(files) / "toy/meshes/a.stl").read_bytes() == MEMBERS["toy/meshes/a.stl"]


def test_the_slower_of_two_fetches_takes_what_is_there(
        index: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = make_wheel(index)
    check = module._check

    def other_finishes_first(files: WheelFiles, wheel: Path) -> None:
        check(files, wheel)
        (folder_of(files) / "toy").mkdir(parents=True)

    monkeypatch.setattr(module, "_check", other_finishes_first)
    assert fetch(files) == folder_of(files)
    assert leftovers() == [folder_of(files).name]
