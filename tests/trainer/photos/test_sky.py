"""An initial far background; oracles: colours that depend on the direction alone."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gscore.config import Switch, TrainConfig
from gscore.errors import ConfigError
from gscore.scene import Cameras, PointCloud
from gscore.splats import Splats
from gscore.stress.capture import SIZE, VIEWS
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.photos.sky import check_sky, sky_radius, sky_splats
from gscore.trainer.photos.sky_search import Sky, cells_of, decide_sky, sky_views
from gscore.trainer.strategy.free_sky import FreeSky
from gscore.trainer.strategy.pruning import Emptied
from gscore.trainer.trainer import Trainer

CONFIG = TrainConfig(iterations=6, max_splats=4000, sh_degree=0, coarse_factor=1, sky=Switch.ON)


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


def found_sky(photos: Any, config: TrainConfig = CONFIG) -> Sky | None:
    masked = photos.mask_mode != "none"
    views = sky_views(config, photos)
    cells = {v: cells_of(photos.image(v), photos.mask(v) if masked else None) for v in views}
    return decide_sky(config, photos, cells, is_part=False)[0]


def analysis_of(photos: Any, config: TrainConfig = CONFIG) -> Analysis:
    return Analysis(photos=photos, sky=found_sky(photos, config))


def sky_of(photos: Any, config: TrainConfig = CONFIG) -> Splats:
    found, cameras = found_sky(photos, config), photos.scene.cameras
    assert found is not None
    far = sky_radius(cameras, list(photos.train), photos.scene.points.points)
    splats = sky_splats(config, found, cameras, *far)
    assert splats is not None
    return splats


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
    """Oracle: a radius of eight times the distance of the farthest point that counts; the spacing
    of a hexagonal pattern with as many splats, within a tenth."""
    photos = looking_out(make_photos)
    sky, points = sky_of(photos), photos.scene.points.points
    radius = np.linalg.norm(sky.means, axis=1)
    reach = np.quantile(np.linalg.norm(points, axis=1), 0.99)
    np.testing.assert_allclose(radius, 8 * reach, rtol=1e-5)
    gaps = np.linalg.norm(sky.means[:, None] - sky.means[None], axis=2)
    np.fill_diagonal(gaps, np.inf)
    pattern = np.sqrt(2 / np.sqrt(3) * 4 * np.pi / len(sky)) * 8 * reach
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


def test_there_is_none_unless_requested_or_where_nothing_has_a_size(
    make_photos: Callable[..., Any],
) -> None:
    photos = looking_out(make_photos)
    cameras = photos.scene.cameras
    assert found_sky(photos, replace(CONFIG, sky=Switch.OFF)) is None
    sky = found_sky(photos)
    assert sky is not None
    assert sky_splats(CONFIG, sky, cameras, np.zeros(3), 0.0) is None
    assert sky_splats(replace(CONFIG, max_splats=9), sky, cameras, np.zeros(3), 1.0) is None


def test_a_training_starts_with_it_and_keeps_its_cap(make_photos: Callable[..., Any]) -> None:
    """Oracle: the splats of a start without a sky; a cap that points alone would fill."""
    photos = looking_out(make_photos)
    plain = Trainer(replace(CONFIG, sky=Switch.OFF), Analysis(photos=photos)).splats()
    found = Trainer(CONFIG, analysis_of(photos)).splats()
    assert len(found) == len(plain) + 400
    np.testing.assert_array_equal(found.means[: len(plain)], plain.means)
    few = replace(CONFIG, max_splats=100)
    full = Trainer(few, analysis_of(photos, few)).splats()
    assert len(full) == 100
    away = np.linalg.norm(full.means, axis=1)
    assert (away > 2 * np.linalg.norm(plain.means, axis=1).max()).sum() == 10


def test_large_splats_stay_since_opacities_are_not_reset(make_photos: Callable[..., Any]) -> None:
    """Oracle: the plans of both runs; an interval set by the option is kept."""
    photos = looking_out(make_photos)
    long = replace(CONFIG, iterations=7000)
    analysis = analysis_of(photos)
    assert Trainer(long, Analysis(photos=photos)).plan.reset_every == 3000
    assert Trainer(long, analysis).plan.reset_every == 0
    assert Trainer(replace(long, reset_every=500), analysis).plan.reset_every == 500


def test_given_splats_have_the_last_word(make_photos: Callable[..., Any]) -> None:
    """Oracle: the given splats."""
    photos = looking_out(make_photos)
    start = Trainer(replace(CONFIG, sky=Switch.OFF), Analysis(photos=photos)).splats()
    np.testing.assert_array_equal(
        Trainer(CONFIG, replace(analysis_of(photos), start=start)).splats().means, start.means
    )


def test_a_given_sky_stays_since_opacities_are_not_reset(make_photos: Callable[..., Any]) -> None:
    """Oracle: start splats with and without a sky; the paper's interval for the latter."""
    photos = looking_out(make_photos)
    with_sky = Trainer(CONFIG, analysis_of(photos)).splats()
    plain = Trainer(replace(CONFIG, sky=Switch.OFF), Analysis(photos=photos)).splats()
    faint = replace(with_sky, opacities=np.full_like(with_sky.opacities, -1))
    long = replace(CONFIG, iterations=7000)
    found = [
        Trainer(long, Analysis(photos=photos, start=start)).plan.reset_every
        for start in (with_sky, plain, faint)
    ]
    assert found == [0, 3000, 3000]


