"""Merged blocks; oracle: the splats of one model, cut apart and merged again."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gscore.blocks.block_cells import make_cells
from gscore.blocks.split_capture import cut_capture
from gscore.commands.merge import TrainedBlock, check_complete, merge_blocks
from gscore.config import DataConfig
from gscore.errors import ConfigError, FormatError
from gscore.io.block_record import BlockRecord, read_block
from gscore.splats import Splats


@pytest.fixture
def records(capture: Path) -> list[BlockRecord]:
    """Records of four blocks of the street."""
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


def test_shared_splats_are_merged_once(records: list[BlockRecord]) -> None:
    """Oracle: the one model of all blocks, in another order."""
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
    """Oracle: the mark of the block on its splats, by the bounds of its record; the highest of
    different SH degrees."""
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
    """Oracle: sentences with the runs and the blocks."""
    runs = [(Path(f"run{record.index}"), record) for record in records]
    check_complete(runs[::-1])
    with pytest.raises(ConfigError, match=r"2 of 4 blocks are missing: 1, 3\."):
        check_complete(runs[::2])
    with pytest.raises(ConfigError, match="run0 and run0 were trained on the same block, 0"):
        check_complete([*runs, runs[0]])
    other = (Path("other"), replace(records[1], split="another"))
    with pytest.raises(ConfigError, match="other and run0 were trained on blocks that were not"):
        check_complete([runs[0], other])


@pytest.mark.parametrize(
    ("odd", "changed"),
    [
        ("overlap", {"bounds": [[[None, None], [1.0, None]], [[0.0, None], [None, None]]]}),
        ("gap", {"bounds": [[[None, None], [-1.0, None]], [[0.0, None], [None, None]]]}),
        ("inverted", {"bounds": [[[None, 2.0], [0.0, 1.0]], [[0.0, None], [None, None]]]}),
        ("all the world", {"bounds": [[[None, None], [None, None]]] * 2}),
        ("beyond", {"bounds": [[[None, None], [1e300, None]], [[1e300, None], [None, None]]]}),
        ("NaN", {"bounds": [[[None, None], [float("nan"), None]], [[0.0, None], [None, None]]]}),
        ("slanted", {"axes": [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]}),
        ("long", {"axes": [[2.0, 0.0, 0.0], [0.0, 0.0, 1.0]]}),
    ],
)
def test_cells_that_do_not_fill_the_world_once_are_refused(
    odd: str, changed: dict, tmp_path: Path
) -> None:
    """Oracle: two halves of the world, read back; with one number changed, a splat would be in two
    cells or in none."""
    content = {
        "kind": "gscore block 1",
        "split": "a",
        "index": 0,
        "axes": [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        "bounds": [[[None, None], [0.0, None]], [[0.0, None], [None, None]]],
        "test_names": [],
        "masks_are": "",
    }
    (tmp_path / "block.json").write_text(json.dumps(content))
    record = read_block(tmp_path)
    assert record is not None and record.count == 2, odd
    (tmp_path / "block.json").write_text(json.dumps(content | changed))
    with pytest.raises(FormatError, match="not a record of a block"):
        read_block(tmp_path)


@pytest.mark.parametrize("count", [2, 3, 7, 64])
def test_cells_that_were_cut_are_read_back(capture: Path, count: int, tmp_path: Path) -> None:
    """Oracle: the original cells; any number of them, far from the origin too."""
    rng = np.random.default_rng(count)
    xyz = rng.normal(size=(5000, 3)) * [100, 1, 30] + [5e5, 0, 5e6]
    viewmats = np.tile(np.eye(4), (4, 1, 1))
    cells = make_cells(xyz, np.ones(5000), viewmats, count, up=None)
    for index in range(count):
        record = BlockRecord(split="a", index=index, axes=cells.axes, bounds=cells.bounds)
        record.write(tmp_path)
        found = read_block(tmp_path)
        assert found is not None and found.is_cell_of(record)


def test_blocks_with_other_bounds_under_one_name_are_refused(records: list[BlockRecord]) -> None:
    """Oracle: the sentence of blocks that were not cut together."""
    moved = replace(records[1], bounds=records[1].bounds + 1)
    with pytest.raises(ConfigError, match="blocks that were not cut together"):
        check_complete([(Path("a"), records[0]), (Path("b"), moved)])
