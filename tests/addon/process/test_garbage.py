"""Python's search for garbage, put off. Oracle: what the collector itself tells of its searches."""

import gc
from collections.abc import Iterator

import pytest

from addon.process import garbage
from addon.process.incremental_tasks import Pieces, TaskRunner


@pytest.fixture
def whole() -> Iterator[list[int]]:
    """The searches through all objects since the test began."""
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
    """More objects than there were, of the kind that is searched."""
    return [[[]] for _ in range(len(gc.get_objects()) + 100_000)]


def test_much_is_made(whole: list[int]) -> None:
    """Without it there is a search through all, and afterwards again."""
    with garbage.put_off():
        kept = many()
    assert not whole
    kept += many()
    assert whole


def test_younger_garbage_goes(whole: list[int]) -> None:
    """What refers to itself is found, or it would pile up."""
    gone: list[int] = []

    class Own:
        def __init__(self) -> None:
            self.own = self

        def __del__(self) -> None:
            gone.append(1)

    with garbage.put_off():
        for _ in range(100):
            Own()
        made = many()
    assert len(gone) == 100 and made and not whole


def test_two_works_that_end_in_any_order() -> None:
    """Oracle: the collector's own threshold, which is what it was once both have ended."""
    before = gc.get_threshold()

    def work() -> Pieces[None]:
        with garbage.put_off():
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
    """It stays as they chose."""
    with garbage.put_off():
        gc.set_threshold(500, 6, 7)
    assert gc.get_threshold() == (500, 6, 7)
