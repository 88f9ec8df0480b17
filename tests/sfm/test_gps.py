"""Size and up by GPS in EXIF; oracle: a world of known metres and vertical."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

import gscore
from gscore.commands import main
from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.errors import FormatError
from gscore.io.cameras_json import WORLD_FILE, read_cameras_json, read_up, write_cameras
from gscore.io.colmap.folder import read_model
from gscore.sfm.gps_scale import Gps, read_gps, to_metres
from gscore.sfm.search_result import gps_text

from .conftest import cloud

Out = pytest.CaptureFixture[str]
LUND = (55.7, 13.19, 30.0)
METRES = 20.0
"""Metres in a unit of the worlds below."""


def _turned(seed: int) -> np.ndarray:
    """[3, 3] some rotation."""
    quat = np.random.default_rng(seed).normal(size=4)
    return pycolmap.Rotation3d(quat / np.linalg.norm(quat)).matrix()


def _model(centers: np.ndarray) -> pycolmap.Reconstruction:
    """Cameras at these places [n, 3], numbered from 1."""
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(
        camera_id=1, model="SIMPLE_RADIAL", width=640, height=480, params=[600.0, 320.0, 240.0, 0.0]
    )
    model.add_camera_with_trivial_rig(camera)
    for number, center in enumerate(centers, 1):
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(), -center)
        image = pycolmap.Image(name=f"{number}.jpg", camera_id=1, image_id=number)
        model.add_image_with_trivial_frame(image, pose)
    return model


def _places(enu: np.ndarray, noise: float, seed: int = 0) -> dict[int, np.ndarray]:
    """Places [n, 3] in metres to the east, to the north and up, as GPS positions."""
    enu = enu + np.random.default_rng(seed).normal(0, noise, enu.shape)
    reported = pycolmap.GPSTransform().enu_to_ellipsoid(enu, *LUND)
    return dict(enumerate(reported, 1))


def _found(enu: np.ndarray, noise: float, seed: int = 0) -> tuple[Gps, np.ndarray]:
    """The report on a turned model of these places, and its up direction."""
    turn = _turned(seed)
    return read_gps(_model(enu @ turn.T / METRES), _places(enu, noise, seed)), turn[:, 2]


def _degrees(a: np.ndarray | None, b: np.ndarray) -> float:
    assert a is not None
    return math.degrees(math.acos(np.clip(a @ b, -1, 1)))


LINE = np.array([[3.0 * i, 10.0 * i, 0.0] for i in range(10)])
AROUND = np.array(
    [[60 * math.cos(t), 60 * math.sin(t), 5 * math.sin(3 * t)] for t in np.linspace(0, 6, 24)]
)
HIGH = np.array([0.0, 0.0, 370.0])
MAST = np.array([[0.1 * math.sin(i), 0.0, 6.0 * i] for i in range(12)])


def test_gps_gives_the_size_in_metres() -> None:
    """Oracle: the scale factor of the model, on a straight line and with noise."""
    model = _model(LINE / METRES)
    to_metres(model, read_gps(model, _places(LINE, 2.0)))
    ends = [model.images[i].projection_center() for i in (1, 10)]
    assert math.dist(*ends) == pytest.approx(math.dist(LINE[0], LINE[-1]), rel=0.05)


def test_gps_of_a_small_or_a_contradicting_capture_is_not_used() -> None:
    """Oracle: the accuracy that is left by a GPS error of some metres."""
    for enu, noise in ((LINE / 30, 0.2), (LINE / 5, 40.0)):
        found = read_gps(_model(enu), _places(enu, noise))
        assert found.metres is None and found.up is None
    assert vars(read_gps(_model(LINE), {})) == vars(Gps())  # Python 3.13 compares nan by value


@pytest.mark.parametrize("seed", range(8))
def test_gps_up_error_is_within_its_estimate(seed: int) -> None:
    """Oracle: the turned world's vertical; three times the stated error bounds the real one, also
    with one place off by 80 m."""
    for enu, noise in ((AROUND, 0.0), (AROUND, 2.0), (MAST, 1.0)):
        found, up = _found(enu, noise, seed)
        assert _degrees(found.up, up) < 3 * found.tilt + 1e-3
    turn, places = _turned(seed), _places(AROUND, 1.0, seed)
    places[5] = pycolmap.GPSTransform().enu_to_ellipsoid(
        (AROUND[4] + np.array([0, 30, 75]))[None], *LUND
    )[0]
    found = read_gps(_model(AROUND @ turn.T / METRES), places)
    assert _degrees(found.up, turn[:, 2]) < 4


@pytest.mark.parametrize(("enu", "noise"), [(LINE, 0.5), (AROUND / 5, 5.0)])
def test_gps_without_up_is_reported(enu: np.ndarray, noise: float) -> None:
    """Oracle: a line, about which every turn fits, and errors as large as a tenth of the way."""
    found, _ = _found(enu, noise)
    assert found.metres == pytest.approx(METRES, rel=0.3)
    assert found.up is None and found.tilt > 4


def _moved(metres: float) -> Callable[[np.ndarray, float], np.ndarray]:
    """Move a place [3] in degrees and metres by a number of metres in a direction in radians."""

    def move(place: np.ndarray, direction: float) -> np.ndarray:
        transform = pycolmap.GPSTransform()
        way = metres * np.array([math.cos(direction), math.sin(direction), 0.0])
        return transform.enu_to_ellipsoid(
            transform.ellipsoid_to_enu(place[None], *LUND) + way, *LUND
        )[0]

    return move


STRAYS: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "null": lambda place, direction: np.zeros(3),
    "on the equator": lambda place, direction: place * [0, 1, 1],
    "no height": lambda place, direction: place * [1, 1, 0],
    "900 km": _moved(900e3),
    "2 km": _moved(2e3),
    "300 m": _moved(300),
    "80 m": _moved(80),
}


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("kind", STRAYS)
def test_stray_places_are_named_and_change_neither_size_nor_up(kind: str, count: int) -> None:
    """Oracle: the world's metres and vertical; strays are first, last and in between, on a ring, a
    survey and a line, 370 m above sea level."""
    rng = np.random.default_rng(3)
    survey = np.c_[rng.uniform(-60, 60, 30), rng.uniform(-40, 40, 30), rng.normal(0, 8, 30)]
    for seed, enu in enumerate((AROUND, survey, LINE)):
        which = [0, len(enu) - 1, len(enu) // 2][:count]
        places = _places(enu + HIGH, 1.0, seed)
        for i in which:
            places[i + 1] = STRAYS[kind](places[i + 1], 1.3 * i)
        turn = _turned(seed)
        found = read_gps(_model(enu @ turn.T / METRES), places)
        assert found.metres == pytest.approx(METRES, rel=0.05)
        assert {name for name, _ in found.outliers} == {f"{i + 1}.jpg" for i in which}
        if enu is not LINE:
            assert _degrees(found.up, turn[:, 2]) < 3


@pytest.mark.parametrize("share", [0.45, 0.55, 0.75])
@pytest.mark.parametrize("first", [True, False])
def test_a_fix_that_is_repeated_does_not_count(share: float, first: bool) -> None:
    """Oracle: the world's metres and vertical, from the photos with fixes of their own."""
    turn, places = _turned(2), _places(AROUND + HIGH, 1.0)
    same = list(range(1, 25))[: round(24 * share)] if first else range(25 - round(24 * share), 25)
    for number in same:
        places[number] = places[same[0]]
    found = read_gps(_model(AROUND @ turn.T / METRES), places)
    assert found.metres == pytest.approx(METRES, rel=0.1) and found.repeated == len(same)
    sentences = gps_text(found, {})
    assert f"of {len(same)} photos have one position in common" in sentences[0]


