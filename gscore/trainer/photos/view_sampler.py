"""View sampler: random order of the training views, and the interface of a capture."""

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
import torch

from ...engine.random import permutation
from ...raster.request import Frustum
from ...scene import Scene


class Photos(Protocol):
    """Interface of a capture, see `gscore.datasets`."""

    @property
    def scene(self) -> Scene:
        """Cameras at training resolution, and points."""
        ...

    @property
    def train(self) -> Sequence[int]:
        """Training views."""
        ...

    @property
    def test(self) -> Sequence[int]:
        """Held-out views."""
        ...

    @property
    def mask_mode(self) -> str:
        """`composite`, `ignore` or `none`."""
        ...

    def content_hash(self) -> str:
        """Hash of all photos and masks."""
        ...

    def image(self, index: int) -> np.ndarray:
        """Photo of a view, [H, W, 3] uint8."""
        ...

    def mask(self, index: int) -> np.ndarray | None:
        """Mask of a view, [H, W] uint8, or None."""
        ...


def training_camera(
    viewmat: np.ndarray, K: np.ndarray, width: int, height: int, near: float
) -> Frustum:
    """Return a camera in the training frame, [4, 4] and [3, 3] float64, in float32."""
    return Frustum(viewmat.astype(np.float32), K.astype(np.float32), width, height, near)


def mixed(indices: Sequence[int], most: int) -> list[int]:
    """Return at most `most` elements of `indices` from all parts, ascending. Their stride has no
    small factor, so that of photos bracketed by exposure, which repeat every few, all kinds are
    among them."""
    count = len(indices)
    stride = max(-(-count // most), 1)
    while math.gcd(stride, 2 * 3 * 5 * 7 * max(count, 1)) != 1:
        stride += 1
    return sorted(indices[k * stride % count] for k in range(min(most, count)))


class ViewSampler:
    """Draws each view once per epoch, in a new random order each epoch."""

    def __init__(self, indices: Sequence[int]) -> None:
        self.indices = list(indices)
        self.order: list[int] = []
        """Views of this epoch, in order."""
        self.position = 0
        """Index of the next view in `order`."""

    def upcoming(self, count: int, parts: int = 1) -> list[list[int]]:
        """Return `batch_neighbours` of the next views of this epoch, at most `count`."""
        ahead = range(self.position, min(self.position + count, len(self.order)))
        return [self._views_at(at, parts) for at in ahead]

    def batch_neighbours(self, parts: int) -> list[int]:
        """Return one view for each of `parts` models: the last drawn one for the first, others of
        its epoch for the rest. Each model gets each view once per epoch."""
        return self._views_at(self.position - 1, parts)

    def _views_at(self, at: int, parts: int) -> list[int]:
        count = len(self.order)
        return [self.order[(at + part * count // parts) % count] for part in range(parts)]

    @property
    def through(self) -> bool:
        """True if the epoch is complete."""
        return self.position >= len(self.order)

    def begin(self, generator: torch.Generator) -> None:
        """Draw the order of a new epoch."""
        shuffled = permutation(len(self.indices), generator)
        self.order = [self.indices[i] for i in shuffled]
        self.position = 0

    def next(self, generator: torch.Generator) -> int:
        """Return the next view; starts a new epoch if this one is complete."""
        if self.through:
            self.begin(generator)
        self.position += 1
        return self.order[self.position - 1]

    def put_back(self, count: int = 1) -> None:
        """Return the last `count` views to this epoch, because a photo could not be read."""
        self.position = max(self.position - count, 0)
