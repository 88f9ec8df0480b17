"""Light of a scene on surfaces, and colours of splats under it, by the native library."""

import ctypes as ct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..errors import ConfigError, ShapeError
from . import _native, header
from .buffers import address, optional

POINT, SUN = "POINT", "SUN"


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
    size: float = 0.0
    """Radius of the disc that casts soft shadows, of a sun per distance; 0: they are hard."""
    source: tuple[float, float, float] | None = None
    """World position from which shadows fall, any for a sun; None: it casts none."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ShadowMap:
    """Depths of meshes as seen from a lamp."""

    depths: np.ndarray
    """[V, S, S] float32, 1 / z, if parallel distances in front of `farthest`; 0 where there is no
    mesh. V is 1, or 6: along +x, -x, +y, -y, +z and -z of the world."""
    rotations: np.ndarray
    """[V, 3, 3], world to lamp, z ahead."""
    place: np.ndarray
    """World position of the lamp [3]."""
    scale: float
    """Pixels per unit aside, at z = 1 unless parallel."""
    parallel: bool = False
    farthest: float = 0.0
    """z of a plane behind all meshes, if parallel."""
    slack: float = 0.0
    """Distance from a surface within which nothing shadows it, world units."""
    backs: np.ndarray | None = None
    """`depths` of the farthest meshes. Outlines, which make soft shadows, are assumed half way
    between the nearest and the farthest. None: at the nearest, so that contacts are too light."""

    @cached_property
    def nearest(self) -> float:
        """Maximum of `depths`."""
        return float(self.depths.max())


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceLight:
    """All light of a scene."""

    lamps: Sequence[Lamp]
    maps: Sequence[tuple[ShadowMap | None, ShadowMap | None]]
    """Shadows of each lamp by proxies and by other meshes; None: there are none."""
    world: np.ndarray
    """[9, 3] radiance of a white surface by its normal, in harmonics of degree 0 to 2."""
    sky: Sequence[tuple[tuple[float, float, float], ShadowMap]] = ()
    """Directions all around from which the world's light comes: radiance of a white surface that
    faces it, linear, and the parallel shadow map of meshes that are no proxies. `world` is dimmed
    by the share of this light that they hide, unless sides of normals are unknown."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Surfaces:
    """Small white surfaces."""

    places: np.ndarray
    """[N, 3] float32, in the space of an object."""
    normals: np.ndarray
    """[N, 3] float32 unit vectors in it; 0: unknown."""
    matrix: np.ndarray
    """[4, 4] float64, object to world, a similarity."""


def surface_radiance(light: SurfaceLight, surfaces: Surfaces) -> np.ndarray:
    """Radiance of white surfaces, linear Rec. 709, [N, 3] float32.

    A shadow is the mean of 2 x 2 pixels of a map by the distance to them; surfaces outside of a map
    are lit. Soft shadows are means over a disc around the surface, as wide as the nearest meshes
    blur them (Fernando 2005, percentage-closer soft shadows).

    Raises:
        ShapeError: an array has a wrong shape or dtype, or lamps and maps differ in number.
        ConfigError: the kind of a lamp is unknown.
        BackendError: the native library is missing.
    """
    return _lit("gs_surface_radiance", light, surfaces)


def surface_gains(
    light: SurfaceLight,
    surfaces: Surfaces,
    captured: np.ndarray | None,
    *,
    share: float,
    catches: bool,
    most: float,
) -> np.ndarray:
    """Factor of the linear colours of surfaces under a light, [N, 3] float32.

    Args:
        light: The light; errors as for `surface_radiance`.
        surfaces: The surfaces.
        captured: Radiance of white surfaces in the photos [N, 3] float32, 0: unknown, and the
            factor 1. None: it is not known of any, nor on which side the normals are; these are
            turned to each lamp.
        share: Share of the light that replaces the captured one.
        catches: Whether the shadows of meshes that are no proxies darken the captured light too.
        most: Largest ratio of the light to the captured one.
    """
    captured = None if captured is None else np.ascontiguousarray(captured, np.float32)
    shape = (len(surfaces.places), 3)
    return _lit(
        "gs_surface_gains",
        light,
        surfaces,
        captured=optional("captured", captured, shape),
        share=share,
        catches=catches,
        most=most,
    )


