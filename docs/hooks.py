"""Build hooks of the documentation site: generated reference pages and equations as MathML."""

from __future__ import annotations

import ast
import dataclasses
import html
import inspect
import json
import re
import textwrap
from contextlib import redirect_stdout
from importlib import import_module
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gcbench.benchmark.report.published_rows import PublishedRow


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Fill the generated sections of a page, and drop the notes to the tests and on GitHub."""
    markdown = re.sub(r"(?m)^(<!-- test: .*? -->|\*On GitHub, .*\*\n)\n", "", markdown)
    if "<!-- commands -->" in markdown:
        markdown = markdown.replace("<!-- commands -->", command_reference())
    if "<!-- published rows -->" in markdown:
        markdown = markdown.replace("<!-- published rows -->", published_rows())
    markdown = re.sub(r"<!-- notebook (\S+) -->", lambda m: notebook_text(m[1]), markdown)
    return re.sub(r"<!-- settings (\S+) -->", lambda m: settings_table(m[1]), markdown)


def on_page_content(page_html: str = "", **values: Any) -> str:
    """Replace TeX by MathML, which browsers draw without a script or a network."""
    from latex2mathml.converter import convert

    text = page_html or values["html"]
    pattern = r'<(span|div) class="arithmatex">(.*?)</\1>'

    def equation(match: re.Match[str]) -> str:
        tex = html.unescape(match[2]).strip()[2:-2]
        block = match[1] == "div"
        return f"<{match[1]} class='equation'>{convert(tex, 'block' if block else 'inline')}" \
               f"</{match[1]}>"

    return re.sub(pattern, equation, text, flags=re.DOTALL)


# -- command line -----------------------------------------------------------------------------


def help_of(command: str) -> str:
    """The text that `gcbench COMMAND --help all` prints."""
    from gcbench.__main__ import main

    out = StringIO()
    try:
        with redirect_stdout(out):
            main([*command.split(), "--help", "all"])
    except SystemExit as stop:
        if stop.code:
            raise
    return out.getvalue()


def command_reference() -> str:
    """Markdown: one section a command, from its `--help`."""
    from gcbench.__main__ import COMMANDS

    return "\n\n".join(command_section(name, help_of(name)) for name in COMMANDS)


def command_section(name: str, text: str) -> str:
    """Markdown of one command: description, examples, a table of options for each group."""
    about, _, usage = text.partition("usage: ")
    about, _, examples = re.split(r"\n(Examples?:)\n", about)[:3] if "xample" in about \
        else (about, "", "")
    lines = [f"## gcbench {name}", "", _prose(about), ""]
    usage, *sections = usage.strip().split("\n\n")
    lines += ["```text", usage, "```", ""]
    if examples.strip():
        shown = "\n".join(line for line in textwrap.dedent(examples).strip().splitlines() if line)
        lines += ["```bash", shown, "```", ""]
    for section in sections:
        head, _, body = section.partition("\n")
        title, _, note = head.partition(":")
        lines += [f"**{title}**" + f": {_prose(note)}" * bool(note), ""]
        lines += ["| option | meaning | default |", "|---|---|---|"]
        lines += [f"| {' | '.join(row)} |" for row in _options(body)] + [""]
    return "\n".join(lines)


def _prose(text: str) -> str:
    return re.sub(r"(?<![`\w/])(--[a-z](?:[\w.-]*\w)?)", r"`\1`", text.strip()).replace("<", "&lt;")


def _options(body: str) -> list[tuple[str, str, str]]:
    """(option, meaning, default) of the lines below the title of a group."""
    entries: list[list[str]] = []
    for line in body.splitlines():
        if line.startswith("   "):
            entries[-1].append(line.strip())
        else:
            option, _, rest = line.strip().partition("  ")
            entries.append([option, *filter(None, [rest.strip()])])
    out: list[tuple[str, str, str]] = []
    for option, *words in entries:
        text = " ".join(words)
        match = re.fullmatch(r"(.*?) *\((?:default: ?(.*)|required)\)", text) or [text, text, ""]
        value = (match[2] or "").strip("'")
        cells = f"`{option}`", _prose(match[1]), f"`{value}`" if value else ""
        out.append(tuple(cell.replace("|", "\\|") for cell in cells))  # type: ignore[arg-type]
    return out


# -- published rows ---------------------------------------------------------------------------


def published_rows() -> str:
    """Markdown of the published leaderboard, and of what measured it, from the committed rows."""
    from gcbench.benchmark.report.formats import markdown_table
    from gcbench.benchmark.report.leaderboard import build_leaderboard
    from gcbench.benchmark.report.published_rows import (
        PUBLISHED_ROWS,
        PublishedTruth,
        published_files,
        read_row,
    )
    from gcbench.benchmark.report.tables import leaderboard_tables, paper_tables, suite_tables

    truths = dict[str, PublishedTruth]()
    rows = [read_row(path, PUBLISHED_ROWS, truths) for path in published_files(PUBLISHED_ROWS)]
    numbers = sorted(len(row.run.sequences) for row in rows)
    board = build_leaderboard([], PUBLISHED_ROWS)
    out = [f"**So far, rows are measured on {numbers[0]} to {numbers[-1]} sequences of each "
           "dataset.**", ""]
    parts = {"All datasets": suite_tables(board), "Datasets": leaderboard_tables(board),
             "Tables in the form of the paper": paper_tables(board)}
    for title, tables in parts.items():
        out += [f"## {title}", "", tables[0].caption, ""]
        for k, table in enumerate(tables):
            out += [f"### {table.title}", ""]
            out += [table.caption, ""] if k and table.groups else []
            out += [*markdown_table(table), ""]
    head = ["| row | version | date | gcbench | machine | command |", "|---|---|---|---|---|---|"]
    return "\n".join([*out, "## How each row was measured", "", *head, *measured_by(rows)])


def measured_by(rows: list[PublishedRow]) -> list[str]:
    """Lines of a Markdown table: what measured the rows; datasets that differ in nothing else share
    a line."""
    datasets = dict[tuple[str, ...], dict[str, None]]()
    for row in rows:
        before, marker, after = row.command.partition(" --datasets ")
        name, _, after = after.partition(" ")
        for e in row.run.environments:
            line = (f"{row.run.row.title} | {row.run.row.version} | {row.date} | "
                    f"{e.get('gcbench', '')} | {e.get('cpu', '')}, {e.get('cores', '')} cores")
            datasets.setdefault((line, before + marker, after), {})[name] = None
    return [f"| {line} | `{' '.join([before + ' '.join(names), after]).strip()}` |"
            for (line, before, after), names in datasets.items()]


# -- notebooks --------------------------------------------------------------------------------


def notebook_text(path: str) -> str:
    """Markdown of a notebook in docs/: its texts, and its code in blocks."""
    cells = json.loads((Path(__file__).parent / path).read_text())["cells"]
    texts = [(cell["cell_type"], "".join(cell["source"])) for cell in cells]
    return "\n\n".join(text if kind == "markdown" else f"```python\n{text}\n```"
                       for kind, text in texts)


# -- settings of the method -------------------------------------------------------------------


def settings_table(name: str) -> str:
    """Markdown tables of a settings dataclass `module:Class` and of the records inside it."""
    module, _, kind = name.partition(":")
    return "\n".join(_settings_rows(getattr(import_module(module), kind)(), ""))


def _settings_rows(record: Any, prefix: str) -> list[str]:
    """A table of the fields; sections for the records inside follow."""
    notes, inner, rows = field_notes(type(record)), list[str](), list[str]()
    for field in dataclasses.fields(record):
        value, name = getattr(record, field.name), f"{prefix}{field.name}"
        note = notes.get(field.name, "").replace("|", "\\|")
        if dataclasses.is_dataclass(value):
            inner += ["", f"### {name}", "", note or inspect.getdoc(value) or "", ""]
            inner += _settings_rows(value, f"{name}.")
        else:
            rows.append(f"| `{field.name}` | `{_short(value)}` | {note} |")
    head = ["| setting | default | meaning |", "|---|---|---|"] if rows else []
    return [*head, *rows, *inner]


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple):
        return f"({', '.join(_short(v) for v in value)})"
    return str(value)


def field_notes(cls: type) -> dict[str, str]:
    """What stands under, or in a comment behind, each field of a dataclass."""
    notes = field_notes(cls.__base__) if dataclasses.is_dataclass(cls.__base__) else {}
    source = textwrap.dedent(inspect.getsource(cls))
    body = ast.parse(source).body[0].body  # type: ignore[attr-defined]
    lines = source.splitlines()
    for node, after in zip(body, [*body[1:], None], strict=True):
        if not isinstance(node, ast.AnnAssign) or not isinstance(node.target, ast.Name):
            continue
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            text = str(after.value.value)
        else:
            text = lines[(node.end_lineno or 1) - 1].partition("  # ")[2]
        notes[node.target.id] = " ".join(text.split())
    return notes
