"""Merge of block splats: the splats of each trained block inside its own cell."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import ConfigError
from ..formats.joined import joined
from ..io.block_record import BlockRecord
from ..splats import Splats
from ..text_format import count_text, number


@dataclass(frozen=True, kw_only=True)
class TrainedBlock:
    """Training result of a block."""

    path: Path
    """Path of the run, for messages."""
    record: BlockRecord
    splats: Splats
    """Splats in COLMAP's world."""
    origin: np.ndarray | None = None
    """[3] float64, local origin of the splats, the same for all blocks."""


@dataclass(frozen=True, kw_only=True)
class Merged:
    """Merged blocks."""

    splats: Splats
    kept: tuple[int, ...]
    """Number of kept splats per block."""


def check_complete(runs: Sequence[tuple[Path, BlockRecord]]) -> None:
    """Raise unless these are all blocks of one split, each once.

    Raises:
        ConfigError: blocks are of different splits, duplicate or missing.
    """
    first_path, first = runs[0]
    found: dict[int, Path] = {}
    for path, record in runs:
        if record.split != first.split or not replace(record, index=first.index).is_cell_of(first):
            raise ConfigError(
                f"{path} and {first_path} were trained on blocks that were not cut together. "
                "Train all blocks of one `gscore split`."
            )
        if record.index in found:
            raise ConfigError(
                f"{path} and {found[record.index]} were trained on the same block, "
                f"{record.index}; give one of them."
            )
        found[record.index] = path
    missing = [index for index in range(first.count) if index not in found]
    if missing:
        listed = ", ".join(map(str, missing[:10])) + (", ..." if len(missing) > 10 else "")
        raise ConfigError(
            f"{number(len(missing))} of {count_text(first.count, 'block')} "
            f"{'is' if len(missing) == 1 else 'are'} missing: {listed}. Train them "
            f"(gscore train BLOCKS --block {missing[0]} -o RUNS), or give their runs too."
        )


def merge_blocks(blocks: Sequence[TrainedBlock]) -> Merged:
    """Keep the splats of each block whose centres are in its cell, in the order of the blocks.

    Cells fill the world without overlap, so nothing is duplicated or lost at a seam. Splats outside
    the view of a block's photos also belong to the cell they are in.

    Args:
        blocks: All blocks of one split, checked by `check_complete`.
    """
    parts = []
    for block in sorted(blocks, key=lambda block: block.record.index):
        inside = block.record.contains(block.splats.means.astype(np.float64), block.origin)
        parts.append(block.splats.subset(inside))
    return Merged(splats=joined(parts), kept=tuple(len(part) for part in parts))
