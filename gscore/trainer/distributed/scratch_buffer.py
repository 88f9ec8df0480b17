"""Scratch buffer: memory reused in every step, because fresh pages cost more than writing them."""

import torch
from torch import Tensor

from ...raster.memory import empty

_SPARE = 1.25
"""Room for so many times what is asked for, since it is rarely the same twice."""


class ScratchBuffer:
    """A piece of memory that grows as it must."""

    def __init__(self) -> None:
        self._words = empty(0, dtype=torch.int32)

    def of(self, rows: int, width: int) -> Tensor:
        """[rows, width] int32, not filled; what it gave before is lost."""
        count = rows * width
        if len(self._words) < count:
            self._words = empty(int(_SPARE * count), dtype=torch.int32)
        return self._words[:count].view(rows, width)
