"""The journal of an unfinished export: one line of JSON per sequence, after a first one that
identifies the export. An incomplete last line is ignored.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...robots.files import LOCK
from ..runtime import dump_json

_FILE = "journal.jsonl"


class Journal:
    """Appends to _FILE in a folder.

    `entries` are the sequences of earlier runs and this one, in order: "sequence" is the name,
    "frames" their number, "record" what the format needs to know.
    """

    def __init__(self, folder: Path, plan: Mapping[str, Any], names: Sequence[str]) -> None:
        """Continue what is in `folder` if it follows this `plan` for the first of `names`, else
        delete it and begin.
        """
        self.path = folder / _FILE
        lines = self.path.read_bytes().splitlines(keepends=True) if self.path.is_file() else []
        whole = [line for line in lines if line.endswith(b"\n")]
        if whole[:1] == [_line(plan)]:
            self.entries: list[dict[str, Any]] = [json.loads(line) for line in whole[1:]]
            done = [entry["sequence"] for entry in self.entries]
            if done == [*names][: len(done)]:
                self._file = self.path.open("r+b")
                self._file.truncate(sum(map(len, whole)))
                self._file.seek(0, os.SEEK_END)
                return
        self.entries = []
        for path in folder.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            elif path.name != LOCK:
                path.unlink()
        self._file = self.path.open("wb")
        self._append(_line(plan))

    def add(self, name: str, frames: int, record: Mapping[str, Any]) -> Mapping[str, Any]:
        """Append a sequence that is written; return its record as a later run will read it."""
        line = _line({"sequence": name, "frames": frames, "record": record})
        self._append(line)
        self.entries.append(json.loads(line))
        return self.entries[-1]["record"]

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _append(self, line: bytes) -> None:
        self._file.write(line)
        self._file.flush()
        os.fsync(self._file.fileno())


def _line(tree: Mapping[str, Any]) -> bytes:
    """On one line; a number is written so that the same one is read."""
    return json.dumps(json.loads(dump_json(tree))).encode() + b"\n"
