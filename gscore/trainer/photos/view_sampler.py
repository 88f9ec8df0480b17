"""View sampler: the training views of a capture, and the order in which steps use them."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import torch

from ...raster.request import Frustum
from ...scene import Scene
from ..host.random import permutation


class Photos(Protocol):
    """What the trainer asks of a dataset; see `gscore.datasets`."""

    @property
    def scene(self) -> Scene:
        """Cameras at training resolution and points."""
        ...

    @property
    def train(self) -> Sequence[int]:
        """Views to train on."""
        ...

    @property
    def test(self) -> Sequence[int]:
        """Views held out."""
        ...

    @property
    def mask_mode(self) -> str:
        """`composite`, `ignore` or `none`."""
        ...

    def content_hash(self) -> str:
        """Changes with any photo or mask."""
        ...

    def image(self, index: int) -> np.ndarray:
        """[H, W, 3] uint8."""
        ...

    def mask(self, index: int) -> np.ndarray | None:
        """[H, W] uint8, or None."""
        ...


def training_camera(
    viewmat: np.ndarray, K: np.ndarray, width: int, height: int, near: float
) -> Frustum:
    """A camera of the training world, [4, 4] and [3, 3] float64, as float32 tensors."""
    return Frustum(
        torch.from_numpy(viewmat.astype(np.float32)),
        torch.from_numpy(K.astype(np.float32)),
        width,
        height,
        near,
    )


def evenly_spaced(indices: Sequence[int], most: int) -> list[int]:
    """`indices`, or of more than `most` as many at even distances."""
    if len(indices) <= most:
        return list(indices)
    return [indices[i] for i in np.linspace(0, len(indices) - 1, most).round().astype(int)]


class ViewSampler:
    """Each view once an epoch, in another order each epoch."""

    def __init__(self, indices: Sequence[int]) -> None:
        self.indices = list(indices)
        self.order: list[int] = []
        """Views of this epoch."""
        self.position = 0
        """Next place in `permutation`."""

    def upcoming(self, count: int, parts: int = 1) -> list[list[int]]:
        """What `batch_neighbours` gives of the next views as far as they are drawn already, at most
        `count`."""
        ahead = range(self.position, min(self.position + count, len(self.order)))
        return [self._beside(at, parts) for at in ahead]

    def batch_neighbours(self, parts: int) -> list[int]:
        """The view drawn last, and others of its epoch for all but the first of so many `parts`:
        each of them sees each view once an epoch."""
        return self._beside(self.position - 1, parts)

    def _beside(self, at: int, parts: int) -> list[int]:
        count = len(self.order)
        return [self.order[(at + part * count // parts) % count] for part in range(parts)]

    @property
    def through(self) -> bool:
        """Whether the next view is the first of an epoch."""
        return self.position >= len(self.order)

    def begin(self, generator: torch.Generator) -> None:
        """Draw the order of an epoch."""
        shuffled = permutation(len(self.indices), generator)
        self.order = [self.indices[i] for i in shuffled]
        self.position = 0

    def next(self, generator: torch.Generator) -> int:
        """The next view; draws an order where an epoch begins."""
        if self.through:
            self.begin(generator)
        self.position += 1
        return self.order[self.position - 1]

    def put_back(self, count: int = 1) -> None:
        """Let the views of this epoch drawn last come again: a photo was not to be had."""
        self.position = max(self.position - count, 0)
