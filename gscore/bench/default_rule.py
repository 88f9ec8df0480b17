"""Default rule: the one criterion by which a change of the training becomes a default."""

from collections.abc import Mapping
from dataclasses import dataclass

from .paired import Difference

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
