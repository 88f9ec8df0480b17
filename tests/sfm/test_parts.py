"""Parts of the camera search that need no photo of a scene."""

import math
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageFilter

from gscore.camera_neighbours import natural_key
from gscore.errors import DatasetError
from gscore.sfm.database import Overlap, failure_reason, overlap
from gscore.sfm.forecast import ADJUSTING, FEATURES, MATCHING, RECONSTRUCTION, Forecast
from gscore.sfm.pairs import further_parts, in_parts, sequential_pairs
from gscore.sfm.photo_quality import PhotoQuality, blurred, exposure_jumps, measure_quality
from gscore.sfm.photos import Photo, by_camera, captures_inside, list_photos, read_photos, stamp
from gscore.sfm.pycolmap_thread import colmap
from gscore.sfm.search_result import SearchResult, lens_text

from .conftest import STUDIO


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


def test_photos_in_no_order_are_joined_by_what_they_show() -> None:
    """Oracle: a walk of photos that share features with those up to three steps away, named in
    random order; nearly all neighbours are compared, and few others."""
    rng = np.random.default_rng(0)
    places = [rng.integers(0, 120, (120, 128)) for _ in range(204)]
    walk = rng.permutation(200)  # place of each photo on the walk
    shown = {}
    for i, place in enumerate(walk):
        seen = np.concatenate(places[place : place + 4])
        shown[f"{i:06}.jpg"] = np.clip(seen + rng.normal(0, 4, seen.shape), 0, 255).astype(np.uint8)
    known = sequential_pairs([_photo(i) for i in range(200)])
    parts = further_parts(known, shown, {})
    added = {pair for part in parts for pair in part}
    assert not added & set(known) and len(added) <= 8 * 200
    named = {place: f"{i:06}.jpg" for i, place in enumerate(walk)}
    neighbours = {tuple(sorted((named[i], named[i + 1]))) for i in range(199)}
    assert len(neighbours & set(known)) < 0.3 * 199  # pairs by names alone
    assert len(neighbours & (added | set(known))) > 0.97 * 199


