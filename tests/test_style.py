"""Limits of size, and one meaning for each name."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

import pytest

from .test_architecture import FILES, name_of

MODULE_LINES, FUNCTION_LINES, PARAMETERS = 350, 50, 6
KERNELS = {f for f in FILES if "kernels" in f.stem}


def is_compiled(function: ast.FunctionDef) -> bool:
    names = {ast.unparse(d).partition("(")[0].rpartition(".")[2] for d in function.decorator_list}
    return bool(names & {"compiled", "jit"})


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_a_module_is_short(path: Path) -> None:
    lines = len(path.read_text().splitlines())
    assert path in KERNELS or lines <= MODULE_LINES, f"{lines} lines"


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_functions_are_short(path: Path) -> None:
    wrong: list[str] = []
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.FunctionDef) or is_compiled(node):
            continue
        given = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
        parameters = [a.arg for a in given if a.arg not in ("self", "cls")]
        body = node.body[1:] if ast.get_docstring(node) else node.body
        lines = (node.end_lineno or 0) - (body[0].lineno if body else node.lineno) + 1
        too_many = len(parameters) > PARAMETERS and path.stem != "commands"  # options
        if lines > FUNCTION_LINES or too_many:
            wrong.append(f"{node.name}: {lines} lines, {len(parameters)} parameters")
    assert not wrong


def public_names(path: Path) -> set[str]:
    """What a module defines at its top level and does not call private."""
    names: set[str] = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign):
            targets = (n for t in node.targets for n in ast.walk(t))
            names |= {n.id for n in targets if isinstance(n, ast.Name)}
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names.add(node.target.id)
    return {name for name in names if not name.startswith("_")}


def test_a_public_name_means_one_thing() -> None:
    """The command line calls the public API by its names; each is defined once beside it."""
    places: dict[str, set[str]] = defaultdict(set)
    for path in FILES:
        if path.name not in ("__init__.py", "__main__.py", "commands.py"):
            for name in public_names(path):
                places[name].add(name_of(path))
    assert not {name: where for name, where in places.items() if len(where) > 1}


def test_a_public_name_hides_no_module() -> None:
    modules = {f.stem for f in FILES}
    for path in FILES:
        beside = {f.stem for f in path.parent.glob("*.py")} & modules
        if path.name == "__init__.py" and len(name_of(path).split("/")) == 3:
            assigned: set[str] = set()
            for node in ast.parse(path.read_text()).body:
                if isinstance(node, ast.ImportFrom) and node.level and node.module:
                    assigned |= {a.asname or a.name for a in node.names}
            assert not assigned & beside, name_of(path)


IRREGULAR = {
    "begun", "bound", "broken", "brought", "built", "caught", "chosen", "cut", "dealt", "done",
    "drawn", "driven", "fallen", "found", "given", "gone", "grown", "held", "hidden", "kept",
    "known", "laid", "left", "lent", "lost", "made", "met", "paid", "put", "run", "said", "seen",
    "sent", "set", "shown", "shut", "split", "spread", "stood", "taken", "taught", "thought",
    "thrown", "told", "understood", "won", "written",
}
"""Participles that do not end in -ed."""

NOT_PARTICIPLES = {
    "embed", "exceed", "feed", "heading", "mapping", "need", "proceed", "seed", "speed", "string",
    "tiling", "training",
}
"""Words that end like one."""

VERBS = {
    "add", "check", "count", "cut", "describe", "dump", "fill", "find", "has", "is", "list", "load",
    "open", "pose", "put", "read", "refine", "rescore", "round", "run", "score", "select", "set",
    "split", "spread", "subtract", "verify", "write",
}
"""Verbs that may stand alone, or before a participle: `read_stored` reads what is stored."""

OTHERS = {"compiled", "namespaced"}
"""A decorator, which describes the function below it, and a method that trimesh calls."""


def is_participle(word: str) -> bool:
    regular = word.endswith(("ed", "ing")) and len(word) > 4 and word not in NOT_PARTICIPLES
    return word in IRREGULAR or regular


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_no_function_is_called_by_a_participle(path: Path) -> None:
    """`round_values`, not `rounded`; `find_flow`, not `flow_named`."""
    wrong: list[str] = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef) and node.name not in OTHERS:
            words = node.name.strip("_").split("_")
            if is_participle(words[-1]) and words[0] not in VERBS:
                wrong.append(f"{node.name}, line {node.lineno}")
    assert not wrong


FOLK_WORDS = {"badness", "crew", "dice", "footage", "guess", "lively", "spots", "trade", "ways"}
"""Words that the glossary replaces; `feet` is a word of geometry and of appliances."""


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_names_are_words_of_the_field(path: Path) -> None:
    names = [path.stem]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.append(node.name)
        elif isinstance(node, ast.Name | ast.arg):
            names.append(node.id if isinstance(node, ast.Name) else node.arg)
    assert not {name for name in names if FOLK_WORDS & set(name.lower().split("_"))}
