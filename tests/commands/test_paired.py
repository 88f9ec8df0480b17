"""Statistics of `gscore bench quality`; oracles: a slow twin, a simulation, the rule by hand."""

import statistics

import numpy as np
import pytest

from gscore.bench.paired import (
    CaptureChange,
    Difference,
    Verdict,
    decide_default,
    paired_difference,
    trimmed_mean,
)


def slow_twin(captures: list[list[list[float]]], seed: int) -> tuple[float, float, float]:
    """The same draws, view by view in plain Python."""
    rng = np.random.default_rng(seed)
    draws: list[list[float]] = [[] for _ in range(2000)]
    for views in captures:
        places = rng.integers(len(views), size=(2000, len(views)))
        for draw, row in zip(draws, places, strict=True):
            for place in row:
                draw.extend(views[place])
    medians = sorted(statistics.median(draw) for draw in draws)

    def quantile(share: float) -> float:
        place = share * (len(medians) - 1)
        below = int(place)
        above = min(below + 1, len(medians) - 1)
        return medians[below] + (place - below) * (medians[above] - medians[below])

    every = [value for views in captures for view in views for value in view]
    return statistics.median(every), quantile(0.025), quantile(0.975)


@pytest.mark.parametrize("seed", [0, 5])
def test_the_bootstrap_equals_a_slow_twin(seed: int) -> None:
    """Oracle: plain Python; captures of several sizes, views without a seed."""
    rng = np.random.default_rng(9)
    captures = [
        [list(rng.normal(0.1, 1, 3 if view % 3 else 2)) for view in range(count)]
        for count in (5, 1, 8)
    ]
    found = paired_difference(captures, seed=seed)
    assert (found.median, found.low, found.high) == pytest.approx(slow_twin(captures, seed))
    assert found.pairs == sum(len(view) for views in captures for view in views)
    assert found == paired_difference(captures, seed=seed)


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """Oracle: 200 simulated studies of 20 views with three seeds and a true median of 0.3. Seeds
    share most of a view's difference: drawn one by one they would cover it in two of three only."""
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(200):
        views = rng.normal(0.3, 0.5, (20, 1)) + rng.normal(0, 0.05, (20, 3))
        found = paired_difference([[list(view) for view in views]])
        held += found.low <= 0.3 <= found.high
    assert 180 <= held <= 200


def test_trimmed_means() -> None:
    """Oracle: by hand; the outlier of five is trimmed, that of four is not."""
    assert trimmed_mean([3, 1, 2, -100, 9]) == 2
    assert trimmed_mean([1, 2, 3, 102]) == 27
    assert trimmed_mean([7]) == 7


def _difference(median: float, low: float = 0.01) -> Difference:
    return Difference(median=median, low=low, high=median + 1, pairs=9)


def _verdict(
    median: float,
    seconds: float,
    *,
    low: float = 0.01,
    worst: float = 0.0,
    ssim: float = 0.0,
) -> Verdict:
    captures = {
        name: CaptureChange(
            psnr_cc=_difference(db), psnr=0.0, ssim=of_ssim, lpips=None, seconds=1.0
        )
        for name, db, of_ssim in (("horse", 0.2, 0.1), ("plush", worst, ssim))
    }
    return decide_default(_difference(median, low), seconds, captures)


@pytest.mark.parametrize(
    ("verdict", "accepted", "words"),
    [
        (_verdict(0.10, 1.0), True, "+0.10 dB, surely above 0, 1.00 times as long"),
        (_verdict(0.1 + 0.2 - 0.2, 1.02), True, "+0.10 dB"),
        (_verdict(0.09, 1.0), False, "+0.09 dB is less than +0.10, 1.00 times as long"),
        (_verdict(0.30, 1.0, low=0.0), False, "+0.30 dB may be none: the interval reaches 0"),
        (_verdict(0.30, 1.03), False, "+0.30 dB, but 1.03 times as long"),
        (_verdict(-0.03, 0.95, low=-1), True, "0.95 times as long at -0.03 dB"),
        (_verdict(-0.04, 0.5), False, "-0.04 dB is less than +0.10"),
        (_verdict(0.0, 0.96), False, "+0.00 dB is less than +0.10, 0.96 times as long"),
        (_verdict(0.5, 0.5, worst=-0.15), False, "plush loses 0.15 dB"),
        (_verdict(0.5, 0.5, worst=-0.149), True, "+0.50 dB"),
        (_verdict(0.5, 0.5, ssim=-0.002), False, "plush loses 0.0020 of SSIM"),
        (_verdict(0.5, 0.5, ssim=-0.0019), True, "+0.50 dB"),
    ],
)
def test_the_rule(verdict: Verdict, accepted: bool, words: str) -> None:
    """Oracle: each clause of the rule at its limit and next to it, by hand."""
    assert verdict.accepted is accepted and words in verdict.why
