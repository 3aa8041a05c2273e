"""Tables as text for a terminal, Markdown, LaTeX and CSV.

Names come from untrusted methods and files: each writer escapes them for its format.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence

from ..protocol import PCP5
from .leaderboard import Leaderboard
from .tables import Table, leaderboard_tables, suite_tables

CSV_COLUMNS = ("dataset", "method", "inputs", "knowledge", "sequences", "joints", "mean", "std",
               "ci_low", "ci_high", "median", "p90", "pcp5", "coverage", "seconds_per_frame",
               "unit", "published", "version", "training", "sign", "rank")
"""Columns of the CSV: pcp5 and coverage are percent, mean to p90 are in `unit`, `joints` is the
number of (sequence, joint) pairs, `published` the date of a published row (empty: your own), `sign`
how the signs were decided (`Result.sign`), and `rank` is empty on other sequences than most."""
TABLE_COLUMNS = ("table", "row", "group", "column", "value", "source")
"""Columns of the CSV of tables in the paper's form; source is "paper" for numbers of papers."""
_CONTROLS = re.compile(
    r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ufeff\u200b-\u200f\u202a-\u202e\u2066-\u2069]"
)
_LATEX = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#",
    "%": r"\%", "_": r"\_", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}",
    '"': "''", "'": r"\textquotesingle{}", "`": r"\textasciigrave{}",
    "-": "{-}", "±": r"$\pm$", "°": r"$^{\circ}$", "·": r"$\cdot$", "–": "--", "’": "'",
}


def one_line(text: str) -> str:
    """Remove line breaks, control characters and marks that turn the writing direction."""
    return " ".join(_CONTROLS.sub(" ", text).split())


def escape_csv(text: str) -> str:
    """Return text that a spreadsheet does not evaluate as a formula."""
    text = one_line(text)
    return "'" + text if text[:1] in ("=", "+", "-", "@") else text


