"""What notebooks show of datasets, sequences and results: one line, or a card of inert HTML."""

from __future__ import annotations

import dataclasses
import shutil
from html.parser import HTMLParser
from pathlib import Path

import gcbench as gb
import pytest
from gcbench.benchmark.results.rows import Row
from gcbench.benchmark.results.runs import find_runs

from ...support import analytic, bench_data
from ...support.fake_results import write_results

HOSTILE = "<script>alert(1)</script><img src=x onerror=alert(2)>'\"&\x1b[2J\u202e\ud800"
SHOWN = HOSTILE.replace("\x1b", "\\x1b").replace("\u202e", "\\u202e").replace("\ud800", "\\ud800")
ALLOWED = {"div": {"style"}, "table": set(), "tr": set(), "th": {"style"}, "td": {"style"},
           "img": {"alt", "src"}}


class Card(HTMLParser):
    """Text and pictures of a card; anything that could act is an error."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.texts, self.pictures, self.open = list[str](), 0, list[str]()
        html.encode()
        self.feed(html)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert {name for name, _ in attrs} <= ALLOWED[tag]
        if tag == "img":
            assert dict(attrs)["src"].startswith("data:image/jpeg;base64,")  # type: ignore[union-attr]
            self.pictures += 1
        else:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.texts.append(data)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return bench_data.make_dataset(tmp_path / HOSTILE[:-1].replace("/", "|"), n=6)


def test_a_dataset(folder: Path) -> None:
    dataset = gb.open_dataset(folder)
    said = repr(dataset)
    assert said.endswith("robot 'arm', 6 sequences of 4 frames, 48x36 px, 30 fps, seed 0)")
    assert said.isprintable()
    config = dataclasses.replace(dataset.config, robot=HOSTILE)
    card = Card(dataclasses.replace(dataset, config=config)._repr_html_())
    assert card.pictures == 4
    assert {SHOWN, "sequence 000003", "4 frames of 48 x 36 px, 30 per second"} <= {*card.texts}


def test_a_dataset_with_a_damaged_or_a_missing_sequence(folder: Path) -> None:
    (folder / "sequences/000000.zip").write_bytes(b"PK")
    dataset = gb.open_dataset(folder)
    (folder / "sequences/000001.zip").unlink()
    card = Card(dataset._repr_html_())
    assert card.pictures == 2
    assert sum("sequences/" in text for text in card.texts) >= 2


def test_a_dataset_without_sequences(folder: Path) -> None:
    shutil.rmtree(folder / "sequences")
    dataset = gb.open_dataset(folder)
    assert "0 sequences" in repr(dataset)
    assert Card(dataset._repr_html_()).pictures == 0


def test_a_sequence() -> None:
    sequence = analytic.render(width=300, height=20, frames=4, room=False)
    meta = sequence.meta
    joints = tuple(HOSTILE + name for name in meta.joint_names)
    meta = dataclasses.replace(
        meta, name=HOSTILE, asset={"name": HOSTILE, "licence": [HOSTILE]}, joint_names=joints,
        scored_joints=joints,
    )
    sequence = dataclasses.replace(sequence, meta=meta)
    assert repr(sequence).isprintable() and len(repr(sequence)) < 200
    assert "4 frames of 300x20 px" in repr(sequence)
    card = Card(sequence._repr_html_())
    assert card.pictures == 3
    assert {f"Sequence {SHOWN}", SHOWN, "frame 3", "revolute"} <= {*card.texts}
    assert sum("°" in text for text in card.texts) == 2 * 2  # one of the three slides


def test_names_are_cut(folder: Path) -> None:
    sequence = gb.open_dataset(folder)[0]
    meta = dataclasses.replace(sequence.meta, name="x" * 10**6)
    sequence = dataclasses.replace(sequence, meta=meta)
    assert len(repr(sequence)) < 200
    assert max(map(len, Card(sequence._repr_html_()).texts)) < 300


def test_results(tmp_path: Path) -> None:
    for name, scale in ((HOSTILE[:-1], 0.1), ("other", 0.2)):
        write_results(tmp_path, Row(name, "1", "rgb", "axes", "none"), scale, prismatic=1)
    results = gb.Results(tuple(find_runs(tmp_path)), failures=(HOSTILE,))
    assert repr(results) == "Results(2 rows, 1 dataset, 12 sequences, 1 failure)"
    card = Card(results._repr_html_())
    assert {f"{SHOWN[:-6]} 1", "other 1", SHOWN, "ur5", "6"} <= {*card.texts}
    assert sum(text.endswith(" m") for text in card.texts) == 4
    (results.runs[0].path / "scores.csv").write_text("no table")
    assert "scores.csv" in Card(gb.Results(results.runs)._repr_html_()).texts[1]


def test_no_results() -> None:
    assert repr(gb.Results(())) == "Results(0 rows, 0 datasets, 0 sequences, 0 failures)"
    assert Card(gb.Results(())._repr_html_()).texts[0] == repr(gb.Results(()))
