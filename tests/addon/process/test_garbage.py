"""Deferred garbage collection of Python. Oracle: the collector's own callbacks."""

import gc
from collections.abc import Iterator

import pytest

from addon.process import incremental_tasks
from addon.process.incremental_tasks import Steps, TaskRunner


@pytest.fixture
def whole() -> Iterator[list[int]]:
    """Full collections since the start of the test."""
    found: list[int] = []

    def noted(phase: str, info: dict[str, int]) -> None:
        if phase == "start" and info["generation"] == 2:
            found.append(2)

    before = gc.get_threshold()
    gc.collect()
    gc.callbacks.append(noted)
    yield found
    gc.callbacks.remove(noted)
    gc.set_threshold(*before)


def many() -> list[list[list]]:
    """More tracked objects than before."""
    return [[[]] for _ in range(len(gc.get_objects()) + 100_000)]


def test_much_is_made(whole: list[int]) -> None:
    """Without it there is a full collection, and afterwards again."""
    with incremental_tasks.defer_collections():
        kept = many()
    assert not whole
    kept += many()
    assert whole


def test_younger_garbage_goes(whole: list[int]) -> None:
    """Reference cycles are collected; otherwise they would accumulate."""
    gone: list[int] = []

    class Own:
        def __init__(self) -> None:
            self.own = self

        def __del__(self) -> None:
            gone.append(1)

    with incremental_tasks.defer_collections():
        for _ in range(100):
            Own()
        made = many()
    assert len(gone) == 100 and made and not whole


def test_two_works_that_end_in_any_order() -> None:
    """Oracle: the collector's own threshold, restored after the end of both."""
    before = gc.get_threshold()

    def work() -> Steps[None]:
        with incremental_tasks.defer_collections():
            yield "begun"
            yield "goes on"

    first, second = TaskRunner(work()), TaskRunner(work())
    first.step()
    second.step()
    first.cancel()
    assert gc.get_threshold() != before
    while not second.step():
        pass
    assert gc.get_threshold() == before


def test_somebody_else_chooses_meanwhile(whole: list[int]) -> None:
    """Their choice stays."""
    with incremental_tasks.defer_collections():
        gc.set_threshold(500, 6, 7)
    assert gc.get_threshold() == (500, 6, 7)
