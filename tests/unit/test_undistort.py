"""Undistortion against pycolmap: a point that it projects through the lens must end up where K
projects it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.datasets.decode import ViewFile, decode_view
from gscore.datasets.resolution import scale_intrinsics
from gscore.datasets.undistort import Undistortion, plan_undistortion
from gscore.errors import DatasetError, FormatError
from gscore.io.colmap.folder import ColmapCamera
from gscore.io.colmap.lenses import CAMERA_MODELS
from gscore.io.images.png import write_png
from gscore.io.images.read_image import resize

_DISTORTED = [
    model.name
    for model in CAMERA_MODELS
    if model.name not in ("SIMPLE_PINHOLE", "PINHOLE", "EQUIRECTANGULAR")
]
_SIZE = (200, 150)


def _camera(model: str) -> ColmapCamera:
    """A camera with off-centre principal point, fx != fy where it can, visible distortion."""
    theirs = pycolmap.Camera.create_from_model_name(1, model, 170.0, *_SIZE)
    params = np.array(theirs.params, float)
    if len(theirs.focal_length_idxs()) == 2:
        params[1] = 176.0
    for index, value in zip(theirs.principal_point_idxs(), (103.0, 72.0), strict=True):
        params[index] = value
    small = {"p1": 0.002, "p2": -0.003, "p0": 0.002, "sx1": 0.001, "sy1": 0.001, "omega": 1.0}
    small |= {"alpha": 0.5, "beta": 1.1, "k": -0.1, "k1": -0.1, "k2": 0.02, "k0": -0.1}
    names = [name.strip() for name in theirs.params_info.split(",")]
    for k in theirs.extra_params_idxs():
        params[k] = small.get(names[k], 0.001)
    return ColmapCamera(model=model, width=_SIZE[0], height=_SIZE[1], params=params)


def _project(camera: ColmapCamera, points: np.ndarray) -> np.ndarray:
    """Pixels of camera-space points [P, 3], by pycolmap."""
    return _theirs(camera).img_from_cam(points)


def _theirs(camera: ColmapCamera) -> pycolmap.Camera:
    return pycolmap.Camera(
        model=camera.model, width=camera.width, height=camera.height, params=camera.params
    )


def _marker(size: tuple[int, int], at: np.ndarray) -> np.ndarray:
    """[h, w] uint8, a smooth spot of standard deviation 2 px around a position."""
    row, column = np.mgrid[0 : size[1], 0 : size[0]] + 0.5
    spot = np.exp(-((column - at[0]) ** 2 + (row - at[1]) ** 2) / (2 * 2.0**2))
    return np.rint(255 * spot).astype(np.uint8)


def _centroid(image: np.ndarray) -> np.ndarray:
    weight = np.where(image > 8, image, 0).astype(float)
    row, column = np.mgrid[0 : image.shape[0], 0 : image.shape[1]] + 0.5
    return np.array([(weight * column).sum(), (weight * row).sum()]) / weight.sum()


def _plan(camera: ColmapCamera) -> Undistortion:
    plan = plan_undistortion(camera)
    assert plan is not None
    return plan


@pytest.mark.parametrize("model", _DISTORTED)
@pytest.mark.parametrize("scale", [1.0, 1.5])
def test_markers_land_where_the_pinhole_predicts(model: str, scale: float) -> None:
    """Oracle: pycolmap projects 3D points with the distorted camera; K alone predicts the result.

    With scale 1.5 the photo is larger than the camera was calibrated at.
    """
    camera = _camera(model)
    plan = _plan(camera)
    photo_size = (round(_SIZE[0] * scale), round(_SIZE[1] * scale))
    size = (round(plan.width * scale), round(plan.height * scale))
    K = scale_intrinsics(plan.K, (plan.width, plan.height), size)
    # Points behind pixels of the pinhole image, at several depths.
    targets = np.array([[0.5, 0.5], [0.15, 0.2], [0.85, 0.2], [0.15, 0.8], [0.8, 0.85]]) * size
    depths = np.array([1.0, 2.0, 3.0, 0.5, 7.0])
    rays = np.column_stack([targets, np.ones(5)]) @ np.linalg.inv(K).T
    drawn = _project(camera, rays * depths[:, None]) * scale
    moved = np.abs(drawn - _project_pinhole(camera, rays) * scale).max()
    assert moved > 0.5  # the distortion is large enough to matter
    for target, at in zip(targets, drawn, strict=True):
        photo = np.repeat(_marker(photo_size, at)[..., None], 3, axis=2)
        out = plan.remap(photo, size, pixels=(scale, scale))
        assert out.shape == (size[1], size[0], 3)
        assert np.abs(_centroid(out[..., 1]) - target).max() < 0.2
        np.testing.assert_array_equal(out[..., 0], out[..., 2])
        mask = plan.remap(_marker(photo_size, at), size, pixels=(scale, scale))
        np.testing.assert_array_equal(mask, out[..., 0])


def _project_pinhole(camera: ColmapCamera, rays: np.ndarray) -> np.ndarray:
    projected = rays @ camera.K.T
    return projected[:, :2] / projected[:, 2:]


@pytest.mark.parametrize("model", _DISTORTED)
def test_the_pinhole_is_the_one_of_colmap(model: str, rng: np.random.Generator) -> None:
    """Oracle: pycolmap's own choice, for lenses of weak and strong distortion, in and out. Where
    ours is refused or cut off, and only there, pycolmap's has pixels outside the photo, or some
    twice."""
    reported = 0
    for _ in range(20):
        camera = _camera(model)
        bend = rng.uniform(-0.5, 0.5, len(camera.params))
        names = list(camera.named_params)
        bends = [i for i, name in enumerate(names) if name[0] == "k"]
        camera.params[bends] = bend[bends] * [1.0 if i == bends[0] else 0.2 for i in bends]
        theirs = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), _theirs(camera))
        bad = _bad_share(theirs, _theirs(camera))
        try:
            plan = _plan(camera)
        except FormatError:
            assert bad > 0.05
            continue
        assert (bad > 0) == (plan.cut_off > 0)
        if plan.cut_off:
            continue
        reported += 1
        assert (theirs.width, theirs.height) == (plan.width, plan.height)
        np.testing.assert_allclose(theirs.calibration_matrix(), plan.K)
    assert reported >= 15


def _bad_share(pinhole: pycolmap.Camera, lens: pycolmap.Camera) -> float:
    """Share of a pinhole camera's picture that is outside the photo of a lens, or at a place of it
    which pycolmap maps to another direction."""
    x, y = (np.linspace(0, size, 65) for size in (pinhole.width, pinhole.height))
    rays = pinhole.cam_from_img(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    photo = lens.img_from_cam(np.column_stack([rays, np.ones(len(rays))]))
    inside = ((photo > -1) & (photo < [lens.width + 1, lens.height + 1])).all(axis=1)
    back = np.abs(lens.cam_from_img(photo) - rays).max(axis=1) < 1e-3
    return float(1 - (inside & back).mean())


@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV"])
def test_pictures_equal_those_of_colmap(model: str, rng: np.random.Generator) -> None:
    """Oracle: pycolmap's own undistorter on a smooth random photo, pixel by pixel."""
    camera = _camera(model)
    plan = _plan(camera)
    coarse = rng.uniform(0, 255, (8, 10, 3))
    row, column = np.mgrid[0 : _SIZE[1], 0 : _SIZE[0]]
    r, c = row / _SIZE[1] * 6.9, column / _SIZE[0] * 8.9
    i, j = r.astype(int), c.astype(int)
    u, v = (r - i)[..., None], (c - j)[..., None]
    top = coarse[i, j] * (1 - v) + coarse[i, j + 1] * v
    below = coarse[i + 1, j] * (1 - v) + coarse[i + 1, j + 1] * v
    photo = np.rint(top * (1 - u) + below * u).astype(np.uint8)
    theirs, theirs_camera = pycolmap.undistort_image(
        pycolmap.UndistortCameraOptions(),
        pycolmap.Bitmap.from_array(photo),
        pycolmap.Camera(model=model, width=_SIZE[0], height=_SIZE[1], params=camera.params),
    )
    assert (theirs_camera.width, theirs_camera.height) == (plan.width, plan.height)
    np.testing.assert_allclose(theirs_camera.calibration_matrix(), plan.K)
    ours = plan.remap(photo, (plan.width, plan.height))
    difference = np.abs(ours.astype(int) - theirs.to_array().astype(int)).max(axis=2)
    # Beyond the photo they paint black and we repeat its border.
    row, column = np.mgrid[0 : plan.height, 0 : plan.width] + 0.5
    source = plan.distort(np.column_stack([column.ravel(), row.ravel()])).reshape(*row.shape, 2)
    inside = ((source > 1) & (source < np.array(_SIZE) - 1)).all(axis=2)
    assert inside.mean() > 0.95
    assert difference[inside].max() <= 1


