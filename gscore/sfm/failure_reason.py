"""Failure reason: a message with a remedy where no camera poses were found."""

import numpy as np

from ..datasets.capture import listing
from ..text_format import count_words
from .database import Overlap

_FEW_FEATURES = 100
"""Features of the median photo below which there is too little to hold on to."""
_MOSTLY_FLAT = 0.8
"""Share of pairs without parallax from which on that is the reason."""


def failure_reason(found: Overlap, names: dict[str, str]) -> str:
    """The sentences for photos of which no model could be made.

    Args:
        found: How the photos hang together.
        names: Of the photos, by alias.
    """
    photos = count_words(len(found.features), "photo")
    median = int(np.median(found.features))
    if median < _FEW_FEATURES:
        return (
            f"No cameras found: the photos show too little texture. Half of the {photos} have "
            f"{f'{median} or fewer features' if median else 'no feature at all'}, {_FEW_FEATURES} "
            "are few. Take sharp photos with something patterned in view, or leave masks out with "
            "--no-masks."
        )
    if not found.pairs:
        return (
            f"No cameras found: none of the {photos} shows the same thing as another. Take more "
            "photos, so that each shows most of what the one before it shows."
        )
    if found.flat >= _MOSTLY_FLAT * found.pairs:
        return (
            f"No cameras found: {found.flat} of the {count_words(found.pairs, 'pair')} of photos "
            "that overlap show no parallax; the camera turned on the spot, or saw a flat wall, or "
            "stood still. Walk around the subject and take photos from different places."
        )
    alone = f" {count_words(len(found.alone), 'photo matches', 'photos match')} no other: "
    alone = f"{alone}{listing([names[alias] for alias in found.alone], 3)}." if found.alone else ""
    return (
        f"No cameras found: the photos overlap too little. Of the {photos}, "
        f"{count_words(found.pairs, 'pair matches', 'pairs match')}, which is not enough for a "
        f"model.{alone} Take more photos between those that there are."
    )
