"""Level-of-detail (LOD) index: number, offsets and coarseness of the chunks of an LOD file."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..events import strict_json
from ..json_text import parse_json
from ..scene import Cameras, checked_origin
from ..splats import SH_REST_BY_DEGREE

KIND = "gscore levels of detail 1"
"""First line of an LOD file, and the kind in its index."""
CHILDREN = 4
"""Chunks of a level that one chunk of the next coarser level replaces."""
_MOST_LEVELS = 16


@dataclass(frozen=True, kw_only=True)
class LodLevel:
    """C chunks of one level; chunk i replaces chunks 4 i to 4 i + 3 of the next finer level."""

    counts: np.ndarray
    """[C] int64, splats per chunk, at least one."""
    low: np.ndarray
    """[C, 3] float64, lower bounds of the means, world units."""
    high: np.ndarray
    """[C, 3] float64, upper bounds."""
    reach: np.ndarray
    """[C] float64, largest standard deviation of a splat, world units."""
    errors: np.ndarray
    """[C] float64, root mean square distance by which the finest splats were moved into those of
    the chunk, weighted by the area they cover, world units; 0 at the finest level."""
    checks: np.ndarray
    """[C] int64, CRC-32 of the bytes."""
    psnr: float | None = None
    """PSNR of pictures of the level against those of level `against`, taken from the distance at
    which the error is one pixel, dB; None: not measured."""
    against: int = 0
    """Level that `psnr` compares with: the finest, or for coarse levels the finest that fits."""

    @property
    def splats(self) -> int:
        """Number of splats."""
        return int(self.counts.sum())

    @property
    def error(self) -> float:
        """Median error of the chunks, world units."""
        return float(np.median(self.errors))


@dataclass(frozen=True, kw_only=True)
class LodIndex:
    """Index of all levels, the finest first."""

    sh_degree: int
    antialias: bool
    """True if the splats need the anti-aliasing compensation."""
    near: float
    """Near plane of the training, world units."""
    background: tuple[float, float, float]
    """Background colour of measurements, RGB."""
    cameras: Cameras | None
    """Cameras of the run; None: unknown."""
    origin: np.ndarray | None
    """[3] float64, local origin of splats and cameras, as `Cameras.origin`."""
    levels: tuple[LodLevel, ...]

    @property
    def row_bytes(self) -> int:
        """Bytes per splat."""
        return 4 * row_floats(self.sh_degree)

    @property
    def data_bytes(self) -> int:
        """Bytes of all chunks."""
        return self.row_bytes * sum(level.splats for level in self.levels)

    def offsets(self, level: int) -> np.ndarray:
        """[C + 1] int64, offsets at which the chunks of a level begin and end, bytes after the
        header."""
        before = self.row_bytes * sum(one.splats for one in self.levels[:level])
        ends = np.cumsum(self.levels[level].counts) * self.row_bytes
        return before + np.concatenate([[0], ends])

    def to_bytes(self) -> bytes:
        """The index as JSON."""
        cameras = self.cameras
        content = {
            "kind": KIND,
            "sh_degree": self.sh_degree,
            "antialias": self.antialias,
            "near": self.near,
            "background": list(self.background),
            "cameras": None if cameras is None else _camera_columns(cameras),
            "levels": [
                {
                    "counts": level.counts.tolist(),
                    "low": level.low.tolist(),
                    "high": level.high.tolist(),
                    "reach": level.reach.tolist(),
                    "errors": level.errors.tolist(),
                    "checks": level.checks.tolist(),
                    "psnr": level.psnr,
                    "against": level.against,
                }
                for level in self.levels
            ],
        }
        if self.origin is not None:
            content["origin"] = self.origin.tolist()
        return (strict_json(content) + "\n").encode()


def row_floats(sh_degree: int) -> int:
    """Numbers per splat of this SH degree."""
    return 14 + 3 * SH_REST_BY_DEGREE[sh_degree]


def parse_index(text: bytes) -> LodIndex:
    """Parse an index written by `LodIndex.to_bytes`.

    Raises:
        ValueError, TypeError, KeyError, AttributeError, OverflowError: it is damaged.
    """
    content = parse_json(text)
    if content["kind"] != KIND or content["sh_degree"] not in SH_REST_BY_DEGREE:
        raise ValueError
    background = tuple(map(float, content["background"]))
    cameras = content["cameras"]
    origin = checked_origin(content["origin"]) if "origin" in content else None
    index = LodIndex(
        sh_degree=content["sh_degree"],
        antialias=bool(content["antialias"]),
        near=float(content["near"]),
        background=(background[0], background[1], background[2]),
        cameras=None if cameras is None else replace(_cameras(cameras), origin=origin),
        origin=origin,
        levels=tuple(map(_level, content["levels"])),
    )
    _check(index)
    return index


def _level(entry: Any) -> LodLevel:
    psnr = entry["psnr"]
    count = len(entry["counts"])
    return LodLevel(
        counts=_numbers(entry["counts"], (count,), np.int64),
        low=_numbers(entry["low"], (count, 3)),
        high=_numbers(entry["high"], (count, 3)),
        reach=_numbers(entry["reach"], (count,)),
        errors=_numbers(entry["errors"], (count,)),
        checks=_numbers(entry["checks"], (count,), np.int64),
        psnr=None if psnr is None else float(psnr),
        against=int(entry["against"]),
    )


def _check(index: LodIndex) -> None:
    """Raise ValueError unless the levels are consistent."""
    levels = index.levels
    if not 1 <= len(levels) <= _MOST_LEVELS or not index.near > 0:
        raise ValueError
    for depth, level in enumerate(reversed(levels)):
        chunks = CHILDREN**depth
        fits = len(level.counts) == chunks and (level.counts > 0).all()
        fits = fits and (level.low <= level.high).all() and (level.reach >= 0).all()
        if not fits or not (level.errors >= 0).all() or not 0 <= level.against < len(levels):
            raise ValueError
        if (level.counts > 1 << 40).any():  # so that sums of bytes cannot overflow
            raise ValueError


def _numbers(values: Any, shape: tuple[int, ...], dtype: type = np.float64) -> np.ndarray:
    numbers = np.array(values, dtype)
    if numbers.shape != shape or not np.isfinite(numbers).all():
        raise ValueError
    return numbers


def _camera_columns(cameras: Cameras) -> dict[str, Any]:
    return {
        "viewmats": cameras.viewmats.tolist(),
        "Ks": cameras.Ks.tolist(),
        "widths": cameras.widths.tolist(),
        "heights": cameras.heights.tolist(),
        "names": list(cameras.names),
    }


def _cameras(columns: Any) -> Cameras:
    names = tuple(map(str, columns["names"]))
    count = len(names)
    return Cameras(
        viewmats=_numbers(columns["viewmats"], (count, 4, 4)),
        Ks=_numbers(columns["Ks"], (count, 3, 3)),
        widths=_numbers(columns["widths"], (count,), np.int64),
        heights=_numbers(columns["heights"], (count,), np.int64),
        names=names,
    )
