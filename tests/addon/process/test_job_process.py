"""Oracle: the output of scripts of `fake_trainer.py`, and the process table."""

import json
import os
import time
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import pytest

from addon.process import child_program
from addon.process.child_program import Process, environment
from addon.training import run_state
from addon.training import training_job as job_module
from addon.training.training_job import Job
from tests.addon.fake_trainer import CONFIG, STARTED, fake_python, finish, step

Start = Callable[..., Job]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start a job that plays a script; killed after the test."""
    jobs: list[Job] = []

    def begin(*script: dict, name: str = "run", **kwargs: object) -> Job:
        out = tmp_path / name
        arguments = ["train", "capture", "-o", str(out)]
        python = fake_python(tmp_path / f"{name}-python", list(script))
        jobs.append(Job(python, arguments, source=tmp_path, output=out, **kwargs))
        return jobs[-1]

    yield begin
    for job in jobs:
        job.kill()


def run_until(job: Job, condition: Callable[[], bool], timeout: float = 60.0) -> None:
    """Poll like Blender's timer until a condition is true."""
    until = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < until, f"waited in vain; {job.state.status} {job.state.sentence}"
        job.poll()
        time.sleep(0.01)


def run_to_end(job: Job, timeout: float = 60.0) -> run_state.RunState:
    """Poll until the job has ended."""
    run_until(job, lambda: job.state.ended, timeout)
    return job.state


def test_events_become_state(start: Start) -> None:
    """Oracle: the numbers in the script."""
    preview = {"event": "preview", "step": 40, "view": "a.jpg", "path": "$out/p.png"}
    saved = {"event": "saved", "step": 100, "path": "$out/checkpoints/step_00000100.safetensors"}
    state = run_to_end(
        start(
            {"say": STARTED},
            step(40, loss=0.25, psnr=21.5, splats=1500, eta_s=None),
            {"say": preview},
            {"say": {"event": "warning", "message": "few points", "code": "capture"}},
            {"say": {"event": "warning", "message": "few points", "code": "capture"}},
            {"say": saved},
            finish(),
        )
    )
    assert state.status == run_state.FINISHED
    assert (state.loss, state.psnr, state.eta_s) == (0.25, 21.5, None)
    curve = state.curve
    assert (curve.steps, curve.losses, curve.psnrs) == ([40], [0.25], [21.5])
    assert (state.step, state.splats, state.warnings) == (100, 1234, ["few points"])
    assert state.preview is not None and state.preview.view == "a.jpg"
    assert state.checkpoint is not None and state.checkpoint.name == "step_00000100.safetensors"
    assert state.sentence == "Finished after 100 steps: 1,234 splats, PSNR 25.00 dB on test views."


def test_garbage_between_events_is_left_out(start: Start) -> None:
    """Oracle: the events around it arrive; lines that only look like events do not."""
    state = run_to_end(
        start(
            {"raw": 'Loading...\n\xff\xfe\x00\n{"event": \n[1]\nnull\n\n'},
            {"raw": json.dumps({"event": "progress", "step": "many"}) + "\n"},
            {"raw": json.dumps({"event": "saved", "step": 1, "path": 5}) + "\n"},
            {"raw": json.dumps({"event": "nonsense"}) + "\n"},
            {"say": STARTED | {"step": 3}},
            step(7),
            finish(),
        )
    )
    assert (state.status, state.curve.steps, state.checkpoint) == (run_state.FINISHED, [7], None)


def test_a_huge_line_costs_only_itself(start: Start) -> None:
    """Oracle: the event after 30 MB without a line break."""
    state = run_to_end(start({"say": STARTED}, {"huge": 30_000_000}, step(9), finish()))
    assert (state.status, state.curve.steps) == (run_state.FINISHED, [9])


