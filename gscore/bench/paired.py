"""Paired statistics over many views: robust mean differences, confidence intervals, verdict."""

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

_TRIMMED = 0.2
"""Share of the values left out at each end of a trimmed mean."""
_RESAMPLES = 2000
"""Draws of a bootstrap."""
_COVERED = 0.95
"""Share of the draws inside an interval."""


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Difference between a change and its baseline, over pairs of measurements."""

    median: float
    low: float
    high: float
    """Ends of the 95 % interval."""
    pairs: int


def trimmed_mean(values: Sequence[float]) -> float:
    """Mean without the lowest and the highest fifth, rounded down: 9 values lose two."""
    cut = int(len(values) * _TRIMMED)
    kept = sorted(values)[cut : len(values) - cut]
    return math.fsum(kept) / len(kept)


def paired_difference(
    captures: Sequence[Sequence[Sequence[float]]], *, seed: int = 0
) -> Difference:
    """Median of paired differences, and its interval by a bootstrap over views.

    Seeds of one view are not independent, so views are drawn with all their differences, and from
    each capture its number of views (percentile bootstrap over clusters, Davison and Hinkley 1997,
    sections 2.4 and 5.3).

    Args:
        captures: Differences by capture and view, at least one per view.
        seed: Seed of the draws.

    Returns:
        The median over all differences, and the interval of 2,000 draws.
    """
    rng = np.random.default_rng(seed)
    most = max(len(view) for views in captures for view in views)
    everything, drawn = [], []
    for views in captures:
        padded = np.array([[*view, *[math.nan] * (most - len(view))] for view in views])
        places = rng.integers(len(views), size=(_RESAMPLES, len(views)))
        everything.append(padded.reshape(1, -1))
        drawn.append(padded[places].reshape(_RESAMPLES, -1))
    medians = _medians(np.concatenate(drawn, axis=1))
    whole = np.concatenate(everything, axis=1)
    edge = (1 - _COVERED) / 2
    low, high = np.quantile(medians, [edge, 1 - edge])
    return Difference(
        median=float(_medians(whole)[0]),
        low=float(low),
        high=float(high),
        pairs=int(np.isfinite(whole).sum()),
    )


def _medians(rows: np.ndarray) -> np.ndarray:
    """The median of each row of [R, n], without NaN."""
    ordered = np.sort(rows, axis=1)  # NaN last
    count = np.isfinite(rows).sum(axis=1)
    places = np.stack([(count - 1) // 2, count // 2], axis=1)
    return np.take_along_axis(ordered, places, axis=1).mean(axis=1)


BETTER = 0.10
"""Gain of colour-corrected PSNR that justifies a change, dB."""
EQUAL_SECONDS = 1.02
"""Relative time that still counts as equal."""
FASTER = 0.95
"""Relative time that justifies a change."""
FASTER_MAY_LOSE = 0.03
"""Loss of colour-corrected PSNR that a faster training may have, dB."""
MOST_LOST_DB, MOST_LOST_SSIM = 0.15, 0.002
"""Losses that no capture may reach."""


@dataclass(frozen=True, kw_only=True)
class CaptureChange:
    """Medians of the paired differences on one capture."""

    psnr_cc: Difference
    """dB."""
    psnr: float | None
    """dB; None: no view has one in both."""
    ssim: float | None
    lpips: float | None
    """None: not measured."""
    seconds: float
    """Relative time."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Whether a change becomes a default, and why."""

    accepted: bool
    why: str
    """A clause without a full stop."""


def decide_default(
    overall: Difference, seconds: float, captures: Mapping[str, CaptureChange]
) -> Verdict:
    """Apply the rule.

    Args:
        overall: Difference of the colour-corrected PSNR over all captures, dB.
        seconds: Relative time of the change.
        captures: The change on each capture.
    """
    for name, change in captures.items():
        # Figures are rounded as they are displayed, so that 0.15 dB counts as 0.15.
        if round(change.psnr_cc.median, 6) <= -MOST_LOST_DB:
            return Verdict(accepted=False, why=f"{name} loses {-change.psnr_cc.median:.2f} dB")
        if change.ssim is not None and round(change.ssim, 6) <= -MOST_LOST_SSIM:
            return Verdict(accepted=False, why=f"{name} loses {-change.ssim:.4f} of SSIM")
    gain = round(overall.median, 6)
    took = f"{seconds:.2f} times as long"
    if gain >= BETTER and overall.low > 0 and seconds <= EQUAL_SECONDS:
        return Verdict(accepted=True, why=f"{gain:+.2f} dB, surely above 0, {took}")
    if seconds <= FASTER and gain >= -FASTER_MAY_LOSE:
        return Verdict(accepted=True, why=f"{took} at {gain:+.2f} dB")
    if gain < BETTER:
        return Verdict(accepted=False, why=f"{gain:+.2f} dB is less than {BETTER:+.2f}, {took}")
    if overall.low <= 0:
        return Verdict(accepted=False, why=f"{gain:+.2f} dB may be none: the interval reaches 0")
    return Verdict(accepted=False, why=f"{gain:+.2f} dB, but {took}")


