"""HTML that needs no script: the index of a dataset, and the first frame of a sequence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from ... import __version__
from ..dataset import Dataset
from ..runtime import address
from .html import shared_text

Links = Sequence[tuple[str, str, str]]
"""(rel, address, text) of the links from a page to others of its folder."""
_CAPTIONS = {"rgb": "RGB", "depth": "Depth", "part": "Parts", "flow": "Forward flow",
             "visibility": "Visibility", "normal": "Normals", "coordinates": "Coordinates",
             "points": "Points"}
_INDEX_STYLE = """
main, header { max-width: 1600px; margin: 0 auto; padding: 0 16px; }
header { padding-top: 18px; } h1 { font-size: 1.45rem; margin: 0; } p { margin: 4px 0; }
h2 { font-size: 1rem; margin: 6px 0 0; }
ol { list-style: none; margin: 16px 0 0; padding: 0; display: grid; gap: 14px;
     grid-template-columns: repeat(auto-fill, minmax(min(100%, 240px), 1fr)); }
li { background: var(--card); border: 1px solid var(--line); border-radius: 12px;
     padding: 10px 12px; }
li img { display: block; width: 100%; height: auto; border-radius: 6px; }
li a { color: inherit; text-decoration: none; display: block; }
li a h2 { color: var(--accent); text-decoration: underline; }
code { background: var(--well); border-radius: 4px; padding: 1px 4px; }
"""


@dataclass(frozen=True)
class IndexEntry:
    """What an index says of a sequence."""

    title: str
    lines: tuple[str, ...]
    picture: str
    """`data:` URI"""
    address: str
    """Of its page; "" if there is none."""


def index_page(dataset: Dataset, entries: Sequence[IndexEntry]) -> str:
    """Return the page that lists the sequences of a dataset."""
    config, more = dataset.config, len(dataset) - len(entries)
    name = dataset.path.absolute().name
    licences = sorted({str(asset.get("licence", "")) for asset in dataset.info.assets} - {""})
    facts = [f"{len(dataset)} sequences of {config.frames} frames",
             f"{config.width} × {config.height} px", f"seed {config.seed}", *licences]
    notes = []
    if missing := [int(entry.title) for entry in entries if not entry.address]:
        notes.append("Sequences without a link have no page yet. To write more pages: "
                     f"<code>gcbench show {_text(address(dataset.path))} --sequences "
                     f"{missing[0]}-{missing[0] + 9}</code>")
    if more:
        notes.append(f"{more} more sequences are not listed.")
    items = "".join(f"<li>{_link(entry)}</li>\n" for entry in entries)
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<meta name="color-scheme" content="light dark"><link rel="icon" href="data:,">
<title>{_text(name)} · gcbench</title><style>{shared_text("page.css")}{_INDEX_STYLE}</style></head>
<body><header><h1>{_text(config.robot)} · {_text(name)}</h1>
<p class="soft">{_text(" · ".join(facts))}</p>
{"".join(f'<p class="note">{note}</p>' for note in notes)}</header>
<main><ol>
{items}</ol><footer class="note">Made by gcbench {__version__}.</footer></main></body></html>
"""


def _link(entry: IndexEntry) -> str:
    lines = "".join(f'<div class="note">{_text(line)}</div>' for line in entry.lines)
    card = (f'<img src="{entry.picture}" alt="First frame of {_text(entry.title)}" loading="lazy">'
            f"<h2>{_text(entry.title)}</h2>{lines}")
    return f'<a href="{_text(entry.address)}">{card}</a>' if entry.address else card


def static_page(data: Mapping[str, Any]) -> str:
    """Return what the page of a sequence (`page_data`) shows where scripts are off."""
    cards = "".join(
        f'<article class="card"><div class="head"><h2>{title}</h2></div>'
        f'<img src="{data["images"][name][0]}" alt="{title} of the first frame"></article>'
        for name, title in _CAPTIONS.items() if data["images"].get(name, [None])[0])
    links = " ".join(f'<a rel="{rel}" href="{_text(address)}">{_text(text)}</a>'
                     for rel, address, text in data["links"])
    name = " · ".join(filter(None, (data["robot"], data["name"])))
    return ("<style>#bar, #curves-card, #joints-card, #about { display: none }"
            " #static { display: grid; gap: 14px;"
            " grid-template-columns: repeat(auto-fill, minmax(min(100%, 380px), 1fr)) }</style>"
            f"<h1>{_text(name)}</h1><nav>{links}</nav><p class=\"note\">Allow scripts to see all "
            f'frames, the curves and the 3D view.</p><div id="static">{cards}</div>')


def _text(text: str) -> str:
    """Escape a text of unknown origin for HTML; what UTF-8 cannot encode becomes `?`."""
    return escape(text.encode("utf-8", "replace").decode())
