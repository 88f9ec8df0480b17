"""Runs that are stopped; oracle: exit codes, sentences, readable files."""

import os
import random
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from gscore.events import Failed, from_line
from gscore.io.ply.splats import read_ply
from gscore.trainer.files import checkpoint
from gscore.trainer.files.run_folder import RunFolder
from tests.forked import Forked

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals and shells of POSIX")
SHORT = ["--iterations", "12", "--max-splats", "200", "--sh-degree", "0"]
LONG = ["--iterations", "10000000", "--max-splats", "200", "--checkpoint-seconds", "0.2"]


def command(capture: Path, out: Path, *options: str) -> list[str]:
    return [sys.executable, "-m", "gscore", "train", str(capture), "-o", str(out), *options]


@pytest.fixture
def begin() -> Iterator[Callable[..., Forked]]:
    """`start(arguments, **options)`: a program, killed after the test."""
    made: list[Forked] = []

    def start(arguments: list[str], **options: Any) -> Forked:
        made.append(Forked(arguments[1:], **options))
        return made[-1]

    yield start
    for process in made:
        process.close()


def is_training(process: Forked, out: Path) -> None:
    """Wait until there is a checkpoint after the first step."""
    while process.poll() is None and len(RunFolder(out).checkpoints()) < 2:
        time.sleep(0.02)
    assert process.poll() is None


@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGPIPE, 141)],
)
def test_every_signal_leaves_a_checkpoint(
    capture: Path, tmp_path: Path, begin: Callable[..., Forked], number: int, code: int
) -> None:
    """Oracle: 128 + the signal, results and a checkpoint of the last step; a second signal that is
    not from a key changes nothing."""
    process = begin(command(capture, tmp_path, *LONG))
    is_training(process, tmp_path)
    process.send_signal(number)
    if number != signal.SIGINT:
        time.sleep(0.02)
        process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == code
    assert "Traceback" not in err
    assert "--resume" in out
    assert checkpoint.load(RunFolder(tmp_path).checkpoints()[-1]).steps > 0
    assert (tmp_path / "metrics.json").is_file()


def test_a_second_ctrl_c_ends_at_once(
    capture: Path, tmp_path: Path, begin: Callable[..., Forked]
) -> None:
    """Oracle: both sentences and no other output after the progress; intact checkpoints. The steps
    take five seconds, so that the second key comes before the run ends by the first, and keys are
    two seconds apart, so that two do not become one on a busy machine."""
    code = (
        "import sys, time; from gscore.__main__ import main\n"
        "from gscore.trainer.trainer import Trainer; real = Trainer.advance\n"
        "Trainer.advance = lambda self: (time.sleep(5), real(self))[1]; sys.exit(main())"
    )
    process = begin([sys.executable, "-c", code, *command(capture, tmp_path, *LONG)[3:]])
    is_training(process, tmp_path)
    for _ in range(2):
        process.send_signal(signal.SIGINT)
        time.sleep(2)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.splitlines()[-2:] == [
        "Stopping in an orderly way; press Ctrl-C again to stop immediately.",
        "Stopped immediately. Files written before are complete.",
    ]
    assert all(checkpoint.load(path) for path in RunFolder(tmp_path).checkpoints())


@pytest.mark.parametrize("runs", [2, pytest.param(30, marks=pytest.mark.slow)])
def test_ctrl_c_at_any_moment(capture: Path, tmp_path: Path, runs: int) -> None:
    """Oracle: no traceback and no torn file, for one to three keys at random moments from the start
    of the interpreter on: imports, reading, checkpoints, evaluation, report."""
    chance = random.Random(runs)
    options = ["--iterations", "60", "--max-splats", "200", "--checkpoint-seconds", "0.05"]
    began, pipes = time.monotonic(), {"stderr": subprocess.PIPE, "stdin": subprocess.DEVNULL}
    subprocess.run(command(capture, tmp_path / "whole", *options), **pipes, timeout=60)
    usual = time.monotonic() - began
    for run in range(runs):
        out = tmp_path / str(run)
        process = subprocess.Popen(command(capture, out, *options), **pipes, text=True)
        time.sleep(0.15 + chance.uniform(0, usual))
        for _ in range(chance.randint(1, 3)):
            process.send_signal(signal.SIGINT)
            time.sleep(chance.choice([0.001, 0.02, 0.3]))
        _, err = process.communicate(timeout=60)
        assert process.returncode in (0, 130), err
        assert not any(word in err for word in ("Traceback", "Exception", "rror")), err
        assert all(checkpoint.load(path) for path in RunFolder(out).checkpoints())
        if (out / "point_cloud.ply").exists():
            read_ply(out / "point_cloud.ply")


