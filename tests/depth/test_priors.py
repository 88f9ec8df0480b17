"""Priors at training resolution against two planes with known inverse depth everywhere."""

import json
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.depth import load_priors
from gscore.depth.maps import DepthKind
from gscore.depth.observations import observations, observed
from gscore.errors import ConfigError, DatasetError, FormatError
from gscore.io.colmap.model import PointIndex
from gscore.io.images.png import write_png


def _load(planes, **options):
    config = DataConfig(source=planes.folder, depths="depths", **{"resolution": 1, **options})
    dataset = load_dataset(config)
    return dataset, load_priors(config, dataset)


def _truth(planes, dataset, index):
    """[H, W] true inverse depth at the pixel centres of the training camera."""
    cameras = dataset.scene.cameras
    width, height = int(cameras.widths[index]), int(cameras.heights[index])
    pixels = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5, [1]), -1)[
        :, :, 0
    ]
    return planes.inverse_depth(index, pixels @ np.linalg.inv(cameras.Ks[index]).T)


def _npy(function):
    return lambda path, inverse: np.save(path, function(inverse).astype(np.float32))


def _png(path, inverse):
    code = np.rint(65535 * (inverse - inverse.min()) / np.ptp(inverse)).astype(np.uint16)
    Image.fromarray(code).save(path)


def _z_pass(path, inverse):
    with OpenEXR.File({}, {"ViewLayer.Depth.Z": (1 / inverse).astype(np.float32)}) as file:
        file.write(str(path))


KINDS = {
    "relative": (_npy(lambda s: 17 * s + 3), ".npy", DepthKind.INVERSE, 1 / 17),
    "negative offset": (_npy(lambda s: 0.2 * s - 5), ".npy", DepthKind.INVERSE, 5),
    "metric": (_npy(lambda s: 1.7 / s), ".npy", DepthKind.DEPTH, 1.7),
    "16-bit png": (_png, ".png", DepthKind.INVERSE, None),
    "z pass": (_z_pass, ".exr", DepthKind.DEPTH, 1.0),
}


@pytest.mark.parametrize("resolution", [1, 2])
@pytest.mark.parametrize("name", KINDS)
def test_every_kind_gives_the_true_inverse_depth(planes, name, resolution):
    """Oracle: the planes; the kind of the maps is detected, scale and offset are known."""
    save, ending, kind, scale = KINDS[name]
    planes.write_maps(save, ending=ending)
    dataset, priors = _load(planes, resolution=resolution)
    assert priors.kind is kind and priors.warnings == ()
    for i, prior in enumerate(priors.views):
        assert prior is not None and prior.aligned and prior.fit is not None
        if scale is not None:
            assert prior.fit.scale == pytest.approx(scale, rel=1e-3)
        truth = _truth(planes, dataset, i)
        assert prior.inverse_depth.dtype == prior.confidence.dtype == np.float32
        trusted = prior.confidence > 0.5
        assert trusted.mean() > 0.9  # all but the crease between the planes and unknown minima
        assert prior.inverse_depth[trusted] == pytest.approx(truth[trusted], rel=3e-3)
        assert prior.fit.inliers == pytest.approx(1) and prior.fit.error < 1e-3


@pytest.mark.parametrize("factor", [0.25, 3])
def test_maps_of_another_size(planes, factor):
    """Oracle: the planes; the same places in a network's small map and in a large one."""
    width, height = round(planes.width * factor), round(planes.height * factor)
    for i, name in enumerate(planes.names):
        path = (planes.folder / "depths" / name).with_suffix(".npy")
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, planes.truth(i, width, height).astype(np.float32))
    dataset, priors = _load(planes)
    for i, prior in enumerate(priors.views):
        assert prior.fit.scale == pytest.approx(1, rel=5e-3)
        inner = np.s_[3:-3, 3:-3]
        off = np.abs(prior.inverse_depth / _truth(planes, dataset, i) - 1)[inner]
        assert np.median(off) < 1e-3 and np.quantile(off, 0.99) < 0.02


