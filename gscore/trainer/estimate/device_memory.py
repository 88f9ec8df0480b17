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
_ENTRY, _MOMENTS, _ENTRIES = 20, 48, 8
"""Bytes per splat and tile of lists and of gradients, and tiles that a splat touches on average in
a large model."""
_PIXEL = 53
"""Bytes per pixel of the largest view: pictures and their gradients, 36; photo and mask on the
device and for each step in flight, 16; sums of tiles, 1."""
_DERIVATIVES = 36
"""Bytes per pixel of the derivatives of SSIM, where gradients of splats are later."""
_CONSTANT = 2_000_000
"""Bytes of buffers of constant size."""
_TRANSFER_SPLAT, _TRANSFER_PIXEL = 32, 20
"""Bytes per splat and per pixel of the buffers through which columns and pictures are read and
written, below a limit."""
_TRANSFER_MOST = 2 * (8 << 20)
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
    shared = max(splats * _MOMENTS * _ENTRIES, pixels * _DERIVATIVES)
    transfers = min(_TRANSFER_SPLAT * splats + _TRANSFER_PIXEL * pixels, _TRANSFER_MOST)
    return splats * a_splat + pixels * _PIXEL + shared + transfers + _CONSTANT


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
