"""gscore split and gscore merge, from a capture to one file of splats."""

import json
import shutil

import numpy as np
import pytest

from gscore.io.block_record import read_block
from gscore.io.ply.splats import MIP_COMMENT, header_comments, read_ply
from tests.trainer.distributed.start_ranks import start

SHORT = ("--preset", "draft", "--iterations", 3, "--quiet")


@pytest.fixture(scope="module")
def blocks(tmp_path_factory, capture):
    """Two blocks of the capture, and runs of three steps on them."""
    from gscore.commands import main

    folder = tmp_path_factory.mktemp("blocks")
    lines = [("split", capture, "-o", folder / "blocks", "--blocks", 2, "--quiet")]
    for i in range(2):
        lines.append(("train", folder / f"blocks/block_{i}", "-o", folder / f"runs/{i}", *SHORT))
    for line in lines:
        assert main([str(word) for word in line]) == 0
    return folder


def test_split_says_what_each_block_has(gscore, capture, tmp_path):
    """Oracle: the blocks' records and folders; a next command that can be copied."""
    out = tmp_path / "blocks"
    code, text, err = gscore("split", capture, "-o", out, "--blocks", 2)
    assert code == 0 and not err
    assert "9 photos" in text and f"Next: gscore train {out} -o RUNS" in text
    assert "Nearly every photo shows every block" in text
    code, text, _ = gscore("split", capture, "-o", tmp_path / "other", "--blocks", 2, "--json")
    facts = json.loads(text)
    assert code == 0 and facts["photos"] == 9 and len(facts["blocks"]) == 2
    for index, block in enumerate(facts["blocks"]):
        record = read_block(out / f"block_{index}")
        assert record is not None and block["test_photos"] == len(record.test_names)
        images = list((out / f"block_{index}/images").iterdir())
        assert block["photos"] == len(images)
    assert sum(block["own_points"] for block in facts["blocks"]) == facts["points"]


def test_merge_keeps_each_block_to_its_cell(gscore, blocks, tmp_path):
    """Oracle: the splats of both runs, cut by the bounds of the records; the same bytes for runs
    one by one and as a folder."""
    out = tmp_path / "merged.ply"
    code, text, _ = gscore("merge", blocks / "runs", "-o", out)
    merged = read_ply(out)
    kept = []
    for index in range(2):
        record = read_block(blocks / f"blocks/block_{index}")
        means = read_ply(blocks / f"runs/{index}/point_cloud.ply").means
        ground = means.astype(np.float64) @ record.axes.T
        low, high = record.bounds[index]
        kept.append(means[((ground >= low) & (ground < high)).all(axis=1)])
    np.testing.assert_array_equal(merged.means, np.concatenate(kept))
    assert code == 0 and f"{len(merged)} splats of" in text
    runs = [blocks / "runs/1", blocks / "runs/0"]
    code, text, _ = gscore("merge", *runs, "-o", tmp_path / "again.ply", "--json")
    facts = json.loads(text)
    assert [block["kept"] for block in facts["blocks"]] == [len(part) for part in kept]
    assert (tmp_path / "again.ply").read_bytes() == out.read_bytes()


def test_a_block_that_starts_from_splats_grows_in_its_cell(gscore, blocks, tmp_path):
    """Oracle: the splats on both sides of the cell's bounds, before and after; growth on both sides
    for the same photos as a separate capture."""
    start = tmp_path / "start.ply"
    gscore("merge", blocks / "runs", "-o", start)
    record = read_block(blocks / "blocks/block_0")
    low, high = record.bounds[0]

    def inside_and_around(path):
        ground = read_ply(path).means.astype(np.float64) @ record.axes.T
        inside = ((ground >= low) & (ground < high)).all(axis=1)
        return int(inside.sum()), int((~inside).sum())

    line = ("--preset", "preview", "--iterations", 60, "--refine-every", 10, "--refine-start", 10)
    line = (*line, "--grow-grad", 1e-7, "--max-splats", 9000, "--start-splats", start)
    plain = tmp_path / "plain"
    shutil.copytree(blocks / "blocks/block_0", plain)
    (plain / "block.json").unlink()
    reported, found = [], [inside_and_around(start)]
    for source in (blocks / "blocks/block_0", plain):
        code, _, err = gscore("train", source, "-o", tmp_path / f"run_{source.stem}", *line)
        assert code == 0
        reported.append("Splats are added only in the block's cell" in err)
        found.append(inside_and_around(tmp_path / f"run_{source.stem}/point_cloud.ply"))
    assert reported == [True, False]
    (inside, around), block, whole = found
    assert block[0] > 4 * inside and whole[0] > 4 * inside
    # Splats move: some that were created inside end up outside.
    assert block[1] < 2 * around and whole[1] > 4 * around