def test_photos_near_each_other_by_gps_are_compared() -> None:
    """Oracle: distances on a grid; no error for photos without features or places."""
    names = [f"{i:06}.jpg" for i in range(150)]
    places = {name: np.array([i % 12, i // 12, 0.0]) for i, name in enumerate(names[:144])}
    nothing = dict.fromkeys(names, np.zeros((0, 128), np.uint8))
    pairs = {pair for part in further_parts([], nothing, places) for pair in part}
    near = {(a, b) for a, b in combinations(names[:144], 2)
            if np.linalg.norm(places[a] - places[b]) <= 1}  # fmt: skip
    assert near <= pairs and len(pairs) <= 10 * 144


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
    """Oracle: the last photo of one folder, which is no neighbour of the first of the next."""
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
    """Oracle: the tags that were written; the same camera for a photo turned by EXIF."""
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
    """Oracle: 9 before 10, without hidden and excluded files."""
    for name in ("v10.jpg", "v9.jpg", "._v9.jpg", "masks/v9.png", ".trash/x.jpg", "sub/a.PNG"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "x.heic").write_bytes(b"")
    names, unread = list_photos(tmp_path, (tmp_path / "masks",))
    assert names == ["sub/a.PNG", "v9.jpg", "v10.jpg"] and unread == ["x.heic"]
    assert natural_key("v9") < natural_key("v10")
    assert sorted(["a.jpg", "001.jpg", "000.jpg"], key=natural_key)[1] == "001.jpg"


def test_renders_of_a_run_are_no_photos(tmp_path: Path) -> None:
    """Oracle: the folder is named only with the config.json of a training."""
    names = ["renders/a.png", "renders/b.png"]
    assert captures_inside(tmp_path, names) == ""
    (tmp_path / "config.json").write_text('{"gscore": "0", "data": {}, "train": {}}')
    assert "is the folder of a training" in captures_inside(tmp_path, names)


def test_reasons_name_the_first_that_holds() -> None:
    """Oracle: the reason for which each set of numbers was made."""
    names = {f"{i:06}.jpg": f"{i}.jpg" for i in range(4)}
    many = np.array([900, 900, 900, 900])
    cases = {
        "too little texture": Overlap(np.array([3, 5, 900, 8]), 0, 0, 0, ()),
        "no two of the": Overlap(many, 0, 0, 0, ()),
        "no parallax": Overlap(many, 6, 6, 2, ()),
        "a still background": Overlap(many, 6, 5, 3, ()),
        "2.jpg": Overlap(many, 2, 0, 0, ("000002.jpg",)),
    }
    for words, found in cases.items():
        assert words in failure_reason(found, names)
    none = Overlap(np.zeros(4, np.int64), 0, 0, 0, ())
    assert "Half of the 4 photos have no features, at least 100" in failure_reason(none, names)
    assert "--no-masks" not in failure_reason(none, names)
    assert "--no-masks" in failure_reason(none, names, masked=True)


def test_matches_at_the_same_pixels_are_still(tmp_path: Path) -> None:
    """Oracle: one photo with a square at another place, as of a turntable before a wall."""
    rng = np.random.default_rng(0)
    wall = rng.integers(0, 255, (60, 60, 3), np.uint8).repeat(8, 0).repeat(8, 1)
    (tmp_path / "photos").mkdir()
    for i in range(3):
        photo = wall.copy()
        photo[200:280, 180 + 20 * i : 260 + 20 * i] = 255
        Image.fromarray(photo).save(tmp_path / f"photos/{i}.png")
    database, p = tmp_path / "database.db", colmap()
    p.extract_features(database, tmp_path / "photos", device=p.Device.cpu)
    p.match_exhaustive(database, device=p.Device.cpu)
    found = overlap(database, least=15)
    assert (found.pairs, found.flat, found.still) == (3, 3, 3)


def test_the_verdict_names_what_to_do() -> None:
    """Oracle: the photos left out, by name, and the next command."""
    found = SearchResult(
        output=Path("cap"),
        photos=9,
        registered=5,
        models=(("a", "b", "c", "d", "e"), ("x", "y", "z")),
        alone=("lost.jpg",),
        points=10,
        reprojection_px=2.0,
        track_length=2.1,
        cameras=(),
        lens=lens_text(1.3, 0.47),
        attempts=3,
        seconds=1.0,
        resumed=False,
        warnings=(),
    )
    text = "\n".join(found.lines())
    for words in ("5 of 9 photos", "x, y, z", "lost.jpg", "--camera-model OPENCV", "gscore train"):
        assert words in text
    assert "kept as OPENCV" in text and "from 1.30 px down to 0.47 px" in text
    assert found.facts()["models"] == 2 and found.facts()["others"] == (("x", "y", "z"),)


def _looks(paths: list[Path]) -> list[PhotoQuality]:
    looks = []
    for path in paths:
        with Image.open(path) as photo:
            looks.append(measure_quality(photo))
    return looks


def test_blurred_photos_and_jumps_of_exposure_are_named(tmp_path: Path) -> None:
    """Oracle: the photos that were blurred, along one axis too, and darkened by two stops."""
    names = [f"view_{i:03}.jpg" for i in range(10)]
    for i, name in enumerate(names):
        with Image.open(STUDIO / "images" / name) as photo:
            changed = photo.copy()
        if i == 3:
            changed = changed.filter(ImageFilter.GaussianBlur(2))
        if i == 6:
            rows = np.asarray(changed, np.float32)
            moved = np.mean([np.roll(rows, k, axis=1) for k in range(9)], axis=0)
            changed = Image.fromarray(moved.astype(np.uint8))
        if i == 8:
            changed = changed.point(lambda value: value * 0.25 ** (1 / 2.2))
        changed.save(tmp_path / name, quality=95)
    looks = _looks([tmp_path / name for name in names])
    assert blurred(looks) == [3, 6] and exposure_jumps(looks) == [8]


def test_good_photos_are_neither_blurred_nor_jump() -> None:
    """Oracle: the bundled capture, rendered sharp under one light."""
    looks = _looks(sorted((STUDIO / "images").iterdir()))
    assert blurred(looks) == [] and exposure_jumps(looks) == []


def test_a_forecast_learns_the_pace() -> None:
    """Oracle: a machine of half the speed, on a simulated clock."""
    now = [0.0]
    forecast = Forecast(
        megapixels=[0.5] * 60, most=3072, pairs=1770, threads=2, clock=lambda: now[0]
    )
    reported, finding = forecast.seconds, forecast._seconds[FEATURES]
    assert forecast.left(FEATURES, 0.0) == pytest.approx(reported)
    now[0] = finding * 2.0 * 0.5  # half of the features, at half the pace
    assert forecast.left(FEATURES, 0.5) == pytest.approx(2.0 * (reported - finding / 2))
    assert forecast.pace == pytest.approx(2.0)
    before = forecast.left(MATCHING, 0.0)
    forecast.has_features(60 * 7000)
    assert forecast.left(MATCHING, 0.0) > before
    assert math.isnan(forecast.left("writing the capture", 0.0))


def test_loaded_features_do_not_count_for_the_pace() -> None:
    """Oracle: a resumed search that loads half of its features immediately and computes the others
    as fast as forecast; no more time for one whose features are complete."""
    now = [0.0]
    forecast = Forecast(
        megapixels=[0.5] * 40, most=4096, pairs=780, threads=2, clock=lambda: now[0]
    )
    finding, reported = forecast._seconds[FEATURES], forecast.seconds
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        forecast.left(FEATURES, share)
        now[0] += 0.01 if share < 0.5 else finding / 4
    assert forecast.pace == pytest.approx(1.0, rel=0.05)
    forecast.has(FEATURES)
    assert forecast.seconds == pytest.approx(reported - finding, rel=0.05)


@pytest.mark.parametrize(
    ("photos", "pixels", "features", "pairs", "matches", "took"),
    [
        (29, 800 * 600, 149343, 406, 14952, 24),  # lund
        (59, 800 * 600, 96221, 1711, 70815, 27),  # plush
        (60, 510 * 510, 192210, 1770, 79250, 46),  # stone_horse
        (60, 480 * 640, 76131, 1770, 79627, 28),  # studio, with its masks
    ],
)
def test_a_forecast_is_near_what_it_took(
    photos: int, pixels: int, features: int, pairs: int, matches: int, took: float
) -> None:
    """Oracle: measured seconds on two otherwise idle cores, of four captures; by the features of a
    few photos with a quarter more or less than the others, whose square is the cost of comparing,
    and by all."""
    most = 4096 if photos <= 40 else 3072
    for some in (0.75, 1.0, 1.25):
        forecast = Forecast(megapixels=[pixels / 1e6] * photos, most=most, pairs=pairs, threads=2)
        forecast.has_features(round(some * 4 * features / photos), 4)
        assert took / 1.8 < forecast.seconds < 1.6 * took
    forecast.has_features(features)
    forecast.has_matches(matches)
    assert took / 1.3 < forecast.seconds < 1.3 * took


def test_a_forecast_goes_one_way() -> None:
    """Oracle: a machine a third as fast, with photos and pairs in four pieces: the share of the
    work never falls and ends at 1, the time left falls by the second during a piece, and after the
    first one it is right to a fifth."""
    now = [0.0]
    forecast = Forecast(
        megapixels=[0.5] * 40, most=4096, pairs=780, threads=2, clock=lambda: now[0]
    )
    took = {name: 3 * s for name, s in forecast._seconds.items()}
    shares, pieces = [], {RECONSTRUCTION: 1, ADJUSTING: 1}
    for phase, seconds in took.items():
        count = pieces.get(phase, 4)
        for piece in range(count):
            begin, left = now[0], []
            while now[0] < begin + seconds / count:
                left.append(forecast.left(phase, piece / count, 1 / count))
                shares.append(forecast.share)
                if phase != FEATURES or piece:
                    assert left[-1] == pytest.approx(sum(took.values()) - now[0], rel=0.2, abs=1)
                now[0] += 0.2
            assert left == sorted(left, reverse=True)
            now[0] = begin + seconds / count
    assert shares == sorted(shares) and 0.98 < shares[-1] <= 1
    assert shares[0] == pytest.approx(0)


def test_a_photo_that_is_gone_is_named(tmp_path: Path) -> None:
    """Oracle: the sentence, which names the file removed after it was listed."""
    with pytest.raises(DatasetError, match=r"b\.png is gone"):
        stamp("b.png", tmp_path / "b.png")
