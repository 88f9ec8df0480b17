"""Memory estimate of a training, and the memory that is available."""

from ...config import Skip, TrainConfig
from ...metrics.machine import available_memory_bytes, total_memory_bytes
from ...splats import SH_REST_BY_DEGREE
from ..model.nearest_points import few_queries

RUNTIME = 230_000_000
"""Bytes of Python with torch before a training begins."""
_BASE = 80_000_000
"""Bytes of everything else that does not grow."""
_NUMBER = 16
"""Bytes a number of a splat takes in a step: itself, its gradient and two moments, float32."""
_STEP_PER_SPLAT = 420
"""Bytes the rasterizer and the strategy keep for a splat: projection, tile lists, sums over tiles,
counters."""
_STEP_PER_PIXEL = 60
"""Bytes of the picture, its gradient and the loss, for a pixel of the largest view."""
_LOOK_NUMBER = 4
"""Bytes a number of a splat takes at the end, when moments and gradients are gone."""
_LOOK_PER_SPLAT = 220
"""Bytes of the rasterizer where no gradients are wanted."""
_LOOK_PER_PIXEL = 300
"""Bytes of a picture that is measured."""
_LPIPS, _LPIPS_PER_PIXEL = 80_000_000, 900
"""Bytes of the network that measures LPIPS and what runs it, and of a picture in it, for a pixel;
other metrics are done by then."""
_SMALLER_COPIES = 0.5
"""Bytes of scaled-down photos, as a share of the photos: half the pixels is the largest size but
the full one."""
_WORTH_DECODING = 0.05
"""Share of the rest of the memory that photos decoded anew must save."""
_STEPS_A_PHOTO = 50
"""Steps a photo from which on decoding it a few times more does not matter."""
_FEWEST_PHOTOS = 64_000_000
"""Bytes of photos that are kept at least where not all fit."""
_POINT = 27
"""Bytes of a point of structure from motion, as long as the run lasts: float64 and colour."""
_POINT_AT_START, _POINT_OF_MANY = 60, 45
"""Bytes it takes besides before the first step: its place in the training world, and the tree by
which its neighbours are found; where few splats come from many points that is smaller."""
_DEPTH_BYTES = 11
"""Bytes a pixel while depth maps are read: value and confidence in float32, and the target."""


def training_bytes(
    *, splats: int, sh_degree: int, pixels: int, lpips: bool = False, joined: bool = False
) -> int:
    """Memory that training needs at most, without photos and what Python and torch take.

    Args:
        splats: Largest number of splats.
        sh_degree: Highest degree.
        pixels: Of the largest view.
        lpips: Whether LPIPS is measured at the end.
        joined: Whether there are several models, which pictures show as one.
    """
    numbers = 11 + 3 * (1 + SH_REST_BY_DEGREE[sh_degree])
    step = splats * (_NUMBER * numbers + _STEP_PER_SPLAT) + pixels * _STEP_PER_PIXEL
    look = splats * (_LOOK_NUMBER * numbers + _LOOK_PER_SPLAT)
    look += _LPIPS + pixels * _LPIPS_PER_PIXEL if lpips else pixels * _LOOK_PER_PIXEL
    copy = splats * _LOOK_NUMBER * numbers if joined else 0
    return max(step, look) + copy + _BASE


def photo_memory(photos: int, config: TrainConfig, *, anew: bool) -> int:
    """Memory of photos that take `photos` bytes and of the scaled copies that training makes;
    `anew`: see `decoded_anew`."""
    copies = _SMALLER_COPIES if _starts_small(config) and not anew else 0
    return round(photos * (1 + copies))


def decoded_anew(config: TrainConfig, photos: int, *, views: int, rest: int) -> bool:
    """Whether full-size photos are let go while smaller ones are trained on, and decoded once more
    for each size: where that saves much and is little beside the steps of the run.

    Args:
        config: How to train.
        photos: Bytes of all photos, decoded.
        views: Number of photos.
        rest: Bytes that the training needs besides.
    """
    saved = photos * _SMALLER_COPIES
    return (
        _starts_small(config)
        and saved > _WORTH_DECODING * rest
        and config.iterations >= _STEPS_A_PHOTO * views
    )


def _starts_small(config: TrainConfig) -> bool:
    """Whether photos are scaled down at first."""
    full = config.coarse_factor == 1 or (config.coarse_factor == 0 and config.start_splats)
    return not full and Skip.SMALL_PHOTOS not in config.without


def point_bytes(points: int, *, splats: int) -> tuple[int, int]:
    """Memory that so many points of structure from motion take during the whole run, and what they
    take besides before the first step, when no gradients are there yet.

    Args:
        points: Of the capture.
        splats: Largest number of splats.
    """
    each = _POINT_OF_MANY if few_queries(points, splats) else _POINT_AT_START
    return _POINT * points, each * points + _BASE


def depth_bytes(pixels: int) -> int:
    """Memory of depth maps of that many pixels in all."""
    return _DEPTH_BYTES * pixels


def free_memory() -> int | None:
    """Bytes a training may use, or None if the system does not tell."""
    free, total = available_memory_bytes(), total_memory_bytes()
    if free is None and total is not None:
        free = int(0.8 * total)  # macOS does not tell; it swaps and compresses long before
    return free


def cache_bytes(
    config: TrainConfig, photos: int, *, all_of_them: int, rest: int, free: int | None
) -> int | None:
    """Bytes of decoded photos to keep; None: all of them.

    Args:
        config: `cache_mb` says how much where it is not 0.
        photos: Bytes of all photos, decoded.
        all_of_them: Bytes they take in training, with their copies.
        rest: Bytes that the training needs besides.
        free: Bytes there are; None: unknown, as many as are needed.
    """
    if config.cache_mb:
        asked = config.cache_mb * 1_000_000
        return None if photos <= asked else asked
    if free is None or all_of_them + rest <= free:
        return None
    return max(int(0.8 * (free - rest)), _FEWEST_PHOTOS)
