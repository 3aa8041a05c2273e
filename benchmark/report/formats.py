"""The board as CSV, Markdown and LaTeX. Every name comes from outside and is escaped for each."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Sequence

from .leaderboard import PCP5, Line, labels_of
from .tables import NONE, Table, percent, value

CSV_COLUMNS = ("dataset", "method", "inputs", "knowledge", "sequences", "joints", "mean", "std",
               "ci_low", "ci_high", "median", "p90", "pcp5", "coverage", "seconds_per_frame",
               "unit")  # fmt: skip
"""pcp5 and coverage in percent; mean .. p90 in `unit`; `joints` are (sequence, joint) pairs."""
_CONTROLS = re.compile(
    r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ufeff\u200b-\u200f\u202a-\u202e\u2066-\u2069]"
)
_LATEX = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#",
    "%": r"\%", "_": r"\_", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}",
    '"': r"\textquotedbl{}", "'": r"\textquotesingle{}", "`": r"\textasciigrave{}",
    "-": "{-}", "±": r"$\pm$", "°": r"$^{\circ}$", "·": r"$\cdot$", "–": "--", "’": "'",
}  # fmt: skip


def one_line(text: str) -> str:
    """`text` without line breaks, control characters and marks that turn the writing direction."""
    return " ".join(_CONTROLS.sub(" ", text).split())


def csv_cell(text: str) -> str:
    """Text that a spreadsheet does not take for a formula."""
    text = one_line(text)
    return "'" + text if text[:1] in ("=", "+", "-", "@") else text


def markdown(text: str) -> str:
    """Text that stays text in a cell of a Markdown table."""
    text = one_line(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    text = re.sub(r"([\\`*_{}\[\]()#+!|~$^])", r"\\\1", text)
    return text.replace("://", "&#58;//").replace("www.", "www&#46;").replace("@", "&#64;")


def latex(text: str) -> str:
    """Text that stays text in LaTeX; letters that pdfTeX has not by default become `?`."""
    known = (c if c.isascii() or c in _LATEX or ("\xa1" <= c <= "\xff" and c != "\xad") else "?"
             for c in one_line(text))  # fmt: skip
    return "".join(_LATEX.get(c, c) for c in known)


def leaderboard_csv(lines: Iterable[Line]) -> str:
    """A row for each line, columns as CSV_COLUMNS; an unknown time is empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for line in lines:
        s, row = line.summary, line.row
        seconds = line.means.get("seconds_per_frame")
        numbers = (s.mean, s.std, s.ci_low, s.ci_high, s.median, s.p90, s.pcp[PCP5], s.coverage)
        words = [csv_cell(x) for x in (line.dataset, row.name, row.inputs, row.knowledge)]
        writer.writerow([
            *words, s.sequences, s.joints, *(f"{x:.6g}" for x in numbers),
            "" if seconds is None else f"{seconds:.6g}", line.unit,
        ])  # fmt: skip
    return text.getvalue()


def leaderboard_md(lines: Sequence[Line], ranks: Sequence[int], version: str) -> str:
    """A table for each dataset, best first, with shared ranks."""
    out = [
        "# Leaderboard",
        "",
        "Error of each scored joint at the last frame: mean over all pairs of sequence and joint, "
        "with its 95 % interval (bootstrap by sequence, or by object where there are several). "
        "Rows that paired differences on the same sequences cannot tell apart share a "
        "rank. A failed joint counts as no motion at all. "
        "(best sign): the better of the two signs of each joint, where none is known or returned.",
    ]
    labels = labels_of(lines)
    for group in dict.fromkeys(line.group for line in lines):
        mine = [k for k, line in enumerate(lines) if line.group == group]
        first, unit = lines[mine[0]], group[1]
        within = "5°" if unit == "deg" else "5 cm"
        head = ("rank", "method", "training", "sequences", f"mean ({unit})", "95 % interval", "std",
                "median", "P90", f"PCP@{within}", "coverage", "s / frame")  # fmt: skip
        out += [
            "",
            f"## {markdown(first.dataset)}" + (" (prismatic joints)" if unit == "m" else ""),
        ]
        out += ["", _md_row(head), _md_row(["---:", ":---", ":---", *["---:"] * (len(head) - 3)])]
        for k in sorted(mine, key=lambda k: (ranks[k], lines[k].summary.mean)):
            line, s = lines[k], lines[k].summary
            seconds = line.means.get("seconds_per_frame")
            best = " (best sign)" if "best" in line.sign else ""
            out.append(_md_row([
                str(ranks[k]), markdown(labels[k]) + best, markdown(line.row.training),
                str(s.sequences), value(s.mean, unit), interval(line), value(s.std, unit),
                value(s.median, unit), value(s.p90, unit), percent(s.pcp[PCP5]),
                percent(s.coverage), NONE if seconds is None else f"{seconds:.3g}",
            ]))  # fmt: skip
    return "\n".join([*out, "", f"Made by gcbench {version}.", ""])


def interval(line: Line) -> str:
    """ "0.10 to 0.20", or a dash where there are not two clusters to draw from."""
    if len(set(line.cluster.values())) < 2:
        return NONE
    return f"{value(line.summary.ci_low, line.unit)} to {value(line.summary.ci_high, line.unit)}"


def tables_tex(tables: Iterable[Table], version: str) -> str:
    """A `table*` for each table; the preamble needs booktabs, xcolor with [table], and textcomp."""
    out = [f"% Made by gcbench {version}.",
           r"% \usepackage[table]{xcolor} \usepackage{booktabs,graphicx,textcomp}",
           "% Grey cells: numbers of the GC-Pose paper, whose data are not published."]  # fmt: skip
    for table in tables:
        groups = [rf"\multicolumn{{{span}}}{{c}}{{{latex(text)}}}" for text, span in table.groups]
        rules, start = [], 1
        for text, span in table.groups:
            if text:
                rules.append(rf"\cmidrule(lr){{{start}-{start + span - 1}}}")
            start += span
        body = [
            r"\begin{table*}", r"  \centering\small", r"  \resizebox{\ifdim\width>\textwidth"
            r"\textwidth\else\width\fi}{!}{%",
            rf"  \begin{{tabular}}{{l{'c' * (len(table.columns) - 1)}}}", r"    \toprule",
            "    " + " & ".join(groups) + r" \\", "    " + " ".join(rules),
            "    " + " & ".join(latex(text) for text in table.columns) + r" \\", r"    \midrule",
        ]  # fmt: skip
        for k, row in enumerate(table.rows):
            if row.reference and k and not table.rows[k - 1].reference:
                body.append(r"    \midrule")
            cells = [
                (r"\cellcolor{gray!12}" if row.reference or table.reference[i] else "")
                + latex(text)
                for i, text in enumerate(row.cells)
            ]
            body.append("    " + " & ".join(cells) + r" \\")
        body += [r"    \bottomrule", r"  \end{tabular}}",
                 rf"  \caption{{\textbf{{{latex(table.title)}.}} {latex(table.caption)}}}",
                 r"\end{table*}"]  # fmt: skip
        out += ["", *body]
    return "\n".join([*out, ""])


def _md_row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"
