"""The estimated pose in red: drawn where the estimate says, over what is there."""

from __future__ import annotations

import base64
import dataclasses
import io
from pathlib import Path

import numpy as np
import pytest
from gcbench import GcbenchError, open_dataset
from gcbench.benchmark.report.gallery import (
    WIDTH,
    draw_pictures,
    estimated_motion,
    select_pictures,
    write_pages,
)
from gcbench.benchmark.report.leaderboard import read_leaderboard
from gcbench.benchmark.results.runs import find_runs, write_run
from gcbench.renderer.dataset.reader import Dataset
from gcbench.renderer.scene.config import STUDIO, RenderConfig
from gcbench.renderer.scene.models import model_of
from gcbench.renderer.show.overlay import _RED, Painter, blend, estimated_positions, shade
from gcbench.renderer.types.sequence import Sequence
from PIL import Image

from ...support.analytic import render
from ...support.fake_results import FREE, GCPOSE, write_results

URDF = """<robot name="flag">
  <link name="foot"><visual><geometry><box size="0.3 0.3 0.1"/></geometry></visual></link>
  <joint name="turn" type="continuous"><parent link="foot"/><child link="post"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 0 1"/></joint>
  <link name="post"><visual><origin xyz="0.3 0 0.1"/><geometry><box size="0.6 0.1 0.2"/></geometry>
  </visual></link>
  <joint name="wave" type="revolute"><parent link="post"/><child link="flag"/>
    <origin xyz="0.6 0 0.2"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <link name="flag"><visual><origin xyz="0 0 0.3"/><geometry><box size="0.1 0.2 0.6"/></geometry>
  </visual></link>
</robot>"""
# Red over a dark grey or over the paled background: red by far, and not the grey of anything.
REDDISH = 30


def reddish(image: np.ndarray) -> np.ndarray:
    r, g, b = np.moveaxis(image.astype(int), -1, 0)
    return r - np.maximum(g, b) > REDDISH


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    from gcbench.renderer.generate.driver import render_dataset

    folder = tmp_path_factory.mktemp("overlay")
    (folder / "flag.urdf").write_text(URDF)
    config = RenderConfig(robot=str(folder / "flag.urdf"), seed=3, frames=4, width=160, height=120,
                          randomization=STUDIO, keep_unobservable=True)
    render_dataset(config, 2, folder / "data", workers=1, progress=False)
    return open_dataset(folder / "data")


def moved(sequence: Sequence) -> dict[str, float]:
    q, meta = sequence.state.joint_positions, sequence.meta
    return {n: float(q[-1, j] - q[0, j]) for j, n in enumerate(meta.joint_names)
            if n in meta.scored_joints}


def test_positions_are_the_true_ones_but_for_the_estimate() -> None:
    s = render(width=32, height=24, frames=3)
    names, q = s.meta.joint_names, s.state.joint_positions
    got = estimated_positions(s, {names[1]: 0.25}, 2)
    assert got[1] == q[0, 1] + 0.25
    assert np.array_equal(np.delete(got, 1), np.delete(q[2], 1))


def test_the_estimate_is_red_and_the_background_pales() -> None:
    rgb = np.full((40, 60, 3), (40, 90, 160), np.uint8)
    there = np.zeros((40, 60), bool)
    there[10:30, 10:30] = True
    estimate = np.roll(there, 20, axis=1)
    out = blend(rgb, there, np.where(estimate, 2, 0).astype(np.float32), estimate,
                np.array([[50.0, 0, 30], [0, 50, 20], [0, 0, 1]]))
    assert (out[there & ~estimate] == rgb[0, 0]).mean() > 0.9  # but for the outline
    assert reddish(out[estimate]).all()
    assert out[0, 0].min() > 200 and np.ptp(out[0, 0].astype(int)) < 2
    assert _RED[0] > 2 * max(_RED[1:])


def test_a_wall_seen_squarely_is_lit_and_a_slanted_one_darker() -> None:
    k = np.array([[50.0, 0, 15.5], [0, 50, 15.5], [0, 0, 1]])
    u = np.indices((32, 32))[1]
    everywhere = np.ones((32, 32), bool)
    flat = shade(np.full((32, 32), 2, np.float32), everywhere, k)
    slanted = shade((2 / (1 - 1.5 * (u - 15.5) / 50)).astype(np.float32), everywhere, k)
    assert flat[16, 16] == pytest.approx(1, abs=0.01)
    cosine = 1 / np.hypot(1, 1.5)
    assert slanted[16, 16] == pytest.approx(0.35 + 0.65 * cosine, abs=0.02)
    assert (shade(np.zeros((4, 4), np.float32), np.zeros((4, 4), bool), k) == 1).all()


