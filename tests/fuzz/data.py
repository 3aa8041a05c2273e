"""Fuzzed datasets, predictions and results folders, for the commands that read them."""

from __future__ import annotations

import io
import json
import zipfile
from functools import cache
from typing import Any

import numpy as np

from .binary import change_array, change_bytes, change_png, make_zip, npy
from .cases import Case, Special, read_tree, write
from .mutations import change_json
from .rng import NAMES, NUMBERS, CaseRng
from .sandbox import Command, Sandbox, run

Content = dict[str, "bytes | Special"]
_ARM = """<robot name="arm">
<link name="base"><visual><geometry><box size="0.3 0.3 0.1"/></geometry></visual></link>
<link name="low"><visual><origin xyz="0.3 0 0.1"/><geometry><box size="0.6 0.1 0.05"/></geometry>
</visual></link><link name="high"><visual><origin xyz="0.2 0 0.1"/><geometry>
<cylinder radius="0.06" length="0.3"/></geometry></visual></link>
<joint name="pan" type="revolute"><parent link="base"/><child link="low"/><origin xyz="0 0 0.1"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
<joint name="slide" type="prismatic"><parent link="low"/><child link="high"/>
<origin xyz="0.4 0 0.1"/><axis xyz="1 0 0"/><limit lower="0" upper="0.4" effort="1" velocity="1"/>
</joint></robot>"""
_LAYERS = ("--layers", "normal", "coordinates", "tracks", "--track-points", "8")
EVALUATE = (
    "eval",
    "--method",
    "hold-still",
    "--data",
    "../input/d",
    "--keep-unobservable",
    "--results",
    "results",
)

_RENDER = (
    *("render", "--robot", "../input/arm.urdf", "--n", "2", "--frames", "3", "--width", "48"),
    *("--height", "36", "--samples", "1", "--workers", "1", "--keep-unobservable", *_LAYERS),
    *("--textures.size", "32", "--background.room", "0"),
)


@cache
def dataset_files() -> Content:
    """A dataset of two sequences of two frames, and the model beside it, as gcbench makes them."""
    return _made()[0]


@cache
def results_files() -> Content:
    """The results of a method on that dataset."""
    return _made()[1]


@cache
def _made() -> tuple[Content, Content]:
    with Sandbox.temporary() as box:
        box.reset()
        write({"arm.urdf": _ARM.encode()}, box)
        for argv in ((*_RENDER, "--out", "../input/d"), EVALUATE):
            done = run(Command(argv), box)
            if done.code:
                raise RuntimeError(f"{argv}: {done.stderr}")
        results = read_tree(box.work / "results", "work/results")
        model: Content = {"arm.urdf": _ARM.encode()}
        return {**read_tree(box.input / "d", "d"), **model}, results


# -- datasets -------------------------------------------------------------------------------------


def dataset(rng: CaseRng) -> Case:
    """A dataset with a changed description, sequence, member or file."""
    files = dict(dataset_files())
    for _ in range(len(rng.few(2)) + 1 if rng.chance(0.97) else 0):
        how = rng.choice(
            ["json", "sequence", "sequence", "sequence", "sequence", "special", "file"]
        )
        if how == "json":
            files["d/dataset.json"] = _changed_json(rng, files["d/dataset.json"], "dataset.json")
        elif how == "sequence":
            _change_sequence(rng, files)
        elif how == "special":
            name = rng.choice(
                [
                    "d/dataset.json",
                    "d/sequences/000001.zip",
                    "d/sequences/000002.zip",
                    "d/sequences/000001",
                    "d/sequences",
                    "d/sequences/x.zip",
                ]
            )
            if name == "d/sequences":
                for other in [n for n in files if n.startswith("d/sequences/")]:
                    del files[other]
            files[name] = rng.choice(
                [
                    Special("fifo"),
                    Special("folder"),
                    b"",
                    b"PK\5\6" + bytes(18),
                    Special("link", "/dev/zero"),
                    Special("link", "nowhere"),
                ]
            )
            rng.note(f"{name}: {files[name]}")
        else:
            name = rng.choice([n for n in files if isinstance(files[n], bytes)])
            data = files[name]
            assert isinstance(data, bytes)
            files[name] = change_bytes(rng, data, name)
    return read_dataset(files, rng.choice(READERS), rng.steps)


