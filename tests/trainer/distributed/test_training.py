"""One training on several processes; oracle: files of undisturbed runs, exit codes."""

import json
import os
import platform
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gscore.engine.cpu.model import accumulated_of
from gscore.io.ply.splats import read_ply
from gscore.io.runs import AGENT
from gscore.trainer.files import checkpoint

from .processes import rank_of, wait_for
from .start_ranks import PATIENCE, ROOT, Ended, start

SHORT = ("--iterations", "60", "--max-splats", "300", "--refine-every", "10", "--sh-every", "12")


def train(capture: Path, output: Path, *more: str, ranks: int = 2) -> list[Ended]:
    """Train on ranks with the same arguments; only rank 0 receives the output folder."""
    line = ["-m", "gscore", "train", capture, *SHORT, "--quiet", *more]
    others = [*line, "-o", output.with_name("nobody")]
    return start([*line, "-o", output], *[others] * (ranks - 1))


def assert_fine(ranks: list[Ended]) -> None:
    """Check that all ranks succeeded, and that only the first one printed."""
    for rank in ranks:
        assert rank.code == 0, rank.err
    assert not any(rank.out or rank.err for rank in ranks[1:])


def test_the_same_ranks_give_the_same_bits_and_rank_0_alone_writes(
    capture: Path, tmp_path: Path
) -> None:
    """Oracle: the PLY of a second run; the folders after both. The last step has one photo."""
    more = ("--eval", "--random-background", "--iterations", "61")
    for name in ("a", "b"):
        assert_fine(train(capture, tmp_path / name, *more))
    files = [(tmp_path / name / "point_cloud.ply").read_bytes() for name in ("a", "b")]
    assert files[0] == files[1]
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b"}
    assert not (tmp_path / "a" / AGENT).exists()
    (last,) = (tmp_path / "a" / "checkpoints").iterdir()
    assert checkpoint.load(last).steps == 61


@pytest.mark.parametrize("models", ["1", "2"])
def test_checkpoint_contains_accumulated_gradients_of_all_ranks(
    capture: Path, tmp_path: Path, models: str
) -> None:
    """Oracle: the PLY of the resumed run, to the bit, with the checkpoint between two steps of the
    higher coefficients; the sum for another number of ranks, in numpy."""
    line = ("--shN-every", "7", "--checkpoint-iterations", "38", "--ensemble", models)
    assert_fine(train(capture, tmp_path / "a", *line))
    kept = tmp_path / "a" / "checkpoints" / "step_00000038.safetensors"
    assert_fine(train(capture, tmp_path / "b", *line, "--start-checkpoint", str(kept)))
    files = [(tmp_path / name / "point_cloud.ply").read_bytes() for name in ("a", "b")]
    assert files[0] == files[1]
    first, second = (
        checkpoint.load(kept).tensors[f"gathered/shN{of}"].numpy() for of in ("", "/1")
    )
    assert first.any()
    assert second.any()
    alone, rest = (accumulated_of(checkpoint.load(kept).tensors, rank, 3) for rank in (0, 2))
    assert alone is not None
    assert rest is not None
    assert (alone.numpy() == first + second).all()
    assert not rest.any()


@pytest.mark.slow
def test_another_number_of_ranks_goes_on(capture: Path, tmp_path: Path) -> None:
    """Oracle: steps of the checkpoints, counted in photos; finite splats."""
    run = tmp_path / "run"
    assert_fine(train(capture, run))
    assert_fine(train(capture, run, "--resume", "--iterations", "91", ranks=1))
    assert_fine(train(capture, run, "--resume", "--iterations", "120"))
    (last,) = (run / "checkpoints").iterdir()
    assert checkpoint.load(last).steps == 120
    assert np.isfinite(read_ply(run / "point_cloud.ply").means).all()


