"""Many processes verify a dataset: their files make the report of one process."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from gcbench import ConfigError, DatasetError, merge_verification, verify_dataset, verify_shard
from gcbench.__main__ import main

from ...support import bench_data
from ..generate.test_generate import until

N = 5


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset whose images do not show its motion, so that checks fail."""
    return bench_data.make_dataset(tmp_path_factory.mktemp("data") / "arm", N)


@pytest.fixture
def data(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "arm"))


def start(data: Path, shard: str, reports: Path) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "gcbench", "verify", str(data), "--shard", shard, "--reports",
         str(reports), "--workers", "1", "--quiet"], stdout=subprocess.DEVNULL,
        start_new_session=True)


def test_merged_shards_are_the_report_of_one_run(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "reports"
    for k in (1, 0):
        with pytest.raises(DatasetError, match="not verified"):
            merge_verification(data, out)
        assert not verify_shard(data, f"{k}/2", out, progress=False).ok
    alone = verify_dataset(data, progress=False)
    assert not alone.ok and merge_verification(data, out) == alone


def test_the_command_tells_what_is_wrong(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    here = ["--reports", str(tmp_path / "reports")]
    assert main(["verify", str(data), "--shard", "0/2", "--workers", "1", "--quiet", *here]) == 1
    assert main(["verify", str(data), "--merge", *here]) == 2
    assert "--shard 1/2" in capsys.readouterr().err
    assert main(["verify", str(data), "--shard", "1/2", "--workers", "1", "--quiet", *here]) == 1
    capsys.readouterr()
    assert main(["verify", str(data), "--merge", "--json", *here]) == 1
    merged = json.loads(capsys.readouterr().out)
    assert main(["verify", str(data), "--workers", "1", "--quiet", "--json"]) == 1
    assert json.loads(capsys.readouterr().out) == merged
    assert main(["verify", str(data), "--merge", "--sequences", "0"]) == 2
    assert "exclude each other" in capsys.readouterr().err


def test_a_killed_shard_continues(data: Path, tmp_path: Path) -> None:
    file = tmp_path / "0-of-1.jsonl"
    killed = start(data, "0/1", tmp_path)
    assert until(lambda: file.exists() and file.read_bytes().count(b"\n") >= 3, 120)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.wait()
    done = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(b"".join(done) + done[-1][:40])  # a line that a kill has cut off
    verify_shard(data, "0/1", tmp_path, progress=False)
    assert file.read_bytes().splitlines(keepends=True)[: len(done)] == done
    assert merge_verification(data, tmp_path) == verify_dataset(data, progress=False)


def test_what_changed_is_refused_until_it_is_verified_again(data: Path, tmp_path: Path) -> None:
    for k in (0, 1):
        verify_shard(data, f"{k}/2", tmp_path, progress=False)
    sequences = data / "sequences"
    shutil.copy(sequences / "000004.zip", sequences / "000003.zip")
    with pytest.raises(DatasetError, match=r"1 of 5 .*first: 000003.*--shard 1/2"):
        merge_verification(data, tmp_path)
    verify_shard(data, "1/2", tmp_path, progress=False)
    report = merge_verification(data, tmp_path)
    assert "seed and index" in report.failures
    assert report == verify_dataset(data, progress=False)
    file = data / "dataset.json"
    tree = json.loads(file.read_text())
    tree["config"]["frames"] = 5
    file.write_text(json.dumps(tree))
    with pytest.raises(DatasetError, match="of another dataset or version"):
        merge_verification(data, tmp_path)


def test_what_cannot_be_read_is_a_failure_and_no_shard_is_out_of_range(
    data: Path, tmp_path: Path
) -> None:
    (data / "sequences/000001.zip").write_bytes(b"damaged")
    assert "readable" in verify_shard(data, "1/2", tmp_path, progress=False).failures
    with pytest.raises(ConfigError, match="shard 2/2"):
        verify_shard(data, "2/2", tmp_path, progress=False)
    assert verify_shard(data, "8/9", tmp_path, progress=False).checks == ()
