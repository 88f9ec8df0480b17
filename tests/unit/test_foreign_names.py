"""Names and points of other systems and programs; oracle: the written capture."""

import json
import shutil
import unicodedata
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plyfile import PlyData, PlyElement

from gscore.config import DataConfig
from gscore.datasets import Dataset, load_dataset
from gscore.errors import DatasetError, FormatError
from gscore.io.colmap.folder import read_model, write_model
from gscore.io.images.png import write_png

NFC, NFD = (unicodedata.normalize(form, "Größe é") for form in ("NFC", "NFD"))


def _load(root: Path, **options: object) -> Dataset:
    return load_dataset(DataConfig(source=root, **options))  # type: ignore[arg-type]


def _rename(root: Path, names: list[str]) -> None:
    """Other names of the model's images, in their order."""
    model = read_model(root)
    images = [replace(i, name=n) for i, n in zip(model.images, names, strict=True)]
    write_model(replace(model, images=images), root / "sparse/0")


def _same_photos(data: Dataset, photos: dict[str, np.ndarray]) -> None:
    for i, photo in enumerate(photos.values()):
        np.testing.assert_array_equal(data.image(i), photo)


@pytest.mark.parametrize(("stated", "on_disk"), [(NFC, NFD), (NFD, NFC), (NFC, NFC)])
@pytest.mark.parametrize("inner", ["", "Ordner für/"])
def test_forms_of_accented_letters(
    stated: str, on_disk: str, inner: str, make_capture: Callable, tmp_path: Path
) -> None:
    """Oracle: photos, masks and a list of test views, in either form of Unicode."""
    inner = unicodedata.normalize("NFD" if stated == NFD else "NFC", inner)
    there = unicodedata.normalize("NFD" if on_disk == NFD else "NFC", inner)
    capture = make_capture(names=[f"{there}{on_disk} {i}.png" for i in range(4)])
    names = [f"{inner}{stated} {i}.png" for i in range(4)]
    _rename(capture.root, names)
    mask = np.zeros((48, 64), np.uint8)
    mask[:, 9:] = 255
    for i in range(4):
        write_png(capture.root / f"masks/{there}{on_disk} {i}.png.png", mask)
    (tmp_path / "list.txt").write_text(f"{on_disk} 2\n", encoding="utf-8")
    data = _load(capture.root, eval=True, test_list=tmp_path / "list.txt")
    _same_photos(data, capture.photos)
    assert data.test == [2] and data.names == tuple(names)
    for i in range(4):
        np.testing.assert_array_equal(data.mask(i), mask)


@pytest.mark.parametrize(("stated", "on_disk"), [(NFC, NFD), (NFD, NFC)])
def test_forms_in_a_transforms_json(stated: str, on_disk: str, tmp_path: Path) -> None:
    """Oracle: photo, mask and test view by names of the other form."""
    photo = np.full((6, 8, 3), 70, np.uint8)
    mask = np.full((6, 8), 255, np.uint8)
    mask[:3] = 0
    frames = []
    for i in range(2):
        write_png(tmp_path / f"{on_disk}{i}.png", photo + i)
        write_png(tmp_path / f"m/{on_disk}{i}.png", mask)
        pose = np.eye(4)
        pose[0, 3] = i
        frames.append(
            {
                "file_path": f"{stated}{i}.png",
                "mask_path": f"m/{stated}{i}.png",
                "transform_matrix": pose.tolist(),
            }
        )
    facts = {"w": 8, "h": 6, "fl_x": 9, "frames": frames, "test_filenames": [f"{stated}1.png"]}
    (tmp_path / "transforms.json").write_text(json.dumps(facts))
    data = _load(tmp_path, eval=True)
    assert data.test == [1] and len(data) == 2
    np.testing.assert_array_equal(data.mask(0), mask)


@pytest.mark.parametrize(
    "prefix",
    ["/home/ada/photos/", "C:\\Users\\Ada\\", "D:/photos/", "\\\\nas\\share\\x\\", "C:", "images/"],
)
@pytest.mark.parametrize("place", ["images", "input", "", "images/cam 1"])
def test_photos_where_their_names_do_not_say(
    prefix: str, place: str, make_capture: Callable
) -> None:
    """Oracle: the photos of a flat folder, for any prefix of their names in the model."""
    capture = make_capture(views=4)
    _rename(capture.root, [prefix + name for name in capture.photos])
    if place != "images":
        shutil.move(capture.root / "images", capture.root / "away")
        (capture.root / place).mkdir(parents=True, exist_ok=True)
        for photo in (capture.root / "away").iterdir():
            shutil.move(photo, capture.root / place)
    data = _load(capture.root)
    assert len(data) == 4
    _same_photos(data, capture.photos)
    assert bool([s for s in data.warnings if "absolute name" in s]) == (prefix != "images/")


def test_absolute_names_that_are_there_twice(make_capture: Callable) -> None:
    """Oracle: equal names, distinguished by the folders below the common one."""
    names = [f"{side}/{i}.png" for side in ("left", "right") for i in range(2)]
    capture = make_capture(names=names)
    _rename(capture.root, [f"/data/{name}" for name in names])
    data = _load(capture.root)
    assert data.names == tuple(names)
    _same_photos(data, capture.photos)
    _rename(capture.root, ["/data/a/x.png", "C:\\data\\a\\x.png", "left/1.png", "right/1.png"])
    with pytest.raises(FormatError, match="are not unique"):
        _load(capture.root)


def test_folders_that_lack_are_not_guessed(make_capture: Callable) -> None:
    """Oracle: no photo from a file whose name two images of the model have."""
    capture = make_capture(names=["a.png", "b.png", "c.png"])
    _rename(capture.root, ["left/a.png", "right/a.png", "left/b.png"])
    with pytest.raises(DatasetError, match=r"2 of the 3 images .* are missing"):
        _load(capture.root)


@pytest.mark.parametrize("name", ["points3D.ply", "points3d.ply", "init.ply"])
@pytest.mark.parametrize("place", ["sparse/0", "sparse", ""])
@pytest.mark.parametrize("left", ["nothing", "an empty file"])
def test_points_in_a_ply(name: str, place: str, left: str, make_capture: Callable) -> None:
    """Oracle: the points moved there."""
    capture = make_capture(views=4)
    points = capture.model.points
    table = np.empty(
        len(points), [(n, "f8") for n in "xyz"] + [(n, "u1") for n in ("red", "green", "blue")]
    )
    for k, axis in enumerate("xyz"):
        table[axis] = points.xyz[:, k]
    for k, channel in enumerate(("red", "green", "blue")):
        table[channel] = points.rgb[:, k]
    PlyData([PlyElement.describe(table, "vertex")]).write(capture.root / place / name)
    (file,) = (capture.root / "sparse/0").glob("points3D.bin")
    file.write_bytes(bytes(8)) if left == "an empty file" else file.unlink()
    data = _load(capture.root)
    np.testing.assert_array_equal(data.scene.points.points, points.xyz)
    np.testing.assert_array_equal(data.scene.points.colors, points.rgb)
    assert any(name in sentence for sentence in data.warnings)


def test_advice_where_there_are_no_points(make_capture: Callable) -> None:
    """Oracle: the sentence, with the file that would help."""
    capture = make_capture(views=4)
    (capture.root / "sparse/0/points3D.bin").unlink()
    assert any("or a PLY of points named points3D.ply" in s for s in _load(capture.root).warnings)
