"""Light on surfaces; oracle: the float64 twin."""

from dataclasses import replace

import numpy as np
import pytest

from gscore.errors import BackendError, ConfigError, ShapeError
from gscore.raster.light import (
    Lamp,
    ShadowMap,
    SurfaceLight,
    Surfaces,
    scaled_colors,
    surface_gains,
    surface_radiance,
)
from gscore.raster.mesh import mesh_backs, mesh_depth, mesh_nearness
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
        slack=0.05 if seed % 2 else 0.02,
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
    light = SurfaceLight(lamps=lamps, maps=maps, world=rng.normal(size=(9, 3)) * 0.3)
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


@pytest.mark.parametrize("slack", [None, 0.0])
def test_radiance(isa: str, slack: float | None) -> None:
    """Oracle: the twin; shadows change much of it."""
    light, surfaces, _ = scene()
    if slack is not None:
        maps = [[one and replace(one, slack=slack) for one in pair] for pair in light.maps]
        light = replace(light, maps=maps)
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
    )
    wanted = twin.radiance(light, surfaces)
    check(surface_radiance(light, surfaces), wanted)
    assert (wanted > 0).mean() > 0.02


def sky(count: int) -> list[tuple[tuple[float, float, float], ShadowMap]]:
    """Random maps of directions all around, of other strengths."""
    rng = np.random.default_rng(9)
    axes = rng.normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return [
        (
            tuple(rng.uniform(0, 2, 3).tolist()),
            replace(
                shadows(number, "parallel", tuple((-6 * axis).tolist())),
                rotations=turned(axis)[None],
            ),
        )
        for number, axis in enumerate(axes)
    ]


def test_meshes_hide_the_world(isa: str) -> None:
    """Oracle: the twin; much of the world is hidden; lamps are as before."""
    light, surfaces, _ = scene()
    hidden = replace(light, sky=sky(7))
    for lamps in (light.lamps, []):
        own = [replace(one, lamps=lamps, maps=light.maps[: len(lamps)]) for one in (light, hidden)]
        bright, wanted = (twin.radiance(one, surfaces) for one in own)
        check(surface_radiance(own[1], surfaces), wanted)
        assert (bright > 1.05 * wanted).mean() > 0.3
        assert (bright >= wanted).all()


def test_a_ball_hides_its_share_of_the_world(isa: str) -> None:
    """Oracle: the form factor of a ball over a floor (Howell's catalogue): (r / h)^2 below it,
    times the cosine beside it. Below it, where no light passes, a ball that stands leaves none."""
    turn, up = 2.39996 * np.arange(64), 1 - (2 * np.arange(64) + 1) / 64
    level = np.sqrt(1 - up**2)
    axes = -np.stack([level * np.cos(turn), level * np.sin(turn), up], 1)
    lamp, _, _ = plate("sun")
    u, v = np.meshgrid(np.linspace(0, np.pi, 40), np.linspace(0, 2 * np.pi, 80))
    unit = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], -1).reshape(-1, 3)
    k = np.arange(79 * 40).reshape(79, 40)[:, :-1].ravel()
    faces = np.concatenate([np.stack([k, k + 1, k + 41], 1), np.stack([k, k + 41, k + 40], 1)])
    x = np.linspace(0, 4, COUNT)
    places = np.stack([x, 0.3 * x, 0 * x], 1).astype(np.float32)
    up_ = np.tile(np.float32([0, 0, 1]), (COUNT, 1))
    surfaces = Surfaces(places=places, normals=up_, matrix=np.eye(4))
    world = np.zeros((9, 3))
    world[0] = 0.5 / 0.28209479177387814
    for height in (1.001, 1.5, 2.5):
        maps = [
            sun_map(
                replace(lamp, axis=tuple(axis)),
                np.add(unit, [0, 0, height]),
                faces,
                size=128,
                width=4.0,
                slack=0.001,
            )
            for axis in axes
        ]
        light = SurfaceLight(lamps=[], maps=[], world=world, sky=[((1, 1, 1), one) for one in maps])
        found = surface_radiance(light, surfaces)[:, 0] / 0.5
        away = np.sqrt((places[:, :2] ** 2).sum(1) + height**2)
        off = np.abs(found - 1 + height / away**3)
        assert off.mean() < 0.03
        assert np.percentile(off, 98) < 0.08
    captured = np.full((COUNT, 3), 0.25, np.float32)
    how = {"share": 1.0, "catches": True, "most": 5.0}
    gains = surface_gains(light, surfaces, captured, **how)
    np.testing.assert_allclose(gains[:, 0], 2 * found, rtol=1e-5)
    kept = surface_gains(light, surfaces, captured, **{**how, "share": 0.0})
    np.testing.assert_allclose(kept[:, 0], found, rtol=1e-5)
    assert (surface_gains(light, surfaces, None, **{**how, "share": 0.0}) == 1).all()


