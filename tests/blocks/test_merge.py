"""Blocks put together; oracle: the splats of one model, cut apart and put together again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gscore.blocks.cut import cut_capture
from gscore.blocks.merge import TrainedBlock, check_complete, merge_blocks
from gscore.config import DataConfig
from gscore.errors import ConfigError
from gscore.io.block_record import BlockRecord
from gscore.splats import Splats


@pytest.fixture
def records(capture: Path) -> list[BlockRecord]:
    """Of four blocks of the street."""
    cut = cut_capture(DataConfig(source=capture, eval=True), 4)
    return [block.record for block in cut.blocks]


def some_splats(count: int, rest: int = 3) -> Splats:
    rng = np.random.default_rng(count)
    draw = lambda *shape: rng.normal(size=(count, *shape)).astype(np.float32)  # noqa: E731
    return Splats(
        means=draw(3) * 30,
        quats=draw(4),
        scales=draw(3),
        opacities=draw(),
        sh0=draw(1, 3),
        shN=draw(rest, 3),
    )


def test_what_every_block_holds_comes_out_once(records: list[BlockRecord]) -> None:
    """Oracle: all blocks hold the same model, so the merged one is that model, in another order."""
    model = some_splats(3000)
    blocks = [
        TrainedBlock(path=Path(str(record.index)), record=record, splats=model)
        for record in reversed(records)
    ]
    merged = merge_blocks(blocks)
    assert sum(merged.kept) == len(merged.splats) == 3000
    order = np.lexsort(merged.splats.means.T)
    given = np.lexsort(model.means.T)
    for name, values in vars(merged.splats).items():
        assert (values[order] == vars(model)[name][given]).all(), name


def test_each_block_gives_its_own_cell_alone(records: list[BlockRecord]) -> None:
    """Oracle: the mark of the block on its splats, by the bounds of its record; degrees of SH that
    differ come out as the highest."""
    blocks = []
    for record in records:
        splats = some_splats(500, rest=3 if record.index else 8)
        marked = replace(splats, opacities=np.full(500, record.index, np.float32))
        blocks.append(TrainedBlock(path=Path("run"), record=record, splats=marked))
    merged = merge_blocks(blocks).splats
    assert merged.shN.shape[1] == 8
    ground = merged.means.astype(np.float64) @ records[0].axes.T
    for record in records:
        low, high = record.bounds[record.index]
        mine = ((ground >= low) & (ground < high)).all(axis=1)
        assert mine.any() and ((merged.opacities == record.index) == mine).all()


def test_only_all_blocks_of_one_split_can_be_merged(records: list[BlockRecord]) -> None:
    """Oracle: sentences that name the runs and the blocks."""
    runs = [(Path(f"run{record.index}"), record) for record in records]
    check_complete(runs[::-1])
    with pytest.raises(ConfigError, match=r"2 of 4 blocks are not there: 1, 3\."):
        check_complete(runs[::2])
    with pytest.raises(ConfigError, match="run0 and run0 were trained on the same block, 0"):
        check_complete([*runs, runs[0]])
    other = (Path("other"), replace(records[1], split="another"))
    with pytest.raises(ConfigError, match="other and run0 were trained on blocks that were not"):
        check_complete([runs[0], other])
