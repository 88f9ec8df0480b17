"""Georeferenced captures: splats and cameras about a local origin, stated in their files."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gscore as package
from gscore.config import DataConfig
from gscore.datasets.read import read_capture
from gscore.formats import read_splat_file, write_splat_file
from gscore.io.cameras_json import read_cameras_json, write_cameras
from gscore.io.colmap.folder import read_model, write_model
from gscore.io.images.read_image import read_image
from gscore.io.ply.splats import write_splats

from .conftest import STEPS

UTM = np.array([500000.0, 5600000.0, 120.0])
ECEF = np.array([4027893.75, 307045.906, 4919474.91])
TRAIN = ("--preset", "draft", "--iterations", STEPS, "--eval", "--quiet", "--threads", 1)


def moved(capture: Path, folder: Path, shift: np.ndarray, scale: float = 1.0) -> Path:
    """A copy of a capture with its model scaled, then moved, in float64."""
    model = read_model(capture)
    images = []
    for image in model.images:
        rotation = image.viewmat[:3, :3]
        center = -rotation.T @ image.viewmat[:3, 3] * scale + shift
        images.append(replace(image, tvec=-rotation @ center))
    points = replace(model.points, xyz=model.points.xyz * scale + shift)
    (folder / "sparse/0").mkdir(parents=True)
    write_model(replace(model, images=images, points=points), folder / "sparse/0")
    (folder / "images").symlink_to(capture / "images")
    return folder


def psnr(folder: Path) -> float:
    """The PSNR of a metrics.json, dB."""
    return json.loads((folder / "metrics.json").read_text())["psnr"]


@pytest.fixture(params=["utm", "ecef", "small"])
def far(request, capture, tmp_path):
    """The capture, moved, and the offset."""
    shift, scale = {"utm": (UTM, 1.0), "ecef": (ECEF, 1.0), "small": (UTM / 1e3, 0.01)}[
        request.param
    ]
    return moved(capture, tmp_path / "far", shift, scale)


def test_a_far_capture_trains_and_measures_as_a_near_one(gscore, far, trained, tmp_path):
    """Oracle: PSNR of the run on the unmoved capture, and positions of the model's files."""
    run, again = tmp_path / "run", tmp_path / "again"
    assert gscore("train", far, "-o", run, *TRAIN)[0] == 0
    assert psnr(run) == pytest.approx(psnr(trained), abs=0.05)
    assert gscore("eval", run, "-s", far, "-o", again, "--quiet")[0] == 0
    assert psnr(again) == pytest.approx(psnr(run), abs=0.005)
    found = read_splat_file(run / "point_cloud.ply")
    cameras = read_cameras_json(run / "cameras.json")
    assert found.origin is not None and cameras.origin is not None
    np.testing.assert_array_equal(found.origin, cameras.origin)
    poses = {image.name: image.viewmat for image in read_model(far).images}
    truth = replace(cameras, viewmats=np.stack([poses[name] for name in cameras.names]))
    wanted = truth.centers
    np.testing.assert_allclose(cameras.centers + cameras.origin, wanted, rtol=1e-12, atol=3e-9)


def test_an_ordinary_capture_has_no_local_origin(capture, trained):
    """Oracle: the files of today, without an origin."""
    assert read_capture(DataConfig(source=capture)).origin is None
    assert read_splat_file(trained / "point_cloud.ply").origin is None
    assert b"origin" not in (trained / "point_cloud.ply").read_bytes()[:1000]
    assert "origin" not in (trained / "cameras.json").read_text()


@pytest.mark.parametrize(
    ("shift", "wanted"),
    [
        ((500.0, 0, 0), False),
        ((5e4, -2e4, 10), True),
        ((0, 0, 1e5), True),
        ((1e3, 1e3, 1e3), False),
    ],
)
def test_a_local_origin_is_where_float32_costs_a_hundredth_of_a_pixel(
    capture, tmp_path, shift, wanted
):
    """Oracle: float32 steps at the capture's coordinates, viewed from 5 units with a focal length
    of 45 px: 0.01 px is reached about 15,000 units away."""
    far = moved(capture, tmp_path / "far", np.array(shift))
    found = read_capture(DataConfig(source=far))
    assert (found.origin is not None) == wanted
    if found.origin is not None:
        assert np.abs(found.origin - shift).max() <= 1 and (found.origin % 1 == 0).all()
        assert "local origin" in found.warnings[-1]


