"""Failure reason: a message with a remedy where no camera poses were found."""

import numpy as np

from ..datasets.capture import listing
from ..text_format import count_words
from .database import Overlap

_FEW_FEATURES = 100
"""Number of features of the median photo below which missing texture is the reason."""
_MOSTLY_FLAT = 0.8
"""Share of pairs without parallax from which missing parallax is the reason."""


def failure_reason(found: Overlap, names: dict[str, str]) -> str:
    """Message for photos that gave no model.

    Args:
        found: Match statistics of the photos.
        names: Names of the photos by alias.
    """
    photos = count_words(len(found.features), "photo")
    median = int(np.median(found.features))
    if median < _FEW_FEATURES:
        return (
            f"No cameras found: the photos show too little texture. Half of the {photos} have "
            f"{f'{median} or fewer features' if median else 'no features'}, at least "
            f"{_FEW_FEATURES} are needed. Take sharp photos of textured surfaces, or leave masks "
            "out with `--no-masks`."
        )
    if not found.pairs:
        return (
            f"No cameras found: no two of the {photos} overlap. Take more photos, so that each "
            "overlaps most of the previous one."
        )
    if found.flat >= _MOSTLY_FLAT * found.pairs:
        return (
            f"No cameras found: {found.flat} of the {count_words(found.pairs, 'pair')} of photos "
            "that overlap show no parallax: the camera turned on the spot, faced a flat wall, or "
            "did not move. Walk around the subject and take photos from different places."
        )
    alone = f" {count_words(len(found.alone), 'photo matches', 'photos match')} no other: "
    alone = f"{alone}{listing([names[alias] for alias in found.alone], 3)}." if found.alone else ""
    return (
        f"No cameras found: the photos overlap too little. Of the {photos}, "
        f"{count_words(found.pairs, 'pair matches', 'pairs match')}, which is not enough for a "
        f"model.{alone} Take more photos between the existing ones."
    )
