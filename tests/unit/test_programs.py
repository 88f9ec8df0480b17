"""Camera files of other programs; oracle: `tests/program_files.py`, with their formulas."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import plyfile
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from gscore.config import DataConfig
from gscore.datasets import Capture, View, load_dataset, read_capture
from gscore.errors import FormatError, GsError
from gscore.inspection import find_capture, inspect
from gscore.io.colmap.lenses import DISTORTED_MODELS, distorted_pixels
from gscore.io.images.png import write_png
from gscore.sfm.photos import is_photo_folder, other_cameras
from tests import program_files as files
from tests.program_files import Chunk, Rig

SIZE = (64, 48)
BROWN = {"k1": -0.11, "k2": 0.04, "k3": -0.013}
UTM = np.array([500_000.0, 5_600_000.0, 120.0])


@pytest.fixture
def rig() -> Rig:
    """Eight cameras facing various ways, tilted, on their side and upside down, with an off-centre
    principal point."""
    turns = Rotation.random(8, rng=np.random.default_rng(3)).as_matrix()
    places = np.random.default_rng(4).normal(size=(8, 3))
    names = tuple(f"view_{i}.png" for i in range(8))
    return Rig(names, turns, places, SIZE, 61.5, off=(1.25, -2.5))


def _points(rig: Rig, count: int = 40) -> np.ndarray:
    """World points in front of the first camera, within 35 degrees of its axis."""
    rng = np.random.default_rng(5)
    rays = np.column_stack([rng.uniform(-0.5, 0.5, (count, 2)), np.ones(count)])
    return (rays * rng.uniform(1, 3, (count, 1))) @ rig.turns[0] + rig.places[0]


def _photos(folder: Path, rig: Rig) -> Path:
    for i, name in enumerate(rig.names):
        photo = np.full((rig.size[1], rig.size[0], 3), 20 * i + 40, np.uint8)
        (folder / "images" / name).parent.mkdir(parents=True, exist_ok=True)
        write_png(folder / "images" / name, photo)
    return folder


def _read(folder: Path) -> Capture:
    return read_capture(DataConfig(source=folder))


def _pixels(view: View, points: np.ndarray) -> np.ndarray:
    at = points @ view.viewmat[:3, :3].T + view.viewmat[:3, 3]
    rays, camera = at[:, :2] / at[:, 2:], view.camera
    if camera.model in DISTORTED_MODELS:
        return distorted_pixels(camera.model, camera.params.tolist(), rays)
    return rays * np.diag(camera.K)[:2] + camera.K[:2, 2]


def _check(capture: Capture, rig: Rig, program: str, tolerance: float = 1e-6) -> None:
    """Check poses, and the pixels of points in front of the first camera."""
    assert [view.name for view in capture.views] == list(rig.names)
    origin = np.zeros(3) if capture.origin is None else capture.origin
    for view, turn, place in zip(capture.views, rig.turns, rig.places, strict=True):
        np.testing.assert_allclose(view.viewmat[:3, :3], turn, atol=1e-9)
        center = -view.viewmat[:3, :3].T @ view.viewmat[:3, 3]
        np.testing.assert_allclose(center + origin, place, rtol=1e-13, atol=tolerance)
        assert (view.camera.width, view.camera.height) == rig.size
        assert view.image.is_file()
    points = _points(rig)
    expected = files.pixels_of(program, rig, points)[0]
    found = _pixels(capture.views[0], points - origin)
    np.testing.assert_allclose(found, expected, atol=tolerance)


TILTED = {**BROWN, "t1": 0.003, "t2": -0.0021}
WRITERS: dict[str, Callable[[Path, Rig], object]] = {
    "csv": files.write_rs_csv,
    "csv of RealityCapture": lambda folder, rig: files.write_rs_csv(folder, rig, new=False),
    "csv for OpenCV": files.write_rs_opencv_csv,
    "xmp": lambda folder, rig: files.write_rs_xmp(folder / "images", rig),
    "xmp version 2": lambda folder, rig: files.write_rs_xmp(
        folder / "images", rig, attributes=True, Version="2"
    ),
}


@pytest.mark.parametrize("terms", [TILTED, {"k1": -0.1, "t1": 0.002}, {}], ids=len)
@pytest.mark.parametrize("form", WRITERS)
def test_realityscan(form: str, terms: dict[str, float], rig: Rig, tmp_path: Path) -> None:
    """Oracle: equations (27) to (48) of RealityScan's own document, and known poses."""
    rig = replace(rig, terms=terms)
    WRITERS[form](_photos(tmp_path, rig), rig)
    assert not is_photo_folder(tmp_path)
    _check(_read(tmp_path), rig, "realityscan")


