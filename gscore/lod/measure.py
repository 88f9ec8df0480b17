"""LOD error measurement: each level compared with finer splats at the distance of its use."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..formats.joined import joined
from ..io.lod_file import LodFile, lod_chunks_of
from ..io.lod_index import CHILDREN, LodIndex, LodLevel
from ..raster.api import render
from ..raster.gpu.choice import CPU, Chosen
from ..sampling import evenly_spaced
from ..splats import Splats

_CHUNKS = 4
"""Evaluated chunks per level, evenly spaced."""
_MOST = 1_000_000
"""Most splats that a chunk is compared with, for the memory of a small machine."""
_SIDE = 256
"""Side of a picture, px."""
_FOCAL = 2.0 * _SIDE
"""Focal length of its camera, px."""
_COVERED = 0.02
"""Least opacity of a counted pixel, because black surroundings would make any error small."""


def measured_levels(path: Path, index: LodIndex, device: Chosen = CPU) -> tuple[LodLevel, ...]:
    """Levels of an index with measured `psnr` and `against`; the file's chunks must be written.

    Some chunks of each level are rendered from six sides, at the distance at which their error is
    one pixel; the covered pixels are compared.
    """
    levels = [index.levels[0]]
    with lod_chunks_of(path, index) as file:
        for level in range(1, len(index.levels)):
            against = _finest_that_fits(index, level)
            psnr = _level_psnr(file, level, against, device)
            levels.append(replace(index.levels[level], psnr=psnr, against=against))
    return tuple(levels)


def _finest_that_fits(index: LodIndex, level: int) -> int:
    counts = index.levels[level].counts
    for below in range(level):
        share = CHILDREN ** (level - below)
        if index.levels[below].counts.reshape(len(counts), share).sum(axis=1).max() <= _MOST:
            return below
    return level - 1


def _level_psnr(file: LodFile, level: int, against: int, device: Chosen) -> float | None:
    """PSNR over some chunks, dB; None if none of them has an error or covers pixels."""
    total = pixels = 0.0
    count = len(file.index.levels[level].counts)
    for chunk in evenly_spaced(range(count), _CHUNKS):
        share = CHILDREN ** (level - against)
        fine = [
            Splats(**file.chunk(against, one)) for one in range(chunk * share, (chunk + 1) * share)
        ]
        coarse, exact = Splats(**file.chunk(level, chunk)), joined(fine)
        for viewmat in _views(file.index.levels[level], chunk):
            squares, covered = _loss(coarse, exact, viewmat, file.index, device)
            total, pixels = total + squares, pixels + covered
        device.release()
    return -10 * math.log10(total / pixels) if total and pixels else None


def _views(level: LodLevel, chunk: int) -> Iterator[np.ndarray]:
    """Six cameras around a chunk, at the distance at which its error is a pixel; none without
    error."""
    low, high, error = level.low[chunk], level.high[chunk], level.errors[chunk]
    if not error:
        return
    for axis in range(3):
        for sign in (-1.0, 1.0):
            forward = np.roll([-sign, 0.0, 0.0], axis)
            right = np.roll([0.0, 1.0, 0.0], axis)
            eye = (low + high) / 2 - forward * ((high - low)[axis] / 2 + error * _FOCAL)
            viewmat = np.eye(4)
            viewmat[:3, :3] = right, np.cross(forward, right), forward
            viewmat[:3, 3] = -viewmat[:3, :3] @ eye
            yield viewmat


def _loss(
    coarse: Splats, exact: Splats, viewmat: np.ndarray, index: LodIndex, device: Chosen
) -> tuple[float, float]:
    """Sum over covered pixels of squared errors, averaged over colours, and the number of
    pixels."""
    K = np.array([[_FOCAL, 0, _SIDE / 2], [0, _FOCAL, _SIDE / 2], [0, 0, 1.0]])
    made = [
        render(
            splats,
            K,
            viewmat,
            _SIDE,
            _SIDE,
            depths=False,
            antialias=index.antialias,
            near=index.near,
            device=device,
            keep=True,
        )
        for splats in (coarse, exact)
    ]
    counts = made[1].alpha > _COVERED
    a, b = (np.clip(one.rgb[counts].astype(np.float64), 0, 1) for one in made)
    return float(((a - b) ** 2).mean(axis=1).sum()), float(counts.sum())