@pytest.mark.parametrize(
    ("closed", "more"),
    [
        pytest.param(">&-", ["--json"], marks=pytest.mark.slow),
        pytest.param("2>&-", [], marks=pytest.mark.slow),
        ("<&- >&- 2>&-", ["--events", "jsonl"]),
    ],
)
def test_streams_that_are_closed_from_the_start_are_not_missed(
    capture: Path, tmp_path: Path, closed: str, more: list[str]
) -> None:
    """Oracle: the whole run, code 0, and none of its text in its files."""
    line = " ".join(f"'{word}'" for word in command(capture, tmp_path, *SHORT, *more))
    ended = subprocess.run(["sh", "-c", f"{line} {closed}"], capture_output=True, text=True)
    assert (ended.returncode, "Traceback" in ended.stderr) == (0, False)
    assert (tmp_path / "report.html").is_file()
    assert checkpoint.load(RunFolder(tmp_path).checkpoints()[-1]).steps == 12


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_a_reader_that_goes_away_ends_a_run_with_a_checkpoint(
    capture: Path, tmp_path: Path, begin: Callable[..., Forked], stream: str
) -> None:
    """Oracle: 141, the shells' code for a closed pipe, and a run that can be resumed."""
    events = ["--events", "jsonl"] if stream == "stdout" else []
    often = (  # a progress line for people comes every ten seconds
        "import sys; from gscore.__main__ import main\n"
        "from gscore.commands.terminal import status; status._LINE_PERIOD = 0.1; sys.exit(main())"
    )
    process = begin([sys.executable, "-c", often, *command(capture, tmp_path, *LONG, *events)[3:]])
    is_training(process, tmp_path)
    getattr(process, stream).close()
    other = process.stderr if stream == "stdout" else process.stdout
    assert process.wait(timeout=60) == 141
    assert "Traceback" not in other.read()
    assert checkpoint.load(RunFolder(tmp_path).checkpoints()[-1]).steps > 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_reported_and_loses_nothing(
    capture: Path, tmp_path: Path, begin: Callable[..., Forked]
) -> None:
    """Oracle: the results, a sentence and code 2, although the summary cannot be written."""
    with Path("/dev/full").open("w") as full:
        process = begin(command(capture, tmp_path, *SHORT), stdout=full)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 2
    last = err.splitlines()[-1]
    assert last.startswith("gscore: error: Cannot write the output: the disk is full.")
    assert (tmp_path / "metrics.json").is_file()


def test_a_stop_before_the_first_step_has_a_code_of_its_own(
    capture: Path, tmp_path: Path, begin: Callable[..., Forked]
) -> None:
    """Oracle: code 3, its event, and no folder."""
    process = begin(
        command(capture, tmp_path / "out", *LONG, "--events", "jsonl"), stdin=subprocess.PIPE
    )
    out, _ = process.communicate("stop\n", timeout=60)
    last = from_line(out.splitlines()[-1])
    assert process.returncode == 3
    assert isinstance(last, Failed)
    assert last.message == "Stopped before the first step; nothing was written."
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["SIGHUP", "SIGINT", "SIGTERM"])
def test_a_signal_that_is_ignored_stays_so(
    capture: Path, tmp_path: Path, begin: Callable[..., Forked], name: str
) -> None:
    """Oracle: a run under nohup, or in the background of a script, to its end."""
    code = (
        f"import os, signal, sys; signal.signal(signal.{name}, signal.SIG_IGN)\n"
        "from gscore.__main__ import main; from gscore.trainer.trainer import Trainer\n"
        "real = Trainer.advance\n"
        f"Trainer.advance = lambda self: (os.kill(os.getpid(), signal.{name}), real(self))[1]\n"
        "sys.exit(main())"
    )
    arguments = command(capture, tmp_path, *SHORT, "--quiet")[3:]
    assert begin([sys.executable, "-c", code, *arguments]).wait(timeout=60) == 0


@pytest.mark.skipif(os.name == "nt", reason="POSIX shells")
def test_in_the_background_of_a_script_ctrl_c_ends_nothing(capture: Path, tmp_path: Path) -> None:
    """Oracle: the signals that sh ignores for a background job, sent at every poll."""
    words = shlex.join([*command(capture, tmp_path, *SHORT, "--quiet")])
    script = (
        f"{words} & job=$!; for i in 1 2 3 4 5 6; do sleep 0.3; kill -INT $job; done; wait $job"
    )
    ended = subprocess.run(["sh", "-c", script], stdin=subprocess.DEVNULL, check=False)
    assert ended.returncode == 0
