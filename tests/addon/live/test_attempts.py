"""Retries after failures of the graphics card; oracle: the test's own clock."""

from addon.live.retry_limit import FORGIVEN, PAUSES, Attempts


def test_pauses_grow_and_end() -> None:
    attempts, now = Attempts(), 100.0
    for pause in PAUSES:
        assert attempts.failed(now) == pause
        assert attempts.rests(now) and attempts.rests(now + pause - 0.01)
        now += pause
        assert not attempts.rests(now)
    assert attempts.failed(now) is None and not attempts.rests(now)


def test_failures_of_long_ago_are_forgiven() -> None:
    attempts, now = Attempts(), 0.0
    for _ in range(5 * len(PAUSES)):
        assert attempts.failed(now) == PAUSES[0]
        now += PAUSES[0] + FORGIVEN + 1
    assert attempts.failed(now) == PAUSES[0] and attempts.failed(now + 1) == PAUSES[1]
