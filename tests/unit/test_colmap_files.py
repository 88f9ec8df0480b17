"""Real-world COLMAP files: large, with marks and counts, joined by hand, with any names."""

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gscore.errors import FormatError
from gscore.io.colmap import binary as colmap_binary
from gscore.io.colmap import text as colmap_text
from gscore.io.colmap.folder import ColmapModel, read_model, write_model
from gscore.io.colmap.model import PointIndex


def same(a: ColmapModel, b: ColmapModel) -> None:
    """Assert that two models are equal to the bit."""
    for name in ("ids", "xyz", "rgb", "error", "track_lengths"):
        np.testing.assert_array_equal(getattr(a.points, name), getattr(b.points, name))
    for one, other in zip(a.images, b.images, strict=True):
        assert (one.id, one.name, one.camera_id) == (other.id, other.name, other.camera_id)
        np.testing.assert_array_equal(one.xys, other.xys)
        np.testing.assert_array_equal(one.point3D_ids, other.point3D_ids)


def test_windows_of_any_size_give_the_same(
    make_capture: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the written model; windows end within records, tracks and names."""
    model = make_capture(write=False, views=5, points=40).model
    write_model(model, tmp_path / "bin")
    write_model(model, tmp_path / "txt", binary=False)
    whole = read_model(tmp_path / "bin")
    monkeypatch.setattr(colmap_text, "_BATCH", 7)
    same(read_model(tmp_path / "txt"), whole)
    for size in (64, 100, 333):
        monkeypatch.setattr(colmap_binary._Reader.__init__, "__defaults__", (size,))
        monkeypatch.setattr(colmap_binary, "_WINDOW_OF_POINTS", size)
        same(read_model(tmp_path / "bin"), whole)


@pytest.mark.parametrize("binary", [True, False])
def test_observations_that_nobody_wants(
    binary: bool, make_capture: Callable, tmp_path: Path
) -> None:
    """Oracle: the same images without observations; with them if requested with the points."""
    model = make_capture(write=False).model
    write_model(model, tmp_path, binary=binary)
    asked = []
    found = read_model(tmp_path, observations=lambda points: bool(asked.append(len(points))))
    assert asked == [len(model.points)]
    assert [image.name for image in found.images] == [image.name for image in model.images]
    assert not any(len(image.xys) + len(image.point3D_ids) for image in found.images)


@pytest.mark.parametrize("binary", [True, False])
def test_the_longest_tracks_of_an_image(
    binary: bool, make_capture: Callable, tmp_path: Path
) -> None:
    """Oracle: track lengths counted over all images; no kept observation belongs to another."""
    made = make_capture(write=False, views=6, points=40).model
    rng = np.random.default_rng(0)
    keep = [rng.random(len(image.xys)) < 0.6 for image in made.images]
    images = [
        replace(image, xys=image.xys[good], point3D_ids=image.point3D_ids[good])
        for image, good in zip(made.images, keep, strict=True)
    ]
    write_model(replace(made, images=images), tmp_path, binary=binary)
    whole, few = read_model(tmp_path), read_model(tmp_path, most=7)
    ids = np.concatenate([image.point3D_ids for image in whole.images])
    lengths = dict(zip(*np.unique(ids[ids != -1], return_counts=True), strict=True))
    cut = 0
    for all_of, image in zip(whole.images, few.images, strict=True):
        seen = all_of.point3D_ids[all_of.point3D_ids != -1]
        assert len(image.point3D_ids) == min(7, len(seen))
        longest = sorted(lengths[i] for i in seen)[-7:]
        assert sorted(lengths[i] for i in image.point3D_ids) == longest
        places = {int(i): tuple(xy) for i, xy in zip(all_of.point3D_ids, all_of.xys, strict=True)}
        assert [places[int(i)] for i in image.point3D_ids] == [tuple(xy) for xy in image.xys]
        cut += len(seen) > 7
    assert cut >= 3


def test_rows_by_id() -> None:
    """Oracle: a dictionary."""
    from gscore.io.colmap.model import ColmapPoints

    none = ColmapPoints.none()
    ids = np.array([7, 3, 9, 4], np.int64)
    points = ColmapPoints(
        ids=ids,
        xyz=np.zeros((4, 3)),
        rgb=np.zeros((4, 3), np.uint8),
        error=np.zeros(4),
        track_lengths=np.zeros(4, np.int32),
    )
    wanted = np.array([9, -1, 5, 7, 100, 3])
    known, rows = PointIndex(points).find(wanted)
    places = {int(i): row for row, i in enumerate(ids)}
    assert known.tolist() == [int(i) in places for i in wanted]
    assert rows.tolist() == [places[int(i)] for i in wanted if int(i) in places]
    assert not PointIndex(none).find(wanted)[0].any()


def test_byte_order_marks(make_capture: Callable, tmp_path: Path) -> None:
    """Oracle: the model without them."""
    write_model(make_capture(write=False).model, tmp_path, binary=False)
    plain = read_model(tmp_path)
    for name in ("cameras", "images", "points3D"):
        path = tmp_path / f"{name}.txt"
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    same(read_model(tmp_path), plain)


@pytest.mark.parametrize(("name", "what"), [("cameras", "cameras"), ("points3D", "points")])
def test_wrong_counts_warn(
    name: str, what: str, make_capture: Callable, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Oracle: COLMAP's own comment above the records; no warning where it is right."""
    model = make_capture(write=False).model
    write_model(model, tmp_path, binary=False)
    path, there = tmp_path / f"{name}.txt", len(getattr(model, what))
    text = path.read_text()
    for stated, reported in ((there, False), (there + 2, True), (max(there - 1, 0), True)):
        path.write_text(f"# List\n# Number of {what}: {stated}, mean track length: 3.5\n{text}")
        caplog.clear()
        read_model(tmp_path)
        assert (f"states {stated} {what} and has {there}" in caplog.text) == reported


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("name", ["camera", "image"])
def test_an_id_that_is_there_twice(
    name: str, binary: bool, make_capture: Callable, tmp_path: Path
) -> None:
    """Oracle: the sentence, with file and id."""
    write_model(make_capture(write=False, views=3, points=2).model, tmp_path, binary=binary)
    path = tmp_path / f"{name}s{'.bin' if binary else '.txt'}"
    raw = path.read_bytes()
    if binary:
        (count,) = struct.unpack_from("<Q", raw)
        path.write_bytes(struct.pack("<Q", 2 * count) + 2 * raw[8:])
    else:
        path.write_bytes(raw + raw)
    with pytest.raises(FormatError, match=rf"{path.name}: {name} \d+ occurs twice, expected"):
        read_model(tmp_path)


@pytest.mark.parametrize("binary", [True, False])
def test_names_that_no_file_can_have(binary: bool, make_capture: Callable, tmp_path: Path) -> None:
    """Oracle: 255 bytes, in UTF-8, of a part of a path; the message is short."""
    model = make_capture(write=False).model
    for name, good in (("a" * 251 + ".png", True), ("ä" * 126 + ".png", False)):
        object.__setattr__(model.images[0], "name", f"sub/{name}")
        write_model(model, tmp_path, binary=binary)
        if good:
            assert read_model(tmp_path).images[0].name == f"sub/{name}"
            continue
        with pytest.raises(FormatError, match=r"names of 255 bytes at most\. Run") as error:
            read_model(tmp_path)
        assert len(str(error.value)) < 600


@pytest.mark.parametrize("digits", [400, 5000])
@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_numbers_of_many_digits(
    name: str, digits: int, make_capture: Callable, tmp_path: Path
) -> None:
    """Oracle: one of our errors, or a model, for each number of a file made absurd."""
    write_model(make_capture(write=False, views=1, points=2).model, tmp_path, binary=False)
    path = tmp_path / f"{name}.txt"
    lines = path.read_text().split("\n")
    at = next(i for i, line in enumerate(lines) if not line.startswith("#"))
    words = lines[at].split()
    for k in range(len(words)):
        changed = [*words[:k], "9" * digits, *words[k + 1 :]]
        path.write_text("\n".join([*lines[:at], " ".join(changed), *lines[at + 1 :]]))
        try:
            read_model(tmp_path)
        except FormatError as error:
            assert len(str(error)) < 2000