def test_blocks_that_were_moved(gscore, blocks, tmp_path):
    """Oracle: the same file by the paths recorded in the runs; without them a sentence that names
    the option, which gives the same file."""
    elsewhere = tmp_path / "elsewhere"
    shutil.copytree(blocks / "runs", elsewhere)
    for config in elsewhere.glob("*/config.json"):
        config.write_text(config.read_text().replace(str(blocks / "blocks"), "/gone/blocks"))
    assert gscore("merge", elsewhere, "-o", tmp_path / "c.ply")[0] == 0
    for record in elsewhere.glob("*/trained_block.json"):
        record.unlink()
    code, _, err = gscore("merge", elsewhere, "-o", tmp_path / "a.ply")
    assert code == 2 and "no longer exists. Give the folder of the blocks" in err
    given = ("--blocks", blocks / "blocks")
    code, _, err = gscore("merge", elsewhere, "-o", tmp_path / "a.ply", *given)
    assert code == 0 and "0 does not record its block" in " ".join(err.split())
    gscore("merge", blocks / "runs", "-o", tmp_path / "b.ply")
    for name in ("a.ply", "c.ply"):
        assert (tmp_path / name).read_bytes() == (tmp_path / "b.ply").read_bytes()


def test_a_folder_that_was_split_again(gscore, blocks, capture, tmp_path):
    """Oracle: different bounds of both splits, so that runs on the first do not fit the second and
    are refused with no files written; the file of the first split once the new blocks are moved
    away. A resumed run takes the new cell where its photos and points are the same."""
    runs, cut = tmp_path / "runs", tmp_path / "blocks"
    shutil.copytree(blocks / "blocks", cut)
    for i in range(2):
        assert gscore("train", cut, "--block", i, "-o", runs, *SHORT)[0] == 0
    first = read_block(cut / "block_0")
    shutil.rmtree(cut)
    assert gscore("split", capture, "-o", cut, "--blocks", 3, "--quiet")[0] == 0
    assert not read_block(cut / "block_0").is_cell_of(first)
    code, _, err = gscore("merge", runs, "-o", tmp_path / "a.ply")
    words = " ".join(err.split())
    assert code == 2 and "block 0 of 2 of another split" in words, err
    assert not (tmp_path / "a.ply").exists()
    cut.rename(tmp_path / "away")
    assert gscore("merge", runs, "-o", tmp_path / "a.ply")[0] == 0
    gscore("merge", blocks / "runs", "-o", tmp_path / "b.ply")
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
    (tmp_path / "away").rename(cut)
    assert gscore("train", cut, "--block", 0, "-o", runs, *SHORT, "--resume")[0] == 0
    now = read_block(runs / "block_0", "trained_block.json")
    assert now is not None and now.is_cell_of(read_block(cut / "block_0"))


def test_merge_into_a_run_is_refused(gscore, blocks, tmp_path):
    """Oracle: code 2 and unchanged bytes, for any place below the folder of a run."""
    runs = tmp_path / "runs"
    shutil.copytree(blocks / "runs", runs)
    before = {path: path.read_bytes() for path in runs.rglob("*") if path.is_file()}
    (tmp_path / "link").symlink_to(runs / "1")
    for place in (runs / "0/point_cloud.ply", runs / "1/new/a.ply", tmp_path / "link/a.ply"):
        code, _, err = gscore("merge", runs, "-o", place, "--overwrite")
        assert code == 2 and "is in the folder of a training" in " ".join(err.split()), err
    assert {path: path.read_bytes() for path in runs.rglob("*") if path.is_file()} == before


def test_runs_that_do_not_fit_together(gscore, blocks, trained, tmp_path):
    """Oracle: one sentence each, code 2, no files; the options that differ are named."""
    out = tmp_path / "merged.ply"
    for runs, words in (
        ([blocks / "runs/1"], "1 of 2 blocks is missing: 0. Train them (gscore train"),
        ([blocks / "runs/1", blocks / "runs/1"], "on the same block, 1"),
        ([trained], "which is not a block"),
        ([blocks / "blocks"], "is not a run and contains none"),
        ([tmp_path / "nowhere"], "is not a folder"),
    ):
        code, _, err = gscore("merge", *runs, "-o", out)
        assert code == 2 and words in " ".join(err.split()), err
    block = blocks / "blocks/block_1"
    gscore("train", block, "-o", tmp_path / "other", *SHORT, "--sh-degree", 1)
    code, _, err = gscore("merge", blocks / "runs/0", tmp_path / "other", "-o", out)
    assert code == 0 and "sh_degree was 2, is 1" in " ".join(err.split())
    out.unlink()
    gscore("train", block, "-o", tmp_path / "third", *SHORT, "--antialias")
    code, _, err = gscore("merge", blocks / "runs/0", tmp_path / "third", "-o", out)
    assert code == 2 and "differ in --antialias" in " ".join(err.split())
    assert not out.exists()


def splats_in(runs):
    """The bytes of the splats of each block, by the names of their folders."""
    return {path.parent.name: path.read_bytes() for path in runs.glob("*/point_cloud.ply")}