@pytest.mark.parametrize("resolution", [1, 2])
def test_distorted_photos(make_planes, resolution):
    """Oracle: the planes through the pinhole camera that replaces the distorted one."""
    planes = make_planes(radial=-0.15)
    planes.write_maps(_npy(lambda s: 2 * s))
    dataset, priors = _load(planes, resolution=resolution)
    for i, prior in enumerate(priors.views):
        truth = _truth(planes, dataset, i)
        assert prior.inverse_depth.shape == truth.shape
        assert prior.fit.scale == pytest.approx(0.5, rel=1e-3)
        trusted = prior.confidence > 0.5
        assert trusted.mean() > 0.8
        assert prior.inverse_depth[trusted] == pytest.approx(truth[trusted], rel=5e-3)


def test_masks_and_unknown_pixels_are_not_trusted(planes):
    """Oracle: pixels with a mask of 0 and with NaN or 0 in the map, and one pixel around."""
    planes.write_maps(_npy(lambda s: s))
    hole = planes.folder / "depths" / "cam" / "v_2.npy"
    values = np.load(hole)
    values[40:50, 20:30], values[60:, 60:] = np.nan, 0
    np.save(hole, values)
    mask = np.zeros((planes.height, planes.width), np.uint8)
    mask[:, :70] = 255
    for name in planes.names:
        write_png(planes.folder / "masks" / name, mask)
    _, priors = _load(planes)
    trust = priors.views[2].confidence
    assert trust[:, 69:].max() == 0 and trust[39:51, 19:31].max() == 0
    assert trust[59:, 59:].max() == 0 and trust[5:35, 5:65].min() > 0.3
    assert np.isfinite(priors.views[2].inverse_depth).all()
    _, whole = _load(planes, mask_mode="none")
    assert whole.views[2].confidence[5:35, 75:].max() > 0.9


def test_no_maps_and_some_maps(planes):
    """Oracle: errors and warnings that name the missing maps."""
    with pytest.raises(DatasetError, match=r"no folder .*depths.*gscore depth"):
        _load(planes)
    (planes.folder / "depths").mkdir()
    np.save(planes.folder / "depths" / "other.npy", np.ones((4, 4)))
    with pytest.raises(DatasetError, match=r"no depth map of any view \(it contains 1 map\)"):
        _load(planes)
    planes.write_maps(_npy(lambda s: s))
    (planes.folder / "depths" / "cam" / "v_1.npy").unlink()
    _, priors = _load(planes)
    assert priors.views[1] is None and priors.views[0] is not None
    assert "1 of 5 views have no depth map" in priors.warnings[0]
    row = priors.table[1]
    assert (row["view"], row["map"], row["accepted"]) == ("cam/v_1.png", None, False)
    assert "no depth map" in row["reason"]
    json.dumps(priors.table, allow_nan=False)


def test_cropped_maps_are_refused(planes):
    """Oracle: an error with the first map and both sizes."""
    planes.write_maps(_npy(lambda s: s[:, 20:]))
    with pytest.raises(DatasetError, match=r"None of the 5.*v_0\.npy.*100 x 80.*120 x 80"):
        _load(planes)


