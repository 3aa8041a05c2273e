"""Command line options from the arguments of functions and the fields of dataclasses."""

# No `annotations` from the future here: `command` hands annotations to tyro.

import functools
import inspect
import io
import re
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from typing import Annotated, Any

from ...errors import ConfigError


def parse_options(
    args: Sequence[str], name: str, target: Any, doc: str | None, default: Any = None
) -> Any:
    """Return the options of one command: an instance of the dataclass `target`.

    Raises ConfigError for wrong options, SystemExit after printing the help.
    """
    import tyro

    if "-h" in args or "--help" in args:
        print(inspect.cleandoc(doc or "").partition("\n\nArgs:")[0], end="\n\n")
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
    text = text.replace("Unrecognized options", "unknown").replace("Expected 1 values", "Give one")
    meant = re.findall(r"(?m)^ {6}(--\S+)", "\n".join(lines).partition("Perhaps you meant:")[2])
    hint = f" (perhaps you meant {', '.join(meant)})" if meant else ""
    return text[:1].lower() + text[1:] + hint


def command(name: str, function: Callable[..., int]) -> Callable[[Sequence[str]], int]:
    """Return the command whose options are the arguments of `function`."""
    def run(args: Sequence[str]) -> int:
        import tyro

        quiet = tyro.conf.arg(help_behavior_hint="")

        def bind(*positional: Any, **options: Any) -> Callable[[], int]:
            return functools.partial(function, *positional, **options)

        parameters = [
            p if p.default is not None else p.replace(annotation=Annotated[p.annotation, quiet])
            for p in inspect.signature(function).parameters.values()
        ]
        bind.__doc__ = function.__doc__
        bind.__annotations__ = {p.name: p.annotation for p in parameters}
        vars(bind)["__signature__"] = inspect.Signature(parameters)
        call: Callable[[], int] = parse_options(args, name, bind, function.__doc__)
        return call()

    return run


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


def option_value(args: Sequence[str], option: str) -> str | None:
    """Return the value of an option that decides the defaults of the others."""
    for k, arg in enumerate(args):
        if arg == option and k + 1 < len(args):
            return args[k + 1]
        if arg.startswith(option + "="):
            return arg.split("=", 1)[1]
    return None
