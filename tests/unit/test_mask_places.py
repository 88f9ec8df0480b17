"""Masks in the folders of other programs, and of other sizes; oracle: the written masks."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.config import DataConfig
from gscore.datasets import Dataset, load_dataset
from gscore.datasets.folder import Folder, masks_by_photos
from gscore.errors import DatasetError
from gscore.io.images.png import write_png
from gscore.io.images.read_image import resize_mask
from gscore.sfm.masks import find_masks
from gscore.sfm.photos import list_photos, mask_folder
from gscore.transforms import viewmat_from_opengl

SHAPE = (48, 64)


def _mask(i: int, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """White from column 8 * number on."""
    mask = np.zeros(shape, np.uint8)
    mask[:, 8 * i * shape[1] // SHAPE[1] :] = 255
    return mask


def _check(data: Dataset) -> None:
    assert data.mask_mode == "ignore" and not [s for s in data.warnings if "mask" in s]
    for i in range(len(data)):
        np.testing.assert_array_equal(data.mask(i), _mask(i))


def _write(folder: Path, names: list[str], shape: tuple[int, int] = SHAPE) -> None:
    for i, name in enumerate(names):
        write_png(folder / name, _mask(i, shape))


def _as_transforms(capture: object, root: Path, photos: str) -> None:
    """The capture again with a transforms.json, its photos in a separate folder."""
    frames = []
    for image in capture.model.images:  # type: ignore[attr-defined]
        pose = np.linalg.inv(image.viewmat) @ np.diag([1.0, -1, -1, 1])
        np.testing.assert_allclose(viewmat_from_opengl(pose), image.viewmat, atol=1e-12)
        frames.append({"file_path": f"{photos}/{image.name}", "transform_matrix": pose.tolist()})
        write_png(root / photos / image.name, capture.photos[image.name])  # type: ignore[attr-defined]
    facts = {"w": 64, "h": 48, "fl_x": 60.0, "frames": frames}
    (root / "transforms.json").write_text(json.dumps(facts))


@pytest.mark.parametrize("photos", ["images", "data/images_2", "./images"])
@pytest.mark.parametrize(("folder", "asked"), [("masks", ""), ("masks", "masks"), ("mask", "")])
@pytest.mark.parametrize("naming", ["{}.png", "{}"])
def test_masks_in_a_folder_near_the_photos(
    photos: str, folder: str, asked: str, naming: str, make_capture: Callable, tmp_path: Path
) -> None:
    """Oracle: masks found with and without the folder of the photos in their names."""
    capture, root = make_capture(views=4), tmp_path / "nerf"
    _as_transforms(capture, root, photos)
    _write(root / folder, [naming.format(image.name) for image in capture.model.images])
    _check(load_dataset(DataConfig(source=root, masks=asked)))
    names = [f"{photos}/{image.name}" for image in capture.model.images]
    _write(tmp_path / "whole", names)
    assert all(Folder(tmp_path / "whole").find_masks(names))


def test_names_of_different_folders_keep_them(tmp_path: Path) -> None:
    """Oracle: no mask shared by two photos of one name."""
    _write(tmp_path, ["a.png"])
    assert Folder(tmp_path).find_masks(["left/a.png", "right/a.png"]) == [None, None]


@pytest.mark.parametrize("folder", ["masks", "mask", "Masks", "MASK"])
def test_folders_of_a_colmap_capture(folder: str, make_capture: Callable) -> None:
    """Oracle: any of these folders, in a training and in a search for cameras, of photos next to
    it and above it."""
    capture = make_capture(views=4)
    _write(capture.root / folder, [image.name for image in capture.model.images])
    _check(load_dataset(DataConfig(source=capture.root)))
    place = capture.root / folder
    assert mask_folder(capture.root / "images", None) == place
    assert mask_folder(capture.root, None) == place


@pytest.mark.parametrize("name", ["{0.stem}_mask.png", "{0.name}.mask.png", "{0.stem}_MASK.tif"])
def test_masks_next_to_photos(name: str, make_capture: Callable) -> None:
    """Oracle: masks of a COLMAP capture, which are no photos of a search; a photo of the capture is
    no mask, and a folder of masks has precedence."""
    capture = make_capture(views=4)
    images, names = capture.root / "images", [image.name for image in capture.model.images]
    for i, photo in enumerate(names):
        Image.fromarray(_mask(i)).save(images / name.format(Path(photo)))
    _check(load_dataset(DataConfig(source=capture.root)))
    assert sorted(list_photos(images, ())[0]) == sorted(names)
    found = find_masks(None, images, names)
    assert found == {photo: images / name.format(Path(photo)) for photo in names}
    (capture.root / "masks").mkdir()
    assert load_dataset(DataConfig(source=capture.root)).mask_mode == "none"


def test_marked_masks_of_a_search_in_a_folder(tmp_path: Path) -> None:
    """Oracle: the names by Metashape's and RealityScan's templates."""
    names = [f"{i}.jpg" for i in range(3)]
    _write(tmp_path, ["0_mask.png", "1.jpg_mask.png", "2.jpg.mask.png"])
    assert [path.name for path in find_masks(tmp_path, tmp_path, names).values()] == [
        "0_mask.png",
        "1.jpg_mask.png",
        "2.jpg.mask.png",
    ]


def test_a_photo_called_mask_is_a_photo(tmp_path: Path) -> None:
    """Oracle: a search that includes it where no photo matches it, and no mask."""
    _write(tmp_path, ["a_mask.png", "b.png", "b_mask.png", "c.png"])
    assert list_photos(tmp_path, ())[0] == ["a_mask.png", "b.png", "c.png"]
    photos = [tmp_path / name for name in ("b.png", "b_mask.png")]
    assert masks_by_photos(photos) == [None, None]


@pytest.mark.parametrize("shape", [(96, 128), (143, 191), (60, 80), (24, 32), (49, 65)])
def test_masks_of_another_size(shape: tuple[int, int], make_capture: Callable) -> None:
    """Oracle: scaled masks of larger photos; smaller ones, and nearly the photo's size, are
    refused."""
    capture = make_capture(views=4)
    _write(capture.root / "masks", [image.name for image in capture.model.images], shape)
    if shape in ((24, 32), (49, 65)):
        with pytest.raises(DatasetError, match=f"{shape[1]} x {shape[0]} pixels, its photo"):
            load_dataset(DataConfig(source=capture.root))
        return
    data = load_dataset(DataConfig(source=capture.root))
    assert data.warnings == ()
    for i in range(4):
        found = data.mask(i)
        assert found is not None and set(np.unique(found)) <= {0, 255}
        wrong = np.flatnonzero((found != _mask(i)).any(axis=0))
        assert len(wrong) <= 1  # the edge


def test_other_proportions_are_refused(make_capture: Callable) -> None:
    """Oracle: a mask of a cropped photo, refused with both sizes."""
    capture = make_capture(views=4)
    _write(capture.root / "masks", [image.name for image in capture.model.images], (96, 120))
    with pytest.raises(DatasetError, match=r"120 x 96 pixels, its photo .* 64 x 48"):
        load_dataset(DataConfig(source=capture.root))


def test_soft_masks_stay_soft() -> None:
    """Oracle: the mean of each block, and yes or no where the mask has no other value."""
    soft = np.array([[0, 100, 255, 255], [0, 100, 255, 255]], np.uint8)
    np.testing.assert_array_equal(resize_mask(soft, 2, 1), [[50, 255]])
    hard = np.array([[0, 255, 255, 0, 0, 0]] * 3, np.uint8)
    np.testing.assert_array_equal(resize_mask(hard, 2, 1), [[255, 0]])
