"""Whether a run will fit into memory, told before it starts."""

from ..errors import GsError
from ..metrics.machine import available_memory_bytes, total_memory_bytes
from ..splats import SH_REST_BY_DEGREE

_WORKSPACE_PER_SPLAT = 600
"""Bytes the rasterizer and the strategy keep for a splat: projection, tile lists, counters."""
_BYTES_PER_PIXEL = 400
"""Bytes of pictures, their gradients, the loss and the evaluation, for a pixel of the largest
view."""
_BASE = 300_000_000
"""Bytes of torch and Python beyond what they hold when training starts."""


def training_bytes(*, splats: int, sh_degree: int, pixels: int) -> int:
    """Memory that training needs at most, without the photos.

    Args:
        splats: Largest number of splats.
        sh_degree: Highest degree.
        pixels: Of the largest view.
    """
    numbers = 11 + 3 * (1 + SH_REST_BY_DEGREE[sh_degree])
    state = 4 * 4 * numbers  # parameter, gradient and two moments, float32
    return splats * (state + _WORKSPACE_PER_SPLAT) + pixels * _BYTES_PER_PIXEL + _BASE


def check_memory(*, splats: int, sh_degree: int, pixels: int, photos: int = 0) -> None:
    """Raise GsError if a run will not fit into memory.

    Args:
        splats: Largest number of splats.
        sh_degree: Highest degree.
        pixels: Of the largest view.
        photos: Bytes of photos that are not in memory yet.
    """
    free, total = available_memory_bytes(), total_memory_bytes()
    if free is None and total is not None:
        free = int(0.8 * total)  # macOS does not tell; it swaps and compresses long before
    need = photos + training_bytes(splats=splats, sh_degree=sh_degree, pixels=pixels)
    if free is None or need <= free:
        return
    fixed = photos + training_bytes(splats=0, sh_degree=sh_degree, pixels=pixels)
    each = (need - fixed) / splats
    fitting = int((0.9 * free - fixed) / each) // 1000 * 1000
    way = f"use --max-splats {fitting}, " if fitting >= 10_000 else ""
    raise GsError(
        f"Training {splats} splats needs about {need / 1e9:.1f} GB of memory, but "
        f"{free / 1e9:.1f} GB are free; {way}use smaller photos (-r 2) or close programs."
    )