def escape_markdown(text: str) -> str:
    """Return text that remains text in a cell of a Markdown table."""
    text = one_line(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    text = re.sub(r"([\\`*_{}\[\]#+!|~$^])", r"\\\1", text)
    return text.replace("://", "&#58;//").replace("www.", "www&#46;").replace("@", "&#64;")


def escape_latex(text: str) -> str:
    """Return text that remains text in LaTeX; letters that pdfTeX lacks by default become `?`."""
    known = (c if c.isascii() or c in _LATEX or ("\xa1" <= c <= "\xff" and c != "\xad") else "?"
             for c in one_line(text))
    return "".join(_LATEX.get(c, c) for c in known)


def leaderboard_records(board: Leaderboard) -> list[dict[str, str | int | float | None]]:
    """Return a record for each line, with the fields CSV_COLUMNS; what is unknown is None."""
    records: list[dict[str, str | int | float | None]] = []
    for line, rank in zip(board.lines, board.ranks, strict=True):
        s, row = line.summary, line.row
        interval = (s.ci_low, s.ci_high) if line.has_interval else (None, None)
        values = (line.dataset, row.name, row.inputs, row.knowledge, s.sequences, s.joints,
                  s.mean, s.std, *interval, s.median, s.p90, s.pcp[PCP5], s.coverage,
                  line.means.get("seconds_per_frame"), line.unit, line.published,
                  row.version, row.training, line.sign, rank or None)
        records.append(dict(zip(CSV_COLUMNS, values, strict=True)))
    return records


def leaderboard_csv(board: Leaderboard) -> str:
    """Return a row for each line, with the columns CSV_COLUMNS; what is unknown is empty."""
    def cell(value: str | float | None) -> str | float:
        if isinstance(value, str):
            return escape_csv(value)
        return f"{value:.6g}" if isinstance(value, float) else "" if value is None else value

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    writer.writerows(map(cell, record.values()) for record in leaderboard_records(board))
    return text.getvalue()


def leaderboard_text(board: Leaderboard) -> str:
    """Return a leaderboard for a terminal: the report's tables, but narrower."""
    return to_text(suite_tables(board) + leaderboard_tables(board), without=("training",))


def to_text(tables: Iterable[Table], without: tuple[str, ...] = ()) -> str:
    """Return tables for a terminal, in aligned columns except those `without`."""
    out: list[str] = []
    for table in tables:
        shown = [k for k, name in enumerate(table.columns) if name not in without]
        rows = [[one_line(cells[k]) for k in shown]
                for cells in (table.columns, *(row.cells for row in table.rows))]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        out += ["", one_line(table.title)]
        out += [
            "  ".join(
                cell.rjust(width) if table.align[k] == "r" else cell.ljust(width)
                for cell, width, k in zip(row, widths, shown, strict=True)
            ).rstrip()
            for row in rows
        ]
    return "\n".join(out[1:])


def to_markdown(
    parts: Mapping[str, Sequence[Table]], version: str, unfinished: Sequence[str] = ()
) -> str:
    """Return a document with a section for each part, which begins with its first caption.

    Runs that are unfinished stand at its end.
    """
    out: list[str] = []
    for title, tables in parts.items():
        out += [f"# {escape_markdown(title)}", "", *(table.caption for table in tables[:1])]
        for k, table in enumerate(tables):
            out += ["", f"## {escape_markdown(table.title)}", ""]
            out += [table.caption, ""] if k and table.groups else []
            out += markdown_table(table)
        out.append("")
    if unfinished:
        out += ["# Not finished", "", *(f"* {escape_markdown(line)}" for line in unfinished), ""]
    return "\n".join([*out, f"Made by gcbench {version}.", ""])


def markdown_table(table: Table) -> list[str]:
    """Return the lines of a table; the upper row of its head becomes a part of each cell below."""
    rules = {"l": ":---", "c": ":---:", "r": "---:"}
    head = [f"{escape_markdown(group)} {column}".strip() for group, column in _columns(table)]
    rows = [_md_row(map(escape_markdown, row.cells)) for row in table.rows]
    return [_md_row(head), _md_row(rules[a] for a in table.align), *rows]


def tables_csv(tables: Iterable[Table]) -> str:
    """Return a line for each cell of tables in the paper's form, with the columns TABLE_COLUMNS."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(TABLE_COLUMNS)
    for table in tables:
        for row in table.rows:
            for (group, column), cell, grey in list(zip(
                _columns(table), row.cells, table.reference, strict=True))[1:]:
                paper = "paper" if grey or row.reference else ""
                values = (table.title, row.cells[0], group, column, cell, paper)
                writer.writerow(map(escape_csv, values))
    return text.getvalue()


def _columns(table: Table) -> list[tuple[str, str]]:
    """Return the text in the upper and in the lower row of the head of each column."""
    groups = [text for text, span in table.groups for _ in range(span)] or [""] * len(table.columns)
    return list(zip(groups, table.columns, strict=True))


def to_latex(tables: Iterable[Table], version: str) -> str:
    """Return a `table*` for each table of the paper's form.

    The document needs the packages booktabs, graphicx, textcomp and xcolor with [table].
    """
    out = [f"% Made by gcbench {version}.",
           r"% \usepackage[table]{xcolor} \usepackage{booktabs,graphicx,textcomp}",
           "% Grey cells: numbers of papers (those of the GC-Pose paper: data not published)."]
    for table in tables:
        out += ["", *_latex_table(table)]
    return "\n".join([*out, ""])


def latex_figure(file: str, caption: str) -> str:
    """Return a `figure*` of an image beside the document."""
    return "\n".join(["", r"\begin{figure*}", r"  \centering",
                      rf"  \includegraphics[width=\textwidth]{{{file}}}",
                      rf"  \caption{{{escape_latex(caption)}}}", r"\end{figure*}", ""])


def _latex_table(table: Table) -> list[str]:
    groups: list[str] = []
    rules: list[str] = []
    start = 1
    for text, span in table.groups:
        groups.append(rf"\multicolumn{{{span}}}{{c}}{{{escape_latex(text)}}}")
        if text:
            rules.append(rf"\cmidrule(lr){{{start}-{start + span - 1}}}")
        start += span
    body = [
        r"\begin{table*}", r"  \centering\small", r"  \resizebox{\ifdim\width>\textwidth"
        r"\textwidth\else\width\fi}{!}{%",
        rf"  \begin{{tabular}}{{{table.align}}}", r"    \toprule",
        "    " + " & ".join(groups) + r" \\", "    " + " ".join(rules),
        "    " + " & ".join(map(escape_latex, table.columns)) + r" \\", r"    \midrule",
    ]
    for k, row in enumerate(table.rows):
        if row.reference and k and not table.rows[k - 1].reference:
            body.append(r"    \midrule")
        cells = [
            (r"\cellcolor{gray!12}" if row.reference or grey else "") + escape_latex(text)
            for text, grey in zip(row.cells, table.reference, strict=True)
        ]
        body.append("    " + " & ".join(cells) + r" \\")
    title, caption = escape_latex(table.title), escape_latex(table.caption)
    return [
        *body, r"    \bottomrule", r"  \end{tabular}}",
        rf"  \caption{{\textbf{{{title}.}} {caption}}}", r"\end{table*}",
    ]


def _md_row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"
