"""Queue of photos to undistort, with fakes of the program. Oracle: the requests that the fakes
write to a file."""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from addon.cameras.undistort_queue import ANSWER, READY, UndistortQueue

BEGINS = """
import json, sys, time
told = open(sys.argv[1], "a")
print("begun", file=told, flush=True)
"""
ANSWERS = f"""
print({READY!r}, flush=True)
for line in sys.stdin:
    copy = json.loads(line)["copy"]
    print(copy, file=told, flush=True)
    if copy == "crash":
        sys.exit("no memory")
    print({ANSWER!r} + json.dumps({{"copy": copy, "problem": ""}}), flush=True)
"""
Run = Callable[[str], Callable[[], tuple[list[str], dict[str, str]]]]


@pytest.fixture
def reported(tmp_path: Path) -> Path:
    """The file to which fakes write their requests."""
    return tmp_path / "reported"


@pytest.fixture
def run(reported: Path) -> Run:
    """A program from the text of its script."""
    return lambda script: lambda: ([sys.executable, "-c", script, str(reported)], {})


def tasks(*copies: str) -> list[dict[str, str]]:
    """One task per copy."""
    return [{"copy": copy} for copy in copies]


def poll_until(queue: UndistortQueue, program: object, done: Callable[[list[str]], bool]) -> list:
    """Poll until a condition on the finished copies is true; return them."""
    made, until = [], time.monotonic() + 60
    while not done(made):
        assert time.monotonic() < until, (made, queue.problems)
        made += queue.poll(program)
        time.sleep(0.01)
    return made


def test_requests_while_the_program_ends_are_served(run: Run, reported: Path) -> None:
    """The program needs a second to end, in which it reads nothing more."""
    queue, program = UndistortQueue(), run(BEGINS + ANSWERS + "time.sleep(1)")
    queue.enqueue_first(tasks("a"))
    poll_until(queue, program, lambda made: made == ["a"])
    for _ in range(5):  # its input ends
        assert queue.poll(program) == []
        time.sleep(0.02)
    assert queue.busy
    queue.enqueue_first(tasks("b"))
    poll_until(queue, program, lambda made: made == ["b"])
    assert queue.problems == {} and queue.done == queue.total == 2
    poll_until(queue, program, lambda _: not queue.busy)
    assert reported.read_text().split() == ["begun", "a", "begun", "b"]


def test_a_program_that_never_begins_is_given_up(run: Run, reported: Path) -> None:
    """Every photo gets the reason; later ones are tried again."""
    queue, program = UndistortQueue(), run(BEGINS + "sys.exit('no display')")
    for _ in range(2):
        queue.enqueue_first(tasks("a", "b", "c"))
        poll_until(queue, program, lambda _: not queue.busy)
        assert set(queue.problems) == {"a", "b", "c"}
        assert set(queue.problems.values()) == {
            "The Blender that undistorts photos ended at its start (exit code 1). no display"
        }
    assert reported.read_text().split() == ["begun"] * 4


def test_a_photo_that_ends_the_program_is_left_out(run: Run, reported: Path) -> None:
    """Another process makes the others."""
    queue, program = UndistortQueue(), run(BEGINS + ANSWERS)
    queue.enqueue_first(tasks("a", "crash", "b"))
    assert poll_until(queue, program, lambda _: not queue.busy) == ["a", "b"]
    assert reported.read_text().split() == ["begun", "a", "crash", "begun", "b"]
    (copy,) = queue.problems
    assert copy == "crash" and "at crash (exit code 1). no memory" in queue.problems[copy]


def test_latest_requests_come_first(run: Run, reported: Path) -> None:
    """Except for the copy in progress; no copy is made twice."""
    slow = ANSWERS.replace("    if copy", "    time.sleep(0.3)\n    if copy")
    queue, program = UndistortQueue(), run(BEGINS + slow)
    queue.enqueue_first(tasks("a", "b", "c"))
    queue.poll(program)
    queue.enqueue_first(tasks("d", "a", "c"))
    assert poll_until(queue, program, lambda _: not queue.busy) == ["a", "d", "c", "b"]
    assert reported.read_text().split() == ["begun", "a", "d", "c", "b"]