def scaled_colors(
    sh0: np.ndarray, shN: np.ndarray, gains: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of splats whose linear colours are multiplied.

    Args:
        sh0: [N, 1, 3] float32 of sRGB colours.
        shN: [N, R, 3] float32; scaled as the colour is, or kept if that is black.
        gains: [N, 3] float32.

    Returns:
        `sh0` and `shN`; errors as for `surface_radiance`.
    """
    count, rest, _ = _sizes("shN", shN)
    new0, newN = np.empty((count, 1, 3), np.float32), np.empty((count, rest, 3), np.float32)
    colors = header.ColorsStruct(
        count=count,
        sh_rest=rest,
        sh0=address("sh0", sh0, new0.shape),
        shN=address("shN", shN, newN.shape),
        gains=address("gains", gains, (count, 3)),
    )
    outputs = address("sh0", new0, new0.shape), address("shN", newN, newN.shape)
    _native.raise_status(_native.library().gs_scale_colors(ct.byref(colors), 0, *outputs))
    return new0, newN


def _lit(function: str, light: SurfaceLight, surfaces: Surfaces, **more: Any) -> np.ndarray:
    shape = (len(surfaces.places), 3)
    matrix = surfaces.matrix
    turn = matrix[:3, :3] / np.cbrt(abs(np.linalg.det(matrix[:3, :3])))
    places, normals = (
        np.ascontiguousarray(one, np.float32) for one in (surfaces.places, surfaces.normals)
    )
    given = header.SurfacesStruct(
        count=shape[0],
        places=address("places", places, shape),
        normals=address("normals", normals, shape),
        matrix=_floats("matrix", matrix[:3], 12),
        turn=_floats("turn", turn, 9),
        **more,
    )
    out = np.empty(shape, np.float32)
    native, kept = _native_light(light)
    _native.raise_status(
        getattr(_native.library(), function)(
            ct.byref(native), ct.byref(given), 0, address("out", out, shape)
        )
    )
    del kept
    return out


def _native_light(light: SurfaceLight) -> tuple[ct.Structure, list[np.ndarray | None]]:
    """`gs_light`, and arrays that must outlive it."""
    found: dict[int, tuple[int, ShadowMap]] = {}
    maps, lamps, kept = [], [], []
    if len(light.lamps) != len(light.maps):
        raise ShapeError(
            f"there must be a pair of shadow maps for each of {len(light.lamps)} lamps, got "
            f"{len(light.maps)}."
        )

    def index(one: ShadowMap | None) -> int:
        return -1 if one is None else found.setdefault(id(one), (len(found), one))[0]

    is_soft = any(lamp.size > 0 for lamp in light.lamps)
    for lamp, pair in zip(light.lamps, light.maps, strict=True):
        if lamp.kind not in (POINT, SUN):
            raise ConfigError(f"The kind of a lamp must be {POINT} or {SUN}, got {lamp.kind}.")
        lamps.append(
            header.LampStruct(
                is_sun=lamp.kind == SUN,
                is_surface=lamp.is_surface,
                strength=_floats("strength", lamp.strength, 3),
                place=_floats("place", lamp.place, 3),
                axis=_floats("axis", lamp.axis, 3),
                radius=lamp.radius,
                cone=_floats("cone", lamp.cone, 2),
                size=lamp.size,
                maps=(ct.c_int32 * 2)(*map(index, pair)),
            )
        )
    sky = [
        header.SkyStruct(strength=_floats("sky", strength, 3), map=index(one))
        for strength, one in light.sky
    ]
    for _, one in found.values():
        rotations = np.ascontiguousarray(one.rotations, np.float32)
        views, size, _ = _sizes("depths", one.depths)
        kept += [rotations, one.depths, one.backs]
        maps.append(
            header.ShadowMapStruct(
                size=size,
                views=views,
                depths=address("depths", one.depths, (views, size, size)),
                backs=optional("backs", one.backs, (views, size, size)),
                rotations=address("rotations", rotations, (views, 3, 3)),
                place=_floats("place", one.place, 3),
                scale=one.scale,
                parallel=one.parallel,
                farthest=one.farthest,
                nearest=one.nearest if is_soft else 0.0,
                slack=one.slack,
            )
        )
    native = header.LightStruct(
        world=_floats("world", light.world, 27),
        lamp_count=len(lamps),
        lamps=(header.LampStruct * len(lamps))(*lamps),
        map_count=len(maps),
        maps=(header.ShadowMapStruct * len(maps))(*maps),
        sky_count=len(sky),
        sky=(header.SkyStruct * len(sky))(*sky),
    )
    return native, kept


def _sizes(name: str, array: np.ndarray) -> tuple[int, int, int]:
    if array.ndim != 3:
        raise ShapeError(f"{name} must have three dimensions, got {list(array.shape)}.")
    return array.shape


def _floats(name: str, values: Any, count: int) -> ct.Array:
    numbers = np.asarray(values, np.float64).ravel().tolist()
    if len(numbers) != count:  # ctypes would fill up with zeros
        raise ShapeError(f"{name} must have {count} numbers, got {len(numbers)}.")
    return (ct.c_float * count)(*numbers)
