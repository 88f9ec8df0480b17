"""Merge of block splats: from each trained block the splats inside its own cell."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import ConfigError
from ..formats.joined import joined
from ..io.block_record import BlockRecord
from ..splats import Splats
from ..text_format import count_words, number


@dataclass(frozen=True, kw_only=True)
class TrainedBlock:
    """Result of a block."""

    path: Path
    """Of the run, for messages."""
    record: BlockRecord
    splats: Splats
    """In COLMAP world."""
    origin: np.ndarray | None = None
    """[3] float64, the local origin that they are about, the same for all blocks."""


@dataclass(frozen=True, kw_only=True)
class Merged:
    """The blocks as one."""

    splats: Splats
    kept: tuple[int, ...]
    """By block, how many of its splats lie in its cell."""


def check_complete(runs: Sequence[tuple[Path, BlockRecord]]) -> None:
    """Raise unless these are all blocks of one split, each once.

    Raises:
        ConfigError: blocks of different splits, one twice, or some missing.
    """
    first_path, first = runs[0]
    found: dict[int, Path] = {}
    for path, record in runs:
        if record.split != first.split or not _same_cells(record, first):
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
            f"{number(len(missing))} of {count_words(first.count, 'block')} "
            f"{'is' if len(missing) == 1 else 'are'} not there: {listed}. Train what is "
            f"missing (gscore train BLOCKS --block {missing[0]} -o RUNS), or give its run too."
        )


def _same_cells(one: BlockRecord, other: BlockRecord) -> bool:
    return replace(one, index=other.index).is_cell_of(other)


def merge_blocks(blocks: Sequence[TrainedBlock]) -> Merged:
    """Keep of each block the splats whose centres lie in its cell, in the order of the blocks.

    Cells fill the world without overlap, so nothing is there twice and nothing is cut away at a
    seam. Splats outside of all that a block's photos show go with the cell that they lie in.

    Args:
        blocks: All of one split, as `check_complete` wants them.
    """
    parts = []
    for block in sorted(blocks, key=lambda block: block.record.index):
        inside = block.record.holds(block.splats.means.astype(np.float64), block.origin)
        parts.append(block.splats.subset(inside))
    return Merged(splats=joined(parts), kept=tuple(len(part) for part in parts))