@pytest.mark.parametrize("catches", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.4, 1.0, None])
def test_gains(isa: str, share: float | None, catches: bool) -> None:
    """Oracle: the twin; None: the captured light, and the sides of normals, are unknown."""
    light, surfaces, captured = scene()
    light = replace(light, sky=sky(3))
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
    with pytest.raises(ShapeError, match="depths must have three dimensions"):
        flat = replace(maps[0][0], depths=np.zeros((8, 8), np.float32))
        surface_radiance(replace(light, lamps=light.lamps[:1], maps=[(flat, None)]), surfaces)
    with pytest.raises(ShapeError, match="for each of 6 lamps, got 1"):
        surface_radiance(replace(light, maps=light.maps[:1]), surfaces)
    with pytest.raises(ShapeError, match="world must have 27 numbers, got 12"):
        surface_radiance(replace(light, world=light.world[:4]), surfaces)
    with pytest.raises(ShapeError, match="sky must have 3 numbers, got 2"):
        surface_radiance(replace(light, sky=[((1.0, 1.0), light.maps[0][0])]), surfaces)
    with pytest.raises(ShapeError, match="direction 0 of the sky has shadow map 1"):
        surface_radiance(replace(light, sky=[((1.0, 1.0, 1.0), light.maps[1][0])]), surfaces)
    one = replace(light, lamps=[replace(light.lamps[0], axis=(0.0, 1.0))], maps=light.maps[:1])
    with pytest.raises(ShapeError, match="axis must have 3 numbers, got 2"):
        surface_radiance(one, surfaces)
    with pytest.raises(ConfigError, match="must be POINT or SUN, got AREA"):
        surface_radiance(replace(one, lamps=[replace(light.lamps[0], kind="AREA")]), surfaces)
    with pytest.raises(ShapeError, match="shN must have three dimensions"):
        scaled_colors(np.zeros((4, 1, 3), np.float32), np.zeros((4, 9), np.float32), captured[:4])
    with pytest.raises(ShapeError, match="gains"):
        scaled_colors(np.zeros((4, 1, 3), np.float32), np.zeros((4, 3, 3), np.float32), captured)


HEIGHT, HALF = 1.0, 0.6
"""Of a square plate over the ground, z = 0."""


