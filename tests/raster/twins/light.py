"""Reference light on surfaces in float64, by definition: one lamp, and one pixel of a map, after
the other; slow."""

import numpy as np

from gscore.raster.light import SUN, Lamp, ShadowMap, SurfaceLight, Surfaces
from gscore.sh import sh_basis
from tests.light_changes import decode, encode

_SIDES = [sign * np.eye(3)[k] for k in range(3) for sign in (1.0, -1.0)]


def reaching(shadows: ShadowMap | None, places: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Share of a lamp that reaches places [N, 3] with normals [N, 3], [N]."""
    if shadows is None:
        return np.ones(len(places))
    views, size, _ = shadows.depths.shape
    out = np.ones(len(places))
    beside = places + normals * shadows.slack
    for i, away in enumerate(beside - shadows.place):
        view = 0 if views == 1 else int(np.argmax([side @ away for side in _SIDES]))
        x, y, z = shadows.rotations[view] @ away
        if z <= 0:
            continue
        scale = shadows.scale if shadows.parallel else shadows.scale / z
        at = scale * np.array([y, x]) + size / 2 - 0.5
        row, column = np.floor(at).astype(int)
        if not (0 <= row < size - 1 and 0 <= column < size - 1):
            continue
        found = np.float64(shadows.depths[view, row : row + 2, column : column + 2])
        with np.errstate(divide="ignore"):
            far = shadows.farthest - found if shadows.parallel else 1 / found
        passes = ((found == 0) | (z - shadows.slack <= far)).astype(float)
        v, u = at - [row, column]
        out[i] = np.array([1 - v, v]) @ passes @ np.array([1 - u, u])
    return out


def hidden(shadows: ShadowMap, places: np.ndarray) -> np.ndarray:
    """Whether the pixel of a parallel map nearest to each place [N, 3] has a mesh in front, [N]."""
    size = shadows.depths.shape[1]
    out = np.zeros(len(places), bool)
    for i, away in enumerate(places - shadows.place):
        x, y, z = shadows.rotations[0] @ away
        row, column = np.floor(shadows.scale * np.array([y, x]) + size / 2).astype(int)
        if z > 0 and 0 <= row < size and 0 <= column < size:
            found = float(shadows.depths[0, row, column])
            out[i] = found > 0 and shadows.farthest - found < z - shadows.slack
    return out


def falloff(lamp: Lamp, places: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Share of a lamp's strength that arrives, [N]; below 0 on the back."""
    axis = np.array(lamp.axis)
    if lamp.kind == SUN:
        return -normals @ axis
    towards = np.array(lamp.place) - places
    distance = np.linalg.norm(towards, axis=1)
    share = (towards * normals).sum(1) / distance / np.maximum(distance, lamp.radius) ** 2
    along = -towards @ axis / distance
    edge, fade = lamp.cone
    if edge > -1:
        ramp = np.clip((along - edge) / max(fade, 1e-6), 0, 1)
        share *= 3 * ramp**2 - 2 * ramp**3
    return share * np.maximum(along, 0) if lamp.is_surface else share


def radiance(
    light: SurfaceLight, surfaces: Surfaces, *, two_sided: bool = False, meshes: bool = True
) -> np.ndarray:
    """`surface_radiance`, [N, 3]; normals are turned to each lamp if `two_sided`."""
    matrix = surfaces.matrix
    turn = matrix[:3, :3] / np.cbrt(abs(np.linalg.det(matrix[:3, :3])))
    places = np.float64(surfaces.places) @ matrix[:3, :3].T + matrix[:3, 3]
    normals = np.float64(surfaces.normals) @ turn.T
    basis = sh_basis(2, normals)
    if two_sided:
        basis = (basis + sh_basis(2, -normals)) / 2
    out = np.maximum(basis @ light.world, 0)
    if light.sky and meshes and not two_sided:
        sent, passed = np.zeros((2, *out.shape))
        for strength, shadows in light.sky:
            facing = np.maximum(-normals @ shadows.rotations[0, 2], 0)[:, None] * np.array(strength)
            sent += facing
            passed += facing * ~hidden(shadows, places)[:, None]
        out *= np.where(sent > 0, passed / np.maximum(sent, 1e-30), 1)
    for lamp, (proxies, others) in zip(light.lamps, light.maps, strict=True):
        share, own = falloff(lamp, places, normals), normals
        if two_sided:
            own = np.where(share[:, None] < 0, -normals, normals)
            share = falloff(lamp, places, own)
        share = np.maximum(share, 0) * reaching(proxies, places, own)
        if meshes:
            share *= reaching(others, places, own)
        out += share[:, None] * np.array(lamp.strength)
    return out


def gains(
    light: SurfaceLight,
    surfaces: Surfaces,
    captured: np.ndarray | None,
    *,
    share: float,
    catches: bool,
    most: float,
) -> np.ndarray:
    """`surface_gains`, [N, 3]."""
    white = radiance(light, surfaces, two_sided=captured is None)
    bare = radiance(light, surfaces, two_sided=captured is None, meshes=False)
    with np.errstate(divide="ignore", invalid="ignore"):
        kept = np.where((bare > 0) & catches, white / bare, 1)
        if captured is None:
            return kept
        known = (surfaces.normals != 0).any(1) & (captured > 0).all(1)
        return (1 - share) * kept + share * np.minimum(
            np.where(known[:, None], white / captured, 1), most
        )


def scaled(sh0: np.ndarray, shN: np.ndarray, factors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`scaled_colors`."""
    constant = sh_basis(0, np.array([0.0, 0.0, 1.0]))[0]
    color = np.float64(sh0[:, 0]) * constant + 0.5
    lit = encode(decode(np.maximum(color, 0)) * factors) + np.minimum(color, 0)
    gain = np.where(color > 1 / 255, lit / np.maximum(color, 1 / 255), 1)
    return ((lit - 0.5) / constant)[:, None], shN * gain[:, None]
