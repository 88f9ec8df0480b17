"""Joined models: several models concatenated into one."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from ..splats import Splats
from .splat_file import Decoded

DecodedT = TypeVar("DecodedT", bound=Decoded)


def joined(parts: Sequence[Splats]) -> Splats:
    """Concatenate at least one model; SH coefficients that a part lacks are zero."""
    if len(parts) == 1:
        return parts[0]
    width = max(part.shN.shape[1] for part in parts)
    even = [
        replace(part, shN=np.pad(part.shN, ((0, 0), (0, width - part.shN.shape[1]), (0, 0))))
        for part in parts
    ]
    names = vars(even[0])
    return Splats(
        **{name: np.concatenate([getattr(part, name) for part in even]) for name in names}
    )


def joined_files(parts: Sequence[DecodedT]) -> DecodedT:
    """Concatenate at least one decoded model; local origin and other metadata are those of the
    first."""
    first = parts[0]
    return replace(first, splats=joined([part.about(first.origin).splats for part in parts]))
