"""`gcbench show --rerun`: record one sequence and open the recording in the viewer of Rerun."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path

from ...errors import RenderError
from ..dataset import default_output, open_dataset, select_sequences
from .driver import export_dataset


def record_for_rerun(dataset: Path, index: str = "", allow_model: bool = False) -> Path:
    """Write `DATASET-SEQUENCE.rrd` (`default_output`) and return its path.

    Args:
        dataset: Folder of the dataset.
        index: Number of the sequence. Default: the first.
        allow_model: Whether to read the model from a path that the dataset names.

    Raises:
        DatasetError: there is no dataset, or it cannot be read.
        ConfigError: there is no such sequence, or the SDK of Rerun is not installed.
        RenderError: the file cannot be written.
    """
    name = select_sequences(open_dataset(dataset), index)[0]
    out = default_output(dataset, f"-{name}.rrd")
    try:
        with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.") as folder:
            export = Path(folder) / "export"
            export_dataset(dataset, "rerun", export, str(int(name)), allow_model=allow_model)
            (export / f"{name}.rrd").replace(out)
    except OSError as error:
        raise RenderError(f"cannot write {out}: {error.strerror or error}") from error
    return out


def open_rerun(recording: Path) -> str:
    """Open a recording in the viewer, which stays open; return "".

    Without a display or the program `rerun`, return a message that says what to run.
    """
    program = shutil.which("rerun", path=f"{Path(sys.executable).parent}{os.pathsep}"
                                         f"{os.environ.get('PATH', '')}")
    if program is None or not any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY"))):
        return f"to see the recording where there is a display, run: rerun {recording}"
    silent = [(os.POSIX_SPAWN_OPEN, fd, os.devnull, os.O_RDWR, 0) for fd in range(3)]
    os.posix_spawn(program, [program, str(recording)], os.environ, file_actions=silent, setpgroup=0)
    return ""