_FORMATS = ("kitti", "bop", "coco", "webdataset", "tapvid")
_CONTINUED = (*_RENDER, "--out", "d")
READERS: tuple[tuple[str, ...], ...] = (
    ("verify", "../input/d", "--workers", "1", "--allow-model"),
    ("verify", "../input/d/sequences/000001.zip"),
    ("show", "../input/d", "--index", "1", "--out", "page.html"),
    ("show", "../input/d", "--contact-sheet", "sheet.png"),
    ("show", "../input/d/sequences/000001.zip", "--gif", "film.gif"),
    *(
        ("export", "../input/d", "--format", name, "--out", "export", "--allow-model")
        for name in _FORMATS
    ),
    EVALUATE,
    ("render", "--config", "../input/d/dataset.json", "--n", "1", "--workers", "1", "--out", "out"),
    _CONTINUED,
)
"""Commands that read a dataset."""


def read_dataset(files: Content, argv: tuple[str, ...], steps: list[str]) -> Case:
    """A command on a dataset; one that continues it has it in its current folder."""
    if argv is _CONTINUED:
        files = {f"work/{k}" if k.startswith("d/") else k: v for k, v in files.items()}
    codes = (0, 1, 2) if argv[0] in ("verify", "eval") else (0, 2)
    # a configuration, or a dataset whose model is allowed, may name a robot of the catalogue
    fetches = not {"--config", "--allow-model"}.isdisjoint(argv)
    return Case(files, [Command(argv, codes, quiet=argv[0] != "eval", fetches=fetches)], steps)


def _changed_json(rng: CaseRng, data: bytes | Special, name: str) -> bytes:
    if not isinstance(data, bytes):
        return b"{}"
    try:
        return change_json(rng, data, name)
    except (ValueError, RecursionError):  # it was changed before
        return change_bytes(rng, data, name)


def _change_sequence(rng: CaseRng, files: Content) -> None:
    """Change a member of a sequence, or the ZIP."""
    name = "d/sequences/000001.zip"
    data = files.get(name)
    try:
        members = members_of(data) if isinstance(data, bytes) else {}
    except Exception:  # it was damaged before
        members = {}
    if not members:
        return
    for _ in range(1 + len(rng.few(2))):
        how = rng.choice(["meta", "meta", "state", "state", "state", "png", "png", "zip", "bytes"])
        if how == "meta" and "meta.json" in members:
            members["meta.json"] = _changed_json(rng, members["meta.json"], "meta.json")
        elif how == "state" and "state.npz" in members:
            members["state.npz"] = change_npz(rng, members["state.npz"], "state.npz")
        elif how == "png":
            member = rng.choice([m for m in members if m.endswith(".png")] or ["rgb/000000.png"])
            if member in members:
                members[member] = change_png(rng, members[member], member)
        elif how == "bytes" and members:
            member = rng.choice([*members])
            members[member] = change_bytes(rng, members[member], member)
    if rng.chance(0.1):
        rng.note("unpacked")
        del files[name]
        for member, content in members.items():
            files[f"d/sequences/000001/{member}"] = content
        return
    files[name] = make_zip(rng, members, "000001.zip")


def members_of(data: bytes | Special) -> dict[str, bytes]:
    assert isinstance(data, bytes)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {info.filename: archive.read(info) for info in archive.infolist()}


