"""A sequence trained by many processes; oracle: the files of one process for all frames."""

import json
import os
import platform
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from gscore.commands import main
from gscore.io.runs import AGENT
from gscore.io.sequences import read_sequence
from tests.trainer.distributed.processes import rank_of, wait_for
from tests.trainer.distributed.start_ranks import PATIENCE, ROOT, start

pytestmark = pytest.mark.usefixtures("fake_engine")

SHORT = ["--iterations", "20", "--max-splats", "200", "--sh-degree", "0", "--quiet"]
KEYS = ["--keyframe-every", "2", "--next-iterations", "8"]


@pytest.fixture
def video(frames: Path) -> Path:
    """Five frames in different worlds: two runs of two, and one of one."""
    for number, copied in ((15, 0), (20, 5)):
        shutil.copytree(frames / f"{copied:06d}", frames / f"{number:06d}")
    return frames


@pytest.fixture
def whole(video: Path, tmp_path: Path) -> Path:
    """All frames by one process."""
    out = tmp_path / "whole"
    assert main(["sequence", str(video), "-o", str(out), *SHORT, *KEYS]) == 0
    return out


def splats_in(out: Path) -> dict[str, bytes]:
    """The splats of each frame."""
    return {path.parent.name: path.read_bytes() for path in out.glob("frame_*/point_cloud.ply")}


def listed_in(out: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Options and frames of sequence.json, without machine-dependent values."""
    index = read_sequence(out)
    assert index is not None
    return index.options, [
        {key: value for key, value in entry.items() if key != "train_seconds"}
        for entry in index.frames
    ]


def assert_same(out: Path, whole: Path) -> None:
    """Check for the same splats, the same list and no other files."""
    assert splats_in(out) == splats_in(whole)
    assert len(splats_in(out)) == 5
    assert listed_in(out) == listed_in(whole)
    assert {path.name for path in out.iterdir()} == {path.name for path in whole.iterdir()}


@pytest.mark.usefixtures("real_engine")
def test_ranks_give_what_one_process_gives(video: Path, whole: Path, tmp_path: Path) -> None:
    """Oracle: splats to the bit and the list of frames; JSON of all frames on rank 0 alone."""
    out = tmp_path / "out"
    line = ["-m", "gscore", "sequence", video, "-o", out, *SHORT, *KEYS, "--json"]
    ranks = start(line, line)
    assert [rank.code for rank in ranks] == [0, 0], ranks
    assert not ranks[1].out
    facts = json.loads(ranks[0].out.splitlines()[-1])
    assert [entry["frame"] for entry in facts["per_frame"]] == [0, 5, 10, 15, 20]
    assert_same(out, whole)


def test_jobs_give_what_one_process_gives(video: Path, whole: Path, tmp_path: Path) -> None:
    """Oracle: as above, of jobs in another order, one of them twice; a job with other options is
    refused with a sentence, and changes no file."""
    out = tmp_path / "out"
    line = ["sequence", str(video), "-o", str(out), *SHORT, *KEYS]
    for number in (10, 20, 5):
        assert main([*line, "--frame", str(number)]) == 0
    before = splats_in(out)
    assert main([*line, "--frame", "0"]) == 0
    assert main([*line, "--frame", "0", "--carried-opacity", "1"]) == 2
    assert splats_in(out) == before
    assert_same(out, whole)


def test_another_choice_of_keyframes_is_refused(
    video: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the sentence, where no other option differs."""
    line = ["sequence", str(video), "-o", str(tmp_path / "out"), *SHORT]
    line += ["--carried-opacity", "1", "--next-iterations", "20"]
    assert main([*line, "--keyframe-every", "2"]) == 0
    assert main(["sequence", "-o", line[3], "--resume", "--keyframe-every", "3", "--quiet"]) == 2
    reported = " ".join(capsys.readouterr().err.split())
    assert "it started from no other frame, not frame_000005" in reported


@pytest.mark.slow
def test_ranks_without_a_common_folder_or_work_are_refused(video: Path, tmp_path: Path) -> None:
    """Oracle: sentences of rank 0, exit codes, and no remaining files."""
    out, there = tmp_path / "out", tmp_path / "there"
    line = ["-m", "gscore", "sequence", video, *SHORT]
    elsewhere = f"Rank 1 ({platform.node()}): {there} is not the folder in which"
    for more, other, sentence in (
        ([], out, "so 2 processes cannot share them. Use --keyframe-every N, which"),
        (KEYS, there, elsewhere),
    ):
        ranks = start([*line, *more, "-o", out], [*line, *more, "-o", other])
        assert [rank.code for rank in ranks] == [2, 2], ranks
        assert sentence in " ".join(ranks[0].err.split())
        assert not ranks[1].err
        assert not out.exists()
        assert not there.exists()


@pytest.mark.slow
def test_a_broken_frame_stops_its_own_run_only(video: Path, tmp_path: Path) -> None:
    """Oracle: the finished frames, the sentence, and all frames after the repair."""
    out = tmp_path / "out"
    broken = video / "000005/sparse/0/images.bin"
    good = broken.read_bytes()
    broken.write_bytes(good[:50])
    line = ["-m", "gscore", "sequence", video, "-o", out, *SHORT, *KEYS]
    ranks = start(line, line)
    assert [rank.code for rank in ranks] == [2, 2], ranks
    assert "frame_000005: " in ranks[0].err
    assert sorted(splats_in(out)) == [f"frame_{n:06d}" for n in (0, 10, 15, 20)]
    broken.write_bytes(good)
    ranks = start([*line, "--resume"], [*line, "--resume"])
    assert [rank.code for rank in ranks] == [0, 0], ranks
    assert len(splats_in(out)) == 5


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="looks for processes in /proc")
@pytest.mark.usefixtures("real_engine")
@pytest.mark.parametrize("victim", [0, 1])
def test_a_killed_rank_is_resumed(video: Path, whole: Path, tmp_path: Path, victim: int) -> None:
    """Oracle: the splats of an undisturbed process; the list of frames."""
    out = tmp_path / "out"
    torchrun = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    words = [*torchrun, "--max-restarts", "2", "-m", "gscore", "sequence", str(video), "-o"]
    running = subprocess.Popen(
        [sys.executable, *words, str(out), *SHORT, *KEYS],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        wait_for(out / "frame_000000" / "config.json")
        wait_for(out / "frame_000010" / "config.json")
        os.kill(rank_of([running.pid], victim), signal.SIGKILL)
        _, reported = running.communicate(timeout=PATIENCE)
    finally:
        running.kill()
    assert running.returncode == 0, reported
    assert not (out / AGENT).exists()
    assert_same(out, whole)