def assert_refused(ranks: list[Ended], sentence: str, output: Path) -> None:
    """Check for exit code 2 on every rank, one sentence on rank 0 alone and no files."""
    assert [rank.code for rank in ranks] == [2, 2], ranks
    assert sentence in " ".join(ranks[0].err.split()), ranks[0].err
    assert "Traceback" not in ranks[0].err
    assert not ranks[1].err
    assert not output.exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("other", "sentence"),
    [
        (("--iterations", "61"), "in the option iterations: 61 there, 60 here"),
        (("--eval",), "in the option eval: True there, nothing here"),
    ],
)
def test_ranks_with_other_options_are_named(
    capture: Path, tmp_path: Path, other: tuple[str, ...], sentence: str
) -> None:
    """Oracle: the sentence and the exit codes."""
    output = tmp_path / "o"
    line = ["-m", "gscore", "train", capture, "-o", output, *SHORT, "--quiet"]
    assert_refused(
        start(line, [*line, *other]), f"differs from rank 0 ({_host()}) {sentence}", output
    )


@pytest.mark.slow
def test_a_rank_without_the_capture_is_named(capture: Path, tmp_path: Path) -> None:
    """Oracle: the sentence, on any rank; no objection to a capture in another folder."""
    there, output = tmp_path / "there", tmp_path / "o"
    line = ["-m", "gscore", "train", "-o", output, *SHORT, "--quiet"]
    refused = start([*line, "-s", capture], [*line, "-s", there])
    assert_refused(refused, f"Rank 1 ({_host()}): There is no folder {there}", output)
    refused = start([*line, "-s", there], [*line, "-s", capture])
    assert_refused(refused, f"gscore train: error: There is no folder {there}", output)
    shutil.copytree(capture, there)
    assert_fine(start([*line, "-s", capture], [*line, "-s", there]))


@pytest.mark.slow
def test_a_rank_with_another_photo_is_named(capture: Path, tmp_path: Path) -> None:
    """Oracle: the sentence, for two exchanged photos."""
    there, output = tmp_path / "there", tmp_path / "o"
    shutil.copytree(capture, there)
    first, second, *_ = sorted(path for path in (there / "images").iterdir())
    first.rename(there / "aside")
    second.rename(first)
    (there / "aside").rename(second)
    line = ["-m", "gscore", "train", "-o", output, *SHORT, "--quiet"]
    refused = start([*line, "-s", capture], [*line, "-s", there])
    assert_refused(refused, f"Rank 1 ({_host()}) differs from rank 0 ({_host()}) in photos", output)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize("victim", [0, 1])