def change_npz(rng: CaseRng, data: bytes, name: str) -> bytes:
    """Change an array of an NPZ file, or the file."""
    try:
        members = members_of(data)
    except Exception:  # it was damaged before
        return change_bytes(rng, data, name)
    how = rng.choice(["array", "array", "array", "missing", "more", "zip", "bytes"])
    if not members:
        return change_bytes(rng, data, name)
    member = rng.choice([*members])
    if how == "bytes":
        return change_bytes(rng, data, name)
    if how == "missing":
        rng.note(f"{name}: no {member}")
        del members[member]
    elif how == "more":
        members[rng.choice(["x.npy", ".npy", "", "../x.npy", "x"])] = npy(np.zeros(3))
    elif how == "array":
        try:
            members[member] = change_array(rng, members[member], f"{name}: {member}")
        except Exception:  # it was damaged before
            members[member] = change_bytes(rng, members[member], f"{name}: {member}")
    return make_zip(rng, members, name)


# -- predictions ----------------------------------------------------------------------------------


def predictions(rng: CaseRng) -> Case:
    """A CSV or an NPZ of predictions, changed."""
    files = dict(dataset_files())
    header = {"method": "mine", "inputs": "rgbd", "knowledge": "free", "training": "none"}
    for _ in rng.few(2):
        key = rng.choice([*header, "version", "# x", "unknown"])
        if rng.chance(0.2):
            header.pop(key, None)
        else:
            header[key] = rng.choice([*NAMES, "rgb", "none", "axes", "self-supervised", "9" * 400])
        rng.note(f"{key}: {header.get(key)!a}")
    if rng.chance(0.5):
        name, files["p.npz"] = "p.npz", _npz(rng, header)
    else:
        name, files["p.csv"] = "p.csv", _csv(rng, header)
    if rng.chance(0.03):
        files[name] = rng.choice(
            [Special("fifo"), Special("folder"), Special("link", "/dev/zero")]
        )
    argv = (
        "score",
        "--predictions",
        f"../input/{name}",
        "--data",
        "../input/d",
        "--keep-unobservable",
        "--results",
        "results",
    )
    return Case(
        files,
        [
            Command(argv, quiet=False),
            Command(("report", "results", "--no-pictures", "--out", "report"), (0,)),
        ],
        rng.steps,
    )


def _csv(rng: CaseRng, header: dict[str, str]) -> bytes:
    lines = [f"# {key}: {text}" for key, text in header.items()]
    lines.append("sequence,frame,joint,displacement")
    lines += [f"{s:06d},{t},{j},{0.01 * t * j}" for s in (0, 1) for t in (1, 2) for j in (1, 2)]
    for _ in rng.few(4):
        k = rng.randrange(len(lines))
        cells = lines[k].split(",")
        how = rng.choice(["cell", "cell", "name", "delete", "copy", "quote", "more", "blank"])
        if how == "cell":
            cells[rng.randrange(len(cells))] = rng.choice(NUMBERS)
        elif how == "name":
            cells[rng.randrange(len(cells))] = rng.choice(NAMES)
        elif how == "quote":
            cells[0] = '"' + cells[0]
        elif how == "more":
            cells.append("0")
        lines[k] = ",".join(cells)
        if how == "delete":
            del lines[k]
        elif how == "copy":
            lines.insert(k, lines[k])
        elif how == "blank":
            lines[k:k] = [""] * rng.choice([1, 60])
        rng.note(f"line {k} {how} {lines[min(k, len(lines) - 1)][:50]!a}")
    data = "\n".join(lines).encode("utf-8", "surrogatepass")
    if rng.chance(0.05):
        return data.decode(errors="replace").encode("utf-16")
    return change_bytes(rng, data, "p.csv") if rng.chance(0.1) else data


def _npz(rng: CaseRng, header: dict[str, str]) -> bytes:
    members = {f"{key}.npy": npy(np.array(text)) for key, text in header.items() if "/" not in key}
    for name in ("000000", "000001"):
        members[f"{name}.npy"] = npy(np.arange(6.0).reshape(3, 2) * 0.01)
        if rng.chance(0.3):
            members[f"{name}.screw.npy"] = npy(np.ones((2, 6)))
    data = make_zip(None, members)
    for _ in rng.few(3):
        data = change_npz(rng, data, "p.npz")
    return data