def plate(kind: str) -> tuple[Lamp, ShadowMap, np.ndarray]:
    """A lamp over the plate, its map of plate and ground, and samples of its disc [K, 3], of a sun
    of directions."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    vertices = np.concatenate(
        [np.insert(HALF * corners, 2, HEIGHT, axis=1), np.insert(20.0 * corners, 2, 0, axis=1)]
    )
    square, size = np.array([[0, 1, 2], [0, 2, 3]], np.int32), 512
    triangles = np.concatenate([square, square + 4])
    index = np.arange(3000)
    spiral = np.sqrt((index + 0.5) / len(index))[:, None] * np.stack(
        [np.cos(2.39996 * index), np.sin(2.39996 * index)], 1
    )
    place = np.array([0.3, 0.2, 4.0])
    axis = np.array([-0.6, 0.3, -0.75])
    axis /= np.linalg.norm(axis)
    parallel = kind == "sun"
    axes = twin._SIDES if kind == "cube" else [axis if parallel else np.array([0, 0, -1.0])]
    scale = size / 2 - 1 if kind == "cube" else size / 6 if parallel else 1.5 * size / 2
    K = np.array([[scale, 0, size / 2], [0, scale, size / 2], [0, 0, 1]])
    depths, farthest = [], 0.0
    for one in axes:
        viewmat = np.eye(4)
        viewmat[:3, :3] = turned(one)
        viewmat[:3, 3] = -viewmat[:3, :3] @ place
        given = vertices, triangles, K, viewmat, size, size
        if parallel:
            drawn, farthest = mesh_nearness(*given)
            depths.append(drawn)
        else:
            depths.append(mesh_depth(*given))
    radius = 0.2 if parallel else 0.3
    across = turned(axis if parallel else np.array([0, 0, -1.0]))[:2]
    samples = radius * spiral @ across + (-axis if parallel else place)
    lamp = Lamp(
        kind="SUN" if parallel else "POINT",
        strength=(1, 1, 1),
        axis=tuple(axis),
        place=tuple(place),
        size=radius,
    )
    shadows = ShadowMap(
        depths=np.stack(depths),
        rotations=np.stack([turned(one) for one in axes]),
        place=place,
        scale=scale,
        parallel=parallel,
        farthest=farthest,
        slack=0.01,
    )
    return lamp, shadows, samples


@pytest.mark.parametrize("kind", ["sun", "single", "cube"])
def test_soft_shadows(isa: str, kind: str) -> None:
    """Oracle: the mean of hard shadows over many samples of the lamp, in closed form; hard ones, by
    a lamp without a size, are far from it. The ground, drawn in the map, does not shadow itself."""
    lamp, shadows, samples = plate(kind)
    rng = np.random.default_rng(0)
    places = np.column_stack([rng.uniform(-2, 2, (COUNT, 2)), np.zeros(COUNT)]).astype(np.float32)
    up = np.tile(np.float32([0, 0, 1]), (COUNT, 1))
    surfaces = Surfaces(places=places, normals=up, matrix=np.eye(4))
    away = samples[None] - (0 if kind == "sun" else places[:, None])
    crossed = places[:, None, :2] + away[..., :2] * HEIGHT / away[..., 2:]
    wanted = (np.abs(crossed) > HALF).any(2).mean(1)
    found = []
    for size in (lamp.size, 0.0):
        one = replace(lamp, size=size)
        light = SurfaceLight(lamps=[one], maps=[(shadows, None)], world=np.zeros((9, 3)))
        bare = surface_radiance(replace(light, maps=[(None, None)]), surfaces)
        found.append(surface_radiance(light, surfaces)[:, 0] / bare[:, 0])
    blurred = (wanted > 0.02) & (wanted < 0.98)
    assert blurred.sum() > 50
    soft, hard = (np.abs(one - wanted) for one in found)
    assert soft[blurred].mean() < 0.05
    assert soft.max() < 0.25
    assert hard[blurred].mean() > 0.15
    assert soft[~blurred].mean() < 0.01


def sun_map(
    lamp: Lamp,
    vertices: np.ndarray,
    triangles: np.ndarray,
    *,
    size: int,
    width: float,
    slack: float,
) -> ShadowMap:
    """The shadow map of a sun: `size` px for `width` around the origin, drawn from 20 away."""
    rotation, viewmat = turned(np.array(lamp.axis)), np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = rotation, [0, 0, 20]
    scale = size / width
    K = np.array([[scale, 0, size / 2], [0, scale, size / 2], [0, 0, 1]])
    given = vertices, triangles.astype(np.int32), K, viewmat, size, size
    drawn, farthest = mesh_nearness(*given)
    backs = mesh_backs(*given, orthographic=True)
    assert backs is not None
    return ShadowMap(
        depths=drawn[None],
        rotations=rotation[None],
        place=-rotation.T @ viewmat[:3, 3],
        scale=scale,
        parallel=True,
        farthest=farthest,
        slack=slack,
        backs=backs[None],
    )


def standing_ball(*, ground: bool) -> tuple[Lamp, ShadowMap, np.ndarray, np.ndarray]:
    """A wide sun, its map of a ball, with or without the ground below it, places on the ground
    [N, 3], and the share of the sun that reaches them past the ball [N], in closed form."""
    lamp, _, _ = plate("sun")
    lamp = replace(lamp, axis=(0.9, 0.0, -0.43589), size=0.3)
    u, v = np.meshgrid(np.linspace(0, np.pi, 40), np.linspace(0, 2 * np.pi, 80))
    ball = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u) + 1], -1)
    k = np.arange(79 * 40).reshape(79, 40)[:, :-1].ravel()
    square = 9 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    faces = [np.stack([k, k + 1, k + 41], 1), np.stack([k, k + 41, k + 40], 1)]
    faces += ground * [np.array([[0, 1, 2], [0, 2, 3]]) + 3200]
    vertices = np.concatenate([ball.reshape(-1, 3), square])
    given = lamp, vertices, np.concatenate(faces)
    shadows = sun_map(*given, size=512, width=10, slack=0.02 if ground else 0.002)
    flat = np.random.default_rng(0).uniform([-1, -1.2], [3, 1.2], (COUNT, 2))
    places = np.column_stack([flat, np.zeros(COUNT)]).astype(np.float32)
    turn = 2.39996 * np.arange(500)
    disc = np.sqrt(np.linspace(0, 1, 500))[:, None] * np.stack([np.cos(turn), np.sin(turn)], 1)
    rays = lamp.size * disc @ shadows.rotations[0][:2] - np.array(lamp.axis)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    center = [0, 0, 1] - places.astype(np.float64)
    near = center @ rays.T
    wanted = (((center**2).sum(1)[:, None] - near**2 > 1) | (near < 0)).mean(1)
    return lamp, shadows, places, wanted


def reached(lamp: Lamp, shadows: ShadowMap, places: np.ndarray) -> np.ndarray:
    """Share of a lamp that reaches ground [N, 3], [N]."""
    up = np.tile(np.float32([0, 0, 1]), (len(places), 1))
    surfaces = Surfaces(places=places, normals=up, matrix=np.eye(4))
    light = SurfaceLight(lamps=[lamp], maps=[(shadows, None)], world=np.zeros((9, 3)))
    bare = surface_radiance(replace(light, maps=[(None, None)]), surfaces)
    return surface_radiance(light, surfaces)[:, 0] / bare[:, 0]


def test_a_soft_shadow_stays_dark_where_a_ball_stands(isa: str) -> None:
    """Oracle: rays to many samples of the sun past a ball on the ground, in closed form; means of
    the blurs of its upper side, which the map shows, let light pass below it."""
    lamp, shadows, places, wanted = standing_ball(ground=True)
    found, dark = reached(lamp, replace(shadows, backs=None), places), wanted < 0.02
    assert dark.sum() > 40
    assert found[dark].mean() < 0.145
    assert np.abs(found - wanted).mean() < 0.1


def test_backs_end_the_light_below_a_ball(isa: str) -> None:
    """As above, in the map of the ball alone with its far sides."""
    lamp, shadows, places, wanted = standing_ball(ground=False)
    assert shadows.backs is not None
    near_sides = reached(lamp, replace(shadows, backs=None), places)
    found, dark = reached(lamp, shadows, places), wanted < 0.02
    assert near_sides[dark].mean() > 0.1
    assert found[dark].mean() < 0.01
    beside = (np.hypot(*places[:, :2].T) < 0.7) & (wanted < 0.98)
    assert beside.sum() > 50
    assert np.abs(found - wanted)[beside].mean() < 0.1
    assert np.abs(near_sides - wanted)[beside].mean() > 0.14


@pytest.mark.parametrize("size", [0.0, 0.3])
def test_lamps_with_the_same_shadows_add_up(isa: str, size: float) -> None:
    """Oracle: the sum of the lamps alone; there are more than are summed at once."""
    lamp, shadows, _ = plate("single")
    rng = np.random.default_rng(0)
    places = np.column_stack([rng.uniform(-2, 2, (COUNT, 2)), np.zeros(COUNT)]).astype(np.float32)
    normals = rng.normal([0, 0, 1], size=(COUNT, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    surfaces = Surfaces(places=places, normals=normals.astype(np.float32), matrix=np.eye(4))
    lamps = [
        replace(lamp, size=size, place=(0.3 + 0.1 * k, 0.2, 4 - 0.9 * k), strength=(1, k, 2))
        for k in range(6)
    ]

    def radiance(lamps: list[Lamp]) -> np.ndarray:
        maps = [(shadows, None)] * len(lamps)
        light = SurfaceLight(lamps=lamps, maps=maps, world=np.zeros((9, 3)))
        return surface_radiance(light, surfaces)

    alone = sum(radiance([one]) for one in lamps)
    np.testing.assert_allclose(radiance(lamps), alone, rtol=1e-5, atol=1e-6)


def test_a_slope_does_not_shadow_itself(isa: str) -> None:
    """A plane that is drawn in its own map, in oblique light of a wide sun, is lit."""
    lamp, _, _ = plate("sun")
    lamp = replace(lamp, axis=(0.6, 0.0, -0.8), size=0.3)
    normal = np.array([0.3, 0.2, 1.0]) / np.linalg.norm([0.3, 0.2, 1.0])
    corners = 9 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    heights = -(corners @ normal[:2]) / normal[2]
    square = np.array([[0, 1, 2], [0, 2, 3]])
    shadows = sun_map(
        lamp, np.column_stack([corners, heights]), square, size=256, width=20, slack=0.1
    )
    rng = np.random.default_rng(0)
    flat = rng.uniform(-2, 2, (COUNT, 2))
    places = np.column_stack([flat, -(flat @ normal[:2]) / normal[2]]).astype(np.float32)
    normals = np.tile(np.float32(normal), (COUNT, 1))
    surfaces = Surfaces(places=places, normals=normals, matrix=np.eye(4))
    light = SurfaceLight(lamps=[lamp], maps=[(shadows, None)], world=np.zeros((9, 3)))
    bare = replace(light, maps=[(None, None)])
    np.testing.assert_allclose(
        surface_radiance(light, surfaces), surface_radiance(bare, surfaces), rtol=1e-5
    )
