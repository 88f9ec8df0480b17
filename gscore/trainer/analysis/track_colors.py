"""Track colours: colours of SfM points in the photos that observe them."""

from dataclasses import dataclass

import numpy as np

from ...datasets import Dataset
from ...datasets.tracks import Tracks
from ...io.images.read_image import resize

_SIDE = 200
"""Longer side of the downscaled photos that colours are sampled from, px: large pixels tolerate
reprojection errors."""
_DARK, _BRIGHT = 10, 245
"""Range of bytes in which a colour follows the exposure."""
_SHOWN = 128
"""Smallest mask byte of a valid colour."""


@dataclass(frozen=True, kw_only=True)
class TrackColors:
    """S colours of P points in V photos."""

    view: np.ndarray
    """[S] int64, 0 to V - 1: index in the measured views."""
    point: np.ndarray
    """[S] int64, row of the point."""
    log_color: np.ndarray
    """[S, 3] float64, ln of encoded R, G, B in [0, 1]."""
    views: int
    """V."""

    def __len__(self) -> int:
        return len(self.view)


def joined_colors(found: list[tuple[np.ndarray, np.ndarray]]) -> TrackColors:
    """Join the results of `colors_in_view`, by view."""
    return TrackColors(
        view=np.repeat(np.arange(len(found)), [len(rows) for rows, _ in found]),
        point=np.concatenate([rows for rows, _ in found]),
        log_color=np.concatenate([colors for _, colors in found]),
        views=len(found),
    )


def colors_in_view(dataset: Dataset, tracks: Tracks, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows [M] of points and ln of their colours [M, 3] at their observations in one photo, except
    dark, clipped and masked ones."""
    image, mask, cameras = dataset.image(index), dataset.mask(index), dataset.scene.cameras
    height, width = image.shape[:2]
    small = max(1.0, max(height, width) / _SIDE)
    columns, lines = max(1, round(width / small)), max(1, round(height / small))
    rows = tracks.observed[index]
    K = cameras.Ks[index]
    pixels = tracks.rays[index] * K[[0, 1], [0, 1]] + K[:2, 2]
    pixels = pixels * (columns / width, lines / height)
    inside = ((pixels >= 0) & (pixels < (columns, lines))).all(axis=1)
    rows, (u, v) = rows[inside], pixels[inside].astype(np.int64).T
    colors = resize(image, columns, lines)[v, u]
    good = (colors.min(axis=1) >= _DARK) & (colors.max(axis=1) <= _BRIGHT)
    if mask is not None and dataset.mask_mode != "none":
        good &= resize(np.dstack([mask] * 3), columns, lines)[v, u, 0] >= _SHOWN
    return rows[good], np.log(colors[good] / 255.0)
