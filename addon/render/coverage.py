"""Coverage: the blending weight of each object in each pixel, for mattes."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from .holdout import HALF
from .model import Model
from .scene import Identity


def one_hot(model: Model) -> Iterator[tuple[list[Identity], Model]]:
    """A model with objects coded as colors, so that its pictures are the objects' coverage.

    Yields:
        Up to three objects, and the model with the first in red, the second in green, the third in
        blue and all else black; repeated for all objects except holdouts.
    """
    found = list(dict.fromkeys(owner for owner, _ in model.owners if owner is not None))
    counts = [count for _, count in model.owners]
    for first in range(0, len(found), 3):
        three = found[first : first + 3]
        # Far below black, so that rounding leaves nothing of the other objects.
        colors = np.full((len(counts), 3), -2 * HALF, np.float32)
        for row, (owner, _) in zip(colors, model.owners, strict=True):
            if owner in three:
                row[three.index(owner)] = HALF
        sh0 = np.repeat(colors, counts, axis=0)[:, None]
        splats = replace(model.splats, sh0=sh0, shN=np.zeros_like(model.splats.shN[:, :0]))
        yield three, replace(model, splats=splats, shares=None)


def summed(
    covered: Mapping[Identity, np.ndarray], name_of: Callable[[Identity], str]
) -> dict[str, np.ndarray]:
    """Coverage summed over the objects of one name, by name."""
    total: dict[str, np.ndarray] = {}
    for owner, part in covered.items():
        name = name_of(owner)
        total[name] = total[name] + part if name in total else part
    return total


def index_pass(
    covered: Mapping[Identity, np.ndarray], shape: tuple[int, int], threshold: float
) -> np.ndarray:
    """The Pass Index of the object with the largest coverage of a pixel, [H, W] float32.

    0 where the coverage of all objects together is below the threshold, or zero.
    """
    most, total, result = (np.zeros(shape, np.float32) for _ in range(3))
    for owner, part in covered.items():
        result[part > most] = owner.index
        np.maximum(most, part, out=most)
        total += part
    result[total < threshold] = 0
    return result
