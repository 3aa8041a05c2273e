"""Fuzzed configuration files, suites and options of every command."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

from .binary import change_bytes
from .cases import Case, Special
from .data import EVALUATE, dataset_files
from .mutations import change_json, change_tree, dump_tree, places
from .rng import NAMES, NUMBERS, CaseRng, Raw
from .sandbox import Command

Content = dict[str, "bytes | Special"]
_SMALL: dict[str, Any] = {
    "robot": "../input/arm.urdf",
    "frames": 2,
    "width": 32,
    "height": 24,
    "samples": 1,
    "track_points": 4,
}
"""What is asked for must be small: a fuzzed number may be large, and is then a wish, no error."""


def configuration(rng: CaseRng) -> Case:
    """A configuration file, a suite, or options of a command."""
    return rng.choice([_file, _file, _suite, _options, _options])(rng)


def _tree(rng: CaseRng) -> dict[str, Any]:
    """All fields of a RenderConfig with their defaults, some of them changed."""
    from gcbench.renderer.scene.config import RenderConfig

    tree = json.loads(json.dumps(dataclasses.asdict(RenderConfig())))
    tree |= {k: v for k, v in _SMALL.items() if k != "robot"} | {"robot": _SMALL["robot"]}
    tree["randomization"]["textures"]["size"] = 32
    tree["randomization"]["background"]["room"] = 0.1
    for _ in rng.few(5):
        change_tree(rng, tree, "config")
    _restrain(tree)
    return tree


def _restrain(tree: Any) -> None:
    """Set back what asks for hours of work."""
    large = {"frames": 10, "width": 400, "height": 400, "track_points": 300, "n": 3, "size": 1024}
    for holder, key, _ in places(tree):
        if key in large and isinstance(holder, dict):
            old = holder[key]
            if isinstance(old, int | float) and large[key] < old < 2**40:
                holder[key] = large[key]


def _file(rng: CaseRng) -> Case:
    tree = _tree(rng)
    name = rng.choice(["c.toml", "c.json", "c.json", "c.txt"])
    data = _toml(tree) if name == "c.toml" else dump_tree(tree)
    if rng.chance(0.15):
        data = change_bytes(rng, data, name)
    elif name == "c.json" and rng.chance(0.1):
        data = change_json(rng, dataset_files()["d/dataset.json"], name)  # type: ignore[arg-type]
        data = data if b"[[[" in data else _restrained(data)
    files: Content = {"arm.urdf": dataset_files()["arm.urdf"], name: data}
    if rng.chance(0.03):
        files[name] = rng.choice(
            [Special("fifo"), Special("folder"), Special("link", "/dev/zero")]
        )
    argv = ("render", "--config", f"../input/{name}", "--n", "1", "--workers", "1", "--out", "out")
    return Case(files, [Command(argv, fetches=True)], rng.steps)


def _restrained(data: bytes) -> bytes:
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError):
        return data
    _restrain(tree)
    return dump_tree(tree)


def _suite(rng: CaseRng) -> Case:
    config = {k: v for k, v in _tree(rng).items() if k not in ("stream",) or rng.chance(0.2)}
    config.pop("keep_unobservable", None)
    entry = {"name": "a", "n": 1, **config}
    tree: dict[str, Any] = {"name": "mine", "dataset": [entry]}
    if rng.chance(0.3):
        tree["defaults"] = {"seed": 5}
    for _ in rng.few(2):
        change_tree(rng, tree, "suite")
    _restrain(tree)
    data = _toml(tree)
    if rng.chance(0.1):
        data = change_bytes(rng, data, "s.toml")
    files: Content = {"arm.urdf": dataset_files()["arm.urdf"], "s.toml": data}
    argv = (
        "eval",
        "--method",
        "hold-still",
        "--suite",
        "../input/s.toml",
        "--results",
        "results",
        "--suites",
        "suites",
    )
    return Case(files, [Command(argv, (0, 1, 2), quiet=False, fetches=True)], rng.steps)


def _toml(tree: dict[str, Any]) -> bytes:
    """TOML of a tree; what it has no words for becomes a line that is not TOML."""

    def inline(item: Any) -> str:
        if isinstance(item, Raw):
            return str(item)
        if isinstance(item, dict):
            return "{" + ", ".join(f"{_key(k)} = {inline(v)}" for k, v in item.items()) + "}"
        if isinstance(item, list):
            return "[" + ", ".join(map(inline, item)) + "]"
        if isinstance(item, str):
            return json.dumps(item)
        return "nil" if item is None else json.dumps(item)

    return "\n".join(f"{_key(k)} = {inline(v)}" for k, v in tree.items()).encode()


def _key(name: str) -> str:
    return json.dumps(str(name))


_OPTIONS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "render": (
        (
            "--robot",
            "../input/arm.urdf",
            "--n",
            "1",
            "--frames",
            "2",
            "--width",
            "32",
            "--height",
            "24",
            "--samples",
            "1",
            "--workers",
            "1",
            "--out",
            "out",
            "--textures.size",
            "32",
        ),
        (
            "--seed",
            "--stream",
            "--package",
            "--scored-joints",
            "--vary",
            "--layers",
            "--camera.fov",
            "--camera.azimuth",
            "--lights.number",
            "--motion.total",
            "--background.color",
            "--background.folder",
            "--textures.kinds",
            "--textures.folder",
            "--image.noise",
            "--image.blur",
            "--animation",
            "--randomize",
            "--robot",
            "--config",
            "--samples",
            "--workers",
            "--n",
            "--frames",
            "--width",
            "--out",
        ),
    ),
    "verify": (("../input/d", "--workers", "1"), ("--workers",)),
    "show": (
        ("../input/d", "--out", "page.html"),
        ("--index", "--contact-sheet", "--gif", "--out"),
    ),
    "export": (
        ("../input/d", "--format", "coco", "--out", "export"),
        ("--format", "--sequences", "--out"),
    ),
    "eval": (
        EVALUATE[1:],
        (
            "--method",
            "--flow",
            "--depth",
            "--set",
            "--inputs",
            "--knowledge",
            "--timeout",
            "--retry",
            "--data",
            "--suite",
            "--workers",
            "--results",
        ),
    ),
    "score": (
        ("--predictions", "../input/p.csv", "--data", "../input/d"),
        ("--predictions", "--data", "--suite", "--results"),
    ),
    "report": (("results", "--out", "report"), ("--out", "--pictures")),
    "robots": ((), ("--x",)),
    "robots fetch": (("nothing",), ("--all=1",)),
    "train flow": (
        ("--out", "raft", "--data", "../input/d", "--steps", "0", "--device", "cpu"),
        (
            "--steps",
            "--batch",
            "--crop",
            "--device",
            "--rate",
            "--seed",
            "--held-out",
            "--start-from",
            "--precision",
            "--robots",
        ),
    ),
}
_VALUES = (
    "0",
    "-1",
    "1",
    "2",
    "1.5",
    "nan",
    "inf",
    "1e999",
    "none",
    "full",
    "ur5@true-parts",
    "hold-still@true-flow",
    "icp",
    "gcpose",
    "x.py:Y",
    "json:loads",
    "os:system",
    ":",
    "x:",
    "@",
    "rgb",
    "rgbd",
    "free",
    "ok",
    "mini",
    "cpu",
    "cuda:9",
    "0-9",
    "9-0",
    "0,,1",
    "../input/d",
    "../input",
    "../secret",
    "/dev/zero",
    "/dev/null",
    "nowhere",
    "a=b",
    "rgbd.candidates=8",
    "rgbd.candidates=x",
    "x=y=z",
    "normal",
    "tracks",
    "lights",
    "pan",
    "slide",
    "8192",
)
_LONG = ("--n", "--frames", "--width", "--workers", "--steps", "--batch")


def _options(rng: CaseRng) -> Case:
    name = rng.choice([*_OPTIONS, "render", "eval"])
    base, more = _OPTIONS[name]
    argv = [*name.split(), *base]
    for _ in range(1 + len(rng.few(3))):
        option = rng.choice(more)
        values = [
            rng.choice([*_VALUES, *NUMBERS, *NAMES])
            for _ in range(rng.choice([0, 1, 1, 1, 1, 2, 3]))
        ]
        if option in _LONG:
            values = [v for v in values if not (v.isdecimal() and v.isascii() and 3 < len(v) < 12)]
        if option == "--out":  # a command may write where it is told to
            values = [v for v in values if v not in ("../input", "../secret")]
        how = rng.choice(["append", "append", "insert", "replace", "delete", "equals"])
        if how == "insert":
            at = rng.randrange(len(name.split()), len(argv) + 1)
            argv[at:at] = [option, *values]
        elif how == "replace" and base:
            argv[rng.randrange(len(name.split()), len(argv))] = rng.choice([*_VALUES, *NAMES])
        elif how == "delete" and base:
            del argv[rng.randrange(len(name.split()), len(argv))]
        elif how == "equals":
            argv.append(f"{option}={values[0] if values else ''}")
        else:
            argv += [option, *values]
        if len(argv) <= len(name.split()) and base:
            break
    if name == "export" and not any(a.startswith("--out") for a in argv):
        argv += ["--out", "export"]  # the default is beside the dataset
    rng.note(" ".join(argv).encode("ascii", "backslashreplace").decode()[:100])
    words = tuple(a.replace("\0", "?").encode("utf-8", "replace").decode() for a in argv)
    codes = (0, 1, 2) if name in ("verify", "eval") else (0, 2)
    return Case(
        dict(dataset_files()),
        [Command(words, codes, quiet=name not in ("eval", "score"), fetches=True)],
        rng.steps,
    )