def test_repeated_fixes_alone_are_named() -> None:
    """Oracle: four fixes, too few for a size, and a sentence with the reason; the two cameras of
    each of six stations keep theirs."""
    places = _places(AROUND, 1.0)
    repeated = {number: places[20 if number < 21 else number] for number in range(4, 25)}
    found = read_gps(_model(AROUND / METRES), repeated)
    assert found.repeated == 17 and found.metres is None and found.up is None
    assert "not used for size and up" in gps_text(found, {})[0]
    rigs = {number: places[1 + (number - 1) // 2 * 2] for number in places if number <= 12}
    centers = np.repeat(AROUND[:12:2], 2, axis=0) / METRES
    found = read_gps(_model(centers), rigs)
    assert found.metres == pytest.approx(METRES, rel=0.2) and not found.repeated


def test_the_messages_name_strays_and_contradictions() -> None:
    """Oracle: the heights and places set to zero, and errors as large as the way."""
    places = _places(AROUND + HIGH, 0.5)
    height = places[3][2]
    places[3], places[9] = STRAYS["no height"](places[3], 0.0), np.zeros(3)
    found = read_gps(_model(AROUND / METRES), places)
    [sentence] = gps_text(found, {f"{i}.jpg": f"walk/{i}.jpg" for i in places})
    far = math.dist(*pycolmap.GPSTransform().ellipsoid_to_ecef(np.array([LUND, (0, 0, 0)])))
    assert f": walk/9.jpg ({far / 1000:,.0f} km), walk/3.jpg ({height:.0f} m)." in sentence
    noisy = read_gps(_model(LINE), _places(LINE, 40.0))
    assert noisy.contradicts is not None
    [sentence] = gps_text(noisy, {})
    assert "is not used for scale and up direction" in sentence


def test_up_is_that_of_the_place_on_both_sides_of_the_date_line() -> None:
    """Oracle: the world's vertical at Taveuni, with photos at longitudes 180 and -180."""
    turn = _turned(4)
    reported = pycolmap.GPSTransform().enu_to_ellipsoid(AROUND, -16.85, 180.0, 5.0)
    assert {bool(longitude > 0) for longitude in reported[:, 1]} == {True, False}
    found = read_gps(_model(AROUND @ turn.T / METRES), dict(enumerate(reported, 1)))
    assert found.metres == pytest.approx(METRES, rel=1e-6)
    assert _degrees(found.up, turn[:, 2]) < 0.01


def _exif(place: np.ndarray) -> Image.Exif:
    """Latitude, longitude and height as cameras write them."""

    def sexagesimal(degrees: float) -> tuple[float, float, float]:
        whole = int(degrees)
        minutes = (degrees - whole) * 60
        return float(whole), float(int(minutes)), (minutes - int(minutes)) * 60

    exif = Image.Exif()
    exif[0x8825] = {
        1: "N", 2: sexagesimal(place[0]), 3: "E", 4: sexagesimal(place[1]),
        5: b"\0", 6: float(place[2]),
    }  # fmt: skip
    return exif


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray, np.ndarray]:
    """Twelve oblique photos with GPS; names, places and rotations of the cameras.

    One photo had no GPS fix and has zeros.

    The world is east, north, up, in units of 20 m. All cameras are rolled by 70 degrees, so that
    the common up direction of the photos is not up.
    """
    folder = tmp_path_factory.mktemp("flight")
    splats, size = cloud(3), 256
    K = np.array([[0.9 * size, 0, size / 2], [0, 0.9 * size, size / 2], [0, 0, 1]])
    roll = math.radians(70)
    rolled = np.array(
        [[math.cos(roll), math.sin(roll), 0], [-math.sin(roll), math.cos(roll), 0], [0, 0, 1]]
    )
    viewmats, eyes = [], []
    for i in range(12):
        turn = 0.12 * i
        eye = np.array([2.4 * math.sin(turn), -2.4 * math.cos(turn), 2.0 + 0.3 * (i % 3)])
        ahead = -eye / np.linalg.norm(eye)
        right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
        viewmat = np.eye(4)
        viewmat[:3, :3] = rolled @ np.stack([right, np.cross(ahead, right), ahead])
        viewmat[:3, 3] = -viewmat[:3, :3] @ eye
        pixels = gscore.render(splats, K, viewmat, size, size).rgb
        picture = Image.fromarray((np.clip(pixels, 0, 1) * 255).round().astype(np.uint8))
        place = pycolmap.GPSTransform().enu_to_ellipsoid(METRES * eye[None], *LUND)[0]
        place = np.zeros(3) if i == 4 else place
        picture.save(folder / f"DJI_{i:04}.jpg", quality=95, exif=_exif(place))
        viewmats.append(viewmat)
        eyes.append(eye)
    return folder, np.array(viewmats), np.array(eyes)


@pytest.fixture(scope="module")
def made(
    flight: tuple[Path, np.ndarray, np.ndarray], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The capture that `gscore sfm` makes of them."""
    capture = tmp_path_factory.mktemp("made") / "capture"
    assert main(["sfm", str(flight[0]), "-o", str(capture), "--quiet"]) == 0
    return capture


def test_photos_with_gps_give_metres_and_up(
    flight: tuple[Path, np.ndarray, np.ndarray], made: Path
) -> None:
    """Oracle: the cameras that rendered the photos, which give the true up; up may be off by 4
    degrees, because mappers differ by some tenths from run to run."""
    model = read_model(made)
    true = {f"DJI_{i:04}.jpg": viewmat for i, viewmat in enumerate(flight[1])}
    ups = [im.viewmat[:3, :3].T @ true[im.name][:3, :3] @ [0, 0, 1] for im in model.images]
    assert len(ups) == 12
    assert _degrees(model.up, np.mean(ups, axis=0)) < 4
    centers = {im.name: -im.viewmat[:3, :3].T @ im.viewmat[:3, 3] for im in model.images}
    apart = math.dist(centers["DJI_0000.jpg"], centers["DJI_0011.jpg"])
    assert apart == pytest.approx(METRES * math.dist(flight[2][0], flight[2][11]), rel=0.05)
    record = json.loads((made / "sfm.json").read_text())
    assert record["in_metres"] and record["up"] == pytest.approx(model.up.tolist())
    [sentence] = [each for each in record["warnings"] if "GPS" in each]
    assert "GPS in EXIF of 1 photo is an outlier" in sentence and "DJI_0004.jpg (" in sentence


def test_up_direction_reaches_all_readers(made: Path, tmp_path: Path) -> None:
    """Oracle: the model's up, in the dataset, in a run's cameras and in a capture cut in blocks."""
    up = read_model(made).up
    cameras = load_dataset(DataConfig(source=made)).scene.cameras
    np.testing.assert_allclose(cameras.up, up)
    write_cameras(tmp_path / "cameras.json", cameras)
    np.testing.assert_allclose(read_cameras_json(tmp_path / "cameras.json").up, up)
    assert main(["split", str(made), "-o", str(tmp_path / "cut"), "--blocks", "2"]) == 0
    np.testing.assert_allclose(read_model(tmp_path / "cut/block_0").up, up)


def test_up_that_is_no_direction_is_refused(made: Path, tmp_path: Path) -> None:
    """Oracle: a sentence that names the file, for each kind of damage."""
    for text in ("", "[]", "{}", '{"up": [0, 0, 0]}', '{"up": [1, 2]}', '{"up": "z"}',
                 '{"up": [1e300, 0, 0]}'):  # fmt: skip
        (tmp_path / WORLD_FILE).write_text(text)
        with pytest.raises(FormatError, match=r"world\.json states no up direction"):
            read_up(tmp_path)
