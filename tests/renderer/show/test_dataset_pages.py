"""The index of a dataset and the links between its pages; recordings for Rerun."""

from __future__ import annotations

import dataclasses
import json
import re
import sys
import time
from pathlib import Path

import pytest
from gcbench import GcbenchError, open_dataset
from gcbench.__main__ import main
from gcbench.renderer.dataset.provenance import new_provenance, write_provenance
from gcbench.renderer.dataset.storage import SequenceWriter
from gcbench.renderer.scene.config import RenderConfig
from gcbench.renderer.show import show

from ...support.analytic import render
from ...test_cli import Lines

HOSTILE = '"><img src="http://example.invalid" onerror="alert(1)"><b>'


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """Sequences 0, 1, 2 and 4, in a folder and of a robot with hostile names."""
    folder = tmp_path / f"data {HOSTILE.replace('/', '_')}"
    made = render(width=40, height=30, frames=2)
    joints = (HOSTILE, *made.meta.joint_names[1:])
    for index in (0, 1, 2, 4):
        with SequenceWriter(folder, index) as writer:
            for frame in made:
                writer.add(frame)
            writer.finish(dataclasses.replace(
                made.meta, name=f"{index:06d}", index=index, asset={"name": HOSTILE},
                joint_names=joints, scored_joints=joints[:2]), made.state)
    write_provenance(folder, new_provenance(RenderConfig(frames=2, seed=7)))
    return folder


def pages(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def links(page: Path) -> dict[str, str]:
    found = re.search(r'id="data">(.*?)</script>', page.read_text())
    assert found
    return {rel: address for rel, address, _ in json.loads(found[1])["links"]}


def check_links(folder: Path) -> None:
    """Every address that a page names is there."""
    for page in folder.glob("*.html"):
        for address in re.findall(r'href="([^"]*)"', page.read_text()):
            assert address == "data:," or (folder / address).is_file(), (page, address)
        if page.name != "index.html":
            assert all((folder / address).is_file() for address in links(page).values())


def test_pages_link_to_their_neighbors_and_the_index(dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "pages"
    assert show(dataset, out, index="0-2") == [out / "index.html"]
    assert pages(out) == ["000000.html", "000001.html", "000002.html", "index.html"]
    assert links(out / "000000.html") == {"up": "index.html", "next": "000001.html"}
    assert links(out / "000001.html") == {"up": "index.html", "prev": "000000.html",
                                          "next": "000002.html"}
    assert links(out / "000002.html") == {"up": "index.html", "prev": "000001.html"}
    check_links(out)
    index = (out / "index.html").read_text()
    assert index.count("<li>") == 4, "those without a page, too"
    assert index.count("<a href=") == 3
    assert "--sequences" in index


def test_a_second_run_adds_what_is_missing_and_keeps_the_rest(
    dataset: Path, tmp_path: Path
) -> None:
    out = tmp_path / "pages"
    show(dataset, out, index="0-2")
    times = {name: (out / name).stat().st_mtime_ns for name in pages(out)}

    def written() -> list[str]:
        return [name for name in pages(out) if (out / name).stat().st_mtime_ns != times.get(name)]

    time.sleep(0.02)
    show(dataset, out, index="4")
    assert written() == ["000002.html", "000004.html", "index.html"], "2 links to 4 from now on"
    assert links(out / "000002.html")["next"] == "000004.html"
    check_links(out)

    times = {name: (out / name).stat().st_mtime_ns for name in pages(out)}
    cut = (out / "000001.html").read_bytes()[:-40]
    (out / "000001.html").write_bytes(cut)
    sequence = dataset / "sequences/000004.zip"
    sequence.write_bytes(sequence.read_bytes())
    show(dataset, out, index="0")
    assert written() == ["000001.html", "000004.html", "index.html"]
    assert links(out / "000001.html")["next"] == "000002.html", "it is whole again"


def test_the_default_is_a_folder_of_the_first_ten(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("gcbench.renderer.show.driver._PAGES", 3)
    (index,) = show(open_dataset(dataset))
    assert index == Path(f"{dataset.name}-show/index.html")
    assert pages(index.parent) == ["000000.html", "000001.html", "000002.html", "index.html"]
    for one in ("a.html", "a.HTML"):
        assert show(dataset, one) == [Path(one)], "one page"
    with pytest.raises(GcbenchError, match=r"no sequence 3"):
        show(dataset, tmp_path / "none", index="3")
    assert not (tmp_path / "none").exists()


def test_an_index_names_the_command_that_writes_the_missing_pages(
    dataset: Path, tmp_path: Path
) -> None:
    index = tmp_path / "pages/index.html"
    show(dataset, index.parent, index="0")
    (missing,) = re.findall(r"--sequences ([\d-]+)", index.read_text())
    show(dataset, index.parent, index=missing)
    names = open_dataset(dataset).names
    assert pages(index.parent) == [*(f"{name}.html" for name in names), "index.html"]
    assert "--sequences" not in index.read_text()


def test_names_in_an_index_are_text(dataset: Path, tmp_path: Path) -> None:
    show(dataset, tmp_path / "pages", index="0")
    index = (tmp_path / "pages/index.html").read_text()
    assert "<img src=\"http" not in index
    assert "<b>" not in index
    assert "script-src" not in index, "the policy admits no script"
    assert "<script" not in index
    assert "seed 7" in index
    assert re.search(r"onerror=&quot;.* -?\d+\.\d to -?\d+\.\d deg", index), "joint ranges"


def test_a_file_in_the_place_of_the_folder(dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "pages").write_text("")
    with pytest.raises(GcbenchError, match="cannot write"):
        show(dataset, tmp_path / "pages")


# ---- Rerun


def test_rerun_records_and_opens_the_viewer_or_says_what_to_run(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Lines
) -> None:
    pytest.importorskip("rerun")
    dataset = dataset.rename(tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    command = ["show", str(dataset), "--index", "2", "--rerun"]
    assert main(command) == 0
    said = capsys.readouterr()
    assert said.out.split() == ["data-000002.rrd"]
    assert "run: rerun data-000002.rrd" in said.err
    assert Path("data-000002.rrd").read_bytes()[:4] == b"RRF2"
    assert pages(tmp_path) == ["data", "data-000002.rrd"]

    viewer = tmp_path / "bin/rerun"
    viewer.parent.mkdir()
    viewer.write_text(f"#!/bin/sh\necho \"$@\" > {tmp_path}/seen\n")
    viewer.chmod(0o755)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(sys, "executable", str(viewer.with_name("python")))
    assert main(command) == 0
    end = time.monotonic() + 20
    while not (tmp_path / "seen").exists() or not (tmp_path / "seen").read_text():
        assert time.monotonic() < end
        time.sleep(0.02)
    assert (tmp_path / "seen").read_text() == "data-000002.rrd\n"
    assert "run:" not in capsys.readouterr().err