def test_a_poll_ends_within_its_budget(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: a clock that each look at it moves by a millisecond: at most 6 lines in 5 ms, and
    none of 2000 is lost."""
    clock = count()
    monkeypatch.setattr(
        child_program,
        "time",
        SimpleNamespace(perf_counter=lambda: next(clock) / 1000, monotonic=time.monotonic),
    )
    steps: list[int] = []
    job = start({"loop": [2000, [step("$i")]]}, finish())
    apply = job.state.apply
    monkeypatch.setattr(
        job.state, "apply", lambda event: (steps.append(getattr(event, "step", -1)), apply(event))
    )
    most, polls = 0, 0
    until = time.monotonic() + 60
    while not job.state.ended:
        assert time.monotonic() < until
        before = len(steps)
        job.poll(0.005)
        most, polls = max(most, len(steps) - before), polls + 1
    assert most <= 6 < len(steps) / 100
    assert [n for n in steps if n >= 0][:2000] == list(range(2000))
    assert job.state.status == run_state.FINISHED


def test_silence_is_reported(start: Start) -> None:
    """Oracle: a message after the limit, for which the last line is dated back; none before and
    after the next line."""
    job = start({"say": STARTED}, {"await": "go"}, step(5), {"await": "end"}, finish())
    run_until(job, lambda: job.state.started is not None)
    assert job.silence == ""
    job._process.last_line_at -= job_module.SILENT + 10
    assert job.silence == "No response for 30 s"
    job._process.send("go")
    run_until(job, lambda: job.state.step == 5)
    assert job.silence == ""
    job._process.send("end")
    assert run_to_end(job).status == run_state.FINISHED


def test_an_early_exit_quotes_the_reason(start: Start) -> None:
    """Oracle: the last line on stderr and the exit code."""
    state = run_to_end(start({"say": STARTED}, {"stderr": "boom\nkaputt"}, {"exit": 3}))
    assert state.status == run_state.FAILED
    assert "exit code 3" in state.sentence and '"kaputt"' in state.sentence


def test_exit_zero_without_done_is_a_failure(start: Start) -> None:
    """Oracle: a trainer without events has not trained."""
    assert run_to_end(start({"say": STARTED}, {"exit": 0})).status == run_state.FAILED


def test_a_crash_names_the_signal_and_the_checkpoint(start: Start) -> None:
    """Oracle: SIGKILL is 9; the script saved a checkpoint at step 60."""
    saved = {"event": "saved", "step": 60, "path": "$out/checkpoints/step_00000060.safetensors"}
    state = run_to_end(start({"say": STARTED}, step(60), {"say": saved}, {"signal": 9}))
    assert state.status == run_state.FAILED
    assert "signal 9" in state.sentence
    assert "Resume continues from step 60." in state.sentence


def test_a_full_disk_is_said_in_the_trainers_words(start: Start) -> None:
    """Oracle: the message of the error event."""
    message = "Cannot write out/s.ply: the disk is full. Free some space or choose another folder."
    error = {"event": "error", "message": message, "type": "GsError"}
    state = run_to_end(start({"say": STARTED}, {"say": error}, {"stderr": "x"}, {"exit": 2}))
    assert (state.status, state.sentence) == (run_state.FAILED, message)


def test_a_missing_package_gets_instructions(start: Start) -> None:
    """Oracle: the event of gscore, whatever its message; other errors get no advice."""
    error = {"event": "error", "type": "BackendError", "message": "Ohne torch geht nichts."}
    job = start({"say": error | {"package": "torch"}}, {"exit": 2})
    state = run_to_end(job)
    assert state.status == run_state.FAILED
    assert state.sentence.startswith("Ohne torch geht nichts. Make Environment in the add-on's")
    assert job.python in state.sentence
    assert run_to_end(start({"say": error}, {"exit": 2})).sentence == error["message"]


def test_output_of_a_python_that_cannot_run_gscore_is_quoted(start: Start) -> None:
    """Oracle: its last line, and advice for exit code 1, which gscore never has without event."""
    text = "python3: Kein Modul gscore"
    state = run_to_end(start({"stderr": text}, {"exit": 1}))
    assert f'cannot run gscore. Its last output: "{text}"' in state.sentence
    assert "Make Environment" in state.sentence


def test_a_python_without_gscore_for_real(tmp_path: Path) -> None:
    """Oracle: this Python in an empty folder, from which gscore cannot be imported."""
    import venv

    venv.create(tmp_path / "empty", with_pip=False)
    python = tmp_path / "empty" / ("Scripts" if os.name == "nt" else "bin") / "python"
    job = Job(python, ["train"], source=tmp_path, output=tmp_path / "o")
    sentence = run_to_end(job).sentence
    assert f"{python} cannot run gscore" in sentence and "No module named gscore" in sentence


def test_no_such_program(tmp_path: Path) -> None:
    """Oracle: an immediate OSError."""
    with pytest.raises(OSError):
        Job(tmp_path / "nothing", [], source=tmp_path, output=tmp_path)


def test_pause_and_stop_reach_the_trainer(start: Start) -> None:
    """Oracle: no steps while paused; a checkpoint and `done` after stop."""
    job = start({"say": STARTED}, {"follow": 600})
    run_until(job, lambda: job.state.step > 3)
    job.pause()
    run_until(job, lambda: job.state.status == run_state.PAUSED)
    paused_at = job.state.step
    time.sleep(0.3)
    job.poll()
    assert job.state.step == paused_at and job.silent_s == 0.0
    job.unpause()
    run_until(job, lambda: job.state.step > paused_at)
    assert job.state.status == run_state.RUNNING
    job.stop()
    assert job.state.status == run_state.STOPPING
    state = run_to_end(job)
    assert state.status == run_state.STOPPED
    assert state.checkpoint is not None and state.checkpoint.is_file()
    assert "Resume" in state.sentence


def test_letting_go_leaves_a_checkpoint(start: Start) -> None:
    """Oracle: the trainer stops at the end of its input."""
    job = start({"say": STARTED}, {"follow": 600})
    run_until(job, lambda: job.state.step > 3)
    job.leave()
    state = run_to_end(job)
    assert state.done is not None and state.done.reason == "input ended"
    assert state.checkpoint is not None and state.checkpoint.is_file()


def test_a_trainer_that_does_not_stop_is_killed(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: ended by SIGKILL after the grace period, which is shortened here."""
    monkeypatch.setattr(job_module, "STOP_GRACE", 0.5)
    job = start({"say": STARTED}, {"sleep": 600})
    run_until(job, lambda: job.state.started is not None)
    job.stop()
    assert "signal 9" in run_to_end(job).sentence


@pytest.mark.parametrize("resumed", [False, True])
def test_discarding_removes_only_what_this_run_made(start: Start, resumed: bool) -> None:
    """Oracle: the folder is removed, except for earlier runs and foreign files."""
    write = {"write": ["$out/checkpoints/step_00000001.safetensors", "state"]}
    job = start(
        CONFIG, write, {"write": ["$out/note.txt", "mine"]}, {"say": STARTED}, {"sleep": 600}
    )
    alone = start(CONFIG, write, {"say": STARTED}, {"sleep": 600}, name="alone", resumed=resumed)
    for one in (job, alone):
        run_until(one, lambda one=one: one.state.started is not None)
        one.discard()
        assert run_to_end(one).status == run_state.DISCARDED
    assert [path.name for path in job.output.iterdir()] == ["note.txt"]
    assert alone.output.exists() == resumed


def test_discarding_before_the_start_spares_others(start: Start) -> None:
    """Oracle: files of another training in the folder still exist."""
    write = {"write": ["$out/checkpoints/step_00000001.safetensors", "not ours"]}
    job = start(write, {"raw": "still loading\n"}, {"sleep": 600})
    run_until(job, lambda: (job.output / "checkpoints").exists())
    job.discard()
    assert run_to_end(job).sentence == "Discarded before the first step."
    assert [path.name for path in job.output.rglob("*.safetensors")] == [
        "step_00000001.safetensors"
    ]


def test_jobs_do_not_disturb_each_other(start: Start) -> None:
    """Oracle: one is stopped and one crashes while the third runs to its end."""
    a = start({"say": STARTED}, {"follow": 600}, name="a")
    b = start({"say": STARTED}, {"sleep": 0.3}, {"signal": 11}, name="b")
    c = start({"say": STARTED}, {"loop": [30, [step("$i"), {"sleep": 0.02}]]}, finish(), name="c")
    run_until(a, lambda: a.state.step > 2)
    a.stop()
    states = [run_to_end(job).status for job in (a, b, c)]
    assert states == [run_state.STOPPED, run_state.FAILED, run_state.FINISHED]


def test_snapshots_are_asked_for_one_at_a_time(start: Start) -> None:
    """Oracle: not more often than the interval, none while one is running."""
    job = start({"say": STARTED}, {"follow": 600})
    job.live_seconds = 0.2
    run_until(job, lambda: job.state.snapshot is not None)
    first = job.state.snapshot
    assert first is not None
    run_until(job, lambda: job.state.snapshot is not first)
    second = job.state.snapshot
    assert second is not None and second.step - first.step >= 5
    job.stop()
    run_to_end(job)


def test_children_do_not_inherit_blenders_python() -> None:
    """Oracle: the variables that refer to Blender's own files."""
    base = {"PATH": "/bin", "PYTHONHOME": "/b", "PythonPath": "/c", "__PYVENV_LAUNCHER__": "/d"}
    kept = environment(base)
    assert kept["PATH"] == "/bin" and kept["PYTHONSAFEPATH"] == "1"
    assert not {"PYTHONHOME", "PythonPath", "__PYVENV_LAUNCHER__"} & kept.keys()


def test_a_pipe_held_by_a_grandchild_does_not_hang(tmp_path: Path) -> None:
    """Oracle: ended within seconds although a sleeping child keeps stdout open."""
    process = Process(["/bin/sh", "-c", "sleep 600 & echo $!; exit 4"])
    until, lines = time.monotonic() + 60, []
    while not process.ended and time.monotonic() < until:
        lines += list(process.lines(0.01))
        time.sleep(0.05)
    assert (process.returncode, process.ended, len(lines)) == (4, True, 1)
    os.kill(int(lines[0]), 9)


def test_errors_are_waited_for(tmp_path: Path) -> None:
    """Oracle: errors written after the process has ended and its output is closed."""
    process = Process(["/bin/sh", "-c", "(sleep 0.5; echo late >&2) >/dev/null & exit 4"])
    until = time.monotonic() + 60
    while not process.ended and time.monotonic() < until:
        assert not list(process.lines(0.01))
        time.sleep(0.01)
    assert process.stderr_tail == ["late"]