@pytest.mark.gl
def test_the_truth_as_an_estimate_covers_the_object(dataset: Dataset) -> None:
    model = model_of(dataset.config, allow=True)
    with Painter(model, 160, 120) as painter:
        for sequence in dataset:
            there = sequence.part[-1] > 0
            true = moved(sequence)
            red = reddish(painter.paint(sequence, true))
            assert (red & there).sum() > 0.99 * there.sum()
            assert (red & ~there).sum() < 0.35 * there.sum()  # its outline, a pixel wide
            off = reddish(painter.paint(sequence, {**true, "wave": true["wave"] + 0.6}))
            assert (off & there).sum() < 0.97 * there.sum()


@pytest.mark.gl
def test_another_model_is_refused(dataset: Dataset) -> None:
    model = model_of(dataset.config, allow=True)
    other = dataclasses.replace(model, screw=-model.screw)
    with Painter(other, 160, 120) as painter, pytest.raises(GcbenchError, match="another model"):
        painter.paint(dataset[0], {})
    other = dataclasses.replace(model, joint_names=("a", "b"))
    with Painter(other, 160, 120) as painter, pytest.raises(GcbenchError, match="does not show"):
        painter.paint(dataset[0], {})


@pytest.mark.gl
def test_the_gallery_has_pictures(dataset: Dataset, tmp_path: Path) -> None:
    for row, scale in ((GCPOSE, 0.001), (FREE, 0.4)):
        path = write_results(tmp_path, row, scale, "flag", 2, ("turn", "wave"), frames=4)
        run = next(f.run for f in find_runs(tmp_path) if f.path == path)
        write_run(path, dataclasses.replace(run, data=str(dataset.path)))
    lines = read_leaderboard([tmp_path]).lines
    pictures = draw_pictures(lines, select_pictures(lines), progress=False, allow_model=True)
    assert len(pictures) == 4
    assert [p.film[:23] for p in pictures] == ["data:image/webp;base64,", ""] * 2
    film = Image.open(io.BytesIO(base64.b64decode(pictures[2].film.partition(",")[2])))
    assert getattr(film, "n_frames", 1) == 3 and film.size == (160, 120)
    assert all(p.image.startswith("data:image/webp;base64,") and not p.reason for p in pictures)
    assert WIDTH <= 640
    assert len({p.image for p in pictures}) == 4
    linked = write_pages(lines, pictures, tmp_path / "out", progress=False)
    worst = sorted({p.sequence for p in pictures if p.kind == "worst"})
    assert all(bool(p.page) == (p.sequence in worst) for p in linked)
    written = sorted(path.relative_to(tmp_path / "out") for path in tmp_path.glob("out/*/*.html"))
    assert [str(path) for path in written] == sorted({p.page for p in linked} - {""})
    assert all(f"{p.sequence}.html" in p.page for p in linked if p.page)
    assert pictures[0].command == f"gcbench show {dataset.path} --index {int(pictures[0].sequence)}"

    run = find_runs(tmp_path)[0]
    changed = dataclasses.replace(run.run, digests=dict.fromkeys(run.run.sequences, "other"))
    write_run(run.path, changed)
    lines = read_leaderboard([tmp_path]).lines
    reasons = [p.reason for p in draw_pictures(lines, select_pictures(lines), progress=False,
                                               allow_model=True)]
    assert sum("changed after it was estimated" in reason for reason in reasons) == 2


@pytest.mark.gl
def test_the_sign_of_a_free_estimate_is_as_it_is_scored(dataset: Dataset, tmp_path: Path) -> None:
    """At `free` an estimate may turn the other way round: what is drawn is what is scored."""
    from gcbench.benchmark.protocol.truth import truth_of
    from gcbench.benchmark.results.estimates import Stored, dump_stored
    from gcbench.renderer.types.observation import Estimate

    write_results(tmp_path, FREE, 0.0, "flag", 2, ("turn", "wave"), frames=4)
    line = read_leaderboard([tmp_path]).lines[0]
    sequence = dataset[0]
    truth = truth_of(sequence)
    flipped = Estimate(-truth.displacement, screw=-truth.screw)
    line.run.estimate_path("000000").write_bytes(dump_stored(Stored("ok", estimate=flipped)))
    last = {name: x[-1] for name, x in estimated_motion(line, sequence, "000000").items()}
    assert last == pytest.approx(moved(sequence))
    line.run.estimate_path("000000").write_bytes(dump_stored(Stored("raised")))
    assert not np.any(list(estimated_motion(line, sequence, "000000").values()))


def test_a_robot_that_is_not_fetched_is_not_downloaded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gcbench.robots.catalog.loading.is_local", lambda entry: False)
    with pytest.raises(GcbenchError, match="gcbench robots fetch ur5"):
        model_of(RenderConfig(robot="ur5"))
