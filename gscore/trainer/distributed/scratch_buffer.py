"""Scratch buffer: memory reused in every step, because fresh pages cost more than writing them."""

import torch
from torch import Tensor

from ...raster.memory import empty

_SPARE = 1.25
"""Allocated size relative to the requested size, because requests vary from step to step."""


class ScratchBuffer:
    """Memory of int32 words that grows on demand."""

    def __init__(self) -> None:
        self._words = empty(0, dtype=torch.int32)

    def of(self, rows: int, width: int) -> Tensor:
        """Return [rows, width] int32, uninitialised; invalidates earlier results."""
        count = rows * width
        if len(self._words) < count:
            self._words = empty(int(_SPARE * count), dtype=torch.int32)
        return self._words[:count].view(rows, width)
