"""Depth of captures from their photos; oracles: traced scenes, and scenes without usable depth."""

from pathlib import Path

import numpy as np
import pytest

from gscore.config import DataConfig
from gscore.datasets import Dataset, load_dataset
from gscore.io.images.png import write_png
from gscore.stereo import dense_points, stereo_maps
from gscore.stereo.maps import StereoMaps

from .captures import ANGLES, write_capture
from .scene import Scene


def opened(folder: Path, **options: object) -> Dataset:
    """The capture."""
    return load_dataset(DataConfig(source=folder, **options))  # pyright: ignore


def found_in(folder: Path, **options: object) -> StereoMaps:
    """Depth of all its training views."""
    dataset = opened(folder, **options)
    return stereo_maps(dataset, dataset.train)


def errors(found: StereoMaps, scene: Scene, angles: tuple[float, ...] = ANGLES) -> np.ndarray:
    """Relative errors of all known inverse depths."""
    parts = []
    for index, one in found.maps.items():
        _, truth = scene.shot(scene.viewmat(angles[index]))
        known = one.inverse_depth > 0
        parts.append(np.abs(one.inverse_depth[known] / truth[known] - 1))
    return np.concatenate(parts)


@pytest.fixture(scope="module")
def arc_maps(arc: Path) -> StereoMaps:
    """Depth of the arc."""
    return found_in(arc)


def test_confirmed_depth_is_right(arc_maps: StereoMaps) -> None:
    """Oracle: the traced depth; most of the photos is textured and visible in others."""
    found = arc_maps
    assert len(found.maps) == len(ANGLES)
    off = errors(found, Scene(160, 120))
    assert found.known > 0.3
    assert np.median(off) < 0.003 and np.mean(off < 0.02) > 0.99
    for one in found.maps.values():
        assert ((one.confidence > 0) == (one.inverse_depth > 0)).all()
        assert one.confidence.max() <= 1 and (one.agree[one.inverse_depth > 0] >= 2).all()


def test_points_lie_on_the_surfaces(arc_maps: StereoMaps) -> None:
    """Oracle: the wall and the ball of the scene, in units of a pixel there."""
    scene = Scene(160, 120)
    cloud = dense_points(arc_maps, most=1500)
    assert 1000 < len(cloud) <= 1500
    x, y, z = cloud.points.T
    wall = np.abs(6 - scene.slant * x - z) / np.hypot(1, scene.slant)
    ball = np.abs(np.hypot(np.hypot(x - 0.3, y), z - 4.6) - 0.8)
    assert np.quantile(np.minimum(wall, ball), 0.95) < 0.06  # a pixel is 0.034 wide there
    assert (ball < 0.05).sum() > 50 and (wall < 0.05).sum() > 500
    nearest = np.sqrt(((cloud.points[:, None] - cloud.points[None]) ** 2).sum(-1))
    np.fill_diagonal(nearest, np.inf)
    spacing = nearest.min(axis=1)
    assert np.quantile(spacing, 0.9) < 6 * np.quantile(spacing, 0.1)


def test_no_more_points_than_asked(arc_maps: StereoMaps) -> None:
    """Oracle: the requested number."""
    found = arc_maps
    for most in (0, 1, 7, 200):
        assert len(dense_points(found, most=most)) <= most


def test_held_out_photos_change_nothing(arc: Path, tmp_path: Path) -> None:
    """Oracle: the same maps where the held-out photos are black."""
    dark = tmp_path / "dark"
    scene = Scene(160, 120)
    write_capture(dark, scene, [scene.viewmat(angle) for angle in ANGLES])
    options = {"eval": True, "test_every": 3}
    test = opened(dark, **options).test
    assert test == [0, 3, 6]
    for index in test:
        path = dark / "images" / f"v{index:02d}.png"
        write_png(path, np.zeros((scene.height, scene.width, 3), np.uint8))
    lit, unlit = found_in(arc, **options), found_in(dark, **options)
    assert lit.maps.keys() == unlit.maps.keys() and not lit.maps.keys() & set(test)
    for index, one in lit.maps.items():
        assert one.inverse_depth.tobytes() == unlit.maps[index].inverse_depth.tobytes()


def test_threads_change_no_bit(arc: Path) -> None:
    """Oracle: one thread."""
    dataset = opened(arc)
    one, many = (stereo_maps(dataset, dataset.train, threads=n) for n in (1, 4))
    for index in one.maps:
        assert one.maps[index].inverse_depth.tobytes() == many.maps[index].inverse_depth.tobytes()
        assert one.maps[index].confidence.tobytes() == many.maps[index].confidence.tobytes()
    clouds = [dense_points(found, most=500) for found in (one, many)]
    assert clouds[0].content_hash() == clouds[1].content_hash()


def test_bare_walls_are_left_out(tmp_path: Path) -> None:
    """Oracle: a wall of one colour, so that only the ball in front of it can have depth."""
    scene = Scene(160, 120, flat=True)
    write_capture(tmp_path, scene, [scene.viewmat(angle) for angle in ANGLES])
    cloud = dense_points(found_in(tmp_path), most=2000)
    assert len(cloud) > 50
    x, y, z = cloud.points.T
    far = np.abs(np.hypot(np.hypot(x - 0.3, y), z - 4.6) - 0.8)
    assert np.quantile(far, 0.9) < 0.15