@pytest.mark.parametrize("align", ["auto", "none"])
def test_a_file_that_cannot_be_used_costs_its_view_alone(planes, align):
    """Oracle: the other views' priors as without it, and the reader's own message."""
    planes.write_maps(_npy(lambda s: s))
    _, whole = _load(planes, depth_align=align)
    folder = planes.folder / "depths" / "cam"
    (folder / "v_1.npy").write_bytes(b"no array")
    np.save(folder / "v_3.npy", np.ones((80, 50), np.float32))
    _, priors = _load(planes, depth_align=align)
    assert [view is None for view in priors.views] == [False, True, False, True, False]
    for i in (0, 2, 4):
        expected = whole.views[i].inverse_depth
        assert priors.views[i].inverse_depth == pytest.approx(expected, rel=1e-4)
        assert priors.views[i].confidence == pytest.approx(whole.views[i].confidence, abs=1e-4)
    assert [row["accepted"] for row in priors.table] == [True, False, True, False, True]
    assert "v_1.npy cannot be read as a NumPy array" in priors.table[1]["reason"]
    assert "50 x 80 pixels" in priors.table[3]["reason"]
    assert "2 depth maps are left out" in priors.warnings[0] and "v_1.npy" in priors.warnings[0]
    assert sum("v_1.npy" in sentence for sentence in priors.warnings) == 1
    json.dumps(priors.table, allow_nan=False)


def test_one_bad_map_among_good_ones(planes):
    """Oracle: the view with noise for a map, refused with a reason and not aligned."""
    planes.write_maps(_npy(lambda s: s))
    rng = np.random.default_rng(0)
    bad = planes.folder / "depths" / "cam" / "v_3.npy"
    np.save(bad, rng.uniform(0.1, 0.3, (80, 120)).astype(np.float32))
    _, priors = _load(planes)
    assert [v.aligned for v in priors.views] == [True, True, True, False, True]
    assert priors.table[3]["reason"] and "1 of 5 depth maps were not aligned" in priors.warnings[0]


def test_a_scale_far_from_the_others_is_refused(planes):
    """Oracle: the rule of 0.2 to 5 times the median."""
    planes.write_maps(_npy(lambda s: s))
    far = planes.folder / "depths" / "cam" / "v_3.npy"
    np.save(far, np.load(far) * 8)
    _, priors = _load(planes)
    assert not priors.views[3].aligned and "times the median" in priors.table[3]["reason"]
    np.save(far, np.load(far) / 4)
    _, priors = _load(planes)
    assert all(view.aligned for view in priors.views)


def _write_params(planes, scale=0.5, offset=0.0, **others):
    path = planes.folder / "sparse" / "0" / "depth_params.json"
    content = {f"cam/v_{i}": {"scale": scale, "offset": offset} for i in range(5)} | others
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize("align", ["auto", "official"])
def test_the_file_is_used(planes, align):
    """Oracle: its numbers, and the official rule for a scale of 0 and one far from the median."""
    planes.write_maps(_npy(lambda s: 2 * s))
    _write_params(
        planes,
        **{"cam/v_1": {"scale": 0, "offset": 0}, "cam/v_2": {"scale": 2.6, "offset": 0.1}},
    )
    dataset, priors = _load(planes, depth_align=align)
    assert [v.aligned for v in priors.views] == [True, False, False, True, True]
    assert priors.views[0].inverse_depth == pytest.approx(_truth(planes, dataset, 0), rel=1e-4)
    assert priors.views[0].fit.scale == 0.5
    assert "times the median" in priors.table[2]["reason"]


def test_a_view_that_the_file_does_not_know(planes):
    """Oracle: a refusal with a reason that names the missing entry."""
    planes.write_maps(_npy(lambda s: 2 * s))
    path = _write_params(planes)
    content = json.loads(path.read_text())
    del content["cam/v_4"]
    path.write_text(json.dumps(content))
    _, priors = _load(planes, depth_align="official")
    assert not priors.views[4].aligned
    assert priors.table[4]["reason"] == "depth_params.json has no entry 'cam/v_4'"


def test_a_file_of_other_maps(planes):
    """Oracle: `official` uses it unchanged; `auto` reports that the points contradict it."""
    planes.write_maps(_npy(lambda s: 2 * s))
    path = _write_params(planes, scale=0.9)
    _, official = _load(planes, depth_align="official")
    assert official.views[0].fit.scale == 0.9 and official.views[0].fit.inliers < 0.1
    dataset, auto = _load(planes)
    assert auto.views[0].fit.scale == pytest.approx(0.5, rel=1e-3)
    assert (
        str(path) in auto.warnings[-1] and "contradicts the points of 5 views" in auto.warnings[-1]
    )
    assert auto.views[0].inverse_depth == pytest.approx(_truth(planes, dataset, 0), rel=2e-3)


