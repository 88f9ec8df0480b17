"""An initial far background; oracles: colours that depend on the direction alone."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gscore.config import TrainConfig
from gscore.errors import ConfigError
from gscore.scene import Cameras
from gscore.splats import Splats
from gscore.stress.capture import SIZE
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.photos.sky import sky_splats
from gscore.trainer.trainer import Trainer

CONFIG = TrainConfig(iterations=6, max_splats=4000, sh_degree=0, coarse_factor=1, sky=True)


def color_of(ahead: np.ndarray) -> np.ndarray:
    """A smooth colour, 0 to 1, for each direction [..., 3]."""
    return 0.5 + 0.4 * ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)


def looking_out(make_photos: Callable[..., Any], views: int = 8) -> Any:
    """Photos of a sky coloured by `color_of`, from one place, around and slightly upwards."""
    photos = make_photos()
    viewmats = []
    for k in range(views):
        turn = 2 * np.pi * k / views
        z = np.array([np.cos(turn), -0.3, np.sin(turn)])
        z /= np.linalg.norm(z)
        x = np.cross([0.0, 1.0, 0.0], z)
        x /= np.linalg.norm(x)
        viewmats.append(np.eye(4))
        viewmats[-1][:3, :3] = np.stack([x, np.cross(z, x), z])
    cameras = replace(photos.scene.cameras, viewmats=np.stack(viewmats))
    v, u = np.mgrid[:SIZE, :SIZE] + 0.5
    pixels = np.stack([u, v, np.ones_like(u)], axis=-1)
    for k in range(views):
        rays = pixels @ np.linalg.inv(cameras.Ks[k]).T @ cameras.viewmats[k, :3, :3]
        photos.images[k] = np.round(255 * color_of(rays)).astype(np.uint8)
    photos.scene = replace(photos.scene, cameras=cameras)
    return photos


def sky_of(photos: Any, config: TrainConfig = CONFIG) -> Splats:
    found = sky_splats(config, photos, photos.scene.cameras, photos.scene.points.points)
    assert found is not None
    return found


def shown(cameras: Cameras, means: np.ndarray, views: list[int]) -> np.ndarray:
    """[N] bool: whether a view shows the place, one view after the other."""
    found = np.zeros(len(means), bool)
    for view in views:
        local = means @ cameras.viewmats[view, :3, :3].T + cameras.viewmats[view, :3, 3]
        u, v, w = (local @ cameras.Ks[view].T).T
        inside = (w > 0) & (u >= 0) & (v >= 0) & (u < SIZE * w) & (v < SIZE * w)
        found |= inside
    return found


def test_a_sphere_has_the_colours_that_photos_have_there(make_photos: Callable[..., Any]) -> None:
    """Oracle: the colour of the direction; the neighbours' colour for directions outside all
    photos."""
    photos = looking_out(make_photos)
    sky = sky_of(photos)
    assert len(sky) == 400  # a tenth of the splats
    ahead = sky.means / np.linalg.norm(sky.means, axis=1, keepdims=True)
    colors = 0.5 + 0.28209479177387814 * sky.sh0[:, 0]
    seen = shown(photos.scene.cameras, sky.means, list(range(8)))
    assert 0.3 < seen.mean() < 0.7
    np.testing.assert_allclose(colors[seen], color_of(ahead)[seen], atol=0.02)
    for row in np.flatnonzero(~seen)[::10]:
        near = np.argsort(-(ahead[seen] @ ahead[row]))[:8]
        np.testing.assert_allclose(colors[row], colors[seen][near].mean(axis=0), atol=1e-4)


def test_sky_is_an_even_distant_sphere(make_photos: Callable[..., Any]) -> None:
    """Oracle: a radius of three times the distance of the farthest point that counts; the spacing
    of a hexagonal pattern with as many splats, within a tenth."""
    photos = looking_out(make_photos)
    sky, points = sky_of(photos), photos.scene.points.points
    radius = np.linalg.norm(sky.means, axis=1)
    reach = np.quantile(np.linalg.norm(points, axis=1), 0.99)
    np.testing.assert_allclose(radius, 3 * reach, rtol=1e-5)
    gaps = np.linalg.norm(sky.means[:, None] - sky.means[None], axis=2)
    np.fill_diagonal(gaps, np.inf)
    pattern = np.sqrt(2 / np.sqrt(3) * 4 * np.pi / len(sky)) * 3 * reach
    assert abs(np.median(gaps.min(axis=1)) / pattern - 1) < 0.15
    assert (np.exp(sky.scales) > gaps.min(axis=1)[:, None] / 2).all()


def test_masked_pixels_do_not_colour_the_sky(make_photos: Callable[..., Any]) -> None:
    """Oracle: the colour of the direction; the photos are blue where masked."""
    photos = looking_out(make_photos)
    photos.mask_mode = "ignore"
    for k in range(8):
        mask = np.full((SIZE, SIZE), 255, np.uint8)
        mask[:, : SIZE // 2] = 0
        photos.images[k][mask == 0] = (0, 0, 255)
        photos.masks[k] = mask
    sky = sky_of(photos)
    colors = 0.5 + 0.28209479177387814 * sky.sh0[:, 0]
    assert (colors @ [1, 1, 0] > 0.3).all()  # none is blue
    photos.masks = [np.zeros((SIZE, SIZE), np.uint8)] * 8
    np.testing.assert_allclose(sky_of(photos).sh0, 0, atol=1e-6)


def test_there_is_none_unless_asked_for_or_where_nothing_has_a_size(
    make_photos: Callable[..., Any],
) -> None:
    photos = looking_out(make_photos)
    cameras, points = photos.scene.cameras, photos.scene.points.points
    assert sky_splats(replace(CONFIG, sky=False), photos, cameras, points) is None
    assert sky_splats(CONFIG, photos, cameras, 0 * points) is None
    assert sky_splats(replace(CONFIG, max_splats=9), photos, cameras, points) is None


def test_a_training_starts_with_it_and_keeps_its_cap(make_photos: Callable[..., Any]) -> None:
    """Oracle: the splats of a start without a sky; a cap that points alone would fill."""
    photos = looking_out(make_photos)
    plain = Trainer(replace(CONFIG, sky=False), Analysis(photos=photos)).splats()
    found = Trainer(CONFIG, Analysis(photos=photos)).splats()
    assert len(found) == len(plain) + 400
    np.testing.assert_array_equal(found.means[: len(plain)], plain.means)
    full = Trainer(replace(CONFIG, max_splats=100), Analysis(photos=photos)).splats()
    assert len(full) == 100
    away = np.linalg.norm(full.means, axis=1)
    assert (away > 2 * np.linalg.norm(plain.means, axis=1).max()).sum() == 10


def test_large_splats_stay_since_opacities_are_not_reset(make_photos: Callable[..., Any]) -> None:
    """Oracle: the plans of both runs; an interval set by the option is kept."""
    photos = looking_out(make_photos)
    long = replace(CONFIG, iterations=7000)
    assert Trainer(replace(long, sky=False), Analysis(photos=photos)).plan.reset_every == 3000
    assert Trainer(long, Analysis(photos=photos)).plan.reset_every == 0
    assert Trainer(replace(long, reset_every=500), Analysis(photos=photos)).plan.reset_every == 500


def test_given_splats_have_the_last_word(make_photos: Callable[..., Any]) -> None:
    """Oracle: the given splats."""
    photos = looking_out(make_photos)
    start = Trainer(replace(CONFIG, sky=False), Analysis(photos=photos)).splats()
    np.testing.assert_array_equal(
        Trainer(CONFIG, Analysis(photos=photos, start=start)).splats().means, start.means
    )


def test_there_is_no_sky_behind_a_subject_or_a_region(
    make_photos: Callable[..., Any], tmp_path: Path
) -> None:
    """Oracle: sentences with the reason."""
    photos = looking_out(make_photos)
    photos.mask_mode = "composite"
    with pytest.raises(ConfigError, match=r"composite.*leave out `--sky`"):
        Trainer(CONFIG, Analysis(photos=photos))
    photos.mask_mode = "none"
    with pytest.raises(ConfigError, match=r"region.*leave out `--sky`"):
        Trainer(replace(CONFIG, region=tmp_path / "box.json"), Analysis(photos=photos))