def test_masked_pixels_have_no_depth(tmp_path: Path) -> None:
    """Oracle: the masks, and the same places of the neighbouring views; the known share is one of
    the unmasked pixels, of a view without depth too."""
    scene = Scene(160, 120)
    write_capture(tmp_path, scene, [scene.viewmat(angle) for angle in ANGLES])
    mask = np.full((scene.height, scene.width), 255, np.uint8)
    mask[:, :70] = 0
    for index in range(len(ANGLES)):
        write_png(tmp_path / "masks" / f"v{index:02d}.png", mask)
    found = found_in(tmp_path, mask_mode="ignore")
    assert found.maps
    for one in found.maps.values():
        assert not (one.inverse_depth[:, :73] > 0).any()
    assert np.mean(errors(found, scene) < 0.02) > 0.97
    known = sum((one.inverse_depth > 0).sum() for one in found.maps.values())
    assert found.known == known / (len(ANGLES) * scene.height * (scene.width - 73))


def test_known_share_counts_all_views(tmp_path: Path) -> None:
    """Oracle: the known pixels of all views over the pixels of all."""
    scene = Scene(160, 120)
    away = scene.viewmat(ANGLES[0]) @ np.diag([-1.0, 1, -1, 1])  # faces the other way
    write_capture(tmp_path, scene, [*(scene.viewmat(angle) for angle in ANGLES), away])
    found = found_in(tmp_path)
    assert len(found.maps) == len(ANGLES)
    known = sum((one.inverse_depth > 0).sum() for one in found.maps.values())
    assert found.known == known / ((len(ANGLES) + 1) * scene.height * scene.width)


@pytest.mark.parametrize("points", [0, 60])
def test_captures_without_points_have_depth_too(points: int, tmp_path: Path) -> None:
    """Oracle: the traced depth; without points the range comes from the intersection of the
    axes."""
    scene = Scene(160, 120)
    write_capture(tmp_path, scene, [scene.viewmat(angle) for angle in ANGLES], points=points)
    off = errors(found_in(tmp_path), scene)
    assert len(off) > 10_000 and np.mean(off < 0.02) > 0.98


@pytest.mark.parametrize("count", [1, 2])
def test_two_photos_are_too_few(count: int, tmp_path: Path) -> None:
    """Oracle: no depth, because two other photos must confirm it."""
    scene = Scene(80, 60)
    write_capture(tmp_path, scene, [scene.viewmat(angle) for angle in ANGLES[:count]])
    found = found_in(tmp_path)
    assert not found.maps and "at least 3 photos" in found.reason


def turned(angle: float) -> np.ndarray:
    """A camera that turns on the spot."""
    a, viewmat = np.radians(angle), Scene().viewmat(0)
    turn = np.eye(4)
    turn[:3, :3] = [[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]
    return turn @ viewmat


@pytest.mark.parametrize("turn", [0.0, 5.0])
def test_cameras_in_one_place_have_no_depth(turn: float, tmp_path: Path) -> None:
    """Oracle: rays from one place, which meet nowhere else; identical cameras too."""
    scene = Scene(120, 90)
    write_capture(tmp_path, scene, [turned(turn * i) for i in range(4)])
    found = found_in(tmp_path)
    assert not found.maps and found.reason


def test_photos_of_one_colour_have_no_depth(tmp_path: Path) -> None:
    """Oracle: no depth, because there is no texture to compare."""
    scene = Scene(80, 60)
    write_capture(tmp_path, scene, [scene.viewmat(angle) for angle in ANGLES])
    for index in range(len(ANGLES)):
        path = tmp_path / "images" / f"v{index:02d}.png"
        write_png(path, np.full((60, 80, 3), 77, np.uint8))
    found = found_in(tmp_path)
    assert not found.maps and "confirmed" in found.reason


def test_a_photo_far_brighter_still_matches(tmp_path: Path) -> None:
    """Oracle: the traced depth; correlation is invariant to gain and offset."""
    scene = Scene(160, 120)
    write_capture(tmp_path, scene, [scene.viewmat(angle) for angle in ANGLES])
    view, _ = scene.shot(scene.viewmat(ANGLES[3]))
    bright = (0.4 * view.grey.astype(np.float64) + 120).round().astype(np.uint8)
    write_png(tmp_path / "images" / "v03.png", np.repeat(bright[..., None], 3, 2))
    found = found_in(tmp_path)
    assert 3 in found.maps
    assert (found.maps[3].inverse_depth > 0).mean() > 0.2
    assert np.mean(errors(found, scene) < 0.02) > 0.98


def test_points_that_are_not_finite_have_no_say(tmp_path: Path) -> None:
    """Oracle: the traced depth."""
    from gscore.depth.observations import PointVisibility
    from gscore.stereo.plan import plan_views

    scene = Scene(80, 60)
    write_capture(tmp_path, scene, [scene.viewmat(angle) for angle in ANGLES])
    dataset = opened(tmp_path)
    points = np.full((50, 3), np.nan)
    tracks = PointVisibility(points=points, observed=[np.zeros(0, np.int64) for _ in ANGLES])
    for plan in plan_views(dataset.scene.cameras, tracks, dataset.train):
        assert plan is not None and 0 < plan.farthest < 1 / 5 < plan.nearest < 2


@pytest.mark.parametrize("subject", [False, True])
def test_without_points_the_range_ends_behind_a_subject_alone(
    subject: bool, tmp_path: Path
) -> None:
    """Oracle: axes that meet 5 units away; no limit on the background behind."""
    from gscore.depth.observations import PointVisibility
    from gscore.stereo.plan import plan_views

    scene = Scene(80, 60)
    write_capture(tmp_path, scene, [scene.viewmat(angle) for angle in ANGLES], points=0)
    dataset = opened(tmp_path)
    tracks = PointVisibility(
        points=np.zeros((0, 3)), observed=[np.zeros(0, np.int64) for _ in ANGLES]
    )
    for plan in plan_views(dataset.scene.cameras, tracks, dataset.train, subject=subject):
        assert plan is not None and 0 < plan.farthest < 1 / 5 < plan.nearest
        assert (1 / plan.farthest > 100) == (not subject)
