"""Uploads of textures to the graphics card, in chunks of a millisecond; for draw handlers."""

from collections.abc import Callable

import gpu
import numpy as np

from .program import ORDER_COLUMNS

Copy = Callable[[gpu.types.GPUTexture, gpu.types.GPUFrameBuffer, int], None]
"""As `Card.copy`."""


class Texels:
    """The texels of an atlas on the card."""

    PIECE = 1 << 16
    """Texels that are uploaded at once, 1 MB, or a row if that is more."""

    def __init__(self, values: np.ndarray) -> None:
        """Nothing is uploaded yet.

        Args:
            values: [R, C, T, 4] float32, of `Atlas.texels`.
        """
        rows, columns, texels, _ = values.shape
        self.values = values
        self.texture = gpu.types.GPUTexture((columns * texels, rows), format="RGBA32F")
        self._target = gpu.types.GPUFrameBuffer(color_slots=self.texture)
        self._done = 0
        """Rows."""

    @property
    def complete(self) -> bool:
        """Whether all are there."""
        return self._done == len(self.values)

    def step(self, copy: Copy) -> None:
        """Upload some more. Blender writes to a texture only when it makes it, so they come in one
        of their own, and the card copies them."""
        width = self.texture.width
        rows = self.values[self._done : self._done + max(self.PIECE // width, 1)]
        copy(texture(rows.reshape(len(rows), width, 4)), self._target, self._done)
        self._done += len(rows)


class Order:
    """An order of splats on the card, in chunks that are uploaded one at a time."""

    CHUNK = 1 << 16
    """Entries; one takes a millisecond."""

    def __init__(self, entries: np.ndarray, before: "Order | None" = None) -> None:
        """Nothing is uploaded yet.

        Args:
            entries: [N, 4] float32, of `order.arrange`.
            before: Another that is on the card; chunks that are the same need no upload.
        """
        self._entries = entries
        self._before = () if before is None else (before._entries, tuple(before.chunks))
        self.chunks: list[tuple[gpu.types.GPUTexture, int]] = []
        """Textures and how many entries each has, in the order of drawing."""

    def step(self) -> bool:
        """Upload one more chunk; whether all are there."""
        number = len(self.chunks)
        at = number * self.CHUNK
        part = self._entries[at : at + self.CHUNK]
        known = self._known(number, part)
        if known is not None:
            self.chunks.append(known)
        elif len(part):
            rows = -(-len(part) // ORDER_COLUMNS)
            padded = np.zeros((rows * ORDER_COLUMNS, 4), np.float32)
            padded[: len(part)] = part
            self.chunks.append((texture(padded.reshape(rows, ORDER_COLUMNS, 4)), len(part)))
        complete = at + self.CHUNK >= len(self._entries)
        if complete:
            self._before = ()  # else each would keep all that were before it
        return complete

    def _known(self, number: int, part: np.ndarray) -> tuple[gpu.types.GPUTexture, int] | None:
        """The chunk of this number of the order before, if it has the same entries."""
        if not self._before or number >= len(self._before[1]):
            return None
        at = number * self.CHUNK
        same = np.array_equal(self._before[0][at : at + self.CHUNK], part)
        return self._before[1][number] if same else None


def texture(values: np.ndarray) -> gpu.types.GPUTexture:
    """[H, W, 1] or [H, W, 4] float32 as a texture of the same numbers."""
    flat = np.ascontiguousarray(values).reshape(-1)
    data = gpu.types.Buffer("FLOAT", flat.size, flat)
    kind = {1: "R32F", 4: "RGBA32F"}[values.shape[2]]
    return gpu.types.GPUTexture(values.shape[1::-1], format=kind, data=data)