def test_portrait_photos_of_realityscan(rig: Rig, tmp_path: Path) -> None:
    """Oracle: the same document: lengths are in units of the longer side, in either orientation."""
    rig = replace(rig, size=(48, 64), terms=TILTED)
    files.write_rs_csv(_photos(tmp_path, rig), rig)
    _check(_read(tmp_path), rig, "realityscan")


CHUNK = Chunk(
    turn=Rotation.from_euler("xyz", [20, 50, -70], degrees=True).as_matrix(),
    shift=np.array([4.0, -2.0, 7.0]),
    scale=12.35,
)
FRAME = {**BROWN, "p1": 0.004, "p2": -0.0013, "b1": 0.75}


@pytest.mark.parametrize("where", ["component", "chunk", ""])
@pytest.mark.parametrize("kind", ["frame", "fisheye", "equidistant_fisheye"])
def test_metashape(kind: str, where: str, rig: Rig, tmp_path: Path) -> None:
    """Oracle: the camera models of Metashape's manual, poses moved into the chunk's axes."""
    rig = replace(rig, terms=FRAME if kind == "frame" else {**FRAME, "k4": 0.002})
    chunk = replace(CHUNK if where else Chunk(), where=where, kind=kind, endings=bool(where))
    files.write_metashape(_photos(tmp_path, rig), rig, chunk)
    capture = _read(tmp_path)
    _check(capture, rig, "frame" if kind == "frame" else "fisheye")
    assert "1 camera of" in capture.warnings[0] and "1 not aligned" in capture.warnings[0]


@pytest.mark.parametrize("by_sensor", [True, False])
def test_slave_cameras_of_metashape_are_named(by_sensor: bool, rig: Rig, tmp_path: Path) -> None:
    """Oracle: a camera without a pose that names a master, itself or by its sensor."""
    path = files.write_metashape(_photos(tmp_path, rig), rig)
    slave = '<camera id="97" sensor_id="1" label="slave"></camera>'
    sensor = '<sensor id="1" label="second" type="frame" master_id="0"></sensor>'
    if not by_sensor:
        slave, sensor = slave.replace("label", 'master_id="0" label'), ""
    text = path.read_text().replace("</sensors>", f"{sensor}</sensors>")
    path.write_text(text.replace('<camera id="98"', f'{slave}<camera id="98"'))
    capture = _read(tmp_path)
    assert len(capture.views) == len(rig.names)
    assert "1 not aligned, 0 not enabled, 1 slaves of a" in capture.warnings[0]
    assert "export the cameras in COLMAP's format" in capture.warnings[1]


def test_geocentric_cameras_of_metashape(rig: Rig, tmp_path: Path) -> None:
    """Oracle: a chunk on the Earth's surface; up points away from the Earth's centre."""
    shift = np.array([4_027_893.0, 307_045.0, 4_919_475.0])
    rig = replace(rig, places=rig.places + shift)
    files.write_metashape(_photos(tmp_path, rig), rig, replace(CHUNK, shift=shift))
    capture = _read(tmp_path)
    _check(capture, rig, "frame", 1e-5)  # float64 at six million metres
    assert capture.up is not None
    np.testing.assert_allclose(capture.up, shift / np.linalg.norm(shift), atol=1e-6)


@pytest.mark.parametrize(
    ("kind", "terms"),
    [
        ("brown", {**BROWN, "p1": 0.004, "p2": -0.0013}),
        ("perspective", {"k1": -0.1, "k2": 0.02}),
        ("radial", {"k1": -0.1, "k2": 0.02}),
        ("fisheye", {"k1": -0.1, "k2": 0.02}),
        ("fisheye_opencv", {"k1": -0.1, "k2": 0.02, "k3": 0.003, "k4": -0.001}),
    ],
)
def test_opensfm(kind: str, terms: dict[str, float], rig: Rig, tmp_path: Path) -> None:
    """Oracle: "Geometric Models" of OpenSfM's documentation; its points, and z for up."""
    rig = replace(rig, terms=terms)
    points = _points(rig)
    folder = tmp_path / "opensfm" if kind == "brown" else tmp_path  # as in OpenDroneMap
    folder.mkdir(exist_ok=True)
    files.write_opensfm(folder, rig, kind, points)
    capture = _read(_photos(tmp_path, rig))
    _check(capture, rig, f"opensfm {kind}")
    np.testing.assert_array_equal(capture.points.points, points)
    assert capture.points.colors[7].tolist() == [10, 20, 30]
    assert capture.up is not None and capture.up.tolist() == [0, 0, 1]
    assert "leaving out 1" in capture.warnings[0]


