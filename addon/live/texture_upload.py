"""Texture upload to the graphics card, in chunks of a millisecond; for draw handlers."""

from collections.abc import Callable

import gpu
import numpy as np

from .program import ORDER_COLUMNS

Copy = Callable[[gpu.types.GPUTexture, gpu.types.GPUFrameBuffer, int], None]
"""Type of `Card.copy`."""


class Texels:
    """The texels of an atlas on the card."""

    PIECE = 1 << 16
    """Texels per upload, 1 MB, or one row if that is more."""

    def __init__(self, values: np.ndarray) -> None:
        """Allocate; uploads nothing yet.

        Args:
            values: `Atlas.texels`, [R, C, T, 4] float32.
        """
        rows, columns, texels, _ = values.shape
        self.values = values
        self.texture = gpu.types.GPUTexture((columns * texels, rows), format="RGBA32F")
        self._target = gpu.types.GPUFrameBuffer(color_slots=self.texture)
        self._done = 0
        """Number of uploaded rows."""

    @property
    def complete(self) -> bool:
        """Whether all are uploaded."""
        return self._done == len(self.values)

    def step(self, copy: Copy) -> None:
        """Upload the next rows: in a texture of their own, which the card copies, because Blender
        writes to a texture only when it makes it."""
        width = self.texture.width
        rows = self.values[self._done : self._done + max(self.PIECE // width, 1)]
        copy(texture(rows.reshape(len(rows), width, 4)), self._target, self._done)
        self._done += len(rows)


class Order:
    """An order of splats on the card, in chunks that are uploaded one at a time."""

    CHUNK = 1 << 16
    """Entries per chunk; a chunk takes a millisecond."""

    def __init__(self, entries: np.ndarray, before: "Order | None" = None) -> None:
        """Prepare; uploads nothing yet.

        Args:
            entries: Result of `order.arrange`, [N, 4] float32.
            before: An uploaded order, whose equal chunks are reused.
        """
        self._entries = entries
        self._before = () if before is None else (before._entries, tuple(before.chunks))
        self.chunks: list[tuple[gpu.types.GPUTexture, int]] = []
        """Textures and their numbers of entries, in the order of drawing."""

    def step(self) -> bool:
        """Upload one more chunk; return whether all are uploaded."""
        number = len(self.chunks)
        at = number * self.CHUNK
        part = self._entries[at : at + self.CHUNK]
        entries, chunks = self._before or ((), ())
        if number < len(chunks) and np.array_equal(entries[at : at + self.CHUNK], part):
            self.chunks.append(chunks[number])
        elif len(part):
            rows = -(-len(part) // ORDER_COLUMNS)
            padded = np.zeros((rows * ORDER_COLUMNS, 4), np.float32)
            padded[: len(part)] = part
            self.chunks.append((texture(padded.reshape(rows, ORDER_COLUMNS, 4)), len(part)))
        complete = at + self.CHUNK >= len(self._entries)
        if complete:
            self._before = ()  # else each order would keep all earlier ones alive
        return complete


def texture(values: np.ndarray) -> gpu.types.GPUTexture:
    """A texture of [H, W, 1] or [H, W, 4] float32 values."""
    flat = np.ascontiguousarray(values).reshape(-1)
    data = gpu.types.Buffer("FLOAT", flat.size, flat)
    kind = {1: "R32F", 4: "RGBA32F"}[values.shape[2]]
    return gpu.types.GPUTexture(values.shape[1::-1], format=kind, data=data)
