"""The bundled capture examples/studio against itself: exact depth, true cameras, COLMAP's model."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.io.colmap.folder import ColmapImage, ColmapModel, read_model

STUDIO = Path(__file__).parents[2] / "examples" / "studio"
VIEWS = 60
WIDTH, HEIGHT = 480, 640


@pytest.fixture(scope="module")
def truth() -> dict:
    """The ground truth of the renderer."""
    return json.loads((STUDIO / "cameras_true.json").read_text())


@pytest.fixture(scope="module")
def model() -> ColmapModel:
    """The model of COLMAP."""
    return read_model(STUDIO / "sparse" / "0")


def read_depth(name: str, truth: dict) -> np.ndarray:
    """[H, W] float64 metres along the optical axis, inf without a surface."""
    code = np.asarray(Image.open(STUDIO / "depths" / f"{Path(name).stem}.png"))
    assert code.dtype == np.uint16
    with np.errstate(divide="ignore"):
        return 1.0 / (code * truth["depth"]["scale"])


def true_view(name: str, truth: dict) -> np.ndarray:
    """[4, 4] world to camera."""
    return np.array(next(v["viewmat"] for v in truth["views"] if v["name"] == name))


def observations(model: ColmapModel) -> list[tuple[ColmapImage, np.ndarray, np.ndarray]]:
    """For every image: itself, rows of its observed points [M], and their pixels [M, 2]."""
    place = {int(i): k for k, i in enumerate(model.points.ids)}
    out = []
    for image in model.images:
        seen = image.point3D_ids >= 0
        index = np.array([place[int(i)] for i in image.point3D_ids[seen]])
        out.append((image, index, image.xys[seen]))
    return out


def unproject(
    pixels: np.ndarray, depth: np.ndarray, viewmat: np.ndarray, K: np.ndarray
) -> np.ndarray:
    """[N, 3] world points at pixels [N, 2], pixel centres at +0.5, and depth [N]."""
    rays = np.concatenate([pixels, np.ones((len(pixels), 1))], 1) @ np.linalg.inv(K).T
    return (rays * depth[:, None] - viewmat[:3, 3]) @ viewmat[:3, :3]


def center(viewmat: np.ndarray) -> np.ndarray:
    """[3] position of a camera."""
    return -viewmat[:3, :3].T @ viewmat[:3, 3]


def project(points: np.ndarray, viewmat: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, ...]:
    """Pixels [N, 2], pixel centres at +0.5, and depth [N]."""
    local = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    image = local @ K.T
    return image[:, :2] / image[:, 2:], local[:, 2]


def test_it_is_complete_and_small(truth: dict) -> None:
    """Oracle: the promises of its README."""
    names = [f"view_{i:03d}" for i in range(VIEWS)]
    for folder, ending in (("images", ".jpg"), ("masks", ".png"), ("depths", ".png")):
        files = sorted((STUDIO / folder).iterdir())
        assert [f.name for f in files] == [n + ending for n in names]
        assert {Image.open(f).size for f in files} == {(WIDTH, HEIGHT)}
    assert [v["name"] for v in truth["views"]] == [f"{n}.jpg" for n in names]
    test = (STUDIO / "test.txt").read_text().split()
    assert test == [f"{n}.jpg" for n in names[::6]]
    assert sum(f.stat().st_size for f in STUDIO.rglob("*") if f.is_file()) < 10_000_000


def test_gscore_loads_it() -> None:
    """Oracle: no warnings, 50 training views and 10 test views."""
    data = load_dataset(DataConfig(source=STUDIO, eval=True, test_list=STUDIO / "test.txt"))
    assert (len(data.train), len(data.test), list(data.warnings)) == (50, 10, [])
    assert len(data.scene.points) > 3000
    assert data.image(0).shape == (HEIGHT, WIDTH, 3)


def test_masks_are_soft_and_hold_the_figure(model: ColmapModel, truth: dict) -> None:
    """Oracle: true cameras; points in the space of a standing person are in the mask."""
    K = np.array(truth["K"])
    points = model.points.xyz
    person = (np.hypot(points[:, 0], points[:, 1]) < 0.45) & (np.abs(points[:, 2] - 0.9) < 0.75)
    assert person.sum() > 500
    for view in truth["views"][::7]:
        mask = np.asarray(Image.open(STUDIO / "masks" / f"{Path(view['name']).stem}.png"))
        assert mask.dtype == np.uint8 and mask.shape == (HEIGHT, WIDTH)
        assert 0.10 < (mask / 255).mean() < 0.35
        between = ((mask > 0) & (mask < 255)).mean()
        assert 0.005 < between < 0.06  # an antialiased rim only
        at, _ = project(points[person], np.array(view["viewmat"]), K)
        column, row = np.floor(at).astype(int).T
        assert (mask[row, column] > 127).mean() > 0.97


def test_colmap_found_the_true_cameras(model: ColmapModel, truth: dict) -> None:
    """Oracle: the renderer's cameras in the same frame, so without alignment."""
    assert len(model.images) == VIEWS
    (camera,) = model.cameras.values()
    assert (camera.model, camera.width, camera.height) == ("PINHOLE", WIDTH, HEIGHT)
    K = np.array(truth["K"])
    expected = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    np.testing.assert_allclose(camera.params, expected, rtol=3e-3)
    shifts, turns = [], []
    for image in model.images:
        found, true = image.viewmat, true_view(image.name, truth)
        shifts.append(np.linalg.norm(center(found) - center(true)))
        cosine = (np.trace(found[:3, :3] @ true[:3, :3].T) - 1) / 2
        turns.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    assert max(shifts) < 0.015 and np.median(shifts) < 0.005
    assert max(turns) < 0.3