def test_llff(rig: Rig, tmp_path: Path) -> None:
    """Oracle: the order of columns in LLFF's own script; photos by their sorted names."""
    rig = replace(rig, off=(0.0, 0.0))
    path = files.write_llff(_photos(tmp_path, rig), rig)
    _check(_read(tmp_path), rig, "realityscan")
    np.save(path, np.load(path)[:-1])
    with pytest.raises(GsError, match="7 poses for 8 photos"):
        _read(tmp_path)


REFUSED = {
    "k4": (files.write_rs_csv, {"k4": 0.001}, r"r\^8 term \(k4\)"),
    "k4 of Metashape": (files.write_metashape, {"k4": 0.001}, r"r\^8 term \(k4\)"),
    "b2": (files.write_metashape, {"b2": 0.3}, r"skew \(b2\)"),
    "p3": (files.write_metashape, {"p3": 0.1}, "p3 is 0.1"),
    "b2 of a fisheye": (
        lambda folder, rig: files.write_metashape(folder, rig, Chunk(kind="fisheye")),
        {"b2": 0.3},
        r"skew \(b2\)",
    ),
    "equisolid": (
        lambda folder, rig: files.write_metashape(folder, rig, Chunk(kind="equisolid_fisheye")),
        {},
        "type 'equisolid_fisheye'",
    ),
    "division": (
        lambda folder, rig: files.write_rs_xmp(folder, rig, DistortionModel="division"),
        {},
        "DistortionModel is 'division'",
    ),
    "division in a CSV": (files.write_rs_csv, {"k1": -0.2}, "may be the division model"),
    "division for OpenCV": (files.write_rs_opencv_csv, {"k1": -0.2}, "may be the division model"),
    "skewed": (lambda folder, rig: files.write_rs_xmp(folder, rig, Skew="0.1"), {}, "xcr:Skew"),
    "aspect": (
        lambda folder, rig: files.write_rs_xmp(folder, rig, AspectRatio="1.01"),
        {},
        "xcr:AspectRatio",
    ),
    "dual": (lambda folder, rig: files.write_opensfm(folder, rig, "dual"), {}, "projection_type"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_unsupported_lens_terms_are_refused(case: str, rig: Rig, tmp_path: Path) -> None:
    """Oracle: terms that COLMAP's models lack, each named in the sentence with a remedy."""
    write, terms, words = REFUSED[case]
    rig = replace(rig, terms=terms)
    write(_photos(tmp_path, rig), rig)
    for path in (tmp_path).glob("*.xmp"):
        shutil.move(path, tmp_path / "images")
    with pytest.raises(FormatError, match=words):
        _read(tmp_path)
    (problem,) = inspect(DataConfig(source=tmp_path)).problems
    assert problem.is_error and str(tmp_path) in problem.text


def test_sidecars_of_several_components_are_refused(rig: Rig, tmp_path: Path) -> None:
    """Oracle: RealityScan's document: relative coordinates are those of one component."""
    for i, name in enumerate(rig.names):
        one = replace(rig, names=(name,), turns=rig.turns[i : i + 1], places=rig.places[i : i + 1])
        files.write_rs_xmp(
            _photos(tmp_path, rig) / "images", one, Coordinates="relative", ComponentId=f"{i % 2}"
        )
    with pytest.raises(FormatError, match="of 2 components"):
        _read(tmp_path)


def test_longitudes_are_no_lengths(rig: Rig, tmp_path: Path) -> None:
    """Oracle: a refusal of a drone's positions in degrees; metres of a projection are read."""
    _photos(tmp_path, rig)
    degrees = np.array([[8.68, 50.11, 120.0]]) + rig.places * [1e-4, 1e-4, 1.0]
    files.write_rs_csv(tmp_path, replace(rig, places=degrees))
    with pytest.raises(FormatError, match=r"longitudes and latitudes, around 8\.68"):
        _read(tmp_path)
    projected = replace(rig, places=rig.places + UTM)
    files.write_rs_csv(tmp_path, projected)
    _check(_read(tmp_path), projected, "realityscan")


def _write_ply(path: Path, points: np.ndarray) -> None:
    table = np.zeros(len(points), [(n, "f8") for n in "xyz"])
    for k, name in enumerate("xyz"):
        table[name] = points[:, k]
    plyfile.PlyData([plyfile.PlyElement.describe(table, "vertex")]).write(path)


def test_points_of_the_folder(rig: Rig, tmp_path: Path) -> None:
    """Oracle: the PLY of the same world, read; one of other coordinates is left out and named, and
    of several the one called points3D.ply is used."""
    files.write_rs_csv(_photos(tmp_path, rig), rig)
    points = _points(rig)
    _write_ply(tmp_path / "cloud.ply", points)
    np.testing.assert_array_equal(_read(tmp_path).points.points, points)
    _write_ply(tmp_path / "cloud.ply", points + UTM)
    capture = _read(tmp_path)
    assert not len(capture.points) and "in other coordinates" in capture.warnings[-1]
    _write_ply(tmp_path / "other.ply", points)
    assert "has 2 PLY files" in _read(tmp_path).warnings[-1]
    (tmp_path / "other.ply").rename(tmp_path / "points3D.ply")
    np.testing.assert_array_equal(_read(tmp_path).points.points, points)


@pytest.mark.parametrize(
    ("write", "name"),
    [
        (files.write_rs_csv, "images/{stem}.png.mask.png"),
        (files.write_rs_csv, "images/{stem}.png_mask.png"),
        (files.write_metashape, "images/{stem}_mask.png"),
        (files.write_metashape, "images/{stem}_Mask.tif"),
        (files.write_metashape, "masks/{stem}_mask.png"),
        (files.write_metashape, "mask/{stem}_mask.png"),
        (files.write_metashape, "Masks/{stem}_mask.png"),
        (files.write_opensfm, "masks/{stem}.png.png"),
    ],
)
def test_masks(write: Callable, name: str, rig: Rig, tmp_path: Path) -> None:
    """Oracle: masks under each program's own names, with a black part."""
    write(_photos(tmp_path, rig), rig)
    mask = np.full((48, 64), 255, np.uint8)
    mask[:10] = 0
    for photo in rig.names:
        path = tmp_path / name.format(stem=Path(photo).stem)
        path.parent.mkdir(exist_ok=True)
        Image.fromarray(mask).save(path)
    data = load_dataset(DataConfig(source=tmp_path))
    assert data.mask_mode != "none" and len(data) == 8
    assert not [s for s in data.warnings if "have no mask" in s]
    for i in range(8):
        np.testing.assert_array_equal(data.mask(i), mask)


def test_photos_that_exif_turns(rig: Rig, tmp_path: Path) -> None:
    """Oracle: a photo on its side: where the file states no size, a sentence states the orientation
    used; Metashape's states it."""
    rig = replace(rig, size=(48, 64))
    files.write_rs_csv(_photos(tmp_path, rig), rig)
    exif = Image.Exif()
    exif[0x0112] = 6
    for name in rig.names:
        Image.new("RGB", rig.size, "gray").save(tmp_path / "images" / name, exif=exif)
    capture = _read(tmp_path)
    assert "EXIF rotates 8 photos" in capture.warnings[0]
    _check(capture, rig, "realityscan")
    (tmp_path / "registration.csv").unlink()
    files.write_metashape(tmp_path, rig)
    assert not any("EXIF" in text for text in _read(tmp_path).warnings)


def test_names_are_found_by_their_ends(rig: Rig, tmp_path: Path) -> None:
    """Oracle: paths of another machine, in other letter case, with a folder that distinguishes
    equal names; without one the photo is not guessed."""
    inner = tuple(f"{side}/shot{i}.png" for i in range(4) for side in ("left", "right"))
    _photos(tmp_path, replace(rig, names=inner))
    stated = tuple("C:\\Photos\\" + name.replace("/", "\\").upper() for name in inner)
    files.write_rs_csv(tmp_path, replace(rig, names=stated))
    assert [view.name for view in _read(tmp_path).views] == list(inner)
    files.write_rs_csv(tmp_path, replace(rig, names=tuple(Path(n).name for n in inner)))
    with pytest.raises(GsError, match=r"may be any of left/shot0\.png, right/shot0\.png"):
        _read(tmp_path)


def test_missing_photos(rig: Rig, tmp_path: Path) -> None:
    """Oracle: three of eight photos missing, which are named; a refusal with five missing."""
    files.write_rs_csv(_photos(tmp_path, rig), rig)
    for i in range(3):
        (tmp_path / "images" / rig.names[i]).unlink()
    capture = _read(tmp_path)
    assert len(capture.views) == 5 and "3 of the 8 photos" in capture.warnings[0]
    for i in range(3, 5):
        (tmp_path / "images" / rig.names[i]).unlink()
    with pytest.raises(GsError, match="5 of the 8 photos"):
        _read(tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        '<!DOCTYPE a [<!ENTITY b "bb">]><document><chunk/></document>',
        "<document><chunk><cameras>",
        "<document><chunk><sensors/><cameras/></chunk></document>",
    ],
)
def test_xml_that_is_no_camera_file(text: str, rig: Rig, tmp_path: Path) -> None:
    """Oracle: entities, a torn file, no cameras: a sentence each."""
    (_photos(tmp_path, rig) / "cameras.xml").write_text(text)
    with pytest.raises(FormatError, match=r"cameras\.xml"):
        _read(tmp_path)
    assert "document type" in str(_error(tmp_path)) or "<!" not in text


def _error(folder: Path) -> GsError:
    try:
        _read(folder)
    except GsError as error:
        return error
    raise AssertionError("it was read")


KINDS = {
    "RealityScan CSV": files.write_rs_csv,
    "Metashape XML": files.write_metashape,
    "OpenSfM": files.write_opensfm,
    "LLFF": files.write_llff,
    "RealityScan XMP": lambda folder, rig: files.write_rs_xmp(folder / "images", rig),
}


@pytest.mark.parametrize("kind", KINDS)
def test_inspected(kind: str, rig: Rig, tmp_path: Path) -> None:
    """Oracle: the kind, the file and the number of written cameras; also for the file itself as
    input."""
    rig = replace(rig, off=(0.0, 0.0)) if kind == "LLFF" else rig
    path = KINDS[kind](_photos(tmp_path, rig), rig)
    for source in (tmp_path, path):
        if source is None:
            continue
        facts = inspect(DataConfig(source=source))
        assert facts.kind == kind and facts.can_train and facts.photos == 8, facts.problems
        assert facts.model == (path or tmp_path / "images")
    assert f"({kind}), which gscore train and the add-on read" in other_cameras(tmp_path)


def test_of_several_camera_files_one_is_read_and_the_others_named(rig: Rig, tmp_path: Path) -> None:
    """Oracle: a CSV and an XML in one folder; sidecars in sub-folders, found below the given folder
    but not below its parent."""
    files.write_metashape(_photos(tmp_path / "a", rig), rig)
    path = files.write_rs_csv(tmp_path / "a", rig)
    text = " ".join(_read(tmp_path / "a").warnings)
    assert "not read: registration.csv; cameras.xml is." in text
    path.unlink()
    (tmp_path / "a/cameras.xml").unlink()
    inner = replace(rig, names=tuple(f"day 1/{name}" for name in rig.names))
    for name in rig.names:
        (tmp_path / "b/day 1").mkdir(parents=True, exist_ok=True)
        shutil.copy(tmp_path / "a/images" / name, tmp_path / "b/day 1")
    files.write_rs_xmp(tmp_path / "b", inner)
    _check(_read(tmp_path / "b"), inner, "realityscan")
    assert find_capture(tmp_path / "b") == tmp_path / "b" and not is_photo_folder(tmp_path / "b")
    assert find_capture(tmp_path / "a") == tmp_path / "a" and is_photo_folder(tmp_path / "a")


@pytest.mark.parametrize("folder", ["images", "input"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_camera_file_among_the_photos(kind: str, folder: str, rig: Rig, tmp_path: Path) -> None:
    """Oracle: the same cameras, whether the folder of the photos or the one above is given."""
    rig = replace(rig, off=(0.0, 0.0)) if kind == "LLFF" else rig
    _photos(tmp_path / "a", rig)
    if kind == "RealityScan XMP":
        KINDS[kind](tmp_path / "a", rig)
    else:
        KINDS[kind](tmp_path / "a/images", rig)
    (tmp_path / "a/images").rename(tmp_path / "a" / folder)
    inner = _read(tmp_path / "a" / folder)
    assert not is_photo_folder(tmp_path / "a")
    assert [v.viewmat.tolist() for v in _read(tmp_path / "a").views] == [
        v.viewmat.tolist() for v in inner.views
    ]


def test_colmap_and_transforms_come_first(rig: Rig, tmp_path: Path) -> None:
    """Oracle: a transforms.json of one camera in the same folder, which has precedence as
    before."""
    files.write_rs_csv(_photos(tmp_path, rig), rig)
    frame = {"file_path": "images/view_0.png", "transform_matrix": np.eye(4).tolist()}
    content = {"fl_x": 60, "w": 64, "h": 48, "frames": [frame]}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    assert len(_read(tmp_path).views) == 1