def _view(
    image: Path, size: tuple[int, int], plan: Undistortion, *, use_alpha: bool = False
) -> ViewFile:
    """A photo of `_SIZE` without a mask."""
    return ViewFile(
        image=image,
        mask=None,
        mask_inverted=False,
        use_alpha=use_alpha,
        upright=True,
        photo_size=_SIZE,
        size=size,
        plan=plan,
    )


def _stripes(points: np.ndarray) -> np.ndarray:
    """[..., 3] of 0 to 255 at [..., 2] px: waves of 4 and 5 px along both axes."""
    x, y = points[..., 0], points[..., 1]
    waves = (np.sin(np.pi / 2 * x), np.sin(2 * np.pi / 5 * y), np.sin(2 * np.pi / 5 * (x + y)))
    return 127.5 + 100 * np.stack(waves, axis=-1)


@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "OPENCV_FISHEYE"])
def test_sharp_photos_keep_fine_detail(model: str) -> None:
    """Oracle: the waves of the photo, evaluated where the lens maps each pixel."""
    plan = _plan(_camera(model))
    row, column = np.mgrid[0 : _SIZE[1], 0 : _SIZE[0]] + 0.5
    photo = np.rint(_stripes(np.stack([column, row], axis=-1))).astype(np.uint8)
    row, column = np.mgrid[0 : plan.height, 0 : plan.width] + 0.5
    source = plan.distort(np.column_stack([column.ravel(), row.ravel()])).reshape(*row.shape, 2)
    inside = ((source > 3) & (source < np.array(_SIZE) - 3)).all(axis=2)
    found = {
        sharp: plan.remap(photo, (plan.width, plan.height), sharp=sharp)[inside].astype(float)
        for sharp in (False, True)
    }
    errors = {s: np.abs(f - _stripes(source)[inside]).mean() for s, f in found.items()}
    assert errors[True] < 0.5 * errors[False], errors
    contrast = {s: f.std(axis=0).mean() / _stripes(source)[inside].std() for s, f in found.items()}
    assert contrast[True] > 0.93 > 0.9 > contrast[False], contrast


