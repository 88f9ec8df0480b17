"""Amount of work per poll with slow redraws. Oracles: in the tests."""

from collections.abc import Callable, Iterator

import pytest

from addon.interface import incremental_operator
from addon.process import incremental_tasks, poll_timer
from addon.process.incremental_tasks import Steps, TaskRunner

PIECE = 0.008


class Clock:
    """Time that passes only on request."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        """Like `time.monotonic`."""
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The clock of `StepBudget`."""
    made = Clock()
    monkeypatch.setattr(incremental_tasks, "time", made)
    return made


class Work:
    """Steps that are run by polls."""

    def __init__(self, clock: Clock, steps: int, seconds: float = PIECE) -> None:
        self.clock, self.left, self.seconds = clock, steps, seconds
        self.stuck = False
        """Whether none can be done now."""

    def collect(self) -> bool:
        """Run a step; steps without duration report that they did something."""
        if not self.left or self.stuck:
            return False
        self.clock.now += self.seconds
        self.left -= 1
        return self.seconds == 0

    def waits(self) -> bool:
        """Whether steps remain."""
        return self.left > 0


@pytest.fixture
def follow(monkeypatch: pytest.MonkeyPatch) -> Callable[[Work], None]:
    """Let the poll timer run only some work, as if it was just registered."""

    def begin(work: Work) -> None:
        poller = poll_timer.Poller(work.collect, work.waits, work.waits)
        monkeypatch.setattr(poll_timer, "POLLERS", [poller])
        monkeypatch.setattr(poll_timer, "_pace", incremental_tasks.Pace())

    return begin


def beats(work: Work, clock: Clock, redraw: float) -> Iterator[int]:
    """Number of steps per poll until all are done, with redraws of a given time in seconds."""
    while work.left:
        before = work.left
        interval = poll_timer._tick()
        yield before - work.left
        clock.now += max(redraw, interval or 0.0)


def test_slow_redraws_do_not_starve_work(clock: Clock, follow: Callable[[Work], None]) -> None:
    """Oracle: the first poll is not late; each other is 0.49 s late, of which it may use a quarter
    of the time beyond 0.05 s, 0.1 s at most, and completes the step it has begun: 13."""
    work = Work(clock, 40)
    follow(work)
    assert list(beats(work, clock, 0.5)) == [1, 13, 13, 13]


def test_pieces_that_take_no_time_are_done_at_once(
    clock: Clock, follow: Callable[[Work], None]
) -> None:
    """Oracle: all are done at the first late poll, as for existing node groups."""
    work = Work(clock, 12, seconds=0.0)
    follow(work)
    assert list(beats(work, clock, 0.5)) == [1, 11]


@pytest.mark.parametrize("redraw", [0.0, 0.016, 0.05])
def test_fast_redraws_stay_fast(
    clock: Clock, follow: Callable[[Work], None], redraw: float
) -> None:
    """Oracle: one step per poll, as always."""
    work = Work(clock, 20)
    follow(work)
    assert set(beats(work, clock, redraw)) == {1}


def test_a_beat_that_has_nothing_to_do_ends(
    clock: Clock, follow: Callable[[Work], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the number of checks: one per late poll, if splats wait for the end of Edit Mode."""
    work = Work(clock, 5)
    work.stuck = True
    follow(work)
    looks = []
    tick = poll_timer.poll
    monkeypatch.setattr(poll_timer, "poll", lambda: looks.append(0) or tick())
    for _ in range(3):
        poll_timer._tick()
        clock.now += 2.0
    assert len(looks) == 3


def test_a_pause_is_no_slow_redraw(clock: Clock, follow: Callable[[Work], None]) -> None:
    """Oracle: one step at the first poll after a minute without work."""
    work = Work(clock, 1)
    follow(work)
    assert poll_timer._tick() is None
    clock.now += 60.0
    work.left = 5
    poll_timer._tick()
    assert work.left == 4


def test_an_operator_does_more_where_redraws_are_slow(clock: Clock) -> None:
    """Oracle: as the poll timer: of 0.49 s a tenth of a second, which is 13 steps."""

    def steps() -> Steps[str]:
        for number in range(30):
            clock.now += PIECE
            yield str(number)
        return "done"

    own = incremental_operator._ModalRun(TaskRunner(steps()), None)
    said = []
    try:
        while not own.step():
            said.append(int(own.runner.sentence) + 1)
            clock.now += 0.49 + incremental_operator.INTERVAL
    finally:
        incremental_operator._MODAL_RUNS.discard(own)
    assert said == [1, 14, 27] and own.runner.result == "done"
