"""The help of a command: the options that most users need, and the others by group."""

from __future__ import annotations

import re
import shutil
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field

from ...errors import ConfigError, suggestion

_INDENT = 26  # columns before the meaning of an option
_REPEATED = re.compile(r"\[(\[?[^\s\]]+) \[.*?\.\.\.\]\]")
_NO_DEFAULT = re.compile(r" ?\(default: (?:''|True|False|None)?\)$")


@dataclass
class OptionGroup:
    """Options below one title."""

    note: str = ""
    options: list[tuple[str, str]] = field(default_factory=list[tuple[str, str]])
    """(option with its values, meaning) of each."""


def format_help(text: str, groups: Mapping[str, str], wanted: str) -> str:
    """Return the help of a command without its description.

    Args:
        text: The help that tyro prints.
        groups: Names of the options of each group, in order; "options" are the usual ones. What
            is not named keeps the group that tyro gives it.
        wanted: "" for the usual options and the names of the others, "all", or one group.

    Raises:
        ConfigError: There is no such group.
    """
    found = _arrange(_parse(text), groups)
    usual = [title for title in found if title in ("positional arguments", "options")]
    others = {title.removesuffix(" options"): title for title in found if title not in usual}
    if wanted not in ("", "all", *others):
        raise ConfigError(f"--help {wanted}: no group of options{suggestion(wanted, others)}; "
                          f"there are all{''.join(f', {name}' for name in others)}")
    chosen = {"": usual, "all": list(found)}.get(wanted) or [others[wanted]]
    command, _, values = " ".join(text.partition("╭")[0].split()).partition(" [-h]")
    lines = [command + _REPEATED.sub(r"\1 ...", values)]
    for title in chosen:
        lines += ["", f"{title}: {found[title].note}".rstrip()]
        for option in found[title].options:
            lines += _entry(*option)
    if others and not wanted:
        again = command.removeprefix("usage: ") + " --help"
        lines += ["", f"more options (`{again} GROUP` or `{again} all` explains them):"]
        for name, title in others.items():
            first, *rest = (option.split()[0] for option, _ in found[title].options)
            prefix = f"--{name}" if first.startswith(f"--{name}.") else ""
            lines += _entry(name, " ".join([first, *(n.removeprefix(prefix) for n in rest)]))
    return "\n".join(lines)


def _parse(text: str) -> dict[str, OptionGroup]:
    """Return the groups of options by title, from the boxes that tyro draws."""
    found: dict[str, OptionGroup] = {}
    for title, body in re.findall(r"╭─ (.*?) ─*╮\n(.*?)╰", text, flags=re.DOTALL):
        lines = [line.strip("│")[1:].rstrip() for line in body.splitlines()]
        rule = next((k for k, line in enumerate(lines) if line.startswith("──")), -1)
        entries: list[list[str]] = []
        for line in lines[rule + 1:]:
            if line.startswith(" "):
                entries[-1].append(line.strip())
            elif line:
                option, _, meaning = line.partition("  ")
                entries.append([option, *filter(None, [meaning.strip()])])
        found[title] = OptionGroup(" ".join(lines[:max(rule, 0)]), [
            (_REPEATED.sub(r"\1 ...", option), _NO_DEFAULT.sub("", " ".join(words)))
            for option, *words in entries])
    return found


def _arrange(found: dict[str, OptionGroup], groups: Mapping[str, str]) -> dict[str, OptionGroup]:
    """Return the groups with the options of tyro's main group in those that name them."""
    main = {re.sub("^-h, ", "", option).split()[0]: (option, meaning)
            for option, meaning in found.get("options", OptionGroup()).options}
    out = {title: group for title, group in found.items() if title.startswith("positional")}
    out["options"] = OptionGroup()
    for title, names in groups.items():
        title = title if title == "options" else f"{title} options"
        out[title] = OptionGroup("", [main.pop(name) for name in names.split() if name in main])
    out["options"].options += main.values()
    return out | {title: group for title, group in found.items() if title not in out}


def _entry(option: str, meaning: str) -> list[str]:
    """Return an option and its meaning as lines, the meaning from column _INDENT."""
    width = max(60, min(shutil.get_terminal_size((80, 24)).columns, 100)) - _INDENT
    lines = textwrap.wrap(meaning, width, break_long_words=False, break_on_hyphens=False) or [""]
    if len(option) <= _INDENT - 4:
        first, *rest = lines
        return [f"  {option:{_INDENT - 4}}  {first}".rstrip(), *(" " * _INDENT + r for r in rest)]
    return [f"  {option}", *(" " * _INDENT + line for line in lines if line)]
