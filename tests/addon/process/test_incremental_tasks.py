"""Incremental tasks. Oracle: the order and the threads of the steps."""

import threading
from collections.abc import Callable
from typing import Any

import pytest

from addon.process.background_task import Cancelled
from addon.process.incremental_tasks import (
    Check,
    Steps,
    TaskRunner,
    run_blocking,
    run_in_thread,
)

MAIN = threading.main_thread()


def work(log: list[Any], raises: Exception | None = None) -> Steps[str]:
    """Two steps, with a thread between them."""

    def beside(check: Check) -> int:
        check()
        log.append(threading.current_thread() is MAIN)
        if raises is not None:
            raise raises
        return 7

    try:
        yield "first"
        number = yield from run_in_thread(beside, "beside")
        yield "last"
        return f"made {number}"
    finally:
        log.append("over")


def ended(going: TaskRunner) -> list[str]:
    """The messages of its steps."""
    reported = []
    for _ in range(10_000):
        done = going.step()
        if not reported or going.sentence != reported[-1]:
            reported.append(going.sentence)
        if done:
            return reported
        threading.Event().wait(0.001)
    raise AssertionError("it never ends")


def test_steps_run_here_and_threads_in_parallel():
    """In one call everything runs in the calling thread, because no other may run then."""
    log: list[Any] = []
    going = TaskRunner(work(log))
    assert ended(going) == ["first", "beside", "last"]
    assert going.result == "made 7" and log == [False, "over"]
    log.clear()
    assert run_blocking(work(log)) == "made 7" and log == [True, "over"]


@pytest.mark.parametrize("do", [run_blocking, lambda steps: ended(TaskRunner(steps))])
def test_an_error_in_a_thread_is_one_of_the_task(do: Callable[[Any], Any]):
    """The error keeps its type, and the task cleans up."""
    log: list[Any] = []
    with pytest.raises(KeyError, match="lost"):
        do(work(log, KeyError("lost")))
    assert log[-1] == "over"


def test_given_up():
    """The thread is cancelled, the task cleans up, and no step is left."""
    log: list[Any] = []
    began, go_on, ends = threading.Event(), threading.Event(), threading.Event()

    def beside(check: Check) -> None:
        began.set()
        assert go_on.wait(60)
        try:
            check()
        except Cancelled:
            ends.set()
            raise

    def endless() -> Steps[None]:
        try:
            yield from run_in_thread(beside, "beside")
            log.append("went on")
        finally:
            log.append("over")

    going = TaskRunner(endless())
    assert not going.step() and began.wait(60) and not going.step()
    going.cancel()
    assert log == ["over"]
    go_on.set()
    assert ends.wait(60) and log == ["over"]
