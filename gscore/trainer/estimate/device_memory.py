"""Device memory of a training: the sizes of its tables on a graphics card."""

from ...config import TrainConfig
from ...scene import Cameras
from ...splats import SH_REST_BY_DEGREE

_QUAD = 16
"""Bytes of four floats: tables have planes of these."""
_PLANES = 3
"""Planes of a splat besides its SH coefficients: mean and opacity, quaternion, scale."""
_COUNTERS = 16
"""Bytes per splat of counters and row numbers."""
_SCREEN = 100
"""Bytes per splat of the projection and its sort."""
_ENTRY, _ENTRIES = 68, 8
"""Bytes per splat and tile, and tiles that a splat touches on average in a large model."""
_PIXEL = 180
"""Bytes per pixel of the largest view: pictures, gradients and the loss, 100; buffers for transfers
of the steps in flight and of pictures, 80."""
_TRANSFERS = 8_000_000
"""Bytes of other buffers for transfers and of constant size."""
_TRANSFER_SPLAT = 32
"""Bytes per splat of the buffers through which columns are read and written, below a limit."""
_TRANSFER_MOST = 2 * (64 << 20)
"""That limit."""


def device_bytes(*, splats: int, sh_degree: int, pixels: int, models: int = 1) -> int:
    """Peak bytes of a training on a device, without photos that stay there.

    Args:
        splats: Largest number of splats of a model.
        sh_degree: Highest SH degree.
        pixels: Number of pixels of the largest view.
        models: Number of models, which are merged for pictures.
    """
    harmonics = -(-3 * (1 + SH_REST_BY_DEGREE[sh_degree]) // 4)
    values = _QUAD * (_PLANES + harmonics)
    tables = 3 * values + _QUAD * harmonics + _COUNTERS
    merged = values if models > 1 else 0
    a_splat = models * (tables + _SCREEN + merged) + _ENTRY * _ENTRIES
    transfers = _TRANSFERS + min(_TRANSFER_SPLAT * splats, _TRANSFER_MOST)
    return splats * a_splat + pixels * _PIXEL + transfers


def photo_room(memory: int, config: TrainConfig, cameras: Cameras, *, models: int) -> int:
    """Bytes of a device's memory in which photos of these cameras may stay, next to a training of
    this number of models."""
    needed = device_bytes(
        splats=config.max_splats,
        sh_degree=config.sh_degree,
        pixels=int((cameras.widths * cameras.heights).max()),
        models=models,
    )
    return max(memory - needed, 0)
