"""A dataset in object storage is the local one, to the byte; a real S3 server holds it."""

from __future__ import annotations

import dataclasses
import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import gcbench as gb
import numpy as np
import pytest
from gcbench.__main__ import main
from gcbench.benchmark.report import gallery
from gcbench.benchmark.results import Row
from gcbench.benchmark.run.datasets import Data
from gcbench.benchmark.run.jobs import describe_run, prepare_job
from gcbench.gcpose.training.data import find_datasets, refuse_test_streams
from gcbench.renderer.generate.driver import Summary, render_dataset
from gcbench.renderer.runtime import object_store, range_cache
from gcbench.renderer.runtime.command_line import to_json
from gcbench.renderer.runtime.object_store import (
    address,
    exists,
    find_object,
    list_folder,
    read_file,
    store_file,
    upload_file,
)
from gcbench.renderer.verify.driver import Reference, verify_files
from gcbench.robots.files import lock_folder

from ...support import bench_data
from ...support.s3_server import Server, s3_server

CONFIG = gb.RenderConfig(robot="arm", seed=3, frames=4, width=64, height=48)
N = 4


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with s3_server(tmp_path_factory.mktemp("cache")) as running:
        yield running


@pytest.fixture
def place(server: Server, request: pytest.FixtureRequest) -> str:
    """An address of its own for each test."""
    return f"s3://videos/{request.node.originalname}"


def render(out: str | Path, config: gb.RenderConfig = CONFIG, n: int = N) -> Summary:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(Path(__file__).parents[2] / "support"))
        return render_dataset(config, n, out, 1, progress=False, source="fake_source:FakeRenderer")


def content(folder: Path) -> dict[str, bytes]:
    """What a local or a stored dataset consists of."""
    files = {p.name: p for p in (folder / "dataset.json", *list_folder(folder / "sequences"))}
    return {name: read_file(path, 2**26) for name, path in files.items()}


def upload(folder: Path, place: str) -> gb.Dataset:
    for path in folder.rglob("*"):
        if path.is_file():
            upload_file(path, Path(place) / path.relative_to(folder))
    return gb.open_dataset(place)


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("local") / "data"
    render(out)
    return out


# -- rendering --------------------------------------------------------------------------------


def test_a_stored_dataset_is_the_local_one_to_the_byte(local: Path, place: str) -> None:
    done = render(place)
    assert (done.rendered, done.sequences, done.frames) == (N, N, 4 * N)
    assert done.describe().startswith(f"{place}: {N} sequences")
    assert content(Path(place)) == content(local)
    assert len(content(local)) == N + 1


def test_a_second_run_renders_what_is_missing(local: Path, place: str) -> None:
    render(place, n=2)
    assert render(place).rendered == N - 2
    assert render(place).rendered == 0
    assert content(Path(place)) == content(local)


