"""A capture cut into blocks; oracle: pycolmap, the files of the whole, and the street's plan."""

import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gscore.blocks.split_capture import cut_capture, write_blocks
from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.errors import ConfigError, DatasetError, FormatError
from gscore.io.block_record import BLOCK_RECORD, read_block
from gscore.io.colmap.folder import read_model
from tests.blocks.conftest import LENGTH, street, write_street


def split(capture: Path, out: Path, count: int = 4, **options: object) -> Path:
    data = DataConfig(source=capture, eval=True)
    write_blocks(cut_capture(data, count, **options), out, lambda done: None)  # type: ignore
    return out


def test_a_block_has_what_its_photos_show(capture: Path, tmp_path: Path) -> None:
    """Oracle: the street: photos of its quarter, and none from the other end; all points that they
    observed, with these observations; the bytes of photos and masks."""
    out = split(capture, tmp_path / "blocks")
    whole = read_model(capture)
    images = {image.name: image for image in whole.images}
    names: set[str] = set()
    for index in range(4):
        block = read_model(out / f"block_{index}")
        x = np.array([-image.tvec[0] for image in block.images])
        assert np.ptp(x) < 0.6 * LENGTH and 6 <= len(x) <= 14
        for image in block.images:
            given = images[image.name]
            assert image.qvec.tolist() == given.qvec.tolist()
            assert image.xys.tolist() == given.xys.tolist()
            assert image.point3D_ids.tolist() == given.point3D_ids.tolist()
            for place in (f"images/{image.name}", f"masks/{image.name}.png"):
                assert (out / f"block_{index}" / place).samefile(capture / place)
        names |= {image.name for image in block.images}
    assert names == set(images)


def test_blocks_open_in_colmap(capture: Path, tmp_path: Path) -> None:
    """Oracle: pycolmap's reader: images, points and observations as gscore counts them."""
    pycolmap = pytest.importorskip("pycolmap")
    out = split(capture, tmp_path / "blocks", 2)
    for index in range(2):
        found = pycolmap.Reconstruction(out / f"block_{index}/sparse/0")
        ours = read_model(out / f"block_{index}")
        assert found.num_points3D() == len(ours.points)
        assert found.num_reg_images() == len(ours.images)
        assert found.compute_num_observations() == ours.points.track_lengths.sum()


def test_a_block_holds_out_what_the_whole_does(capture: Path, tmp_path: Path) -> None:
    """Oracle: the split of the whole by name; all photos of a block train without --eval."""
    whole = load_dataset(DataConfig(source=capture, eval=True))
    held_out = {whole.names[i] for i in whole.test}
    out = split(capture, tmp_path / "blocks")
    found = set()
    for index in range(4):
        block = load_dataset(DataConfig(source=out / f"block_{index}", eval=True))
        test = {block.names[i] for i in block.test}
        assert test == held_out & set(block.names)
        found |= test
    assert found == held_out


def test_without_tracks_frusta_decide(tmp_path: Path) -> None:
    """Oracle: the photos chosen by tracks, because there are no occlusions in the street, but for
    one at an end: without tracks their lengths do not weight the cut."""
    model = street()
    none = {"xys": np.zeros((0, 2)), "point3D_ids": np.zeros(0, np.int64)}
    bare = replace(model, images=[replace(image, **none) for image in model.images])
    chosen = [
        [set(block.views) for block in cut_capture(DataConfig(source=place, eval=True), 3).blocks]
        for place in (
            write_street(tmp_path / "tracks", model),
            write_street(tmp_path / "bare", bare),
        )
    ]
    assert [len(a ^ b) <= 1 for a, b in zip(*chosen, strict=True)] == [True] * 3


def test_photos_with_other_endings_are_found(tmp_path: Path) -> None:
    """Oracle: a block of a capture with photos saved again as BMP, loaded without a warning."""
    folder = write_street(tmp_path / "street", street())
    for path in sorted((folder / "images").rglob("*.png")):
        path.rename(path.with_suffix(".JPEG"))
    out = split(folder, tmp_path / "blocks", 2)
    dataset = load_dataset(DataConfig(source=out / "block_0"))
    assert dataset.names[0] == "walk/00.JPEG" and not dataset.scene.warnings


def test_a_file_system_without_links(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the photos' bytes in the copies."""

    def refuse(*_: object) -> None:
        raise OSError("no links")

    monkeypatch.setattr(os, "link", refuse)
    out = split(capture, tmp_path / "blocks", 2)
    copy = out / "block_0/images/walk/00.png"
    assert not copy.samefile(capture / "images/walk/00.png")
    assert copy.read_bytes() == (capture / "images/walk/00.png").read_bytes()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"count": 1}, "must be 2 to"),
        ({"count": 20_000}, "must be 2 to"),
        ({"count": 400}, "Cut fewer than 400 blocks"),
        ({"margin": -0.1}, "margin must be"),
        ({"share": 0.0}, "share must be"),
        ({"share": float("nan")}, "share must be"),
    ],
)
def test_uncuttable_captures_are_refused(
    capture: Path, tmp_path: Path, options: dict, words: str
) -> None:
    """Oracle: a sentence, and no files."""
    with pytest.raises((ConfigError, DatasetError), match=words):
        split(capture, tmp_path / "blocks", **options)
    assert not list(tmp_path.iterdir())


def test_a_capture_without_points(tmp_path: Path) -> None:
    """Oracle: as above."""
    model = street()
    rows = {name: values[:0] for name, values in vars(model.points).items()}
    empty = replace(model, points=replace(model.points, **rows))
    folder = write_street(tmp_path / "street", empty)
    with pytest.raises(DatasetError, match="no points, which blocks"):
        cut_capture(DataConfig(source=folder, eval=True), 2)


def test_a_full_folder_stays_and_a_failure_leaves_nothing(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the folder's files before and after."""
    full = tmp_path / "full"
    full.mkdir()
    (full / "mine.txt").write_text("mine")
    with pytest.raises(ConfigError, match="not empty"):
        split(capture, full)
    assert [path.name for path in full.iterdir()] == ["mine.txt"]

    def refuse(*_: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(os, "link", refuse)
    monkeypatch.setattr(shutil, "copy2", refuse)
    with pytest.raises(Exception, match="no space left"):
        split(capture, tmp_path / "blocks")
    assert [path.name for path in tmp_path.iterdir()] == ["full"]


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{}", '{"kind": "gscore block 1"}', '{"kind": "other"}', "null", "1" * 5000],
)
def test_damaged_record_is_refused(capture: Path, tmp_path: Path, text: str) -> None:
    """Oracle: the whole record, read; any other text is refused with the file's name."""
    out = split(capture, tmp_path / "blocks", 2)
    record = read_block(out / "block_1")
    assert record is not None and (record.index, record.count) == (1, 2)
    (out / "block_1" / BLOCK_RECORD).write_text(text)
    with pytest.raises(FormatError, match=r"block\.json is not a record"):
        read_block(out / "block_1")
