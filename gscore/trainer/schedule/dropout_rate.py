"""Dropout rate: whether and how many splats the steps of a run leave out."""

from ...config import TrainConfig
from ...events import Decision
from .caps import drops_splats_of_subject


def drop_rate_of(
    config: TrainConfig, *, known: float | None, mask_mode: str
) -> tuple[float, Decision | None]:
    """Return the dropout rate of the last step for these photos.

    Args:
        config: `drop_rate`, and its condition `drop_below`.
        known: Share of the unmasked pixels with a depth by stereo; None: stereo has not run.
        mask_mode: Use of the masks, as `Dataset.mask_mode`.

    Returns:
        The rate in [0, 1), and the decision if a condition led to it.
    """
    rate = config.drop_rate
    if not (rate and config.drop_below):
        return rate, None
    if mask_mode == "composite":
        if not drops_splats_of_subject(config, mask_mode=mask_mode, known=known):
            return 0.0, None
        why = f"Photos agree on the depth of {known:.0%} of the subject's pixels"
    elif known is None or known >= config.drop_below:
        return 0.0, None
    else:
        why = f"Photos agree on the depth of {known:.0%} of their pixels"
    return rate, Decision(
        "drops",
        f"{why}, so steps drop up to {rate:.0%} of the splats, which improves unseen views "
        "(`--drop-rate 0` drops none).",
    )


def drop_rate_at(rate: float, step: int, iterations: int) -> float:
    """Dropout rate of `step`: rises linearly to `rate` (Park et al. 2025, eq. 5)."""
    return rate * min(step / iterations, 1.0)
