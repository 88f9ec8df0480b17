"""Leave-captures-out rule: whether a change holds on each capture when it was chosen without it."""

import math
import statistics
from collections.abc import Mapping
from dataclasses import dataclass, field

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