def test_a_resumed_run_has_the_same_bits(make_photos: Callable[..., Any]) -> None:
    """Oracle: the run without a break, in which splats in front of the sky are removed later; the
    sky is found anew."""
    config = replace(AUTO, iterations=16, refine_every=1, threads=1)
    photos = outside(make_photos)
    cloud = photos.scene.points
    air = np.random.default_rng(3).uniform(-1, 1, (300, 3)) + np.array([5, -4, 9])
    more = PointCloud(points=air, colors=np.full((300, 3), 128, np.uint8))
    analysis = replace(analysis_of(photos, config), points=cloud.with_more(more))
    whole = Trainer(config, analysis)
    while whole.steps < 7:
        whole.step()
    assert not whole.state()["sky_cleared"]
    begun = whole.state(), {name: t.clone() for name, t in whole.tensors().items()}
    resumed = Trainer(config, analysis_of(outside(make_photos), config))  # without these points
    resumed.restore(*begun)
    for trainer in (whole, resumed):
        while trainer.steps < 16:
            trainer.step()
    assert resumed.state() == whole.state()
    after = resumed.tensors()
    for name, tensor in whole.tensors().items():
        assert torch.equal(after[name], tensor), name
    assert whole.state()["sky_cleared"]


def test_there_is_no_sky_behind_a_subject_or_a_region(make_photos: Callable[..., Any]) -> None:
    """Oracle: sentences with the reason; no search of a subject."""
    photos = looking_out(make_photos)
    with pytest.raises(ConfigError, match=r"region.*leave out `--sky on`"):
        check_sky(photos, region=True)
    assert sky_views(replace(AUTO, region=Path("box.json")), photos) == []
    photos.mask_mode = "composite"
    with pytest.raises(ConfigError, match=r"composite.*leave out `--sky on`"):
        check_sky(photos, region=False)
    assert sky_views(AUTO, photos) == []


SIDE, GROUND = 192, 3.0
"""Side of the photos of `outside`, px, and distance of the cameras from the ground."""
AUTO = replace(CONFIG, sky=Switch.AUTO)


def outside(
    make_photos: Callable[..., Any],
    color: tuple[float, float, float] = (0.9, 0.92, 0.95),
    *,
    noise: float = 0.0,
    places: int = 8,
) -> Any:
    """Photos of a textured plane below an even sky, from a circle, looking outwards and up a bit;
    SfM points on the plane. World y is down."""
    rng, photos = np.random.default_rng(0), make_photos()
    viewmats, images = [], []
    K = np.array([[150.0, 0, SIDE / 2], [0, 150.0, SIDE / 2], [0, 0, 1]])
    v, u = np.mgrid[:SIDE, :SIDE] + 0.5
    for k in range(VIEWS):
        turn = 0.15 * k
        z = np.array([np.sin(turn), -0.25, np.cos(turn)])
        z /= np.linalg.norm(z)
        x = np.cross([0.0, 1.0, 0.0], z)
        x /= np.linalg.norm(x)
        R = np.stack([x, np.cross(z, x), z])
        center = np.array([2.0 * (k % places), 0, 0])
        viewmats.append(np.eye(4))
        viewmats[-1][:3, :3], viewmats[-1][:3, 3] = R, -R @ center
        rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(K).T @ R
        picture = np.clip(color + noise * rng.normal(size=(SIDE, SIDE, 3)), 0, 1)
        below = rays[..., 1] > 0
        picture[below] = rng.uniform(0.1, 0.9, (int(below.sum()), 3))
        images.append(np.round(255 * picture).astype(np.uint8))
    points = np.column_stack([rng.uniform(-40, 40, (4000, 2)), np.full(4000, GROUND)])[:, [0, 2, 1]]
    cameras = replace(
        photos.scene.cameras,
        viewmats=np.stack(viewmats),
        Ks=np.repeat(K[None], VIEWS, axis=0),
        widths=np.full(VIEWS, SIDE),
        heights=np.full(VIEWS, SIDE),
    )
    cloud = PointCloud(points=points, colors=np.full((4000, 3), 128, np.uint8))
    photos.scene = replace(photos.scene, cameras=cameras, points=cloud)
    photos.images, photos.masks, photos.train = images, [None] * VIEWS, list(range(VIEWS))
    return photos


