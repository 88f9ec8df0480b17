"""Files of levels of detail, built and read. Oracle: the PLY that they are made from."""

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gscore.errors import ConfigError, DatasetError, FormatError, GsError
from gscore.io.lod_file import HEADER_BYTES, is_lod_file, open_lod_file
from gscore.io.ply.splats import read_ply, read_ply_parts, write_splats
from gscore.lod import groups
from gscore.lod.build import LodFacts, build_lod
from gscore.lod.lod_renderer import choose_chunks
from gscore.raster.request import Frustum
from gscore.splats import PARAMETERS

from .conftest import CHUNK, COUNT, camera, wall


def as_rows(splats) -> np.ndarray:
    """[N, F] of all parameters."""
    return np.concatenate([getattr(splats, n).reshape(len(splats), -1) for n in PARAMETERS], 1)


def in_order(rows: np.ndarray) -> np.ndarray:
    return rows[np.lexsort(rows.T)]


def test_the_finest_level_is_the_model(ply: Path, lod: Path) -> None:
    """Oracle: the rows of the PLY, to the bit, each once; boxes that contain them."""
    with open_lod_file(lod) as file:
        chunks = list(file.chunks(0))
        level = file.index.levels[0]
    found = np.concatenate([as_rows(chunk) for chunk in chunks])
    np.testing.assert_array_equal(in_order(found), in_order(as_rows(read_ply(ply))))
    assert [len(chunk) for chunk in chunks] == level.counts.tolist()
    for chunk, low, high, reach in zip(chunks, level.low, level.high, level.reach, strict=True):
        np.testing.assert_array_equal(chunk.means.min(axis=0), low)
        np.testing.assert_array_equal(chunk.means.max(axis=0), high)
        assert reach == pytest.approx(float(np.exp(chunk.scales.max())), rel=1e-6)


def test_levels_have_a_quarter_each(lod: Path) -> None:
    """Oracle: numbers of chunks and splats; errors that grow, measured in pictures."""
    with open_lod_file(lod) as file:
        levels = file.index.levels
    assert [len(level.counts) for level in levels] == [16, 4, 1]
    assert levels[0].splats == COUNT and levels[0].counts.max() <= CHUNK
    for below, above in itertools.pairwise(levels):
        assert below.splats / 4 <= above.splats <= below.splats / 4 + len(above.counts)
        assert above.error > below.error
    assert levels[0].error == 0 and levels[0].psnr is None
    assert all(level.psnr is not None and level.psnr > 15 for level in levels[1:])


def test_chunks_are_compact_and_even() -> None:
    """Oracle: areas of the boxes of a square, which one splat far away does not change."""
    means = wall().means.copy()
    means[17] = 1e6
    chunks = groups.chunks_of(means, 2)
    counts = np.bincount(chunks)
    assert len(counts) == 16 and np.ptp(counts) <= 1
    areas = [np.ptp(means[chunks == c, :2], axis=0).prod() for c in range(16) if c != chunks[17]]
    assert max(areas) < 3 * 64 / 16


def test_the_same_bytes_again(ply: Path, lod: Path, tmp_path: Path, monkeypatch) -> None:
    """Oracle: the bytes of a second build, with parts of the PLY of another size."""
    from gscore.lod import build
    from gscore.lod.measure import measured_levels

    monkeypatch.setattr(groups, "MOST_IN_A_CHUNK", CHUNK)
    monkeypatch.setattr(build, "_PART", 777)
    build_lod(ply, tmp_path / "b.lod", LodFacts(near=0.02), measured=measured_levels)
    assert (tmp_path / "b.lod").read_bytes() == lod.read_bytes()


def test_a_small_model_has_one_level(tmp_path: Path) -> None:
    """Oracle: one chunk with all of it, of SH degree 0."""
    write_splats(tmp_path / "a.ply", wall(7, degree_rest=0))
    index = build_lod(tmp_path / "a.ply", tmp_path / "a.lod", LodFacts())
    assert len(index.levels) == 1 and index.levels[0].counts.tolist() == [7]
    with open_lod_file(tmp_path / "a.lod") as file:
        assert next(file.chunks(0)).sh_degree == 0


def test_a_model_without_splats(tmp_path: Path) -> None:
    """Oracle: a sentence, and no file."""
    write_splats(tmp_path / "a.ply", wall(3).subset(np.zeros(0, np.int64)))
    with pytest.raises(ConfigError, match="contains no splats that can be drawn"):
        build_lod(tmp_path / "a.ply", tmp_path / "a.lod", LodFacts())
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]


def test_splats_that_cannot_be_drawn_are_left_out(tmp_path: Path, caplog) -> None:
    """Oracle: the rest of them; one warning that counts those of all parts."""
    splats = wall(500)
    splats.means[[3, 450], 1] = np.nan
    write_splats(tmp_path / "a.ply", splats)
    parts = list(read_ply_parts(tmp_path / "a.ply", 100))
    assert [len(part) for part in parts] == [99, 100, 100, 100, 99]
    assert caplog.text.count("2 of 500 splats") == 1
    index = build_lod(tmp_path / "a.ply", tmp_path / "a.lod", LodFacts())
    assert index.levels[0].splats == 498


def test_a_stopped_build_leaves_nothing(ply: Path, tmp_path: Path) -> None:
    """Oracle: the folder, after an interrupt in the middle of the work."""

    def stop(what: str, share: float) -> None:
        if what == "Merging splats":
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(groups, "MOST_IN_A_CHUNK", CHUNK)
        with pytest.raises(KeyboardInterrupt):
            build_lod(ply, tmp_path / "a.lod", LodFacts(), on_share=stop)
    assert not list(tmp_path.iterdir())