def test_sharp_photos_of_one_value_stay_so() -> None:
    """Oracle: weights of sum 1 everywhere, also at the repeated border; bytes that cubic
    convolution would take out of range are clamped."""
    plan = _plan(_camera("OPENCV"))
    size = (plan.width, plan.height)
    assert (plan.remap(np.full((150, 200, 3), 201, np.uint8), size, sharp=True) == 201).all()
    edge = np.zeros((150, 200), np.uint8)
    edge[:, 100:] = 255
    found = plan.remap(edge, size, sharp=True)
    assert found[:, : plan.width // 3].max() == 0 and found[:, -(plan.width // 3) :].min() == 255


@pytest.mark.parametrize(("width", "sharp"), [(0, True), (100, False)])
def test_photos_that_are_not_scaled_down_are_sharp(
    width: int, sharp: bool, tmp_path: Path, rng: np.random.Generator
) -> None:
    """Oracle: `remap` itself, at the full size and at half of it."""
    camera = _camera("SIMPLE_RADIAL")
    plan = _plan(camera)
    photo = rng.integers(0, 256, (*_SIZE[::-1], 3)).astype(np.uint8)
    write_png(tmp_path / "a.png", photo)
    size = (width, round(plan.height * width / plan.width)) if width else (plan.width, plan.height)
    file = _view(tmp_path / "a.png", size, plan)
    remapped = plan.remap(photo, (plan.width, plan.height), sharp=sharp)
    decoded = decode_view(file)[0]
    np.testing.assert_array_equal(decoded, resize(remapped, *size))
    if sharp:
        np.testing.assert_array_equal(plan.undistort_photo(photo), decoded)


def test_a_colour_under_an_edge_of_alpha_stays(tmp_path: Path) -> None:
    """Oracle: the one colour of the photo, wherever alpha shows it."""
    plan = _plan(_camera("SIMPLE_RADIAL"))
    photo = np.full((*_SIZE[::-1], 4), 128, np.uint8)
    photo[:, : _SIZE[0] // 2, 3], photo[:, _SIZE[0] // 2 :, 3] = 0, 255
    write_png(tmp_path / "a.png", photo)
    size = (plan.width, plan.height)
    rgb, alpha = decode_view(_view(tmp_path / "a.png", size, plan, use_alpha=True))
    assert alpha is not None and 0.4 < (alpha > 128).mean() < 0.6
    np.testing.assert_array_equal(plan.undistort_photo(photo), np.dstack([rgb, alpha]))
    assert np.abs(rgb[alpha > 200].astype(int) - 128).max() <= 1


def test_nearest_keeps_values(rng: np.random.Generator) -> None:
    """Oracle: labels and depths of the input; bilinear floats within its range."""
    plan = _plan(_camera("OPENCV"))
    labels = np.where(rng.uniform(size=(150, 200)) > 0.5, 255, 0).astype(np.uint8)
    out = plan.remap(labels, (plan.width, plan.height), nearest=True)
    assert set(np.unique(out).tolist()) == {0, 255}
    depth = rng.uniform(1, 9, (150, 200)).astype(np.float32)
    out = plan.remap(depth, (plan.width, plan.height), nearest=True)
    assert out.dtype == np.float32 and np.isin(out, depth).all()
    smooth = plan.remap(depth, (plan.width, plan.height))
    assert depth.min() <= smooth.min() and smooth.max() <= depth.max()


def test_one_pixel_photo() -> None:
    """Oracle: a photo of one row or column, in which there is nothing to interpolate."""
    plan = _plan(_camera("SIMPLE_RADIAL"))
    for shape in ((1, 1, 3), (1, 200, 3), (150, 1, 3)):
        photo = np.full(shape, 77, np.uint8)
        pixels = (shape[1] / 200, shape[0] / 150)
        assert (plan.remap(photo, (20, 15), pixels=pixels) == 77).all()


def test_pinhole_needs_nothing() -> None:
    """Oracle: cameras without distortion, and models of zero distortion, unchanged."""
    for model in ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL"):
        theirs = pycolmap.Camera.create_from_model_name(1, model, 170.0, *_SIZE)
        camera = ColmapCamera(model=model, width=200, height=150, params=np.array(theirs.params))
        assert plan_undistortion(camera) is None


def test_refusals() -> None:
    """Oracle: a sentence that refuses panoramas and distortion that folds over."""
    panorama = ColmapCamera(
        model="EQUIRECTANGULAR", width=200, height=100, params=np.array([200.0, 100.0])
    )
    with pytest.raises(DatasetError, match="360 degree"):
        plan_undistortion(panorama)
    params = np.array([30.0, 30, 100, 75, -0.3, 0, 0, 0, 0, 0, 0, 0])
    folded = ColmapCamera(model="FULL_OPENCV", width=200, height=150, params=params)
    with pytest.raises(FormatError, match=r"its distortion folds back, so that 9\d % of the"):
        plan_undistortion(folded)


def _is_one_to_one(plan: Undistortion, cells: int = 300) -> bool:
    """True if neighbours of a fine grid keep their order, by the signed areas of its triangles."""
    x, y = np.linspace(0, plan.width, cells), np.linspace(0, plan.height, cells)
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    rays = (grid - plan.K[:2, 2]) / [plan.K[0, 0], plan.K[1, 1]]
    found = _radial(plan.camera, rays)
    right, down = np.diff(found, axis=1)[:-1], np.diff(found, axis=0)[:, :-1]
    return bool((right[..., 0] * down[..., 1] > right[..., 1] * down[..., 0]).all())


def _radial(camera: ColmapCamera, rays: np.ndarray) -> np.ndarray:
    """Pixels of a RADIAL camera for [..., 2] directions with z = 1, from the model's formula."""
    f, cx, cy, k1, k2 = camera.params
    r2 = (rays**2).sum(axis=-1, keepdims=True)
    return f * rays * (1 + k1 * r2 + k2 * r2**2) + [cx, cy]


def _barrel(k1: float, k2: float = 0.0) -> ColmapCamera:
    return ColmapCamera(
        model="RADIAL", width=200, height=150, params=np.array([170.0, 103, 72, k1, k2])
    )


@pytest.mark.parametrize("k1", [-0.3, -0.4, -0.415, -0.42, -0.43, -0.44, -0.45])
def test_rims_that_fold_are_left_out(k1: float) -> None:
    """Oracle: the model's formula in float64: r (1 + k1 r^2) turns back at r = (-3 k1)^-1/2; the
    rest of the picture is one to one and nearly reaches that radius."""
    camera = _barrel(k1)
    theirs = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), _theirs(camera))
    whole = Undistortion(
        camera=camera,
        width=theirs.width,
        height=theirs.height,
        K=np.array(theirs.calibration_matrix()),
    )
    plan = _plan(camera)
    assert _is_one_to_one(plan)
    assert (plan.cut_off == 0) == _is_one_to_one(whole)
    corners = np.array([[0, 0], [plan.width, 0], [0, plan.height], [plan.width, plan.height]])
    radius = np.linalg.norm((corners - plan.K[:2, 2]) / plan.K[0, 0], axis=1).max()
    turns_back = (-3 * k1) ** -0.5
    assert radius <= turns_back
    if plan.cut_off:
        assert radius > 0.98 * turns_back
        assert plan.cut_off == pytest.approx(
            1 - plan.width * plan.height / (whole.width * whole.height)
        )
    # The same pixels show the same as before: the principal point moved with the rim.
    shift = whole.K[:2, 2] - plan.K[:2, 2]
    inside = np.array([[10.0, 10.0], [60.5, 80.25]])
    np.testing.assert_allclose(plan.distort(inside), whole.distort(inside + shift), atol=1e-9)