def test_blocks_are_trained_in_turn_or_by_number(gscore, blocks, tmp_path):
    """Oracle: the splats of both blocks, trained as separate captures; complete ones are unchanged;
    numbers and folders that do not exist are refused."""
    alone = {f"block_{i}": (blocks / f"runs/{i}/point_cloud.ply").read_bytes() for i in range(2)}
    runs, cut = tmp_path / "runs", blocks / "blocks"
    assert gscore("train", cut, "--block", 1, "-o", runs, *SHORT)[0] == 0
    assert splats_in(runs) == {"block_1": alone["block_1"]}
    before = (runs / "block_1/point_cloud.ply").stat()
    for words, sentence in (
        ([cut, *SHORT], "contains runs on 1 block, the first in block_1; continue with"),
        ([cut, *SHORT, "--block", 2], "There is no block 2 in"),
        ([blocks / "runs", *SHORT, "--block", 0], "contains no blocks"),
    ):
        code, _, err = gscore("train", *words, "-o", runs)
        assert code == 2 and sentence in " ".join(err.split()), err
    assert gscore("train", cut, "-o", runs, *SHORT, "--resume")[0] == 0
    assert splats_in(runs) == alone
    assert (runs / "block_1/point_cloud.ply").stat() == before


@pytest.mark.slow
def test_ranks_take_blocks_in_turn(blocks, tmp_path):
    """Oracle: the splats of blocks trained one by one; output from rank 0 alone, and no restart
    files left."""
    runs = tmp_path / "runs"
    line = ["-m", "gscore", "train", blocks / "blocks", "-o", runs, *SHORT]
    ranks = start(line, line)
    assert [rank.code for rank in ranks] == [0, 0], ranks
    alone = {f"block_{i}": (blocks / f"runs/{i}/point_cloud.ply").read_bytes() for i in range(2)}
    assert splats_in(runs) == alone
    assert {path.name for path in runs.iterdir()} == {"block_0", "block_1"}
    ranks = start(line, line)
    assert [rank.code for rank in ranks] == [2, 2]
    assert "contains runs on 2 blocks" in " ".join(ranks[0].err.split())
    assert not ranks[1].err


def test_unfinished_runs_are_refused(gscore, blocks, tmp_path):
    """Oracle: sentences with a remedy, for a stopped run and a killed one."""
    runs = tmp_path / "runs"
    shutil.copytree(blocks / "runs", runs)
    metrics = runs / "1/metrics.json"
    metrics.write_text(json.dumps(json.loads(metrics.read_text()) | {"reason": "interrupted"}))
    code, _, err = gscore("merge", runs, "-o", tmp_path / "a.ply")
    assert code == 0 and "1 was stopped after 3 steps (interrupted)" in " ".join(err.split())
    (runs / "1/point_cloud.ply").unlink()
    code, _, err = gscore("merge", runs, "-o", tmp_path / "b.ply")
    assert code == 2 and "has not ended: it has a checkpoint after 3 steps" in " ".join(err.split())
    assert not (tmp_path / "b.ply").exists()


def test_info_says_which_block_it_is(gscore, blocks, capture):
    """Oracle: the record of the block; no mention of blocks for other captures."""
    assert "block 1 of 2, numbered from 0" in gscore("info", blocks / "blocks/block_1")[1]
    facts = json.loads(gscore("info", blocks / "blocks/block_1", "--json")[1])
    assert facts["block"] == {"index": 1, "count": 2}
    assert "block" not in json.loads(gscore("info", capture, "--json")[1])


def test_the_mark_of_antialiasing_goes_on(gscore, blocks, tmp_path):
    """Oracle: the comments of the header."""
    for i in range(2):
        block = blocks / f"blocks/block_{i}"
        gscore("train", block, "-o", tmp_path / f"runs/{i}", *SHORT, "--antialias")
    assert gscore("merge", tmp_path / "runs", "-o", tmp_path / "a.ply")[0] == 0
    assert MIP_COMMENT in header_comments(tmp_path / "a.ply")


def test_unwritable_outputs_are_refused(gscore, blocks, capture, tmp_path):
    """Oracle: a sentence, and the existing files."""
    full = tmp_path / "full"
    full.mkdir()
    (full / "mine.ply").write_text("mine")
    code, _, err = gscore("split", capture, "-o", full, "--blocks", 2)
    assert code == 2 and "is not empty" in err
    code, _, err = gscore("split", capture, "-o", capture, "--blocks", 2)
    assert code == 2 and "is the capture itself" in " ".join(err.split())
    code, _, err = gscore("merge", blocks / "runs", "-o", full / "mine.ply")
    assert code == 2 and (full / "mine.ply").read_text() == "mine"
    code, _, err = gscore("merge", blocks / "runs", "-o", full / "mine.txt")
    assert code == 2 and "no format of splats has this ending" in " ".join(err.split())
