"""How many steps pay: beyond some for each photo a training learns the photos, not the scene."""

from dataclasses import replace

from ...config import TrainConfig
from ...words import count_words, number

_FEWEST = 1500
"""Steps that are always taken if they were asked for, those of a preview: fewer leave too little
time to grow."""


def enough_steps(
    config: TrainConfig, *, photos: int, mask_mode: str = "none", taken: int = 0
) -> tuple[TrainConfig, str]:
    """The options with no more steps than so many photos are good for.

    Where masks are opacity (`composite`), all steps are taken: a subject alone is seen from all
    sides, and there is nothing before or behind it that one photo alone could explain.

    Args:
        config: How to train.
        photos: Number of training photos.
        mask_mode: What masks are for, as `Dataset.mask_mode`.
        taken: Steps that a run has taken already, which nothing takes back.

    Returns:
        The options, and a sentence that says what was left out; empty where nothing was.
    """
    most = max(config.steps_a_photo * photos, _FEWEST, taken)
    asked = config.iterations
    limited = config.steps_a_photo and not config.time_budget and mask_mode != "composite"
    if not limited or asked <= most:
        return config, ""
    why = (
        f"{number(most)} of {number(asked)} steps are taken: more do not make unseen views of "
        f"{count_words(photos, 'photo')} better (--steps-a-photo 0 takes them all)."
    )
    return replace(config, iterations=most), why
