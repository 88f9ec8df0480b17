"""Relighting: colors of splats under the scene's lights in place of the captured light; no bpy.

A splat has a normal and the captured light, the radiance that a white surface in its place had in
the photos. Its linear color is multiplied by the scene's such radiance divided by that one. Meshes,
and proxies in place of splats, cast shadows; there are no reflections.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..core import Splats, quat_to_rotmat, rgb_to_sh0, sh0_to_rgb, sh_basis
from ..srgb import LUMINANCE, decode, encode
from .shadow_maps import Casters, ShadowMaps, shadow_maps

POINT, SUN = "POINT", "SUN"
_WHITE = 0.8
"""Albedo that the brightest surfaces of a capture are assumed to have."""
_BRIGHTEST = 95
"""Percentile of the colors that are these surfaces."""
_DARKEST = 0.1
"""Least captured light, in means of the capture."""
_STRONGEST = 16.0
"""Largest ratio of the scene's light to the captured light."""
_CELLS = 64
"""Cells in which normals are averaged, along the diagonal of most splats."""
_DIM = 1 / 255
"""sRGB value below which a color is black."""
_BLOCK = 1 << 13
"""Splats of which intermediate results are in the cache."""
_BANDS = np.array([1, *(3 * [2 / 3]), *(5 * [1 / 4])])
"""Irradiance of a white surface over pi, by radiance, of the harmonics of degree 0 to 2
(Ramamoorthi and Hanrahan 2001)."""


_CONSTANT = float(sh_basis(0, np.array([0.0, 0.0, 1.0]))[0])
"""The constant harmonic."""


@dataclass(frozen=True, kw_only=True)
class Lamp:
    """A small source of light in the world; a large one is several."""

    kind: str
    """POINT: `strength` over squared distance; SUN: `strength` everywhere."""
    strength: tuple[float, float, float]
    """Radiance of a white surface that faces it, linear Rec. 709, at distance 1."""
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Unit vector along which it shines: of a sun, a cone, or a surface."""
    radius: float = 0.0
    """Least distance."""
    cone: tuple[float, float] = (-2.0, 0.0)
    """Cosine of half the cone's angle, and the range of cosines in which it fades in."""
    is_surface: bool = False
    """Whether it fades with the cosine of the angle to its axis."""
    source: tuple[float, float, float] | None = None
    """World position from which shadows fall, any for a sun; None: it casts none."""


