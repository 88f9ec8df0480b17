"""Memory estimate of a training, and the memory that is available."""

from ...config import Skip, TrainConfig
from ...io.system_memory import available_memory_bytes, total_memory_bytes
from ...splats import SH_REST_BY_DEGREE
from ..model.nearest_points import few_queries

RUNTIME = 230_000_000
"""Bytes of Python with torch before a training starts."""
_BASE = 80_000_000
"""Bytes of everything else of constant size."""
_NUMBER = 16
"""Bytes per number of a splat in a step: value, gradient and two moments, float32."""
_STEP_PER_SPLAT = 420
"""Bytes per splat of rasterizer and strategy in a step: projection, tile lists, sums over tiles,
counters."""
_STEP_PER_PIXEL = 60
"""Bytes per pixel of the largest view in a step: image, its gradient and the loss."""
_EVAL_NUMBER = 4
"""Bytes per number of a splat in the evaluation, without moments and gradients."""
_EVAL_PER_SPLAT = 220
"""Bytes per splat of the rasterizer without gradients."""
_EVAL_PER_PIXEL = 300
"""Bytes per pixel of an evaluated image."""
_LPIPS, _LPIPS_PER_PIXEL = 80_000_000, 900
"""Bytes of the LPIPS network with its runtime, and per pixel of an image in it; the memory of other
metrics is free by then."""
_SMALLER_COPIES = 0.5
"""Bytes of scaled-down photos relative to the photos: the largest of them has half the pixels."""
_WORTH_DECODING = 0.05
"""Least share of the other memory that decoding photos again must save."""
_STEPS_A_PHOTO = 50
"""Steps per photo from which decoding it a few more times takes negligible time."""
_FEWEST_PHOTOS = 64_000_000
"""Least bytes of photos that are kept if not all fit."""
_POINT = 27
"""Bytes per SfM point during the whole run: float64 position and colour."""
_POINT_AT_START, _POINT_OF_MANY = 60, 45
"""Additional bytes per SfM point before the first step, for its training position and the k-d tree
of the neighbours; less where few splats come from many points."""
_DEPTH_BYTES = 11
"""Bytes per pixel while depth maps are read: value and confidence in float32, and the target."""


def training_bytes(
    *, splats: int, sh_degree: int, pixels: int, lpips: bool = False, joined: bool = False
) -> int:
    """Peak bytes of a training, without photos, Python and torch.

    Args:
        splats: Largest number of splats.
        sh_degree: Highest SH degree.
        pixels: Number of pixels of the largest view.
        lpips: Whether LPIPS is evaluated at the end.
        joined: Whether several models are merged for rendering.
    """
    numbers = 11 + 3 * (1 + SH_REST_BY_DEGREE[sh_degree])
    step = splats * (_NUMBER * numbers + _STEP_PER_SPLAT) + pixels * _STEP_PER_PIXEL
    evaluation = splats * (_EVAL_NUMBER * numbers + _EVAL_PER_SPLAT)
    evaluation += _LPIPS + pixels * _LPIPS_PER_PIXEL if lpips else pixels * _EVAL_PER_PIXEL
    copy = splats * _EVAL_NUMBER * numbers if joined else 0
    return max(step, evaluation) + copy + _BASE


def photo_memory(photos: int, config: TrainConfig, *, decode_again: bool) -> int:
    """Bytes of photos that take `photos` bytes, with their scaled copies unless `decode_again` (see
    `decodes_again`)."""
    copies = _SMALLER_COPIES if _starts_small(config) and not decode_again else 0
    return round(photos * (1 + copies))


def decodes_again(config: TrainConfig, photos: int, *, views: int, rest: int) -> bool:
    """Return whether to free full-size photos while smaller ones are trained on, and decode them
    again for each size: if that saves much memory and takes little time relative to the run.

    Args:
        config: The options.
        photos: Bytes of all decoded photos.
        views: Number of photos.
        rest: Bytes of the training without photos.
    """
    saved = photos * _SMALLER_COPIES
    return (
        _starts_small(config)
        and saved > _WORTH_DECODING * rest
        and config.iterations >= _STEPS_A_PHOTO * views
    )


def _starts_small(config: TrainConfig) -> bool:
    """Return whether training starts with scaled-down photos."""
    full = config.coarse_factor == 1 or (config.coarse_factor == 0 and config.start_splats)
    return not full and Skip.SMALL_PHOTOS not in config.without


def point_bytes(points: int, *, splats: int) -> tuple[int, int]:
    """Bytes of SfM points during the whole run, and additional bytes before the first step, when
    there are no gradients yet.

    Args:
        points: Number of points of the capture.
        splats: Largest number of splats.
    """
    each = _POINT_OF_MANY if few_queries(points, splats) else _POINT_AT_START
    return _POINT * points, each * points + _BASE


def depth_bytes(pixels: int) -> int:
    """Bytes of depth maps with `pixels` in total."""
    return _DEPTH_BYTES * pixels


def free_memory() -> int | None:
    """Bytes that a training may use; None: unknown."""
    free, total = available_memory_bytes(), total_memory_bytes()
    if free is None and total is not None:
        free = int(0.8 * total)  # macOS reports no free memory; it swaps and compresses earlier
    return free


def cache_bytes(
    config: TrainConfig, photos: int, *, all_of_them: int, rest: int, free: int | None
) -> int | None:
    """Bytes of decoded photos to keep; None: all of them.

    Args:
        config: `cache_mb` sets the size unless it is 0.
        photos: Bytes of all decoded photos.
        all_of_them: Bytes of all photos in training, with their copies.
        rest: Bytes of the training without photos.
        free: Bytes available; None: unknown, assumed sufficient.
    """
    if config.cache_mb:
        limit = config.cache_mb * 1_000_000
        return None if photos <= limit else limit
    if free is None or all_of_them + rest <= free:
        return None
    return max(int(0.8 * (free - rest)), _FEWEST_PHOTOS)