def test_files_missing_and_broken(planes):
    """Oracle: without a file an error with `official`, as in the official trainer, and a separate
    alignment with `auto`; an error with both for a broken file."""
    planes.write_maps(_npy(lambda s: 2 * s))
    with pytest.raises(DatasetError, match=r"There is no .*depth_params\.json.*gscore depth"):
        _load(planes, depth_align="official")
    _, priors = _load(planes)
    assert all(view.aligned for view in priors.views)
    _write_params(planes).write_text('{"cam/v_0": ')
    for align in ("auto", "official"):
        with pytest.raises(FormatError, match=r"depth_params\.json is not JSON"):
            _load(planes, depth_align=align)
    _, priors = _load(planes, depth_align="robust")
    assert all(view.aligned for view in priors.views)


def test_no_alignment(planes):
    """Oracle: maps of inverse depth or depth in the capture's unit, used unchanged."""
    planes.write_maps(_npy(lambda s: 1 / s))
    dataset, priors = _load(planes, depth_align="none")
    assert priors.views[1].inverse_depth == pytest.approx(_truth(planes, dataset, 1), rel=1e-3)
    assert priors.views[1].fit.scale == 1
    with pytest.raises(ConfigError, match="depth_align"):
        _load(planes, depth_align="sometimes")


@pytest.mark.parametrize("radial", [0.0, -0.1])
def test_without_a_colmap_model(make_planes, radial):
    """Oracle: the same scale from a transforms.json with a point cloud, by projected points."""
    planes = make_planes(radial=radial)
    planes.write_maps(_npy(lambda s: 4 * s))
    _, expected = _load(planes)
    model = planes.folder / "sparse"
    dataset = load_dataset(DataConfig(source=planes.folder, resolution=1))
    points = dataset.scene.points
    properties = [f"property float {name}" for name in "xyz"]
    properties += [f"property uchar {name}" for name in ("red", "green", "blue")]
    lines = ["ply", "format ascii 1.0", f"element vertex {len(points)}", *properties, "end_header"]
    header = "\n".join(lines) + "\n"
    rows = "".join("{:.9g} {:.9g} {:.9g} 9 9 9\n".format(*p) for p in points.points)
    (planes.folder / "points.ply").write_text(header + rows)
    frames = []
    for name, viewmat in zip(planes.names, planes.viewmats, strict=True):
        pose = np.linalg.inv(viewmat) @ np.diag([1, -1, -1, 1.0])
        frames.append({"file_path": f"images/{name}", "transform_matrix": pose.tolist()})
    focal = {"fl_x": 90, "fl_y": 90, "cx": 60, "cy": 40, "w": 120, "h": 80, "k1": radial}
    content = {"ply_file_path": "points.ply", "frames": frames, **focal}
    (planes.folder / "transforms.json").write_text(json.dumps(content))
    for file in sorted((model / "0").iterdir()):
        file.unlink()
    (planes.folder / "depths").rename(planes.folder / "moved")
    (planes.folder / "depths" / "images").mkdir(parents=True)
    (planes.folder / "moved" / "cam").rename(planes.folder / "depths" / "images" / "cam")
    _, priors = _load(planes)
    for got, want in zip(priors.views, expected.views, strict=True):
        assert got.aligned and got.fit.scale == pytest.approx(want.fit.scale, rel=5e-3)
        assert got.fit.points > 100