@dataclass(frozen=True, kw_only=True)
class SceneLight:
    """All light of a scene."""

    lamps: tuple[Lamp, ...] = ()
    world: np.ndarray = field(default_factory=lambda: np.zeros((9, 3)))
    """[9, 3] radiance of a white surface by its normal, in harmonics of degree 0 to 2."""

    casters: Casters = field(default_factory=Casters)
    """Meshes that cast shadows."""

    @cached_property
    def key(self) -> bytes:
        """Differs if the light differs."""
        return repr(self.lamps).encode() + self.world.tobytes() + self.casters.key

    @cached_property
    def maps(self) -> tuple[tuple[ShadowMaps, ...], ...]:
        """The shadows of each lamp by proxies and by other meshes, in this order, without those
        that are not there; none for lamps after the first `_MOST_MAPS`. They are kept apart, so
        that those of proxies stay when a mesh moves."""
        casting = {_source(lamp): lamp for lamp in self.lamps if lamp.source is not None}
        wanted = {
            key: (kind, lamp)
            for source, lamp in list(casting.items())[:_MOST_MAPS]
            for key, kind in self._kinds(source).items()
        }
        found = {key: maps for key in wanted if (maps := _known.get(key))}
        forget_maps()  # the others are freed before more are drawn
        for key, (kind, lamp) in wanted.items():
            found[key] = found.get(key) or _maps_of(kind, lamp)
        _known.update(found)
        sources = (None if lamp.source is None else _source(lamp) for lamp in self.lamps)
        return tuple(
            tuple(found[key] for key in self._kinds(source) if key in found) for source in sources
        )

    def _kinds(self, source: str | None) -> dict[tuple[bytes, str], Casters]:
        """Proxies and other meshes by their keys in `_known`; none without a source."""
        kinds = (self.casters.only_proxies, self.casters.only_meshes)
        return {(kind.key, source): kind for kind in kinds if kind and source is not None}

    def white(
        self,
        places: np.ndarray,
        normals: np.ndarray,
        *,
        meshes: bool = True,
        two_sided: bool = False,
    ) -> np.ndarray:
        """Radiance of white surfaces, linear Rec. 709, [N, 3] float32.

        Args:
            places: World positions [N, 3] float32.
            normals: Unit vectors [N, 3] float32.
            meshes: Whether meshes other than proxies cast shadows.
            two_sided: Whether it is unknown on which side of a surface its normal is: it is turned
                to each lamp.
        """
        world = self.world.copy()
        if two_sided:
            world[1:4] = 0  # of opposite sign on both sides
        if world[1:].any():
            light = harmonics(normals) @ world.astype(np.float32)
            np.maximum(light, 0, out=light)
        else:  # from all directions
            light = np.tile(np.float32(even_radiance(world)), (len(places), 1))
        left_out = () if meshes else self.casters.meshes
        for lamp, found in zip(self.lamps, self.maps, strict=True):
            share = _falloff(lamp, places, normals)
            own = normals
            if two_sided:
                own, share = np.where(share[:, None] < 0, -normals, normals), np.abs(share)
            np.maximum(share, 0, out=share)
            rows = np.flatnonzero(share)
            if kept := found[:-1] if left_out else found:
                slack = self.casters.slack
                beside = places[rows] + own[rows] * np.float32(slack)
                for maps in kept:
                    share[rows] *= maps.lit(beside, slack)
            for channel, strength in enumerate(lamp.strength):
                light[:, channel] += share * np.float32(strength)
        return light

    def white_of(
        self, means: np.ndarray, normals: np.ndarray, matrix: np.ndarray, **how: bool
    ) -> np.ndarray:
        """`white` of surfaces in the space of an object.

        Args:
            means: Positions in that space [N, 3] float32.
            normals: Unit vectors in it [N, 3] float32.
            matrix: Object to world [4, 4], a similarity.
            **how: Other arguments of `white`.
        """
        turn = matrix[:3, :3] / np.cbrt(abs(np.linalg.det(matrix[:3, :3])))
        turn, matrix = turn.astype(np.float32), matrix.astype(np.float32)
        return self.white(means @ matrix[:3, :3].T + matrix[:3, 3], normals @ turn.T, **how)


_known: dict[tuple[bytes, str], ShadowMaps] = {}
"""Shadow maps of the last light by their meshes and lamp; those of a lamp in a room are 24 MB for
proxies, and as much for other meshes."""
_MOST_MAPS = 32


def forget_maps() -> None:
    """Free the shadow maps."""
    _known.clear()


def _source(lamp: Lamp) -> str:
    """Differs if shadows fall otherwise."""
    return repr(lamp.axis if lamp.kind == SUN else lamp.source)


def _maps_of(casters: Casters, lamp: Lamp) -> ShadowMaps:
    axis = np.array(lamp.axis) if lamp.kind == SUN else None
    return shadow_maps(casters, np.array(lamp.source), axis)


def harmonics(normals: np.ndarray) -> np.ndarray:
    """Basis of degree 0 to 2 of unit vectors [N, 3]: [N, 9]."""
    return sh_basis(2, normals)