def test_a_model_that_changes_meanwhile(ply: Path, tmp_path: Path) -> None:
    """Oracle: a sentence where the second pass finds fewer splats, and no file."""
    path = tmp_path / "a.ply"
    write_splats(path, wall(300))

    def cut(what: str, share: float) -> None:
        if what == "Sorting splats by position":
            write_splats(path, wall(200))

    with pytest.raises(DatasetError, match="changed while it was read"):
        build_lod(path, tmp_path / "a.lod", LodFacts(), on_share=cut)
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]


@pytest.mark.parametrize("share", [0, 0.001, 0.5, 0.999])
def test_truncated(lod: Path, tmp_path: Path, share: float) -> None:
    """Oracle: a sentence that names the file, for any truncation."""
    path = tmp_path / "cut.lod"
    content = lod.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(FormatError, match=r"cut\.lod.*(truncated or damaged|not a file of levels)"):
        open_lod_file(path)


def test_missing(tmp_path: Path) -> None:
    """Oracle: a sentence."""
    with pytest.raises(DatasetError, match="there is no such file"):
        open_lod_file(tmp_path / "none.lod")
    assert not is_lod_file(tmp_path / "none.lod") and not is_lod_file(tmp_path)


def test_a_damaged_chunk_is_named(lod: Path, tmp_path: Path) -> None:
    """Oracle: one flipped bit; neighbouring chunks are read."""
    content = bytearray(lod.read_bytes())
    with open_lod_file(lod) as file:
        begin = int(file.index.offsets(1)[2])
    content[HEADER_BYTES + begin + 5] ^= 16
    (tmp_path / "bad.lod").write_bytes(content)
    with open_lod_file(tmp_path / "bad.lod") as file:
        file.chunk(1, 1)
        with pytest.raises(FormatError, match=r"chunk 2 of level 1 is damaged\. Copy"):
            file.chunk(1, 2)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (rb'"kind": "gscore levels', b'"kind": "gscore lovels'),
        (rb'"sh_degree": 1', b'"sh_degree": 7'),
        (rb'"sh_degree": 1', b'"sh_degree": 2'),
        (rb'"near": 0.02', b'"near": null'),
        (rb'"near": 0.02', b'"near": -0.2'),
        (rb'"counts": \[375', b'"counts": [376'),
        (rb'"counts": \[375', b'"counts": [-75'),
        (rb'"counts": \[375', b'"counts": [{}5'),
        (rb'"against": 0', b'"against": 9'),
        (rb'"levels": \[\{', b'"levels": [[{'),
        (rb'"low": \[\[', b'"low": [[1e400,'),
    ],
)
def test_a_damaged_index(lod: Path, tmp_path: Path, old: bytes, new: bytes) -> None:
    """Oracle: a sentence that names the file; the index keeps its length where possible."""
    content = lod.read_bytes()
    begin = int(content[:HEADER_BYTES].split()[6])
    text, found = re.subn(old, new, content[begin:], count=1)
    assert found
    header = content[:HEADER_BYTES].replace(b"%020d" % (len(content) - begin), b"%020d" % len(text))
    (tmp_path / "bad.lod").write_bytes(header + content[HEADER_BYTES:begin] + text)
    with pytest.raises(FormatError, match=r"bad\.lod"):
        open_lod_file(tmp_path / "bad.lod")


def test_bytes_turned_at_random(lod: Path, tmp_path: Path) -> None:
    """Oracle: whole chunks or a sentence, for a difference in any byte."""
    content = lod.read_bytes()
    begin = int(content[:HEADER_BYTES].split()[6])
    rng = np.random.default_rng(4)
    places = [*rng.integers(0, HEADER_BYTES, 20), *rng.integers(begin, len(content), 60)]
    for place in places:
        bad = bytearray(content)
        bad[place] ^= 1 << int(rng.integers(8))
        (tmp_path / "bad.lod").write_bytes(bad)
        try:
            with open_lod_file(tmp_path / "bad.lod") as file:
                for level in range(len(file.index.levels)):
                    list(file.chunks(level))
        except GsError as error:
            assert "bad.lod" in str(error)


@pytest.mark.parametrize("size", [20.0, 60.0])
def test_giants_do_not_hide_the_errors_of_others(
    lod: Path, tmp_path: Path, size: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the errors of the levels without the giants, one splat of a thousand."""
    monkeypatch.setattr(groups, "MOST_IN_A_CHUNK", CHUNK)
    splats = wall()
    splats.scales[::1000] = size
    write_splats(tmp_path / "a.ply", splats)
    found = build_lod(tmp_path / "a.ply", tmp_path / "a.lod", LodFacts(near=0.02))
    with open_lod_file(lod) as file:
        for level, plain in zip(found.levels[1:], file.index.levels[1:], strict=True):
            np.testing.assert_allclose(level.errors, plain.errors, rtol=0.4)


def test_errors_of_zero_are_not_believed(lod: Path) -> None:
    """Oracle: the choice by the true errors: finest chunks close up, the coarsest far away."""
    with open_lod_file(lod) as file:
        index = file.index
    levels = tuple(replace(one, errors=np.zeros(len(one.errors))) for one in index.levels)
    for away, wanted in ((2.0, 0), (1e5, 2)):
        K, viewmat = camera(away)
        view = Frustum(K=K, viewmat=viewmat, width=96, height=64, near=0.02)
        for one in (index, replace(index, levels=levels)):
            chosen = choose_chunks(one, view, 1.0, eps2d=0.3).by_level(3)
            assert chosen[wanted] > 0 and sum(chosen) == chosen[wanted]