def test_pixels_far_from_the_points_are_trusted_less(make_planes):
    """Oracle: half the confidence for an error as large as the known values, growing away from the
    points; there is no other map."""
    planes = make_planes(reach=(0.2, 0.27))
    waves = 0.01 * np.sin(np.arange(120) / 8.0)
    compared = 0
    for i, name in enumerate(planes.names):
        path = (planes.folder / "depths" / name).with_suffix(".npy")
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, (planes.truth(i) + waves).astype(np.float32))
        view = _load(planes)[1].views[i]
        path.unlink()
        if not view.aligned:  # a scale that the points hardly determine
            continue
        values = (view.inverse_depth - view.fit.offset) / view.fit.scale
        away = np.abs(values - view.fit.center)[4:-4, 4:-4] / view.fit.deviation
        trust = view.confidence[4:-4, 4:-4]
        assert np.median(trust[away < 1]) > 0.93
        if (away > 4).any():
            error = view.fit.relative_error(values)[4:-4, 4:-4]
            far, near = np.median(error[away > 4]), np.median(error[away < 1])
            assert far > 2 * near
            assert np.median(trust[away > 4]) < np.median(trust[away < 1])
            assert np.median(trust[away > 4]) == pytest.approx(1 / (1 + far**2), abs=0.03)
            compared += 1
    assert compared >= 2


def test_observations_of_a_view(planes):
    """Oracle: pycolmap's points and poses; weights by track length and reprojection error."""
    import pycolmap

    from gscore.io.colmap.folder import read_model

    model = read_model(planes.folder)
    image = model.images[2]
    rng = np.random.default_rng(0)
    model.points.error[:] = rng.uniform(0, 3, len(model.points))
    model.points.error[:3] = -1  # unknown counts as one pixel
    model.points.track_lengths[:] = rng.integers(1, 30, len(model.points))
    seen = observed(model, image, PointIndex(model.points))
    truth = pycolmap.Reconstruction(str(planes.folder / "sparse" / "0")).images[image.id]
    cloud = pycolmap.Reconstruction(str(planes.folder / "sparse" / "0")).points3D
    expected = [
        1 / (truth.cam_from_world() * cloud[p.point3D_id].xyz)[2]
        for p in truth.points2D
        if p.has_point3D()
    ]
    assert seen.inverse_depth == pytest.approx(expected, rel=1e-9)
    rows = image.point3D_ids - 1
    error = np.where(model.points.error[rows] < 0, 1, model.points.error[rows])
    tracks = np.minimum(np.maximum(model.points.track_lengths[rows], 2), 10)
    assert seen.weights == pytest.approx(tracks / (1 + error**2))
    assert (seen.width, seen.height) == (120, 80)


def test_a_model_of_another_world_is_not_asked(planes):
    """Oracle: cameras at other places than the model's: its observations have 80 points a view,
    projecting all 400 gives more."""
    config = DataConfig(source=planes.folder, resolution=1)
    dataset = load_dataset(config)
    assert {len(seen) for seen in observations(config, dataset)} == {80}
    cameras = dataset.scene.cameras
    viewmats = cameras.viewmats.copy()
    viewmats[2, 0, 3] += 0.1
    dataset.scene = replace(dataset.scene, cameras=replace(cameras, viewmats=viewmats))
    assert min(len(seen) for seen in observations(config, dataset)) > 150


@pytest.mark.parametrize("slant", [0.0, 0.02])
def test_edges_are_not_trusted_slants_are(slant):
    """Oracle: zero second difference of a slanted plane's inverse depth; a step has one."""
    from gscore.depth.confidence import confidence

    rows, columns = np.mgrid[:60, :80].astype(np.float32)
    values = 0.3 + slant * columns / 8 - 0.01 * rows / 6
    flat = confidence(values, None)
    assert flat.min() > 0.99
    values[:, 40:] += 0.1
    edge = confidence(values, None)
    assert edge[:, 39:41].max() < 0.05
    assert edge[:, :37].min() > 0.9 and edge[:, 43:].min() > 0.9
    scaled = confidence(500 * values + 7, None)
    assert scaled == pytest.approx(edge, abs=0.02)