@pytest.fixture(scope="module")
def exact(tmp_path_factory, capture, splats):
    """A far capture, and its true splats about its local origin."""
    folder = tmp_path_factory.mktemp("exact")
    far = moved(capture, folder / "far", UTM)
    origin = read_capture(DataConfig(source=far)).origin
    means = (splats.means.astype(np.float64) + UTM - origin).astype(np.float32)
    return far, replace(splats, means=means), origin


def test_cameras_in_full_coordinates_meet_splats_about_a_local_origin(
    gscore, exact, cameras, tmp_path, picture
):
    """Oracle: the pictures of the unmoved splats; the same places for cameras of the capture, of
    files with and without a stated origin, and of Python."""
    far, splats, origin = exact
    ply = tmp_path / "true.ply"
    write_splat_file(ply, splats, origin=origin)
    full = cameras.about(-UTM)
    full = replace(full, origin=None)
    write_cameras(tmp_path / "full.json", full)
    write_cameras(tmp_path / "local.json", full.about(origin))
    write_cameras(tmp_path / "other.json", full.about(origin + 7))
    write_cameras(tmp_path / "lost.json", replace(full.about(origin), origin=None))
    wanted = (np.clip(picture(4).rgb, 0, 1) * 255).astype(float)
    for source in (far, *sorted(tmp_path.glob("*.json"))):
        out = tmp_path / "out.png"
        assert gscore("render", ply, "-s", source, "--view", "a_4", "-o", out, "--quiet")[0] == 0
        np.testing.assert_allclose(read_image(out).astype(float), wanted, atol=1.5)
    for path in sorted(tmp_path.glob("*.json")):
        out = tmp_path / "path"
        args = ("--path", path, "-o", out, "--quiet", "--overwrite")
        assert gscore("render", ply, *args)[0] == 0
        found = read_image(sorted(out.glob("*.png"))[4]).astype(float)
        np.testing.assert_allclose(found, wanted, atol=1.5)
    how = (cameras.Ks[4], full.viewmats[4], int(cameras.widths[4]), int(cameras.heights[4]))
    found = package.render(ply, *how, origin=(0, 0, 0)).rgb
    np.testing.assert_allclose(np.clip(found, 0, 1) * 255, wanted, atol=1.5)
    with pytest.raises(package.ShapeError, match="origin needs a splat file"):
        package.render(splats, *how, origin=(0, 0, 0))


@pytest.mark.parametrize("name", ["a.ply", "a.compressed.ply", "a.sog", "a.glb", "a.usdc"])
def test_formats_with_a_place_for_it_state_the_origin(gscore, exact, tmp_path, name):
    """Oracle: the origin in the PLY, to the bit, and its splats, after conversion and back."""
    if name.endswith("usdc"):
        pytest.importorskip("pxr.UsdVol")
    _, splats, origin = exact
    origin = origin + np.array([0.1, 1 / 3, 0])
    write_splat_file(tmp_path / "in.ply", splats, origin=origin)
    assert gscore("convert", tmp_path / "in.ply", tmp_path / "to" / name)[0] == 0
    assert gscore("convert", tmp_path / "to" / name, tmp_path / "back.ply")[0] == 0
    back = read_splat_file(tmp_path / "back.ply")
    np.testing.assert_array_equal(back.origin, origin)
    order = [np.lexsort(one.means.round(1).T) for one in (back.splats, splats)]
    np.testing.assert_allclose(
        back.splats.means[order[0]].mean(axis=0), splats.means[order[1]].mean(axis=0), atol=1e-3
    )