def test_depth_agrees_with_colmaps_points(model: ColmapModel, truth: dict) -> None:
    """Oracle: COLMAP's points at the depth in the renderer's cameras."""
    assert len(model.points.xyz) > 3000
    assert model.points.error.mean() < 1.0
    K, relative = np.array(truth["K"]), []
    for image, index, xys in observations(model):
        _, z = project(model.points.xyz[index], true_view(image.name, truth), K)
        column, row = np.floor(xys).astype(int).T
        relative.append(z / read_depth(image.name, truth)[row, column] - 1)
    relative = np.concatenate(relative)
    assert np.median(np.abs(relative)) < 0.002
    assert np.percentile(np.abs(relative), 90) < 0.01


def test_pixel_centres_lie_at_a_half(model: ColmapModel, truth: dict) -> None:
    """Oracle: features triangulated with the renderer's cameras alone, which are on the depth's
    rug.

    A pixel grid half a pixel off would lift or sink the rug by 1.5 mm, or leave residuals.
    """
    K = np.array(truth["K"])
    normal, right = np.zeros((len(model.points.xyz), 3, 3)), np.zeros((len(model.points.xyz), 3))
    for image, index, xys in observations(model):
        viewmat = true_view(image.name, truth)
        ray = unproject(xys, np.ones(len(xys)), viewmat, K) - center(viewmat)
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        across = np.eye(3) - ray[:, :, None] * ray[:, None]
        np.add.at(normal, index, across)
        np.add.at(right, index, across @ center(viewmat))
    points = np.linalg.solve(normal, right[..., None])[..., 0]
    residuals, lifts = [], []
    for image, index, xys in observations(model):
        viewmat = true_view(image.name, truth)
        residuals.append(project(points[index], viewmat, K)[0] - xys)
        pixel = np.floor(xys).astype(int)
        depth = read_depth(image.name, truth)[pixel[:, 1], pixel[:, 0]]
        surface = unproject(pixel + 0.5, depth, viewmat, K)
        rug = (np.abs(surface[:, :2]).max(1) < 0.7) & (surface[:, 2] < 0.02)
        lifts.append((points[index] - surface)[rug, 2])
    assert len(np.concatenate(lifts)) > 5000
    assert abs(np.median(np.concatenate(lifts))) < 0.0005
    assert np.all(np.abs(np.median(np.concatenate(residuals), axis=0)) < 0.05)


def test_depth_carries_one_picture_into_the_next(truth: dict) -> None:
    """Oracle: nearly the same colour of one surface in two neighbouring pictures."""
    K, first, second = np.array(truth["K"]), "view_020.jpg", "view_021.jpg"
    picture = [np.asarray(Image.open(STUDIO / "images" / n), np.float64) for n in (first, second)]
    depth = [read_depth(n, truth) for n in (first, second)]
    viewmat = [true_view(n, truth) for n in (first, second)]
    v, u = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    world = unproject(np.stack([u, v], -1).reshape(-1, 2), depth[0].ravel(), viewmat[0], K)
    at, z = project(world, viewmat[1], K)
    inside = np.all((at > 1) & (at < np.array([WIDTH, HEIGHT]) - 1), axis=1)
    column, row = np.floor(at[inside]).astype(int).T
    visible = np.abs(z[inside] / depth[1][row, column] - 1) < 0.005
    there = picture[1][row, column][visible]
    here = picture[0].reshape(-1, 3)[inside][visible]
    assert visible.mean() > 0.6
    carried = np.abs(there - here).mean()
    unmoved = np.abs(picture[1] - picture[0]).mean()
    assert carried < 8 and carried < 0.4 * unmoved


def test_depth_scales_are_where_3dgs_trainers_look(truth: dict) -> None:
    """Oracle: the official trainer's rule, inverse depth = value / 65536 * scale + offset."""
    scales = json.loads((STUDIO / "sparse" / "0" / "depth_params.json").read_text())
    assert sorted(scales) == [Path(v["name"]).stem for v in truth["views"]]
    for entry in scales.values():
        assert entry["scale"] / 65536 == truth["depth"]["scale"] and entry["offset"] == 0
