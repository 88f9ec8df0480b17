"""Default rule: the one criterion by which a change of the training becomes a default."""

from collections.abc import Mapping
from dataclasses import dataclass

from .paired import Difference

BETTER = 0.10
"""dB of colour-corrected PSNR that are worth a change."""
EQUAL_SECONDS = 1.02
"""Times as long that still counts as equally long."""
FASTER = 0.95
"""Times as long that is worth a change."""
FASTER_MAY_LOSE = 0.03
"""dB of colour-corrected PSNR that a faster training may lose."""
MOST_LOST_DB, MOST_LOST_SSIM = 0.15, 0.002
"""What no capture may lose."""


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
    """How many times as long."""


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
        overall: Of the colour-corrected PSNR over all captures, dB.
        seconds: How many times as long the change takes.
        captures: The change on each capture.
    """
    for name, change in captures.items():
        # Figures are compared as they are shown: 0.15 dB is no less for its thirtieth digit.
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
