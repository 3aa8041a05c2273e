"""Robots of the package robot_descriptions, by name: `rd:panda_description`.

A module of that package clones the git repository of its robot when it is imported. So a separate
process imports it, in which git asks for no password and gives up when the network stalls. The
cache is that of the package ($ROBOT_DESCRIPTIONS_CACHE, else ~/.cache/robot_descriptions); a
repository in it needs no network.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ...errors import ModelError, suggestion
from ..files import cache_folder

PREFIX = "rd:"
_LIMIT = 3600.0  # s, of a clone
_SILENT = {
    "GIT_TERMINAL_PROMPT": "0", "GIT_ASKPASS": "true", "SSH_ASKPASS": "true",
    "GIT_HTTP_LOW_SPEED_LIMIT": "1000", "GIT_HTTP_LOW_SPEED_TIME": "60",
}  # bytes/s, s
_IMPORT = """
import contextlib, importlib, json, sys
try:
    with contextlib.redirect_stdout(sys.stderr):
        module = importlib.import_module("robot_descriptions." + sys.argv[1])
        import git
        commit = git.Repo(module.REPOSITORY_PATH).head.commit.hexsha
    answer = {k: v for k, v in vars(module).items() if k.endswith("_PATH") and isinstance(v, str)}
    answer["commit"] = commit
except Exception as error:
    answer = {"error": str(error)}
print(json.dumps(answer))
"""


@dataclass(frozen=True)
class ClonedRobot:
    """The files of a robot in the cache of robot_descriptions."""

    urdf: Path
    repository: Path
    """The folder that the URDF may read from."""
    packages: dict[str, Path]
    """Folders of ROS packages by name."""
    source: str
    """One line of provenance."""


def description_of(name: str) -> Any:
    """Return what robot_descriptions says of a robot (`maker`, `robot`, `license_spdx`, ...).

    Raises ModelError if the package is not installed or lacks the robot, or the robot has no URDF.
    """
    try:
        from robot_descriptions import DESCRIPTIONS  # pyright: ignore
    except ImportError:
        raise ModelError(f"{name} comes from the package robot_descriptions, which is not "
                         "installed: pip install robot_descriptions") from None
    known: dict[str, Any] = DESCRIPTIONS
    found = known.get(name.removeprefix(PREFIX))
    if found is None:
        of_urdf = [PREFIX + n for n, d in known.items() if d.has_urdf]
        raise ModelError(f"no robot {name!r}{suggestion(name, of_urdf)}; "
                         f"robot_descriptions has {len(of_urdf)} with a URDF")
    if not found.has_urdf:
        raise ModelError(f"{name} is not supported (it has no URDF, only MuJoCo's MJCF)")
    return found


@cache
def clone_robot(name: str, download: bool = True) -> ClonedRobot:
    """Return the files of a robot; clone its repository if it is not in the cache and `download`.

    Raises ModelError if that is impossible, or the robot is described by xacro only.
    """
    description = description_of(name)
    lock = cache_folder() / "robot_descriptions.lock"
    lock.parent.mkdir(parents=True, exist_ok=True)
    with lock.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # two clones into one folder would disturb each other
        answer = _import(name, download)
    if "URDF_PATH" not in answer:
        raise ModelError(f"{name} is a xacro file, {answer.get('XACRO_PATH')}: run "
                         "`xacro FILE > robot.urdf` (pip install xacro) and load the result")
    repository = Path(answer["REPOSITORY_PATH"])
    package = Path(answer.get("PACKAGE_PATH", repository))
    places = [repository, *repository.iterdir(), *package.parent.iterdir(), *package.iterdir(),
              package]
    return ClonedRobot(
        Path(answer["URDF_PATH"]), repository,
        {p.name: p for p in places
         if p.is_dir() and not p.is_symlink() and p.is_relative_to(repository)},
        f"{name}: robot_descriptions=={version('robot_descriptions')}, "
        f"{description.repository or repository.name} at {answer['commit']}",
    )


def _import(name: str, download: bool) -> dict[str, str]:
    """Return the paths of a module of robot_descriptions, and the commit of its repository."""
    environment = {**os.environ, **_SILENT, **({} if download else {"GIT_ALLOW_PROTOCOL": ""})}
    command = [sys.executable, "-c", _IMPORT, name.removeprefix(PREFIX)]
    show = None if download and sys.stderr.isatty() else subprocess.DEVNULL  # its progress
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                              stderr=show, env=environment, timeout=_LIMIT, check=False)
        answer: dict[str, str] = json.loads(done.stdout)
    except subprocess.TimeoutExpired:
        answer = {"error": f"git did not finish within {_LIMIT:g} s"}
    except ValueError:
        answer = {"error": "its module could not be imported"}
    if "error" in answer:
        fatal = re.search(r"fatal: ([^\n]*)", answer["error"])
        reason = (fatal[1] if fatal else answer["error"].strip().partition("\n")[0]).strip(" '\"")
        fetch = f"gcbench robots fetch {name}"
        raise ModelError(
            f"{name} is not on this machine ({fetch})" if not download else
            f"cannot clone {name} ({reason}); run `{fetch}` where there is network, and copy "
            "~/.cache/robot_descriptions (or $ROBOT_DESCRIPTIONS_CACHE)")
    return answer