@pytest.mark.parametrize(
    ("k1", "k2"), [(-0.46, 0.0), (-0.5, 0.0), (-0.7, 0.0), (-1.5, 0.0), (0.5, -2.0)]
)
def test_distortion_that_folds_back_is_refused(k1: float, k2: float) -> None:
    """Oracle: pycolmap's own picture of such a camera, which shows a part of the photo twice."""
    with pytest.raises(FormatError, match=r"RADIAL camera .* folds back|outside the photo"):
        plan_undistortion(_barrel(k1, k2))


def test_a_second_turn_is_no_way_back() -> None:
    """Oracle: r (1 - 0.9 r^2 + 0.27 r^4), which falls from r = 0.70 to 1.23 and rises again, with
    positive signed areas as in the middle."""
    camera = _barrel(-0.9, 0.27)
    with pytest.raises(FormatError, match=r"folds back"):
        plan_undistortion(camera)


class TestInADataset:
    """The whole chain: model, photos, masks, scaling."""

    @pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "OPENCV_FISHEYE"])
    @pytest.mark.parametrize("resolution", [1, 2, 5])
    def test_points_appear_where_the_scene_says(
        self, model: str, resolution: float, make_capture: Callable
    ) -> None:
        """Oracle: a spot drawn by pycolmap's projection, at K (R x + t), masks alike."""
        camera = _camera(model)
        capture = make_capture(
            model=model, params=camera.params.tolist(), size=_SIZE, views=3, points=1
        )
        point = capture.model.points.xyz[0]
        for image in capture.model.images:
            in_camera = image.viewmat[:3, :3] @ point + image.viewmat[:3, 3]
            spot = _marker(_SIZE, _project(camera, in_camera[None])[0])
            write_png(capture.root / "images" / image.name, np.repeat(spot[..., None], 3, 2))
            write_png(capture.root / "masks" / image.name, np.maximum(spot, 1))
        config = DataConfig(source=capture.root, resolution=resolution, mask_mode="ignore")
        data = load_dataset(config)
        cameras = data.scene.cameras
        for i in range(3):
            K, viewmat = cameras.Ks[i], cameras.viewmats[i]
            x, y, z = K @ (viewmat[:3, :3] @ point + viewmat[:3, 3])
            image, mask = data.image(i), data.mask(i)
            assert mask is not None
            assert image.shape == (cameras.heights[i], cameras.widths[i], 3)
            assert image.flags.c_contiguous and mask.flags.c_contiguous
            np.testing.assert_allclose(_centroid(image[..., 0]), [x / z, y / z], atol=0.25)
            np.testing.assert_allclose(_centroid(mask), [x / z, y / z], atol=0.25)

    def test_cropped_borders_are_reported(self, make_capture: Callable) -> None:
        """Oracle: the sentence, and a photo with its halves still left and right of the middle."""
        params = _barrel(-0.43).params.tolist()
        capture = make_capture(model="RADIAL", params=params, size=_SIZE, views=2)
        for k, name in enumerate(capture.photos):
            photo = np.full((150, 200, 3), k, np.uint8)
            photo[:, :103] = 255
            write_png(capture.root / "images" / name, photo)
        data = load_dataset(DataConfig(source=capture.root))
        (warning,) = data.warnings
        assert "distortion of 2 photos folds back at the rim, so up to 1" in warning
        assert "(view_00.png, RADIAL [170.0, 103.0, 72.0, -0.43, 0.0])" in warning
        middle = data.scene.cameras.Ks[0][0, 2]
        image = data.image(0)
        assert (image[:, : int(middle) - 2] == 255).all() and (
            image[:, int(middle) + 3 :] == 0
        ).all()

    def test_binary_masks_stay_binary(self, make_capture: Callable) -> None:
        """Oracle: values of the input, because nothing is averaged without scaling."""
        params = _camera("OPENCV").params.tolist()
        capture = make_capture(model="OPENCV", params=params, size=_SIZE, views=1)
        half = np.zeros((150, 200), np.uint8)
        half[:, 90:] = 255
        write_png(capture.root / "masks" / "view_00.png", half)
        mask = load_dataset(DataConfig(source=capture.root)).mask(0)
        assert mask is not None and set(np.unique(mask).tolist()) == {0, 255}

    def test_alpha_is_undistorted_with_the_colors(self, make_capture: Callable) -> None:
        """Oracle: no colours from under alpha 0 at the rim of opaque pixels."""
        params = _camera("OPENCV").params.tolist()
        capture = make_capture(model="OPENCV", params=params, size=_SIZE, views=1)
        photo = np.zeros((150, 200, 4), np.uint8)
        photo[..., 1] = 255
        photo[40:110, 60:140] = [200, 0, 0, 255]
        write_png(capture.root / "images" / "view_00.png", photo)
        for resolution in (1, 3):
            data = load_dataset(DataConfig(source=capture.root, resolution=resolution))
            image, mask = data.image(0), data.mask(0)
            assert data.mask_mode == "composite" and mask is not None
            assert 0 < mask.min(initial=255, where=mask > 0) < 255 == mask.max()
            seen = mask > 40
            assert image[seen, 1].max() <= 8 and abs(int(image[seen, 0].min()) - 200) <= 8


def test_huge_photos_are_reduced_first(tmp_path: Path) -> None:
    """Oracle: the result of the direct way, on a smooth picture."""
    camera = ColmapCamera(
        model="SIMPLE_RADIAL",
        width=1200,
        height=900,
        params=np.array([1000.0, 610.0, 440.0, -0.1]),
    )
    plan = _plan(camera)
    row, column = np.mgrid[0:900, 0:1200]
    photo = np.dstack([column / 5, row / 4, 128 + 100 * np.sin(row / 60) * np.cos(column / 50)])
    photo = np.rint(photo).astype(np.uint8)
    write_png(tmp_path / "photo.png", photo)
    size = (round(plan.width / 8), round(plan.height / 8))
    view = ViewFile(
        mask_inverted=False,
        image=tmp_path / "photo.png",
        mask=None,
        use_alpha=False,
        upright=False,
        photo_size=(1200, 900),
        size=size,
        plan=plan,
    )
    ours, _ = decode_view(view)
    straight = resize(plan.remap(photo, (plan.width, plan.height)), *size)
    assert np.abs(ours.astype(int) - straight.astype(int)).max() <= 2
