"""How much memory a training needs, and what of it is there."""

from ..config import TrainConfig
from ..metrics.machine import available_memory_bytes, total_memory_bytes
from ..splats import SH_REST_BY_DEGREE

RUNTIME = 230_000_000
"""Bytes of Python with torch before a training begins."""
_BASE = 150_000_000
"""Bytes of everything else that does not grow."""
_NUMBER = 16
"""Bytes a number of a splat takes: itself, its gradient and two moments, float32."""
_WORKSPACE_PER_SPLAT = 600
"""Bytes the rasterizer and the strategy keep for a splat: projection, tile lists, counters."""
_BYTES_PER_PIXEL = 550
"""Bytes of pictures, their gradients, the loss and the evaluation, for a pixel of the largest
view."""
_SMALLER_COPIES = 0.5
"""Bytes of scaled-down photos, as a share of the photos: half the pixels is the largest size but
the full one."""
_FEWEST_PHOTOS = 64_000_000
"""Bytes of photos that are kept at least where not all fit."""
_DEPTH_BYTES = 11
"""Bytes a pixel while depth maps are read: value and confidence in float32, and the target."""


def bytes_per_splat(sh_degree: int) -> int:
    """Memory that grows with the number of splats."""
    numbers = 11 + 3 * (1 + SH_REST_BY_DEGREE[sh_degree])
    return _NUMBER * numbers + _WORKSPACE_PER_SPLAT


def training_bytes(*, splats: int, sh_degree: int, pixels: int) -> int:
    """Memory that training needs at most, without photos and what Python and torch take.

    Args:
        splats: Largest number of splats.
        sh_degree: Highest degree.
        pixels: Of the largest view.
    """
    return splats * bytes_per_splat(sh_degree) + pixels * _BYTES_PER_PIXEL + _BASE


def photo_bytes(photos: int, config: TrainConfig) -> int:
    """Memory of photos that take `photos` bytes and of the scaled copies that training makes."""
    return photos if config.coarse_factor == 1 else round(photos * (1 + _SMALLER_COPIES))


def depth_bytes(pixels: int) -> int:
    """Memory of depth maps of that many pixels in all."""
    return _DEPTH_BYTES * pixels


def free_memory() -> int | None:
    """Bytes a training may use, or None if the system does not tell."""
    free, total = available_memory_bytes(), total_memory_bytes()
    if free is None and total is not None:
        free = int(0.8 * total)  # macOS does not tell; it swaps and compresses long before
    return free


def cache_bytes(config: TrainConfig, photos: int, *, rest: int, free: int | None) -> int | None:
    """Bytes of decoded photos to keep; None: all of them.

    Args:
        config: `cache_mb` says how much where it is not 0.
        photos: Bytes of all photos, decoded.
        rest: Bytes that the training needs besides.
        free: Bytes there are; None: unknown, as many as are needed.
    """
    if config.cache_mb:
        asked = config.cache_mb * 1_000_000
        return None if photos <= asked else asked
    if free is None or photo_bytes(photos, config) + rest <= free:
        return None
    return max(int(0.8 * (free - rest)), _FEWEST_PHOTOS)