# -- results --------------------------------------------------------------------------------------


def results(rng: CaseRng) -> Case:
    """A results folder with a changed run, score table or estimate."""
    files = {**dataset_files(), **results_files()}
    mine = [*results_files()]
    for _ in range(1 + len(rng.few(3))):
        name = rng.choice(mine)
        data = files.get(name)
        how = rng.random()
        if how < 0.04 or not isinstance(data, bytes):
            files[name] = rng.choice(
                [Special("fifo"), Special("folder"), b"", Special("link", "/dev/zero")]
            )
            rng.note(f"{name}: {files[name]}")
        elif name.endswith(".json"):
            files[name] = _changed_json(rng, data, "run.json")
        elif name.endswith(".csv"):
            files[name] = _scores(rng, data)
        else:
            files[name] = _estimate(rng, data)
    argv = rng.choice(
        [
            ("report", "results", "--no-pictures", "--out", "report"),
            ("report", "results", "--no-pictures", "--out", "report"),
            ("report", "results", "--out", "report"),
            EVALUATE,
            (*EVALUATE, "--retry", "ok"),
            (*EVALUATE, "--retry", "raised", "invalid"),
        ]
    )
    return Case(files, [Command(argv, (0, 1, 2), quiet=argv[0] == "report")], rng.steps)


def _scores(rng: CaseRng, data: bytes) -> bytes:
    if rng.chance(0.1):
        return change_bytes(rng, data, "scores.csv")
    lines = data.decode(errors="replace").split("\n")
    for _ in range(1 + len(rng.few(3))):
        k = rng.randrange(len(lines))
        cells = lines[k].split(",")
        column = rng.randrange(len(cells))
        how = rng.choice(["number", "name", "delete", "copy", "cell", "whole"])
        if how == "delete":
            del lines[k]
        elif how == "copy":
            lines[k:k] = [lines[k]] * rng.choice([1, 100])
        elif how == "cell":
            del cells[column]
        elif how == "whole":  # a column of all lines
            new = rng.choice([*NUMBERS, *NAMES])
            for i, line in enumerate(lines[1:], 1):
                if len(parts := line.split(",")) > column:
                    parts[column] = new
                    lines[i] = ",".join(parts)
        else:
            cells[column] = rng.choice(NUMBERS if how == "number" else NAMES)
        if how in ("cell", "number", "name"):
            lines[k] = ",".join(cells)
        rng.note(f"scores.csv: line {k} column {column} {how} {cells[column : column + 1]!a}")
        lines = lines or [""]
    return "\n".join(lines).encode("utf-8", "replace")


def _estimate(rng: CaseRng, data: bytes) -> bytes:
    try:
        members = members_of(data)
    except Exception:  # it was damaged before
        return change_bytes(rng, data, "estimate")
    how = rng.choice(["json", "arrays", "arrays", "bytes", "bomb"])
    if how == "json" and "estimate.json" in members:
        members["estimate.json"] = _changed_json(rng, members["estimate.json"], "estimate.json")
    elif how == "arrays" and "estimate.npz" in members:
        members["estimate.npz"] = change_npz(rng, members["estimate.npz"], "estimate.npz")
    elif how == "bomb":
        members["estimate.npz"] = bomb("displacement", (2**24, 2))
        rng.note("estimate.npz: bomb")
    else:
        return change_bytes(rng, data, "estimate")
    return make_zip(rng, members, "estimate")


def bomb(name: str, shape: tuple[int, ...]) -> bytes:
    """A deflated NPZ of zeros that is a thousand times larger than the file."""
    out = io.BytesIO()
    with (
        zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open(f"{name}.npy", "w", force_zip64=True) as file,
    ):
        header: Any = {"descr": "<f8", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, header)
        left = 8 * int(np.prod(shape))
        while left > 0:
            left -= file.write(bytes(min(left, 2**20)))
    return out.getvalue()


def tree_of(data: bytes | Special) -> Any:
    assert isinstance(data, bytes)
    return json.loads(data)
