"""Command line options from the arguments of functions and the fields of dataclasses."""

# No `annotations` from the future here: `command` hands annotations to tyro.

import functools
import inspect
import io
import json
import os
import re
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Union, cast

import numpy as np

from ...errors import ConfigError
from .help import format_help
from .object_store import address

_SHOW_TARGET = ["--show-target"]
"""The list with which `parse_options` raises `_TargetShown`; compared by identity."""


class _TargetShown(Exception):  # noqa: N818 - a signal
    pass


@dataclass(frozen=True)
class OutputOptions:
    """What a command prints."""

    quiet: bool = False
    """Show no progress and no plan: print the result and errors only."""
    json: bool = False
    """Print the result as one JSON document."""


def parse_options(
    args: Sequence[str], name: str, target: Any, doc: str | None, default: Any = None,
    groups: Mapping[str, str] | None = None,
) -> Any:
    """Return the options of one command: an instance of the dataclass `target`.

    The help shows the `groups` of options (see `format_help`). Raises ConfigError for wrong
    options, SystemExit after printing the help.
    """
    if args is _SHOW_TARGET:
        raise _TargetShown(target)
    asked = next((k for k, arg in enumerate(args) if arg in ("-h", "--help")), None)
    shown = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")  # of another, boxes are ASCII
    if asked is None:
        with redirect_stdout(shown):
            return _parse(args, name, target, default)
    with _columns(), redirect_stdout(shown), suppress(SystemExit):
        _parse(["--help"], name, target, default)
    about = inspect.cleandoc(doc or "").partition("\n\nArgs:")[0]
    wanted = next((arg for arg in args[asked + 1:asked + 2] if not arg.startswith("-")), "")
    shown.seek(0)
    text = format_help(shown.read(), groups or {}, wanted)
    print(f"{about}\n\n{text}" if wanted in ("", "all") else text)
    raise SystemExit(0)


@contextmanager
def _columns() -> Generator[None]:
    """Have tyro draw its boxes below each other."""
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "100"
    try:
        yield
    finally:
        os.environ.pop("COLUMNS")
        if before is not None:
            os.environ["COLUMNS"] = before


def _parse(args: Sequence[str], name: str, target: Any, default: Any) -> Any:
    import tyro

    complaint = io.StringIO()
    try:
        with redirect_stderr(complaint):
            return tyro.cli(
                target,
                prog=f"gcbench {name}",
                args=args,
                description="",
                default=tyro.MISSING_NONPROP if default is None else default,
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone),
            )
    except SystemExit as stop:
        if not stop.code:
            raise
        hint = f"`gcbench {name} --help` explains the options"
        raise ConfigError(f"{_one_line(complaint.getvalue())}; {hint}") from None


def _one_line(box: str) -> str:
    """Return the error that tyro draws as a box of many lines in one line."""
    lines = re.sub(r"\x1b\[[\d;]*m", "", box).replace("│", " ").splitlines()
    text = " ".join(" ".join(lines[1:]).split())
    text = re.split(r" ?─{3,}| Got errors:", text)[0].rstrip(" .")
    text = re.sub(r"^Missing from gcbench .*?: (\S+).*", r"give \1", text)
    text = _say_numbers(text, lines)
    text = text.replace("Unrecognized options", "unknown").replace("Expected 1 values", "Give one")
    meant = re.findall(r"(?m)^ {6}(--\S+)", "\n".join(lines).partition("Perhaps you meant:")[2])
    hint = f" (perhaps you meant {', '.join(meant)})" if meant else ""
    return text[:1].lower() + text[1:] + hint


def _say_numbers(text: str, lines: list[str]) -> str:
    """Return an error on the numbers of an option with the numbers that it needs."""
    commas = re.fullmatch(
        r"Error parsing (--\S+): .* arguments: \[(?=.*\d,)([-+.\de,' ]+)\]", text)
    if commas:
        given = re.sub("[', ]+", " ", commas[2]).strip()
        return f"{commas[1]}: give numbers with spaces and no commas: {given}"
    needs = re.search(
        r"Argument helptext:\s+(--\S+) ([A-Z]+(?: [A-Z]+)+)\s*\n", "\n".join(lines))
    if needs and "no type matching" in text:
        return f"{needs[1]} needs {len(needs[2].split())} numbers: {needs[2]}"
    return text