@pytest.mark.parametrize("color", [(0.9, 0.92, 0.95), (0.35, 0.5, 0.8)], ids=["white", "blue"])
def test_the_sky_is_found_above_the_horizon(
    make_photos: Callable[..., Any], color: tuple[float, float, float]
) -> None:
    """Oracle: the horizon of each photo; the sky gets splats in its colour there, none below."""
    photos = outside(make_photos, color)
    sky = found_sky(photos, AUTO)
    assert sky is not None and not sky.everywhere
    horizon = SIDE / 2 + 150 * 0.25
    lowest = [np.flatnonzero(shown.any(axis=1)).max() for shown in sky.shown.values()]
    assert min(shown.mean() for shown in sky.shown.values()) > 0.3
    assert horizon - 24 < 4 * (max(lowest) + 1) <= horizon
    splats = sky_of(photos, AUTO)
    assert 20 < len(splats) < 200  # of 400 around
    np.testing.assert_allclose(
        0.5 + 0.28209479 * splats.sh0[:, 0], [color] * len(splats), atol=0.01
    )
    assert (splats.means[:, 1] < 0.25 * np.linalg.norm(splats.means, axis=1)).all()


@pytest.mark.parametrize(
    "change",
    [
        {"color": (0.5, 0.5, 0.5)},
        {"color": (0.95, 0.9, 0.8)},
        {"noise": 0.08},
    ],
    ids=["grey", "yellow", "texture"],
)
def test_walls_are_no_sky(make_photos: Callable[..., Any], change: dict[str, Any]) -> None:
    assert found_sky(outside(make_photos, **change), AUTO) is None


def test_points_and_masks_exclude_a_sky(make_photos: Callable[..., Any]) -> None:
    """Oracle: a dome of points; masks of everything; random points; a block."""
    photos = outside(make_photos)
    assert found_sky(photos, AUTO) is not None
    cells = {v: cells_of(photos.image(v), None) for v in photos.train}
    assert decide_sky(AUTO, photos, cells, is_part=True) == (None, None)
    cloud, rng = photos.scene.points, np.random.default_rng(1)
    dome = rng.normal(size=(40_000, 3))
    dome *= 60 / np.linalg.norm(dome, axis=1, keepdims=True)
    more = PointCloud(points=dome, colors=np.zeros((40_000, 3), np.uint8))
    for changed in (cloud.with_more(more), replace(cloud, made_up=True)):
        photos.scene = replace(photos.scene, points=changed)
        assert found_sky(photos, AUTO) is None
    photos.scene = replace(photos.scene, points=cloud)
    photos.mask_mode, photos.masks = "ignore", [np.zeros((SIDE, SIDE), np.uint8)] * VIEWS
    assert found_sky(photos, AUTO) is None


def test_a_decision_names_the_photos_with_sky(make_photos: Callable[..., Any]) -> None:
    photos = outside(make_photos)
    for view in range(3):
        photos.images[view][:] = 40
    cells = {v: cells_of(photos.image(v), None) for v in photos.train}
    decision = decide_sky(AUTO, photos, cells, is_part=False)[1]
    assert decision is not None and decision.topic == "sky"
    assert decision.text.startswith("5 of 8 photos show the sky")
    for view in range(3, 6):
        photos.images[view][:] = 40
    cells = {v: cells_of(photos.image(v), None) for v in photos.train}
    assert decide_sky(AUTO, photos, cells, is_part=False) == (None, None)


def test_a_requested_sky_is_a_decision(make_photos: Callable[..., Any]) -> None:
    """Oracle: an entry of the topic for `on`; none for `off`, which changes nothing."""
    photos = outside(make_photos)
    cells = {v: cells_of(photos.image(v), None) for v in photos.train}
    on = decide_sky(replace(AUTO, sky=Switch.ON), photos, cells, is_part=False)[1]
    assert on is not None and on.topic == "sky" and "whole sphere" in on.text
    assert decide_sky(replace(AUTO, sky=Switch.OFF), photos, {}, is_part=False) == (None, None)


def test_splats_in_front_of_the_sky_of_two_photos_are_removed(
    make_photos: Callable[..., Any],
) -> None:
    """Oracle: a place above the horizon, in front of all photos; on the plane; at the sky; behind
    the cameras."""
    photos = outside(make_photos)
    sky, cameras = found_sky(photos, AUTO), photos.scene.cameras
    middle, radius = sky_radius(cameras, photos.train, photos.scene.points.points)
    space = FreeSky(sky, cameras, middle, radius)
    ahead = np.array([0.5, -0.4, 1.0]) / np.linalg.norm([0.5, -0.4, 1.0])
    places = np.stack(
        [middle + 10 * ahead, [5, GROUND, 15], middle + radius * ahead, middle - 10 * ahead]
    )
    inside = space.contains(torch.from_numpy(places.astype(np.float32)))
    assert inside.tolist() == [True, False, False, False]
    alone = replace(sky, shown={view: sky.shown[view] for view in photos.train[:1]})
    one = FreeSky(alone, cameras, middle, radius)
    assert not one.contains(torch.from_numpy(places.astype(np.float32))).any()
    assert Emptied(None).due(torch.zeros(2, 3)) is None
