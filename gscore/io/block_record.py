"""Block record: `block.json`, the part of a capture that a block covers, for the later merge."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError
from ..events import strict_json
from ..json_text import parse_json
from ..quoting import brief
from ..scene import checked_origin, offset_between
from .files import atomic_write, is_file, read_bytes

BLOCK_RECORD = "block.json"
"""File in the folder of a block, itself a capture."""
RUN_BLOCK = "trained_block.json"
"""File in the folder of a run: the record of its block at the start of the run."""
_FARTHEST = 1e30
"""Largest finite bound, world units."""
_KIND = "gscore block 1"


@dataclass(frozen=True, kw_only=True)
class BlockRecord:
    """A block and the cells of all blocks."""

    split: str
    """Id of the split, common to its blocks."""
    index: int
    """Number of this block, from 0."""
    axes: np.ndarray
    """[2, 3] float64, unit directions along which the world is cut."""
    bounds: np.ndarray
    """[N, 2, 2] float64: per block, the lower and upper bounds along both axes, world units;
    infinite at the rim. Lower bounds are inclusive."""
    test_names: tuple[str, ...] = ()
    """Held-out views of the whole capture that are in this block."""
    masks_are: str = ""
    """Meaning of masks, as `Capture.masks_are`."""
    origin: np.ndarray | None = None
    """[3] float64, local origin of `bounds`, as `Cameras.origin`."""

    @property
    def count(self) -> int:
        """Number of blocks."""
        return len(self.bounds)

    def contains(self, points: np.ndarray, origin: np.ndarray | None = None) -> np.ndarray:
        """Mask [P] bool of the `points` [P, 3] in the block's cell, in the world of the capture
        relative to a local origin."""
        points = points + offset_between(origin, self.origin)
        return in_cells(points, self.axes, self.bounds[self.index][None])[0]

    def is_cell_of(self, other: "BlockRecord") -> bool:
        """True if both are the same cell of the same split."""
        return (
            (self.split, self.index) == (other.split, other.index)
            and np.array_equal(self.axes, other.axes)
            and np.array_equal(self.bounds, other.bounds)
        )

    def write(self, folder: Path, name: str = BLOCK_RECORD) -> None:
        """Write the record into the folder of its block, or as RUN_BLOCK into that of a run.

        Raises:
            GsError: the file cannot be written.
        """
        bounds = [[[_finite(value) for value in end] for end in cell] for cell in self.bounds]
        content = {
            "kind": _KIND,
            "split": self.split,
            "index": self.index,
            "axes": self.axes.tolist(),
            "bounds": bounds,
            "test_names": list(self.test_names),
            "masks_are": self.masks_are,
        }
        if self.origin is not None:
            content["origin"] = self.origin.tolist()
        atomic_write(folder / name, (strict_json(content) + "\n").encode())


def in_cells(points: np.ndarray, axes: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """Mask [N, P] bool of `points` [P, 3] in each of N cells; `axes` and `bounds` as in
    `BlockRecord`."""
    ground = (points @ axes.T)[None]
    inside = (ground >= bounds[:, None, 0]) & (ground < bounds[:, None, 1])
    return np.logical_and.reduce(inside, axis=-1)


def block_name(index: int) -> str:
    """Name of a block's folder within the folder of the split."""
    return f"block_{index}"


def block_records(folder: Path) -> dict[int, BlockRecord]:
    """Blocks by number in a folder that `gscore split` wrote; empty for other folders.

    Raises:
        FormatError: a record is damaged, or two blocks are from different splits.
        DatasetError: a record cannot be read.
    """
    records: dict[int, BlockRecord] = {}
    for path in sorted(folder.glob(f"block_*/{BLOCK_RECORD}")):
        record = read_block(path.parent)
        if record is None or path.parent.name != block_name(record.index):
            continue
        other = next(iter(records.values()), record)
        if other.split != record.split:
            raise FormatError(
                f"{brief(path.parent)} and {block_name(other.index)} next to it are from different "
                "splits. Keep the blocks of each split in their own folder."
            )
        records[record.index] = record
    return records


def read_block(folder: Path, name: str = BLOCK_RECORD) -> BlockRecord | None:
    """Record in the folder of a block, or as RUN_BLOCK in that of a run; None: no block.

    Raises:
        FormatError: the record is damaged.
        DatasetError: it cannot be read.
    """
    path = folder / name
    if not is_file(path):
        return None
    try:
        content = parse_json(read_bytes(path))
        return _record(content)
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
        raise FormatError(
            f"{brief(path)} is not a record of a block. Split the capture again with gscore split."
        ) from error


def _record(content: Any) -> BlockRecord:
    if content["kind"] != _KIND:
        raise ValueError
    ends = [
        [[_number(value, end) for value in pair] for end, pair in zip((-1, 1), cell, strict=True)]
        for cell in content["bounds"]
    ]
    record = BlockRecord(
        split=str(content["split"]),
        index=int(content["index"]),
        axes=np.array(content["axes"], np.float64),
        bounds=np.array(ends, np.float64),
        test_names=tuple(map(str, content["test_names"])),
        masks_are=str(content["masks_are"]),
        origin=checked_origin(content["origin"]) if "origin" in content else None,
    )
    whole = record.axes.shape == (2, 3) and record.bounds.shape == (record.count, 2, 2)
    if not whole or not 0 <= record.index < record.count or not _tiles(record):
        raise ValueError
    return record


def _tiles(record: BlockRecord) -> bool:
    """True if the block's cell overlaps no other and the cells fill the world: within a square
    around all finite bounds, their areas add up to its area. Overlaps among the other cells are
    checked with their own records."""
    axes, bounds = record.axes, record.bounds
    most = 2 * np.abs(bounds[np.isfinite(bounds)]).max(initial=0.5)
    if not np.allclose(axes @ axes.T, np.eye(2), atol=1e-6) or not most < _FARTHEST:
        return False
    low, high = np.moveaxis(np.clip(bounds, -most, most), 1, 0)
    own_low, own_high = low[record.index], high[record.index]
    overlapping = ((low < own_high) & (own_low < high)).all(axis=1)
    area = float(np.prod(high - low, axis=1).sum())
    whole = math.isclose(area, float(2 * most) ** 2, rel_tol=1e-6)
    return bool((low < high).all()) and overlapping.sum() == 1 and whole


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _number(value: float | None, end: int) -> float:
    """Bound from JSON, which has no infinity: null is infinite."""
    return end * math.inf if value is None else float(value)