@pytest.mark.parametrize("name", ["a.spz", "a.splat"])
def test_formats_without_a_place_say_so_and_are_still_placed(gscore, exact, tmp_path, name):
    """Oracle: the message, which names the origin; `eval` on the capture measures the same as of
    the PLY."""
    far, splats, origin = exact
    write_splat_file(tmp_path / "in.ply", splats, origin=origin)
    code, _, err = gscore("convert", tmp_path / "in.ply", tmp_path / name)
    assert code == 0 and "local origin" in err and "5600000" in err
    worth = []
    for one in ("in.ply", name):
        out = tmp_path / f"{one}.out"
        args = ("-s", far, "-o", out, "--quiet", "--split", "all")
        assert gscore("eval", tmp_path / one, *args)[0] == 0
        worth.append(psnr(out))
    assert worth[0] > 40 and worth[1] > 25


def test_joined_files_come_about_one_origin(gscore, exact, tmp_path):
    """Oracle: the same splats about two origins, which coincide."""
    _, splats, origin = exact
    write_splat_file(tmp_path / "one.ply", splats, origin=origin)
    other = replace(splats, means=splats.means - np.float32([3, -4, 5]))
    write_splat_file(tmp_path / "two.ply", other, origin=origin + np.array([3, -4, 5]))
    args = ("--merge", tmp_path / "two.ply")
    assert gscore("convert", tmp_path / "one.ply", tmp_path / "both.ply", *args)[0] == 0
    found = read_splat_file(tmp_path / "both.ply")
    np.testing.assert_array_equal(found.origin, origin)
    half = len(splats)
    np.testing.assert_allclose(found.splats.means[:half], found.splats.means[half:], atol=1e-5)


def test_levels_of_detail_keep_the_origin(gscore, exact, tmp_path):
    """Oracle: the picture of the PLY, from the capture's cameras."""
    far, splats, origin = exact
    write_splat_file(tmp_path / "in.ply", splats, origin=origin)
    assert gscore("lod", tmp_path / "in.ply", "-o", tmp_path / "a.lod", "--quiet")[0] == 0
    for one in ("in.ply", "a.lod"):
        args = ("-s", far, "--view", "a_4", "-o", tmp_path / f"{one}.png", "--quiet")
        assert gscore("render", tmp_path / one, *args)[0] == 0
    a, b = (read_image(tmp_path / f"{one}.png").astype(float) for one in ("in.ply", "a.lod"))
    assert a.max() > 50 and np.abs(a - b).max() <= 1
    assert gscore("convert", tmp_path / "a.lod", tmp_path / "back.ply")[0] == 0
    np.testing.assert_array_equal(read_splat_file(tmp_path / "back.ply").origin, origin)


def test_a_run_goes_on_about_its_own_origin(gscore, exact, tmp_path):
    """Oracle: files of a run whose checkpoint states an origin, also where another would be chosen
    now; an older run without an origin continues in the capture's coordinates."""
    far, splats, origin = exact
    ply, run = tmp_path / "start.ply", tmp_path / "run"
    other = origin + np.array([2, 0, -1])
    about = replace(splats, means=splats.means - np.float32([2, 0, -1]))
    write_splat_file(ply, about, origin=other)
    short = ("--preset", "draft", "--iterations", 2, "--eval", "--quiet", "--threads", 1)
    assert gscore("train", far, "-o", run, *short, "--start-splats", ply)[0] == 0
    assert psnr(run) > 30
    assert gscore("train", "-o", run, "--resume", "--iterations", 4, "--quiet")[0] == 0
    assert psnr(run) > 30
    np.testing.assert_array_equal(read_splat_file(run / "point_cloud.ply").origin, other)


def test_a_damaged_origin_is_refused(gscore, exact, tmp_path):
    """Oracle: one sentence that names the comment."""
    _, splats, _ = exact
    write_splats(tmp_path / "a.ply", splats, comments=("gscore origin 1 2 nan",))
    code, _, err = gscore("info", tmp_path / "a.ply")
    assert code == 2 and "states no local origin" in err and err.count("\n") <= 3
