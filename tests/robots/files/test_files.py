"""Bounded reads refuse what may block or fill memory; writes leave the old file or the new one."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest
from gcbench.errors import ConfigError, GcbenchError, ModelError
from gcbench.robots.files import (
    AssetFinder,
    asset_finder,
    create_folder_atomically,
    lock_folder,
    read_bounded,
    write_atomically,
)
from gcbench.robots.files.atomic import replace_atomically
from gcbench.robots.files.lock import is_free
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st


def names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


def test_a_file_is_read_up_to_its_bound(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    assert read_bounded(path, 5) == b"12345"
    assert read_bounded(path, 2**62) == b"12345"  # a bound costs no memory
    with pytest.raises(ConfigError, match="larger than 4 bytes"):
        read_bounded(path, 4, ConfigError)


@pytest.mark.parametrize("kind", ["fifo", "device", "folder", "nothing"])
def test_only_regular_files_are_read_and_none_blocks(kind: str, tmp_path: Path) -> None:
    path = tmp_path / kind
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "device":
        path = Path("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    failures: list[BaseException] = []

    def read() -> None:
        with pytest.raises(ModelError, match=str(path)) as failure:
            read_bounded(path, 10)
        failures.append(failure.value)

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    thread.join(10)
    assert failures, "it blocks"


@given(old=st.binary(max_size=200), new=st.binary(max_size=200), fails=st.booleans())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_an_atomic_write_leaves_the_old_file_or_the_new_one(
    old: bytes, new: bytes, fails: bool, tmp_path: Path
) -> None:
    path = tmp_path / "file"
    write_atomically(path, old)
    try:
        with replace_atomically(path) as temporary:
            temporary.write_bytes(new)
            assert path.read_bytes() == old
            if fails:
                raise KeyboardInterrupt
    except KeyboardInterrupt:
        pass
    assert path.read_bytes() == (old if fails else new)
    assert names(tmp_path) == ["file"]


def test_a_folder_is_complete_or_absent(tmp_path: Path) -> None:
    target = tmp_path / "cache" / "folder"

    def fail(folder: Path) -> None:
        (folder / "half").touch()
        raise ModelError("no")

    with pytest.raises(ModelError):
        create_folder_atomically(target, "it", fail)
    assert not names(target.parent)
    create_folder_atomically(target, "it", lambda folder: (folder / "whole").touch())
    create_folder_atomically(target, "it", fail)  # it is there
    assert names(target) == ["whole"] and names(target.parent) == ["folder"]


def test_a_folder_has_one_writer(tmp_path: Path) -> None:
    with (lock_folder(tmp_path), pytest.raises(GcbenchError, match=str(os.getpid())),
          lock_folder(tmp_path)):
        pass
    with lock_folder(tmp_path):
        pass


PIECE = st.sampled_from(["..", ".", "a", "out", "link", "b.obj", "c.stl", "%2e%2e", "~", "", "C:"])


@given(scheme=st.sampled_from(["", "package://", "file://", "model://", "/", "//"]),
       pieces=st.lists(PIECE, min_size=1, max_size=7), nested=st.booleans())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=300)
def test_asset_paths_never_leave_their_root(
    scheme: str, pieces: list[str], nested: bool, tmp_path: Path
) -> None:
    root = tmp_path / "root"
    if not root.exists():
        for folder in ("root/a", "out/a"):
            (tmp_path / folder).mkdir(parents=True)
        for place in ("", "out", "out/a", "root", "root/a"):
            for name in ("b.obj", "c.stl"):
                (tmp_path / place / name).touch()
        (root / "link").symlink_to(tmp_path / "out")
    finder: AssetFinder = asset_finder(root / "a" / "model.urdf", {"a": root / "a"}, root)
    reference = scheme + "/".join(pieces)
    try:
        if nested:
            asset = finder.find_beside(finder.find("b.obj"), reference, frozenset({".obj", ".stl"}))
        else:
            asset = finder.find(reference)
    except ModelError:
        return
    assert asset.path.is_relative_to(root.resolve()) and asset.path.is_file()


@pytest.mark.parametrize("kind", ["fifo", "link", "folder"])
def test_a_lock_is_a_regular_file(kind: str, tmp_path: Path) -> None:
    """A folder of other people must not have a file elsewhere written, nor block."""
    (tmp_path / "precious").write_text("content")
    (tmp_path / "out").mkdir()
    lock = tmp_path / "out/.lock"
    {"fifo": lambda: os.mkfifo(lock), "folder": lock.mkdir,
     "link": lambda: lock.symlink_to(tmp_path / "precious")}[kind]()
    with pytest.raises(ConfigError, match="lock: is not a regular file; delete it"), \
            lock_folder(tmp_path / "out"):
        pass
    assert not is_free(tmp_path / "out")
    assert (tmp_path / "precious").read_text() == "content"


def test_a_message_about_a_name_of_two_lines_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"a\\nb: cannot be read \(No such file"):
        read_bounded(tmp_path / "a\nb", error=ConfigError)
