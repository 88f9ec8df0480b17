"""Light on surfaces; oracle: the float64 twin."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gscore.errors import BackendError, ShapeError
from gscore.raster.light import (
    Lamp,
    ShadowMap,
    SurfaceLight,
    Surfaces,
    scaled_colors,
    surface_gains,
    surface_radiance,
)
from tests.raster.twins import light as twin

COUNT = 701
MATRIX = np.array([[0, -2.0, 0, 1], [2, 0, 0, -1], [0, 0, 2, 0.5], [0, 0, 0, 1]])


def turned(axis: np.ndarray) -> np.ndarray:
    """A rotation to a view along an axis."""
    right = np.cross(np.eye(3)[int(np.argmin(np.abs(axis)))], axis)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(axis, right), axis])


def shadows(seed: int, kind: str, place: tuple[float, ...]) -> ShadowMap:
    """A map of random depths, with holes."""
    rng = np.random.default_rng(seed)
    if kind == "cube":
        rotations = np.stack([turned(side) for side in twin._SIDES])
    else:
        axis = np.array([0.2, -0.3, -1])
        rotations = turned(axis / np.linalg.norm(axis))[None]
    depths = rng.uniform(0.1, 0.5, (len(rotations), 24, 24))
    if kind == "parallel":
        depths = 12 - 1 / depths
    depths[rng.uniform(size=depths.shape) < 0.3] = 0
    return ShadowMap(
        depths=np.float32(depths),
        rotations=rotations,
        place=np.array(place),
        scale=2.0 if kind == "parallel" else 11.0,
        parallel=kind == "parallel",
        farthest=12.0 if kind == "parallel" else 0.0,
    )


def scene(seed: int = 0) -> tuple[SurfaceLight, Surfaces, np.ndarray]:
    """Lamps of all kinds with maps of all kinds, surfaces around them, and their captured light."""
    rng = np.random.default_rng(seed)
    axis = np.array([0.2, -0.3, -1])
    common = {"axis": tuple(axis / np.linalg.norm(axis)), "strength": (3.0, 2.0, 1.0)}
    place = {"place": (0.3, -0.2, 4.0)}
    lamps = [
        Lamp(kind="SUN", **common),
        Lamp(kind="POINT", radius=3.0, **common, **place),
        Lamp(kind="POINT", cone=(0.8, 0.1), **common, **place),
        Lamp(kind="POINT", is_surface=True, radius=0.1, **common, **place),
        Lamp(kind="POINT", is_surface=True, **common, place=(0.5, -0.2, 4.0)),
        Lamp(kind="POINT", **common, place=(0.1, 0.2, 0.3)),
    ]
    down, cube = shadows(1, "single", place["place"]), shadows(2, "cube", (0.1, 0.2, 0.3))
    maps = [
        (shadows(3, "parallel", (0.5, 1, 6)), None),
        (down, shadows(4, "single", place["place"])),
        (None, down),
        (down, None),
        (down, None),
        (cube, shadows(5, "cube", (0.1, 0.2, 0.3))),
    ]
    light = SurfaceLight(lamps=lamps, maps=maps, world=rng.normal(size=(9, 3)) * 0.3, slack=0.05)
    normals = rng.normal(size=(COUNT, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals[::50] = 0
    surfaces = Surfaces(
        places=rng.uniform(-1, 1, (COUNT, 3)).astype(np.float32),
        normals=normals.astype(np.float32),
        matrix=MATRIX,
    )
    captured = rng.uniform(0.02, 1, (COUNT, 3)).astype(np.float32)
    captured[::40] = 0
    return light, surfaces, captured


def check(found: np.ndarray, wanted: np.ndarray) -> None:
    """Equal to rounding, apart from places at borders of pixels and depths, where it decides."""
    assert found.dtype == np.float32
    off = ~np.isclose(found, wanted, rtol=1e-4, atol=1e-5)
    assert off.any(1).mean() < 0.01


@pytest.mark.parametrize("change", [lambda light: light, lambda light: replace(light, slack=0.0)])
def test_radiance(isa: str, change: Callable[[SurfaceLight], SurfaceLight]) -> None:
    """Oracle: the twin; shadows change much of it."""
    light, surfaces, _ = scene()
    light = change(light)
    wanted = twin.radiance(light, surfaces)
    check(surface_radiance(light, surfaces), wanted)
    bright = replace(light, maps=[(None, None)] * len(light.lamps))
    assert (twin.radiance(bright, surfaces) > 1.05 * wanted).mean() > 0.3
    check(surface_radiance(bright, surfaces), twin.radiance(bright, surfaces))
    dark = replace(light, lamps=[], maps=[])
    check(surface_radiance(dark, surfaces), twin.radiance(dark, surfaces))


@pytest.mark.parametrize("index", range(6))
def test_each_lamp(isa: str, index: int) -> None:
    """Oracle: the twin, of one lamp in a black world."""
    light, surfaces, _ = scene(index)
    light = SurfaceLight(
        lamps=light.lamps[index : index + 1],
        maps=light.maps[index : index + 1],
        world=np.zeros((9, 3)),
        slack=0.01,
    )
    wanted = twin.radiance(light, surfaces)
    check(surface_radiance(light, surfaces), wanted)
    assert (wanted > 0).mean() > 0.02


@pytest.mark.parametrize("catches", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.4, 1.0, None])
def test_gains(isa: str, share: float | None, catches: bool) -> None:
    """Oracle: the twin; None: the captured light, and the sides of normals, are unknown."""
    light, surfaces, captured = scene()
    given = None if share is None else captured
    how = {"share": share or 0.0, "catches": catches, "most": 5.0}
    wanted = twin.gains(light, surfaces, given, **how)
    check(surface_gains(light, surfaces, given, **how), wanted)
    assert (wanted != 1).mean() > 0.2 or (not share and not catches)


@pytest.mark.parametrize("rest", [0, 3, 8, 15, 24])
def test_colors(isa: str, rest: int) -> None:
    """Oracle: the twin; of black, negative and very bright colours too."""
    rng = np.random.default_rng(rest)
    sh0 = rng.normal(size=(COUNT, 1, 3)).astype(np.float32) * 2
    sh0[:5] = [[[-1.7724539]], [[1e4]], [[-1.77]], [[-1.76]], [[0]]]
    shN = rng.normal(size=(COUNT, rest, 3)).astype(np.float32)
    factors = rng.uniform(0, 3, (COUNT, 3)).astype(np.float32)
    factors[10:20] = 0
    found, wanted = scaled_colors(sh0, shN, factors), twin.scaled(sh0, shN, factors)
    np.testing.assert_allclose(found[0], wanted[0], rtol=3e-6, atol=3e-6)
    # The quotient of dim colours, by which the rest is scaled, is less exact.
    np.testing.assert_allclose(found[1], wanted[1], rtol=2e-3, atol=1e-5)


def test_bad_arrays_are_refused() -> None:
    """Oracle: the docstrings."""
    light, surfaces, captured = scene()
    how = {"share": 1.0, "catches": False, "most": 5.0}
    with pytest.raises(ShapeError, match="normals"):
        surface_radiance(light, replace(surfaces, normals=surfaces.normals[:3]))
    with pytest.raises(ShapeError, match="captured"):
        surface_gains(light, surfaces, captured[:, :2], **how)
    maps = [(replace(light.maps[1][0], depths=np.zeros((2, 8, 8), np.float32)), None)]
    with pytest.raises((ShapeError, BackendError), match=r"rotations|views"):
        surface_radiance(replace(light, lamps=light.lamps[:1], maps=maps), surfaces)
    with pytest.raises(ShapeError, match="gains"):
        scaled_colors(np.zeros((4, 1, 3), np.float32), np.zeros((4, 3, 3), np.float32), captured)