def world_of_map(light: np.ndarray, directions: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """`SceneLight.world` of radiances [..., 3] from unit directions [..., 3], with solid angles
    [...]."""
    basis = harmonics(directions.reshape(-1, 3)) * weights.reshape(-1, 1)
    return _BANDS[:, None] * (basis.T @ light.reshape(-1, 3).astype(np.float64))


def map_directions(height: int, width: int) -> np.ndarray:
    """Unit vectors [H, W, 3] of the pixels of an equirectangular map of Blender's world: the bottom
    row (straight down) first, +X in the middle, +Y to its left."""
    longitude = np.pi * (1 - 2 * (np.arange(width) + 0.5) / width)
    latitude = np.pi * ((np.arange(height) + 0.5) / height - 0.5)
    x, y = np.cos(longitude), np.sin(longitude)
    level, up = np.cos(latitude)[:, None], np.sin(latitude)[:, None]
    return np.stack([level * x, level * y, np.broadcast_to(up, (height, width))], -1)


def map_solid_angles(height: int, width: int) -> np.ndarray:
    """Steradians [H, W] of these pixels."""
    edges = np.sin(np.pi * (np.arange(height + 1) / height - 0.5))
    return np.broadcast_to(np.diff(edges)[:, None] * (2 * np.pi / width), (height, width))


def even_world(light: np.ndarray) -> np.ndarray:
    """`SceneLight.world` of one radiance [3] from all directions."""
    found = np.zeros((9, 3))
    found[0] = np.asarray(light) / _CONSTANT
    return found


def even_radiance(world: np.ndarray) -> np.ndarray:
    """The radiance [3] of `even_world`."""
    return np.maximum(world[0] * _CONSTANT, 0)


def _falloff(lamp: Lamp, places: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Share of a lamp's strength that arrives at surfaces, [N] float32; below 0 on their back."""
    axis = np.float32(lamp.axis)
    if lamp.kind == SUN:
        return normals @ -axis
    towards = np.float32(lamp.place) - places
    squared = np.maximum(np.einsum("ij,ij->i", towards, towards), np.float32(1e-12))
    distance = np.sqrt(squared)
    share = np.einsum("ij,ij->i", towards, normals)
    share /= distance * np.maximum(squared, np.float32(lamp.radius**2))
    edge, fade = lamp.cone
    if edge > -1 or lamp.is_surface:
        along = (towards @ -axis) / distance
    if edge > -1:
        ramp = np.clip((along - edge) / max(fade, 1e-6), 0, 1)
        share *= ramp * ramp * (3 - 2 * ramp)
    if lamp.is_surface:
        share *= np.maximum(along, 0)
    return share


@dataclass(frozen=True, kw_only=True)
class Relighting:
    """Relighting of an object."""

    share: float
    """0: the captured light; 1: the scene's."""
    catches: bool = False
    """Whether meshes that were not in the photos cast shadows in the captured light too, as those
    lamps that the scene has."""
    light: SceneLight
    matrix: np.ndarray
    """[4, 4] float64, object to world."""

    @cached_property
    def key(self) -> bytes:
        """Differs if the result differs."""
        own = np.float64([self.share, self.catches]).tobytes()
        return own + self.matrix.tobytes() + self.light.key


def relit(
    splats: Splats, normals: np.ndarray, captured: np.ndarray | None, how: Relighting
) -> Splats:
    """Splats under the scene's light.

    Args:
        splats: Splats as captured, in the object's space.
        normals: Unit vectors in that space [N, 3]; zero: none, and the color stays.
        captured: Radiance of white surfaces in the photos [N, 3], linear; None: it is not known,
            nor on which side of a splat its normal is, and `how.share` is 0.
        how: The light.
    """
    count, rest, _ = splats.shN.shape
    sh0, shN = np.empty((count, 3), np.float32), np.empty((count, rest, 3), np.float32)

    def work(part: slice) -> None:
        before = None if captured is None else captured[part]
        ratio = _gain(splats.means[part], normals[part], before, how)
        color = sh0_to_rgb(splats.sh0[part, 0])
        relit = encode(decode(color) * ratio) + np.minimum(color, 0)
        sh0[part] = rgb_to_sh0(relit)
        if rest:
            # View dependence is scaled as the color is; a black one has none of its own.
            gain = np.where(color > _DIM, relit / np.maximum(color, _DIM), 1).astype(np.float32)
            for channel in range(3):
                own, out = splats.shN[part, :, channel], shN[part, :, channel]
                np.multiply(own, gain[:, channel, None], out=out)

    _in_blocks(work, count, how.light)
    return replace(splats, sh0=sh0[:, None], shN=shN)


def shade(
    means: np.ndarray, normals: np.ndarray, captured: np.ndarray | None, how: Relighting
) -> np.ndarray:
    """Factor of the colors of relit splats by shadows, [N, 3] float32; 1: none. Arguments as the
    arrays of `relit`."""
    out = np.ones((len(means), 3), np.float32)
    bare = replace(how, light=replace(how.light, casters=Casters()))

    def work(part: slice) -> None:
        before = None if captured is None else captured[part]
        lit, dark = (_gain(means[part], normals[part], before, one) for one in (bare, how))
        np.divide(dark, lit, out=out[part], where=lit > 0)

    _in_blocks(work, len(means), how.light)
    return out


def _gain(
    means: np.ndarray, normals: np.ndarray, captured: np.ndarray | None, how: Relighting
) -> np.ndarray:
    """Factor of the linear colors of splats by relighting, [N, 3] float32."""
    ratio = np.ones((len(means), 3), np.float32)
    white = how.light.white_of(means, normals, how.matrix, two_sided=captured is None)
    if how.catches and how.share < 1:
        without = {"meshes": False, "two_sided": captured is None}
        bare = how.light.white_of(means, normals, how.matrix, **without)
        np.divide(white, bare, out=ratio, where=bare > 0)
    if captured is None:
        return ratio
    (x, y, z), (r, g, b) = normals.T, captured.T  # reducing rows of three is slow
    known = ((x != 0) | (y != 0) | (z != 0)) & (r > 0) & (g > 0) & (b > 0)
    lit = np.divide(white, captured, out=np.ones_like(white), where=known[:, None])
    return np.float32(1 - how.share) * ratio + np.float32(how.share) * np.minimum(lit, _STRONGEST)


def _in_blocks(work: Callable[[slice], None], count: int, light: SceneLight) -> None:
    """Do the work of blocks of splats in threads."""
    _ = light.maps  # once, before the threads need them
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(work, (slice(at, at + _BLOCK) for at in range(0, count, _BLOCK))))


def shortest_axes(quats: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Unit vectors [N, 3] along the shortest axes of splats with quaternions [N, 4] (w first)."""
    axes = np.argmin(scales, axis=1)
    turns = quat_to_rotmat(quats)
    return np.take_along_axis(turns, axes[:, None, None], axis=2)[..., 0].astype(np.float32)


def facing(means: np.ndarray, eyes: np.ndarray) -> np.ndarray:
    """Vectors [N, 3] from places [N, 3] to the eyes [C, 3] that are near; without eyes away from
    the middle of the places."""
    if not len(eyes):
        return means - np.median(means, axis=0)
    out = np.zeros_like(means)
    for eye in eyes.astype(np.float32):
        away = eye - means
        out += away / np.maximum(np.einsum("ij,ij->i", away, away), 1e-9)[:, None] ** 1.5
    return out


def smooth(means: np.ndarray, normals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Unit vectors averaged over cells of space, [N, 3]; weights [N]."""
    low, high = np.percentile(means, [5, 95], axis=0)
    cell = max(float(np.linalg.norm(high - low)) / _CELLS, 1e-9)
    keys = np.floor(means / cell).astype(np.int64)
    _, home = np.unique(keys, axis=0, return_inverse=True)
    home = home.ravel()
    sums = np.stack(
        [np.bincount(home, weights=normals[:, axis] * weights) for axis in range(3)], axis=1
    )[home]
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.where(lengths > 1e-12, sums / np.maximum(lengths, 1e-12), normals).astype(np.float32)


def captured_light(colors: np.ndarray, normals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The captured light, if surfaces of all directions are equally bright on average, and photos
    are balanced to white light: the smooth function of normals next to the brightness of the
    colors, grey, [N, 3] float32.

    Args:
        colors: Linear colors of the splats [N, 3].
        normals: Unit vectors [N, 3].
        weights: Weights of the splats [N].
    """
    brightness = colors @ LUMINANCE
    basis = harmonics(normals).astype(np.float64)
    rest = 1e-3 * weights.sum() * np.diag([0.0] + 8 * [1.0])  # unseen directions are as the mean
    normal = basis.T @ (basis * weights[:, None]) + rest
    shading = basis @ np.linalg.solve(normal, basis.T @ (brightness * weights))
    shading = np.maximum(shading, _DARKEST * np.average(brightness, weights=weights))
    albedo = brightness / np.maximum(shading, 1e-9)
    order = np.argsort(albedo)
    summed = np.cumsum(weights[order])
    place = np.searchsorted(summed, summed[-1] * _BRIGHTEST / 100)
    top = albedo[order[min(place, len(order) - 1)]]
    shading *= max(top, 1e-9) / _WHITE
    return np.repeat(shading[:, None], 3, axis=1).astype(np.float32)
