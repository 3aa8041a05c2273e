"""What a fuzzed case is: files, and the command lines that read them."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from .binary import png
from .sandbox import Command, Sandbox

SIZE = ("--width", "32", "--height", "24", "--textures.size", "32")
"""Of images and of random textures, on which no case depends."""
_NO_ROOM = ("--background.room", "0")
"""The pictures of a room take most of the time of a small render."""


@dataclass(frozen=True)
class Special:
    """A file that is none: fifo, folder, link (to `target`)."""

    kind: str
    target: str = ""


Files = Mapping[str, "bytes | Special"]


@dataclass
class Case:
    """Files below the input folder (work/... below the current folder), and commands in order.

    A command runs if all before it succeeded.
    """

    files: dict[str, bytes | Special]
    commands: list[Command]
    steps: list[str] = field(default_factory=list)


def write(files: Files, box: Sandbox) -> None:
    """Write the files of a case, and baits that must not be read."""
    triangle = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    for name, data in (
        ("secret.obj", triangle),
        ("secret.png", png(4, 4)),
        ("secret", b"secret"),
        ("secret.bin", bytes(4096)),
        ("secret.stl", b"solid x"),
        ("secret.mtl", b""),
    ):
        (box.root / "secret" / name).write_bytes(data)
    for name, data in files.items():
        folder, _, rest = name.partition("/")
        path = box.work / rest if folder == "work" else box.input / name
        if any(parent.exists() and not parent.is_dir() for parent in path.parents) or path.is_dir():
            continue  # a case may put a file in the place of a folder
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError):
            continue  # a file of the case is in the place of its folder
        path.unlink(missing_ok=True)
        if isinstance(data, bytes):
            path.write_bytes(data)
        elif data.kind == "fifo":
            os.mkfifo(path)
        elif data.kind == "folder":
            path.mkdir()
        else:
            path.symlink_to(data.target)


def read_tree(folder: Path, prefix: str) -> dict[str, bytes | Special]:
    """The files below a folder, as files of a case."""
    return {
        f"{prefix}/{path.relative_to(folder)}": path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }


def copy_tree(folder: Path, to: Path) -> None:
    """Copy without the lock file."""
    shutil.copytree(folder, to, ignore=shutil.ignore_patterns(".lock"))


def render(robot: str, *more: str) -> Command:
    """A small render of a model in the input folder, without a room unless asked for one."""
    return Command(
        (
            "render",
            "--robot",
            robot,
            "--n",
            "1",
            "--frames",
            "2",
            *SIZE,
            "--samples",
            "1",
            "--workers",
            "1",
            "--out",
            "out",
            *(() if {"--background.room", "--randomize"} & {*more} else _NO_ROOM),
            *more,
        )
    )


VERIFY = Command(("verify", "out", "--workers", "1", "--allow-model"), (0,))
"""What gcbench rendered is right."""
