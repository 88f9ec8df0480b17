"""Photos of one exposure, in a search for cameras and in a split; oracle: their making."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.datasets.shots import repeats, shot_of
from gscore.errors import DatasetError
from gscore.io.colmap.folder import read_model, write_model
from gscore.sfm.photos import list_photos, one_of_each, read_photos

STUDIO = Path(__file__).parents[2] / "examples/studio"


def _save(view: int, path: Path, *, turn: int = 1, time: str = "", shrink: float = 1) -> None:
    """Save a photo of the studio again, as a phone in some orientation would."""
    with Image.open(STUDIO / f"images/view_{view:03}.jpg") as photo:
        picture = photo.resize((round(photo.width / shrink), round(photo.height / shrink)))
    if turn == 6:
        picture = picture.transpose(Image.Transpose.ROTATE_90)
    exif = Image.Exif()
    exif[0x0112], exif[0x010F], exif[0x0110] = turn, "Maker", "Phone 1"
    if time:
        exif.get_ifd(0x8769)[0x9003] = time
    path.parent.mkdir(parents=True, exist_ok=True)
    picture.save(path, quality=80, exif=exif)


def _kept(folder: Path) -> tuple[list[str], list[str]]:
    read = read_photos(
        folder, list_photos(folder, ())[0], on_photo=lambda done: None, cancelled=lambda: False
    )
    kept, said = one_of_each(folder, read)
    return [photo.name for photo in kept], said


def test_one_photo_of_each_exposure(tmp_path: Path) -> None:
    """Oracle: the largest of files made of one photo, in any storage; others stay."""
    for view in range(4):
        _save(view, tmp_path / f"{view}.jpg")
    _save(1, tmp_path / "again/1.png", shrink=1.5)
    _save(2, tmp_path / "2_turned.webp", turn=6)
    _save(3, tmp_path / "0 large.jpg", shrink=0.5)
    kept, said = _kept(tmp_path)
    assert kept == ["0 large.jpg", "0.jpg", "1.jpg", "2.jpg"]
    assert "3 photos show the same picture" in said[0] and "again/1.png of 1.jpg" in said[0]


def test_a_moment_alone_is_no_proof(tmp_path: Path) -> None:
    """Oracle: three photos by cameras that release together; an edited file belongs to one of
    them."""
    for view in range(3):
        _save(view * 20, tmp_path / f"camera {view}/1.jpg", time="2026:05:01 12:00:00")
    with Image.open(tmp_path / "camera 0/1.jpg") as photo:
        photo.point(lambda value: value * 0.6).save(
            tmp_path / "camera 0/1.png", exif=photo.getexif()
        )
    kept, said = _kept(tmp_path)
    assert kept == [f"camera {i}/1.jpg" for i in range(3)] and "camera 0/1.png" in said[0]


def test_too_few_without_the_copies(tmp_path: Path) -> None:
    """Oracle: a sentence where four files are two photos."""
    for i in range(4):
        _save(i % 2, tmp_path / f"{i}.jpg", shrink=1 + i / 4)
    with pytest.raises(DatasetError, match=r"2 of the 4 photos .* only 2 are left"):
        _kept(tmp_path)


def test_photos_that_show_little(tmp_path: Path) -> None:
    """Oracle: two dark photos of two places, less than two levels apart; a photo saved again is
    one; pixels of flat ones prove nothing."""
    for view in (0, 20):
        with Image.open(STUDIO / f"images/view_{view:03}.jpg") as photo:
            photo.point(lambda value: value * 0.06).save(tmp_path / f"{view}.png")
    shots = [shot_of(p.name, Image.open(p)) for p in sorted(tmp_path.iterdir())]
    assert np.sqrt(np.mean((shots[0].pixels - shots[1].pixels) ** 2)) < 2
    assert repeats(shots) == [] and repeats([*shots, shots[0]]) == [(0, 2)]
    flat = shot_of("flat.png", Image.new("RGB", (120, 90), (100, 90, 80)))
    assert repeats([flat, flat]) == []


@pytest.fixture(scope="module")
def doubled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten views of the studio; view 8, of the usual split, has a second file as PNG."""
    capture = tmp_path_factory.mktemp("doubled")
    model = read_model(STUDIO)
    chosen = sorted(model.images, key=lambda image: image.name)[:10]
    for image in chosen:
        (capture / "images").mkdir(exist_ok=True)
        shutil.copy(STUDIO / "images" / image.name, capture / "images")
    with Image.open(capture / "images" / chosen[8].name) as photo:
        photo.save(capture / "images/view_008_again.png")
    twin = chosen[8].__class__(**{**vars(chosen[8]), "id": 999, "name": "view_008_again.png"})
    whole = model.__class__(**{**vars(model), "images": [*chosen, twin]})
    write_model(whole, capture / "sparse/0")
    return capture


def test_no_photo_on_both_sides(doubled: Path) -> None:
    """Oracle: the second file of a test view, which is no training view; all others stay."""
    dataset = load_dataset(DataConfig(source=doubled, eval=True))
    names = dataset.scene.cameras.names
    assert [names[i] for i in dataset.test] == [
        "view_000.jpg",
        "view_008.jpg",
        "view_008_again.png",
    ]
    assert len(dataset.train) == 8
    said = [s for s in dataset.scene.warnings if "same picture as a test view" in s]
    assert len(said) == 1 and "view_008_again.png of view_008.jpg" in said[0]


def test_a_stated_split_stays(doubled: Path, tmp_path: Path) -> None:
    """Oracle: the list, and a warning with the photo's name; none without a test view."""
    (tmp_path / "list.txt").write_text("view_008.jpg")
    stated = load_dataset(DataConfig(source=doubled, eval=True, test_list=tmp_path / "list.txt"))
    assert [stated.scene.cameras.names[i] for i in stated.test] == ["view_008.jpg"]
    said = [s for s in stated.scene.warnings if "same picture as a test view" in s]
    assert len(said) == 1 and "view_008_again.png of view_008.jpg" in said[0]
    plain = load_dataset(DataConfig(source=doubled, eval=False))
    assert not [s for s in plain.scene.warnings if "same picture" in s]


def test_dots_in_names_make_no_copies(tmp_path: Path) -> None:
    """Oracle: other views of one second, with names that differ after a dot alone."""
    shots = []
    for view in (0, 5):
        path = tmp_path / f"frame.{view:04}.jpg"
        _save(view, path, time="2026:01:02 03:04:05")
        with Image.open(path) as image:
            shots.append(shot_of(f"shoot.v2/{path.name}", image))
    assert repeats(shots) == []