def test_nothing_stays_in_the_cache_but_what_was_read(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GCBENCH_CACHE", str(tmp_path))
    killed, running = (tmp_path / "scratch" / name for name in ("killed", "running"))
    for folder in (killed, running):
        folder.mkdir(parents=True)
        (folder / "half").touch()
    (killed / ".lock").touch()
    os.utime(killed, (0, 0))
    with lock_folder(running):
        render(place, n=1)
    assert [*(tmp_path / "scratch").iterdir()] == [running]


def test_another_configuration_is_refused(place: str) -> None:
    render(place, n=1)
    there = content(Path(place))
    with pytest.raises(gb.ConfigError, match=f"{place} holds a dataset of another .*seed: 3 -> 4"):
        render(place, gb.RenderConfig(**{**vars(CONFIG), "seed": 4}))
    assert content(Path(place)) == there


def test_shards_write_one_dataset(local: Path, place: str) -> None:
    for index in (1, 0):
        with pytest.MonkeyPatch.context() as patch:
            patch.syspath_prepend(str(Path(__file__).parents[2] / "support"))
            render_dataset(CONFIG, gb.Shard(N, index, 2), place, 1, progress=False,
                           source="fake_source:FakeRenderer")
    assert content(Path(place)) == content(local)


def test_only_one_process_creates_an_object(place: str) -> None:
    path = Path(place) / "dataset.json"
    assert store_file(path, b"mine", create=True)
    assert not store_file(path, b"yours", create=True)
    assert store_file(path, b"mine", create=True)  # the answer to the first attempt was lost
    assert read_file(path, 4) == b"mine"
    assert store_file(path, b"newer") and read_file(path, 5) == b"newer"


def interrupt(server: Server, place: str, sequences: int) -> threading.Thread:
    """Stop the server for 2 s when so many sequences are there."""

    def run() -> None:
        end = time.monotonic() + 60
        while len(list_folder(Path(place) / "sequences")) < sequences < time.monotonic() < end:
            time.sleep(0.02)
        server.stop()
        time.sleep(2.0)
        server.start()

    thread = threading.Thread(target=run)
    thread.start()
    return thread


@pytest.mark.slow
def test_a_render_outlasts_a_restart_of_the_server(
    local: Path, server: Server, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_SECONDS", "0.1")
    stopping = interrupt(server, place, 1)
    render(place)
    stopping.join()
    assert content(Path(place)) == content(local)


@pytest.mark.parametrize("scheme", ["gs", "az"])
def test_other_storage_is_reached_the_same_way(
    local: Path, scheme: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """fsspec's files in memory take the place of a Google or Azure server, in one process."""
    pytest.importorskip("fsspec", reason="fsspec is in the extra cloud")
    from fsspec.implementations.memory import MemoryFileSystem

    monkeypatch.setenv("GCBENCH_CACHE", str(tmp_path))
    monkeypatch.setitem(sys.modules["fsspec.registry"]._registry, scheme, MemoryFileSystem)
    monkeypatch.setattr(MemoryFileSystem, "store", {})
    object_store._file_system.cache_clear()
    place = f"{scheme}://videos/data"
    stored = upload(local, place)
    assert content(Path(place)) == content(local)
    assert repr(stored) == repr(gb.open_dataset(local)).replace(str(local), place)
    assert np.array_equal(stored[1].rgb[2], gb.open_dataset(local)[1].rgb[2])
    assert not store_file(Path(place) / "dataset.json", b"other", create=True)
    object_store._file_system.cache_clear()


# -- reading ----------------------------------------------------------------------------------


def test_sequences_are_those_of_the_local_dataset(local: Path, place: str) -> None:
    stored, here = upload(local, place), gb.open_dataset(local)
    assert repr(stored) == repr(here).replace(str(local), place)
    for one, two in zip(stored, here, strict=True):
        assert one.meta == two.meta
        for name in ("rgb", "depth", "part", "flow", "flow_backward", "visibility"):
            assert np.array_equal(getattr(one, name)[:], getattr(two, name)[:], equal_nan=True)
        for name, value in vars(one.state).items():
            assert np.array_equal(value, getattr(two.state, name))
    with pytest.raises(gb.DatasetError, match=f"{place} has no sequence"):
        stored["000009"]


def test_only_what_is_asked_for_is_read(
    server: Server, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GCBENCH_CACHE", str(tmp_path / "cache"))
    config = gb.RenderConfig(robot="arm", frames=12, width=160, height=120)
    render(tmp_path / "data", config, 1)
    data = upload(tmp_path / "data", place)
    image = data[0].depth[3]

    def read() -> int:
        return sum(p.stat().st_size for p in (tmp_path / "cache").rglob("*") if p.is_file())

    stored = find_object(Path(place) / "sequences/000000.zip")
    assert stored and read() < stored.size / 8
    before = read()
    server.stop()  # what was read stays on this machine; whether the object changed does not
    try:
        assert stored.read(0, 0) == b""
        assert np.array_equal(data_image(data, stored), image)
    finally:
        server.start()
    assert read() == before


def data_image(data: gb.Dataset, stored: object_store.StoredObject) -> np.ndarray:
    """Depth of frame 3 through the object as it was found before."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gcbench.renderer.runtime.zip_archive.find_object", lambda path: stored)
        return data[0].depth[3]


def test_a_cache_has_a_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GCBENCH_CACHE", str(tmp_path))
    monkeypatch.setenv("GCBENCH_OBJECT_CACHE", str(2**20 / 2**30))  # 1 MiB
    loads: list[int] = []
    for k in [*range(64), 63]:
        def load(k: int = k) -> bytes:
            loads.append(k)
            return bytes([k]) * 2**16

        assert range_cache.cached_range(f"key {k}", 2**16, load) == bytes([k]) * 2**16
    assert loads == list(range(64))
    size = sum(p.stat().st_size for p in tmp_path.rglob("*") if p.is_file())
    assert 2**19 < size <= 2**20 + 2**16
    monkeypatch.setenv("GCBENCH_OBJECT_CACHE", "0")
    assert range_cache.cached_range("key 63", 2**16, lambda: b"again") == b"again"
    monkeypatch.setenv("GCBENCH_OBJECT_CACHE", "much")
    with pytest.raises(gb.ConfigError, match="size in GiB"):
        range_cache.cached_range("key 63", 2**16, bytes)


@pytest.mark.parametrize("damage", [
    lambda data: b"", lambda data: b"nothing" * 99, lambda data: data[: len(data) // 2],
    lambda data: data[:-1], lambda data: data.replace(b"PK\x03\x04", b"PK\x03\x05"),
], ids=["empty", "text", "half", "end", "headers"])
def test_a_damaged_object_is_one_line(local: Path, place: str, damage: object) -> None:
    good = (local / "sequences/000000.zip").read_bytes()
    store_file(Path(place) / "dataset.json", (local / "dataset.json").read_bytes())
    store_file(Path(place) / "sequences/000000.zip", damage(good))  # type: ignore[operator]
    with pytest.raises(gb.DatasetError, match=f"{place}/sequences/000000.zip") as caught:
        gb.open_dataset(place)[0].rgb[0]
    assert "\n" not in str(caught.value)


def test_training_finds_stored_datasets(local: Path, place: str) -> None:
    """At an address, and in a folder at an address."""
    upload(local, f"{place}/one")
    upload(local, f"{place}/two")
    one, two = Path(f"{place}/one"), Path(f"{place}/two")
    assert find_datasets((Path(place), two)) == [one, two, two]
    with pytest.raises(gb.DatasetError, match=f"^{place}/three: there is no dataset"):
        find_datasets((Path(f"{place}/three"),))
    with pytest.raises(gb.DatasetError, match=f"^{place}/one is of the stream `test`"):
        refuse_test_streams([one])


@pytest.mark.slow
def test_the_commands_read_a_stored_dataset(
    tmp_path: Path, place: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each does with it what it does with the local one."""
    monkeypatch.chdir(tmp_path)
    folder = bench_data.make_dataset(tmp_path / "here" / place.rpartition("/")[2], 2)
    upload(folder, place)
    outputs: list[str] = []
    for data, to in ((str(folder), "alpha"), (place, "omega")):
        main(["verify", data, "--quiet"])
        main(["verify", f"{data}/sequences/000001.zip", "--quiet"])
        main(["show", data, "--contact-sheet", f"{to}.png"])
        main(["export", data, "--format", "kitti", "--out", f"{to}-kitti", "--quiet"])
        outputs.append(capsys.readouterr().out.replace(to, ""))
        main(["eval", "--method", "hold-still", "--data", data, "--inputs", "rgbd", "--workers",
              "1", "--results", f"{to}-results", "--quiet"])
        capsys.readouterr()  # times
    assert outputs[0] == outputs[1] and "000001" in outputs[0]
    assert Path("alpha.png").read_bytes() == Path("omega.png").read_bytes()
    files = [sorted(p.relative_to(to) for p in Path(to).rglob("*.png"))
             for to in ("alpha-kitti", "omega-kitti")]
    assert files[0] == files[1] and files[0]
    (run,) = Path("omega-results").rglob("run.json")
    assert place in run.read_text()
    main(["export", place, "--format", "coco", "--quiet"])
    assert (tmp_path / f"{place.rpartition('/')[2]}-coco").is_dir()


@pytest.mark.filterwarnings("ignore:This process")  # Python 3.12: threads and fork
def test_tensors_of_a_stored_dataset(local: Path, place: str) -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is in the extra learn")
    from gcbench.renderer.dataset.torch import TorchDataset

    stored, here = TorchDataset(upload(local, place)), TorchDataset(gb.open_dataset(local))
    assert len(stored) == len(here)
    torch.testing.assert_close(stored[5], here[5], rtol=0, atol=0, equal_nan=True)
    batches = torch.utils.data.DataLoader(  # a process has connections of its own
        stored, batch_size=3, num_workers=1, multiprocessing_context="fork")
    assert torch.equal(next(iter(batches))["rgb"][2], here[2]["rgb"])


@pytest.mark.slow
def test_an_evaluation_outlasts_a_restart_of_the_server(
    server: Server, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GCBENCH_OBJECT_CACHE", "0")
    folder = bench_data.make_dataset(tmp_path / place.rpartition("/")[2], 3)
    upload(folder, place)
    scores = []
    for data in (folder, Path(place)):
        stopping = interrupt(server, place, 1) if data != folder else None
        config = gb.EvalConfig(method=("hold-still",), data=(data,), inputs=("rgbd",), workers=1,
                               results=tmp_path / f"results-{len(scores)}")
        found = gb.evaluate(config, progress=False)
        assert not found.failures and found.estimated == 3
        scores.append([p.read_bytes() for p in sorted(config.results.rglob("scores.csv"))])
        if stopping:
            stopping.join()
    assert [len(s) for s in scores] == [1, 1]


# -- what may go wrong ------------------------------------------------------------------------


def test_a_server_that_is_gone_is_one_line(
    local: Path, server: Server, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(object_store, "_WAITS", (0.05,))
    data = upload(local, place)
    server.stop()
    try:
        for attempt in (lambda: gb.open_dataset(place), lambda: data[0], lambda: render(place)):
            with pytest.raises(gb.DatasetError, match="run the same command again") as caught:
                attempt()
            assert "\n" not in str(caught.value) and place in str(caught.value)
    finally:
        server.start()
    assert len(gb.open_dataset(place)) == N


def test_an_outage_is_no_fault_of_a_sequence_or_a_method(
    local: Path, server: Server, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(object_store, "_WAITS", (0.05,))
    monkeypatch.setenv("GCBENCH_OBJECT_CACHE", "0")
    data = Data("stored", upload(local, place), ("000000",), 0)
    row = Row("still", "1", "rgb", "free", "none")
    job = prepare_job(describe_run(row, "still", data, {}), data, tmp_path)
    sequence = Path(place) / "sequences/000000.zip"
    server.stop()
    try:
        for attempt in (lambda: job.write("000000", b"what a method has sent"),
                        lambda: list(verify_files([(sequence, Reference(), None)], 1, False))):
            with pytest.raises(gb.DatasetError, match="does not answer"):
                attempt()
    finally:
        server.start()
    assert job.write("000000", b"what a method has sent").status == "invalid"


def test_no_bucket_and_no_dataset_are_one_line(server: Server) -> None:
    with pytest.raises(gb.DatasetError, match=r"s3://nowhere/data.*no bucket 'nowhere'; create it"):
        render("s3://nowhere/data")
    with pytest.raises(gb.DatasetError, match=r"s3://videos/empty: not a dataset"):
        gb.open_dataset("s3://videos/empty")
    with pytest.raises(gb.DatasetError, match="give a bucket and a path"):
        gb.open_dataset("s3://")


@pytest.mark.slow
def test_what_hangs_ends_within_a_minute(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A server that accepts connections and says nothing: one call, and two in turn."""
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        port = silent.getsockname()[1]
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{port}")
        object_store._file_system.cache_clear()
        path = Path("s3://videos/data/dataset.json")
        for attempts in ([lambda: gb.open_dataset("s3://videos/data")],
                         [lambda: store_file(path, b"{}"), lambda: read_file(path, 9)]):
            object_store._outages.clear()
            started = time.monotonic()
            for attempt in attempts:
                with pytest.raises(gb.DatasetError, match="run the same command again"):
                    attempt()
            assert time.monotonic() - started < 60
    object_store._file_system.cache_clear()


def test_results_of_others_open_no_connection() -> None:
    """An address in run.json is not the user's."""
    picture = gallery.Picture(0, "worst", "000000", 1.0, ())
    (found,) = gallery._draw_folder(Path("s3://videos/data"), [], {7: picture}, False)
    assert found == (7, dataclasses.replace(picture, reason="its dataset is in object storage"))


def test_missing_credentials_are_one_line(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_DEFAULT_REGION", "eu-central-1")
    object_store._file_system.cache_clear()
    with pytest.raises(gb.DatasetError, match=r"no credentials.*AWS_PROFILE") as caught:
        gb.open_dataset("s3://videos/data")
    assert "\n" not in str(caught.value)
    object_store._file_system.cache_clear()


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fsspec", None)
    object_store._file_system.cache_clear()
    with pytest.raises(gb.GcbenchError, match=r"pip install '\.\[cloud\]'"):
        gb.open_dataset("s3://videos/data")


def test_addresses_are_paths() -> None:
    path = Path("s3://videos/a/b")
    assert address(path / "dataset.json") == "s3://videos/a/b/dataset.json"
    assert address(Path("data/ur5")) == "data/ur5"
    assert json.loads(to_json({"dataset": path})) == {"dataset": "s3://videos/a/b"}
    assert not object_store.is_remote(Path("gcs://b/ds"))  # as results of others may say
    assert not object_store.is_remote(Path("/s3:/videos")) and not exists(Path("/s3:/videos"))


@pytest.mark.parametrize("text", ["gcs://b/ds", "S3://b/ds", "file:///data", "https://a.b/c"])
def test_other_addresses_are_refused(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["render", "--robot", "owi535", "--n", "1", "--out", text]) == 2
    assert "no address that gcbench reads; there are s3://, gs://, az:// and" in (
        capsys.readouterr().err)
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("command", [
    "eval --method hold-still --data {data} --results s3://b/r",
    "eval --method hold-still --suite mini --suites s3://b/s",
    "score --predictions {data}/no.csv --data {data} --results s3://b/r",
    "export {data} --format coco --out s3://b/out", "show {data} --out s3://b/out",
    "show {data} --gif s3://b/a.gif", "verify {data} --shard 0/1 --reports s3://b/out",
    "publish {data} --to s3://b/out", "report {data} --out s3://b/out",
    "submit --executor local --logs s3://b/logs -- render --robot owi535 --n 2",
])
def test_only_datasets_are_written_to_addresses(
    command: str, local: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(command.format(data=local).split()) == 2
    assert "only datasets can be in object storage; name a folder" in capsys.readouterr().err
    assert not [*tmp_path.iterdir()]


def test_local_datasets_need_no_fsspec(local: Path) -> None:
    code = (f"import sys, gcbench; gcbench.open_dataset({str(local)!r})[0]\n"
            "sys.exit(' '.join({'fsspec', 's3fs', 'botocore'} & {*sys.modules}) or 0)")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
