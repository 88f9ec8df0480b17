"""Relighting: colors of splats under the scene's lights in place of the captured light; no bpy.

A splat has a normal and the captured light, the radiance that a white surface in its place had in
the photos. Its linear color is multiplied by the scene's such radiance divided by that one. Meshes,
and proxies in place of splats, cast shadows; there are no reflections.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from ..core import (
    SUN,
    Lamp,
    ShadowMap,
    Splats,
    SurfaceLight,
    Surfaces,
    quat_to_rotmat,
    scaled_colors,
    sh_basis,
    sphere,
    surface_gains,
    surface_radiance,
)
from ..srgb import LUMINANCE
from .shadow_maps import Casters, shadow_map, sky_map

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
_FAR = 1 << 20
"""Cells from the middle beyond which all are one, so that three numbers fit an integer."""
_BANDS = np.array([1, *(3 * [2 / 3]), *(5 * [1 / 4])])
"""Irradiance of a white surface over pi, by radiance, of the harmonics of degree 0 to 2
(Ramamoorthi and Hanrahan 2001)."""


_CONSTANT = float(sh_basis(0, np.array([0.0, 0.0, 1.0]))[0])
"""The constant harmonic."""


_SKY = sphere(48)
"""Directions in which meshes hide the world."""


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
    def native(self) -> SurfaceLight:
        """The light with its shadow maps, those of proxies apart, so that they stay when a mesh
        moves; none for lamps after the first `_MOST_MAPS`."""
        casting = {_source(lamp): lamp for lamp in self.lamps if lamp.source is not None}
        proxies, meshes = self._kinds
        wanted = {
            (kind.key, source): partial(_map_of, kind, lamp)
            for source, lamp in list(casting.items())[:_MOST_MAPS]
            for kind in self._kinds
            if kind
        }
        sky = self._sky_light if meshes else np.zeros((0, 3))
        suns = [(meshes.key, f"sky {number}") for number in range(len(sky))]
        for number, key in enumerate(suns):
            wanted[key] = partial(sky_map, meshes, -_SKY[number])
        found = {key: maps for key in wanted if (maps := _known.get(key))}
        forget_maps()  # the others are freed before more are drawn
        new = [key for key in wanted if key not in found]
        with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            found.update(zip(new, pool.map(lambda key: wanted[key](), new), strict=True))
        _known.update(found)
        sources = (None if lamp.source is None else _source(lamp) for lamp in self.lamps)
        return SurfaceLight(
            lamps=self.lamps,
            maps=[(found.get((proxies.key, s)), found.get((meshes.key, s))) for s in sources],
            world=self.world,
            sky=[(tuple(light.tolist()), found[key]) for light, key in zip(sky, suns, strict=True)],
        )

    @property
    def _sky_light(self) -> np.ndarray:
        """The world's radiance from the directions `_SKY` [K, 3]; none if it is black."""
        light = np.maximum(harmonics(_SKY) @ (self.world / _BANDS[:, None]), 0)
        return light if light.any() else light[:0]

    @property
    def _kinds(self) -> tuple[Casters, Casters]:
        """Proxies and other meshes."""
        return self.casters.only_proxies, self.casters.only_meshes

    def white_of(self, means: np.ndarray, normals: np.ndarray, matrix: np.ndarray) -> np.ndarray:
        """Radiance of white surfaces in the space of an object, linear Rec. 709, [N, 3] float32.

        Args:
            means: Positions in that space [N, 3] float32.
            normals: Unit vectors in it [N, 3] float32.
            matrix: Object to world [4, 4], a similarity.
        """
        return surface_radiance(self.native, Surfaces(places=means, normals=normals, matrix=matrix))


_known: dict[tuple[bytes, str], ShadowMap] = {}
"""Shadow maps of the last light by their meshes and lamp; those of a lamp in a room are 24 MB for
proxies, and as much for other meshes."""
_MOST_MAPS = 32


def forget_maps() -> None:
    """Free the shadow maps."""
    _known.clear()


def _source(lamp: Lamp) -> str:
    """Differs if shadows fall otherwise."""
    return repr((lamp.kind, lamp.axis if lamp.kind == SUN else lamp.source, lamp.size > 0))


def _map_of(casters: Casters, lamp: Lamp) -> ShadowMap:
    axis = np.array(lamp.axis) if lamp.kind == SUN else None
    return shadow_map(casters, np.array(lamp.source), axis, soft=lamp.size > 0)


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
    sh0, shN = scaled_colors(splats.sh0, splats.shN, _gains(splats.means, normals, captured, how))
    return replace(splats, sh0=sh0, shN=shN)


def shade(
    means: np.ndarray, normals: np.ndarray, captured: np.ndarray | None, how: Relighting
) -> np.ndarray:
    """Factor of the colors of relit splats by shadows, [N, 3] float32; 1: none. Arguments as the
    arrays of `relit`."""
    given = means, normals, captured, how
    dark, lit = _gains(*given), _gains(*given, shadows=False)
    return np.divide(dark, lit, out=np.ones_like(dark), where=lit > 0)


def _gains(
    means: np.ndarray,
    normals: np.ndarray,
    captured: np.ndarray | None,
    how: Relighting,
    *,
    shadows: bool = True,
) -> np.ndarray:
    """Factor of the linear colors of splats by relighting, [N, 3] float32."""
    light = how.light.native
    return surface_gains(
        light if shadows else replace(light, maps=[(None, None)] * len(light.maps), sky=()),
        Surfaces(places=means, normals=normals, matrix=how.matrix),
        captured,
        share=how.share,
        catches=how.catches,
        most=_STRONGEST,
    )


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
    # One number each: numpy sorts rows much slower, and holds Python's lock meanwhile.
    numbers = np.floor(means / cell) - np.floor((low + high) / (2 * cell))
    numbers = np.clip(numbers, -_FAR, _FAR - 1).astype(np.int64) + _FAR
    x, y, z = numbers.T
    _, home = np.unique((x << 42) | (y << 21) | z, return_inverse=True)
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