THINNED = ", 1 photo in "
"""Separates a capture and its thinning in the name of a case."""
MOST_LOST = {"psnr_cc": 0.15, "ssim_cc": 0.002, "lpips_cc": 0.003, "worst_psnr_cc": 1.0}
"""Losses that no case may exceed: dB, SSIM, LPIPS, dB."""
_NAMES = {"psnr_cc": "dB", "ssim_cc": "SSIM", "lpips_cc": "LPIPS", "worst_psnr_cc": "dB"}
_UNMEASURED = {"psnr_cc": "PSNR", "ssim_cc": "SSIM", "worst_psnr_cc": "a worst view"}
_LESS_IS_BETTER = "lpips_cc"


@dataclass(frozen=True, kw_only=True)
class CaseChange:
    """Differences of a change on one case, a capture or a thinning of it: means over views, seeds
    and offsets; None: not measured in both."""

    trainings: int
    """Pairs of trainings."""
    psnr_cc: float
    """dB."""
    ssim_cc: float | None
    lpips_cc: float | None
    worst_psnr_cc: float | None
    """Difference of the lowest covered views, each a mean over seeds, perhaps of two views; dB."""
    worst_ssim_cc: float | None
    seconds: float
    """Relative time."""
    splats: float
    """Relative number."""


@dataclass(frozen=True, kw_only=True)
class LeaveOut:
    """Whether a change is kept, and why."""

    kept: bool
    why: str
    """A clause without a full stop."""
    gains: dict[str, float] = field(default_factory=dict)
    """Median gain of the other captures without each capture, dB."""


def capture_of(case: str) -> str:
    """The capture of a case."""
    return case.partition(THINNED)[0]


def leave_out(cases: Mapping[str, CaseChange]) -> LeaveOut:
    """Apply the rule: no case loses more than `MOST_LOST`, and without each capture the median gain
    over the cases of the others is above 0, so that its choice did not need that capture.

    Args:
        cases: The change on each case.
    """
    captures = list(dict.fromkeys(map(capture_of, cases)))
    if len(captures) < 2:
        return LeaveOut(kept=False, why="the rule needs at least two captures")
    gains = {
        left_out: statistics.median(
            change.psnr_cc for case, change in cases.items() if capture_of(case) != left_out
        )
        for left_out in captures
    }
    for case, change in cases.items():
        for key, limit in MOST_LOST.items():
            if getattr(change, key) is None and key != _LESS_IS_BETTER:
                why = f"{case}: {_UNMEASURED[key]} was not measured"
                return LeaveOut(kept=False, why=why, gains=gains)
            loss = _loss(change, key)
            if round(loss, 6) > limit:
                where = "its worst view loses " if key == "worst_psnr_cc" else "loses "
                digits = 2 if _NAMES[key] == "dB" else 4
                why = f"{case}: {where}{loss:.{digits}f} {_NAMES[key]}"
                return LeaveOut(kept=False, why=why, gains=gains)
    least = min(gains, key=gains.__getitem__)
    middle = statistics.median(change.psnr_cc for change in cases.values())
    why = f"{middle:+.2f} dB in the median, {gains[least]:+.2f} without {least}"
    if any(change.lpips_cc is None for change in cases.values()):
        why += "; LPIPS was not measured"
    return LeaveOut(kept=round(gains[least], 6) > 0, why=why, gains=gains)


def _loss(change: CaseChange, key: str) -> float:
    value = getattr(change, key)
    if value is None:
        return -math.inf
    return value if key == _LESS_IS_BETTER else -value
