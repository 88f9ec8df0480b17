"""Parts of the search for cameras that need no photo of a scene."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.sfm.database import Overlap
from gscore.sfm.diagnose import why_none
from gscore.sfm.pairs import in_parts, sequential_pairs
from gscore.sfm.photos import Photo, by_camera, list_photos, natural, read_photos
from gscore.sfm.verdict import Found


def _photo(i: int, name: str = "", camera: tuple[str, ...] = ()) -> Photo:
    return Photo(name or f"{i}.jpg", f"{i:06}.jpg", 40, 30, camera)


def test_neighbours_and_loops_are_compared() -> None:
    """Oracle: neighbours, a loop's ends among the photos spread over it, and far fewer than all."""
    photos = [_photo(i) for i in range(400)]
    pairs = sequential_pairs(photos)
    assert len(pairs) == len(set(pairs)) and all(a < b for a, b in pairs)
    assert {("000000.jpg", f"{i:06}.jpg") for i in range(1, 11)} <= set(pairs)
    assert ("000000.jpg", "000390.jpg") in pairs
    assert len(pairs) < 0.15 * len(list(combinations(photos, 2)))


@pytest.mark.parametrize("sequential", [False, True])
def test_parts_hold_each_pair_once(sequential: bool) -> None:
    """Oracle: all pairs, and those of the sequence."""
    photos = [_photo(i) for i in range(43)]
    parts = in_parts(photos, sequential=sequential)
    pairs = [pair for part in parts for pair in part]
    everyone = combinations([photo.alias for photo in photos], 2)
    assert sorted(pairs) == (sequential_pairs(photos) if sequential else sorted(everyone))
    assert all(0 < len(part) <= 100 for part in parts)


def test_folders_are_sequences_of_their_own() -> None:
    """Oracle: the last photo of one folder is no neighbour of the first of the next."""
    photos = [_photo(i, f"{'ab'[i // 200]}/{i}.jpg") for i in range(400)]
    pairs = set(sequential_pairs(photos))
    assert ("000199.jpg", "000201.jpg") not in pairs and ("000197.jpg", "000199.jpg") in pairs


def _save(path: Path, **tags: object) -> None:
    exif = Image.Exif()
    exif[0x010F], exif[0x0110] = tags.get("make", ""), tags.get("model", "")
    exif[0x0112] = tags.get("turn", 1)
    exif.get_ifd(0x8769).update({0xA434: tags.get("lens", ""), 0x920A: tags.get("focal", 5.0)})
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.zeros((30, 40, 3), np.uint8)).save(path, exif=exif)


def test_cameras_are_shared_by_what_exif_says(tmp_path: Path) -> None:
    """Oracle: the tags that were written; a photo turned by EXIF has the same camera."""
    for name, tags in {
        "a1.jpg": {"make": "Acme", "model": "One", "lens": "wide"},
        "a2.jpg": {"make": "Acme", "model": "One", "lens": "wide", "turn": 6},
        "b.jpg": {"make": "Acme", "model": "One", "lens": "tele"},
        "c.jpg": {"make": "Acme", "model": "One", "lens": "wide", "focal": 9.0},
        "sub/d.jpg": {"make": "Other", "model": "One", "lens": "wide"},
    }.items():
        _save(tmp_path / name, **tags)
    names, _ = list_photos(tmp_path, ())
    photos = read_photos(tmp_path, names, on_photo=lambda n: None, cancelled=lambda: False)
    groups = [[photo.name for photo in group] for group in by_camera(photos)]
    assert groups == [["a1.jpg", "a2.jpg"], ["b.jpg"], ["c.jpg"], ["sub/d.jpg"]]


def test_photos_are_listed_as_people_count(tmp_path: Path) -> None:
    """Oracle: 9 before 10, and neither hidden files nor what is to be left out."""
    for name in ("v10.jpg", "v9.jpg", "._v9.jpg", "masks/v9.png", ".trash/x.jpg", "sub/a.PNG"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "x.heic").write_bytes(b"")
    names, unread = list_photos(tmp_path, (tmp_path / "masks",))
    assert names == ["sub/a.PNG", "v9.jpg", "v10.jpg"] and unread == ["x.heic"]
    assert natural("v9") < natural("v10")


def test_reasons_name_the_first_that_holds() -> None:
    """Oracle: the reason that each set of numbers was made for."""
    names = {f"{i:06}.jpg": f"{i}.jpg" for i in range(4)}
    many = np.array([900, 900, 900, 900])
    cases = {
        "too little texture": Overlap(np.array([3, 5, 900, 8]), 0, 0, ()),
        "shows the same thing": Overlap(many, 0, 0, ()),
        "no parallax": Overlap(many, 6, 6, ()),
        "2.jpg": Overlap(many, 2, 0, ("000002.jpg",)),
    }
    for words, overlap in cases.items():
        assert words in why_none(overlap, names)


def test_the_verdict_names_what_to_do() -> None:
    """Oracle: the photos left out, by name, and the next command."""
    found = Found(
        output=Path("cap"),
        photos=9,
        registered=5,
        models=(("a", "b", "c", "d", "e"), ("x", "y", "z")),
        alone=("lost.jpg",),
        points=10,
        reprojection_px=2.0,
        track_length=2.1,
        cameras=(),
        attempts=3,
        seconds=1.0,
        resumed=False,
        warnings=(),
    )
    text = "\n".join(found.lines())
    for words in ("5 of 9 photos", "x, y, z", "lost.jpg", "--camera-model OPENCV", "gscore train"):
        assert words in text
    assert found.facts()["models"] == 2 and found.facts()["others"] == (("x", "y", "z"),)
