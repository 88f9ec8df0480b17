"""LOD reader: splats of one level, all of them or those in a box."""

from pathlib import Path

import numpy as np

from ..edit.crop import in_unit_shape
from ..errors import ConfigError
from ..formats.joined import joined
from ..formats.splat_file import SplatFile
from ..io.lod_file import LodFile, empty_splats, open_lod_file
from ..io.lod_index import LodLevel
from ..quoting import brief
from ..splats import Splats
from ..text_format import count_text

LOD_FORMAT = "lod"
"""`SplatFile.format` of splats of a level."""


def read_lod(
    path: str | Path,
    level: int | None = None,
    *,
    most: int | None = None,
    to_unit: np.ndarray | None = None,
) -> SplatFile:
    """Read one level of a file that `gscore lod` wrote.

    Args:
        path: The file.
        level: Level, from 0, the finest; None: the finest with at most `most` splats, or the
            coarsest.
        most: Most splats; None: no limit.
        to_unit: [4, 4] float64 from the file's world to one in which a box is [-1, 1]^3: only
            splats with centres in the box, and only their chunks, are read.

    Raises:
        DatasetError: the file is missing or cannot be read.
        FormatError: it is not an LOD file, truncated or damaged.
        ConfigError: there is no such level.
    """
    with open_lod_file(path) as file:
        levels = file.index.levels
        if level is None:
            level = _fitting_level(levels, most)
        if not 0 <= level < len(levels):
            raise ConfigError(
                f"{brief(path)} has {count_text(len(levels), 'level')}, from 0, the finest, to "
                f"{len(levels) - 1}; there is no level {level}."
            )
        parts = [
            _inside(Splats(**file.chunk(level, chunk)), to_unit)
            for chunk in _touched(levels[level], to_unit)
        ]
        return SplatFile(
            splats=_whole(file, parts),
            layout=f"level {level} of detail",
            antialiased=file.index.antialias,
            origin=file.index.origin,
            path=Path(path),
            format=LOD_FORMAT,
            storage_bytes=file.storage_bytes,
            notes=(),
        )


def _fitting_level(levels: tuple[LodLevel, ...], most: int | None) -> int:
    fitting = (k for k, one in enumerate(levels) if most is None or one.splats <= most)
    return next(fitting, len(levels) - 1)


def _whole(file: LodFile, parts: list[Splats]) -> Splats:
    """All parts joined; an empty model without parts."""
    parts = [part for part in parts if len(part)]
    return joined(parts) if parts else Splats(**empty_splats(0, file.index.sh_degree))


def _inside(splats: Splats, to_unit: np.ndarray | None) -> Splats:
    if to_unit is None:
        return splats
    inside = in_unit_shape(splats.means.astype(np.float64), to_unit)
    return splats if inside.all() else splats.subset(np.flatnonzero(inside))


def _touched(level: LodLevel, to_unit: np.ndarray | None) -> list[int]:
    """Chunks that may have splats in the box."""
    if to_unit is None:
        return list(range(len(level.counts)))
    middle, half = (level.low + level.high) / 2, (level.high - level.low) / 2
    placed = middle @ to_unit[:3, :3].T + to_unit[:3, 3]
    reach = half @ np.abs(to_unit[:3, :3]).T
    # A small margin for rounding of the sides.
    return np.flatnonzero((np.abs(placed) <= (1 + reach) * (1 + 1e-9)).all(axis=1)).tolist()