def test_a_killed_rank_costs_nothing(capture: Path, tmp_path: Path, victim: int) -> None:
    """Oracle: the PLY of an undisturbed run, to the bit."""
    line = ("--iterations", "800", "--checkpoint-iterations", "100")
    assert_fine(train(capture, tmp_path / "whole", *line))
    output = tmp_path / "killed"
    torchrun = [
        *(sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"),
        *("--max-restarts", "1", "-m", "gscore", "train", str(capture), *SHORT, "--quiet"),
    ]
    running = subprocess.Popen(
        [*torchrun, *line, "-o", str(output)], cwd=ROOT, stderr=subprocess.PIPE, text=True
    )
    try:
        wait_for(output / "checkpoints" / "step_00000100.safetensors")
        os.kill(rank_of([running.pid], victim), signal.SIGKILL)
        _, reported = running.communicate(timeout=PATIENCE)
    finally:
        running.kill()
    assert running.returncode == 0, reported
    files = [tmp_path / name / "point_cloud.ply" for name in ("whole", "killed")]
    assert files[0].read_bytes() == files[1].read_bytes()


def two_machines(capture: Path, output: Path, *more: str) -> list[subprocess.Popen[str]]:
    """A torchrun for each of two ranks, as on two machines."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    line = [
        *(sys.executable, "-m", "torch.distributed.run", "--nnodes", "2", "--nproc-per-node", "1"),
        *("--rdzv-backend", "c10d", "--rdzv-endpoint", f"127.0.0.1:{port}", "--rdzv-id", "1"),
        *("--max-restarts", "1", "-m", "gscore", "train", str(capture), "-o", str(output)),
        *SHORT,
        *more,
    ]
    return [
        subprocess.Popen(
            line,
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"OMP_NUM_THREADS": "1", "GSCORE_THREADS": "1"},
        )
        for _ in range(2)
    ]


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize("what", ["told to stop", "output lost"])
def test_machines_whose_lead_is_disturbed_end_together(
    capture: Path, tmp_path: Path, what: str
) -> None:
    """Oracle: the PLY of an undisturbed run, to the bit; success of both torchruns."""
    line = ("--iterations", "800", "--checkpoint-iterations", "100")
    assert_fine(train(capture, tmp_path / "whole", *line))
    output = tmp_path / "disturbed"
    machines = two_machines(capture, output, *line)
    try:
        wait_for(output / "checkpoints" / "step_00000100.safetensors")
        if what == "told to stop":
            os.kill(rank_of([one.pid for one in machines], 0), signal.SIGTERM)
        else:
            for one in machines:
                assert one.stdout is not None and one.stderr is not None
                one.stdout.close()
                one.stderr.close()
        codes = [one.wait(PATIENCE) for one in machines]
    finally:
        for one in machines:
            one.kill()
    assert codes == [0, 0]
    files = [tmp_path / name / "point_cloud.ply" for name in ("whole", "disturbed")]
    assert files[0].read_bytes() == files[1].read_bytes()


@pytest.mark.slow
def test_a_slow_rank_is_named_and_bytes_are_counted(capture: Path, tmp_path: Path) -> None:
    """Oracle: the warning and metrics.json of ranks with a pause in each step of the second; bytes
    by the formula of docs/scale.md for photos that all show all splats."""
    output = tmp_path / "o"
    line = ["train", capture, "-o", output, *SHORT, "--sh-degree", "0", "--quiet"]
    ranks = start(["-m", "gscore", *line], ["-m", "tests.trainer.distributed.slow_rank", *line])
    assert_fine(ranks)
    metrics = json.loads((output / "metrics.json").read_text())
    warned = (output / "report.html").read_text()
    assert f"All wait for rank 1 ({_host()})" in warned
    reported = metrics["ranks"]
    assert (reported["count"], reported["batches"]) == (2, 30)
    waited = reported["waited_seconds_per_batch"]
    assert waited[0] - waited[1] > 0.3
    words = 14 + 2 + 1  # per splat: gradients, counts of the strategy, its row
    whole = metrics["splats"] * words * 4
    for sent in reported["sent_bytes_per_batch"]:
        assert 0.5 * whole < sent <= 1.1 * whole


@pytest.mark.slow
def test_port_in_use_is_reported(capture: Path, tmp_path: Path) -> None:
    """Oracle: the sentence of rank 0, its exit code, and no files."""
    line = ["-m", "gscore", "train", str(capture), "-o", str(tmp_path / "o"), *SHORT, "--quiet"]
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        here = {"RANK": "0", "WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1"}
        here |= {"MASTER_PORT": str(taken.getsockname()[1])}
        ended = subprocess.run(
            [sys.executable, *line], env=os.environ | here, cwd=ROOT, capture_output=True, text=True
        )
    assert ended.returncode == 2
    reported = " ".join(ended.stderr.split())
    assert "cannot meet the others at 127.0.0.1:" in reported
    assert "Traceback" not in reported
    assert not (tmp_path / "o").exists()


@pytest.mark.slow
def test_a_rank_lost_after_the_end_costs_nothing(capture: Path, tmp_path: Path) -> None:
    """Oracle: the exit code of a torchrun that may restart once; the splats."""
    torchrun = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    torchrun += ["--max-restarts", "1", "-m", "tests.trainer.distributed.rank_lost_at_end", "train"]
    output = tmp_path / "o"
    ended = subprocess.run(
        [sys.executable, *torchrun, str(capture), *SHORT, "--quiet", "-o", str(output)],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert "exitcode: -9" in ended.stderr
    assert ended.returncode == 0, ended.stderr
    assert (output / "point_cloud.ply").is_file()
    assert not (output / AGENT).exists()


@pytest.mark.slow
def test_a_restart_touches_no_run_of_others(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the files of a finished run, which the first and the second start refuse."""
    run = tmp_path / "run"
    assert_fine(train(capture, run))
    before = (run / "point_cloud.ply").stat()
    monkeypatch.setenv("TORCHELASTIC_RESTART_COUNT", "1")
    refused = train(capture, run, "--iterations", "80")
    assert [rank.code for rank in refused] == [2, 2]
    assert "contains another run" in refused[0].err
    assert (run / "point_cloud.ply").stat() == before


def _host() -> str:
    return platform.node()
