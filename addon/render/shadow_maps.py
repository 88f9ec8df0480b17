"""Shadow maps: which surfaces a lamp reaches past meshes; no bpy."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..core import mesh_depth
from ..triangles import Triangles, joined, repeated

_SIZE = 1024
"""Pixels along a side of a map."""
_OUTSIDE = 1.3
"""Distance of a lamp from the middle of `Casters.ball`, in its radii, for a single map."""
_SLACK = 1.5
"""Distance by which proxies may be off the splats, in lengths of their edges."""
_LEAST, _MOST = 0.002, 0.03
"""Limits of that distance, in radii of `Casters.ball`."""


@dataclass(frozen=True, kw_only=True)
class Casters:
    """Meshes that cast shadows on splats."""

    key: bytes = b""
    """Differs if the meshes differ."""
    proxies: tuple[tuple[Triangles, np.ndarray], ...] = field(default=(), compare=False)
    """Proxies of splats, and their matrices to the world [4, 4]: they are on the splats' surface,
    but not exactly."""
    meshes: tuple[tuple[Triangles, np.ndarray], ...] = field(default=(), compare=False)
    """Other meshes."""
    splats: tuple[np.ndarray, float] | None = field(default=None, compare=False)
    """Center [3] and radius of a ball around all splats; None: it is not known."""

    @property
    def only_proxies(self) -> "Casters":
        """The proxies alone: what stood there when the photos were taken."""
        return replace(self, key=self.key + b"proxies", meshes=())

    def __bool__(self) -> bool:
        return bool(self.proxies or self.meshes)

    @cached_property
    def mesh(self) -> Triangles:
        """All of them in the world."""
        return joined([repeated(t, m[None]) for t, m in (*self.proxies, *self.meshes)])

    @cached_property
    def ball(self) -> tuple[np.ndarray, float]:
        """Center [3] and radius of a ball around them, or the splats if that is smaller: maps of a
        wide ground would miss the shadows of small things on it."""
        own = ball_of(self.mesh.vertices)
        return own if self.splats is None or self.splats[1] >= own[1] else self.splats

    @cached_property
    def slack(self) -> float:
        """Distance from a surface within which nothing shadows it, world units."""
        radius, edges = self.ball[1], [0.0]
        for triangles, matrix in self.proxies:
            a, b = (triangles.vertices[triangles.triangles[:, k]] for k in (0, 1))
            edges.append(float(np.median(np.linalg.norm((a - b) @ matrix[:3, :3].T, axis=1))))
        return float(np.clip(_SLACK * max(edges), _LEAST * radius, _MOST * radius))


@dataclass(frozen=True, kw_only=True)
class _Map:
    """Depths of meshes as seen from a lamp."""

    viewmat: np.ndarray
    K: np.ndarray
    parallel: bool
    depth: np.ndarray
    """[H, W] float32; infinite where there is no mesh."""

    def lit(self, places: np.ndarray, slack: float) -> np.ndarray:
        """Share of places [N, 3] that the lamp reaches, [N] float32: a mean of 2 x 2 pixels by the
        distance to them; 1 outside of the map."""
        seen = places @ self.viewmat[:3, :3].T.astype(np.float32) + self.viewmat[:3, 3]
        z = seen[:, 2]
        scale = 1.0 if self.parallel else np.maximum(z, 1e-9)
        x = self.K[0, 0] * seen[:, 0] / scale + self.K[0, 2] - 0.5
        y = self.K[1, 1] * seen[:, 1] / scale + self.K[1, 2] - 0.5
        left, top = np.floor(x), np.floor(y)
        inside = (left >= 0) & (top >= 0) & (left < _SIZE - 1) & (top < _SIZE - 1) & (z > 0)
        column = np.where(inside, left, 0).astype(np.int64)
        row = np.where(inside, top, 0).astype(np.int64)
        u, v = np.where(inside, x - left, 0), np.where(inside, y - top, 0)
        found = np.zeros(len(places))
        for dy, wy in ((0, 1 - v), (1, v)):
            for dx, wx in ((0, 1 - u), (1, u)):
                found += (z - slack <= self.depth[row + dy, column + dx]) * wy * wx
        return np.where(inside, found, 1).astype(np.float32)


@dataclass(frozen=True, kw_only=True)
class ShadowMaps:
    """Shadows of one lamp."""

    maps: tuple[_Map, ...]
    """Several look in different directions."""
    slack: float

    def lit(self, places: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Share of the lamp that reaches surfaces, [N] float32.

        Args:
            places: World positions [N, 3].
            normals: Unit vectors [N, 3].
        """
        places = places + normals * np.float32(self.slack)
        found = np.ones(len(places), np.float32)
        for one in self.maps:
            found *= one.lit(places, self.slack)
        return found


def ball_of(places: np.ndarray) -> tuple[np.ndarray, float]:
    """Center [3] and radius of a ball around the box of places [N, 3], at least one."""
    low, high = places.min(0), places.max(0)
    return (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-9)


def shadow_maps(casters: Casters, place: np.ndarray, axis: np.ndarray | None) -> ShadowMaps:
    """Draw the meshes from a lamp.

    Args:
        casters: At least one mesh.
        place: World position [3].
        axis: Unit vector along which it shines [3], if it is a sun.
    """
    center, radius = casters.ball
    if axis is not None:
        scale = _SIZE / (2.02 * radius)
        ahead = max(2 * radius, radius - float(((casters.mesh.vertices - center) @ axis).min()))
        views = [(_turned(axis, center - ahead * axis), scale, True)]
    else:
        away = center - place
        distance = float(np.linalg.norm(away))
        if distance > _OUTSIDE * radius:
            scale = _SIZE / 2 * np.sqrt(distance**2 - radius**2) / (1.01 * radius)
            views = [(_turned(away / distance, place), scale, False)]
        else:
            sides = [sign * np.eye(3)[k] for k in range(3) for sign in (1.0, -1.0)]
            # Wider by a pixel, so that no place is between two of them.
            views = [(_turned(side, place), _SIZE / 2 - 1, False) for side in sides]

    def draw(view: tuple[np.ndarray, float, bool]) -> _Map:
        viewmat, scale, parallel = view
        K = np.array([[scale, 0, _SIZE / 2], [0, scale, _SIZE / 2], [0, 0, 1]])
        inverse = mesh_depth(
            casters.mesh.vertices,
            casters.mesh.triangles,
            K,
            viewmat,
            _SIZE,
            _SIZE,
            near=1e-4 * radius,
            orthographic=parallel,
        )
        depth = np.full_like(inverse, np.inf)
        np.divide(1, inverse, out=depth, where=inverse > 0)
        return _Map(viewmat=viewmat, K=K, parallel=parallel, depth=depth)

    with ThreadPoolExecutor(len(views)) as pool:
        return ShadowMaps(maps=tuple(pool.map(draw, views)), slack=casters.slack)


def _turned(axis: np.ndarray, place: np.ndarray) -> np.ndarray:
    """[4, 4] from the world to a camera at a place that looks along an axis."""
    aside = np.eye(3)[int(np.argmin(np.abs(axis)))]
    right = np.cross(aside, axis)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(axis, right), axis])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, -turn @ place
    return matrix