def run_command(
    name: str, function: Callable[..., tuple[object, int]], args: Sequence[str]
) -> tuple[object, int]:
    """Run a command and return what it prints and its exit code.

    One that takes `args` parses them; the arguments of another are its options.
    """
    if "args" in function.__annotations__:
        return function(args)
    import tyro

    def bind(*positional: Any, **options: Any) -> Callable[[], tuple[object, int]]:
        return functools.partial(function, *positional, **options)

    def explain(p: inspect.Parameter) -> inspect.Parameter:
        """Return a parameter with what the help shows: a text in Annotated names its values."""
        if p.default is not None:
            return p
        values, = getattr(p.annotation, "__metadata__", (None,))
        arg = tyro.conf.arg(metavar=values, help_behavior_hint="")
        return p.replace(annotation=Annotated[p.annotation, arg])

    parameters = [explain(p) for p in inspect.signature(function).parameters.values()]
    bind.__doc__ = function.__doc__
    bind.__annotations__ = {p.name: p.annotation for p in parameters}
    vars(bind)["__signature__"] = inspect.Signature(parameters)
    return parse_options(args, name, bind, function.__doc__)()


def to_json(record: object) -> str:
    """Return dataclasses, mappings, paths and lists as JSON in ASCII; null for NaN and infinity."""
    def plain(value: Any) -> Any:
        if is_dataclass(value):
            return {f.name: getattr(value, f.name) for f in fields(value)}
        if isinstance(value, Mapping):
            return dict(cast("Mapping[str, Any]", value))
        if isinstance(value, Path):
            return address(value)
        return value.item() if isinstance(value, np.generic) else str(value)

    tree = json.loads(json.dumps(record, default=plain), parse_constant=lambda _: None)
    return json.dumps(tree, indent=1)


def parse_ranges(text: str) -> list[range]:
    """Return the ranges of numbers that `--sequences` names, such as 0-9,15."""
    ranges: list[range] = []
    for item in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,9})(?:\s*-\s*(\d{1,9}))?\s*", item, re.ASCII)
        if not match:
            raise ConfigError(f"--sequences {text[:60]!a}: give numbers and ranges, as in 0-9,15")
        first, last = int(match[1]), int(match[2] or match[1])
        if last < first:
            raise ConfigError(f"--sequences {text[:60]}: give the smaller number first")
        ranges.append(range(first, last + 1))
    return ranges


def completion_script(commands: Mapping[str, Callable[..., object]], shell: str) -> str:
    """Return a script with which a shell completes the commands and their options."""
    import tyro

    shells = ("bash", "zsh", "tcsh")
    if shell not in shells:
        raise ConfigError(f"--completion {shell}: give one of {', '.join(shells)}")
    targets = {name: _target_of(f) for name, f in commands.items() if " " not in name}
    groups: dict[str, list[Any]] = {}
    for name, function in commands.items():
        first, _, second = name.partition(" ")
        if second:
            kind = tyro.conf.subcommand(second)
            groups.setdefault(first, []).append(Annotated[_target_of(function), kind])
    for first, kinds in groups.items():
        if len(kinds) > 1:
            targets[first] = Union[tuple(kinds)]  # noqa: UP007 - as many as there are
    out = io.StringIO()
    with redirect_stdout(out), suppress(SystemExit):
        tyro.extras.subcommand_cli_from_dict(
            targets, prog="gcbench", args=["--tyro-print-completion", shell],
            config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone))
    # a line end in a description would be taken for one more option
    return "\n".join(line.replace("\\n", " ") if line.startswith("COMPLETION_SPEC") else line
                     for line in out.getvalue().splitlines())


def _target_of(function: Callable[..., object]) -> Any:
    """Return what holds the options of a command: its function, or a dataclass."""
    if "args" not in function.__annotations__:
        return function
    try:
        function(_SHOW_TARGET)
    except _TargetShown as found:
        return found.args[0]
    raise AssertionError("the command has parsed no options")


def option_value(args: Sequence[str], option: str) -> str | None:
    """Return the value of an option that decides the defaults of the others."""
    for k, arg in enumerate(args):
        if arg == option and k + 1 < len(args):
            return args[k + 1]
        if arg.startswith(option + "="):
            return arg.split("=", 1)[1]
    return None
