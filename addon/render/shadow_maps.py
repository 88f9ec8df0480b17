"""Shadow maps: which surfaces a lamp reaches past meshes; no bpy."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..core import mesh_depth, mesh_nearness
from ..triangles import Triangles, joined, repeated

_SIZE = 1024
"""Pixels along a side of a map."""
_OUTSIDE = 1.3
"""Distance of a lamp from the middle of `Casters.ball`, in its radii, for a single map."""
_EDGES = 1 << 12
"""Triangles of a proxy by which the length of its edges is judged."""
_SLACK = 1.5
"""Distance by which proxies may be off the splats, in lengths of their edges."""
_LEAST, _MOST = 0.002, 0.03
"""Limits of that distance, in radii of `Casters.ball`."""


_SIDES = [sign * np.eye(3)[k] for k in range(3) for sign in (1.0, -1.0)]
"""Axes of the maps of a lamp among the meshes."""


@dataclass(frozen=True, kw_only=True)
class Casters:
    """Meshes that cast shadows on splats."""

    proxy_key: bytes = b""
    """Differs if the proxies, or `splats`, differ."""
    mesh_key: bytes = b""
    """Differs if the other meshes, or `splats`, differ."""
    proxies: tuple[tuple[Triangles, np.ndarray], ...] = field(default=(), compare=False)
    """Proxies of splats, and their matrices to the world [4, 4]: they are on the splats' surface,
    but not exactly."""
    meshes: tuple[tuple[Triangles, np.ndarray], ...] = field(default=(), compare=False)
    """Other meshes."""
    splats: tuple[np.ndarray, float] | None = field(default=None, compare=False)
    """Center [3] and radius of a ball around all splats; None: it is not known."""

    @property
    def key(self) -> bytes:
        """Differs if the meshes differ."""
        return self.proxy_key + b"|" + self.mesh_key

    @cached_property
    def only_proxies(self) -> "Casters":
        """The proxies alone: what stood there when the photos were taken."""
        return replace(self, mesh_key=b"", meshes=())

    @cached_property
    def only_meshes(self) -> "Casters":
        """The other meshes alone."""
        return replace(self, proxy_key=b"", proxies=())

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
            some = triangles.triangles[:: -(-len(triangles.triangles) // _EDGES)]
            a, b = (triangles.vertices[some[:, k]] for k in (0, 1))
            edges.append(float(np.median(np.linalg.norm((a - b) @ matrix[:3, :3].T, axis=1))))
        return float(np.clip(_SLACK * max(edges), _LEAST * radius, _MOST * radius))


@dataclass(frozen=True, kw_only=True)
class ShadowMaps:
    """Shadows of one lamp: depths of meshes as seen from it."""

    viewmats: np.ndarray
    """[V, 4, 4], world to lamp: one, or six along the axes of the world (`_SIDES`)."""
    scale: float
    """Pixels per unit aside, at depth 1 unless parallel."""
    parallel: bool
    depths: np.ndarray
    """[V * _SIZE * _SIZE] float32, 1 / z, if parallel distances in front of `farthest`; 0 where
    there is no mesh."""
    farthest: float

    def lit(self, places: np.ndarray, slack: float) -> np.ndarray:
        """Share of the lamp that reaches places, [N] float32: a mean of 2 x 2 pixels by the
        distance to them; 1 outside of the maps.

        Args:
            places: World positions [N, 3] float32.
            slack: `Casters.slack`.
        """
        first, x, y, z = self._seen(places)
        scale, before = np.float32(self.scale), z - np.float32(slack)
        if self.parallel:
            most = np.float32(self.farthest) - before
        else:
            scale = scale / np.maximum(z, np.float32(1e-9))
            most = 1 / np.maximum(before, np.float32(1e-30))
        x, y = (scale * one + np.float32(_SIZE / 2 - 0.5) for one in (x, y))
        left, top = np.floor(x), np.floor(y)
        inside = (left >= 0) & (top >= 0) & (left < _SIZE - 1) & (top < _SIZE - 1) & (z > 0)
        pixel = np.where(inside, top * _SIZE + left, 0).astype(np.int32) + first
        u, v = x - left, y - top
        rows = []
        for row in (pixel, pixel + _SIZE):
            near, far = (self.depths[row + k] <= most for k in (0, 1))
            rows.append(near + u * (far.astype(np.float32) - near))
        return np.where(inside, rows[0] + v * (rows[1] - rows[0]), 1).astype(np.float32)

    def _seen(self, places: np.ndarray) -> tuple[np.ndarray | int, ...]:
        """First pixel of the map that shows each place, and its coordinates in the map's axes."""
        if len(self.viewmats) == 1:
            turn, shift = self.viewmats[0, :3, :3], self.viewmats[0, :3, 3:]
            return 0, *(np.float32(turn) @ places.T + np.float32(shift))
        eye = -self.viewmats[0, :3, :3].T @ self.viewmats[0, :3, 3]
        away = np.ascontiguousarray((places - np.float32(eye)).T)
        every, count = away.ravel(), np.arange(away.shape[1])
        axis = np.argmax(np.abs(away), axis=0)
        side = 2 * axis + (every[axis * len(count) + count] < 0)
        turns = self.viewmats[:, :3, :3]
        rows, signs = np.abs(turns).argmax(-1), np.float32(turns.sum(-1))
        own = (signs[side, k] * every[rows[side, k] * len(count) + count] for k in range(3))
        return (side * _SIZE**2).astype(np.int32), *own


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
        views = [_turned(axis, center - ahead * axis)]
    else:
        away = center - place
        distance = float(np.linalg.norm(away))
        if distance > _OUTSIDE * radius:
            scale = _SIZE / 2 * np.sqrt(distance**2 - radius**2) / (1.01 * radius)
            views = [_turned(away / distance, place)]
        else:
            # Wider by a pixel, so that no place is between two of them.
            scale, views = _SIZE / 2 - 1, [_turned(side, place) for side in _SIDES]
    K = np.array([[scale, 0, _SIZE / 2], [0, scale, _SIZE / 2], [0, 0, 1]])
    mesh, parallel, near = casters.mesh, axis is not None, 1e-4 * radius
    depths = np.empty((len(views), _SIZE, _SIZE), np.float32)
    threads = 1 if len(views) > 1 else 0  # a single map is drawn in bands at once

    def draw(viewmat: np.ndarray, out: np.ndarray) -> float:
        given = mesh.vertices, mesh.triangles, K, viewmat, _SIZE, _SIZE
        if parallel:  # all meshes are in front
            return mesh_nearness(*given, threads=threads, out=out)[1]
        mesh_depth(*given, near=near, threads=threads, out=out)
        return 0.0

    with ThreadPoolExecutor(min(os.cpu_count() or 1, len(views))) as pool:
        farthest = list(pool.map(draw, views, depths))
    return ShadowMaps(
        viewmats=np.stack(views),
        scale=float(scale),
        parallel=parallel,
        depths=depths.ravel(),
        farthest=farthest[0],
    )


def _turned(axis: np.ndarray, place: np.ndarray) -> np.ndarray:
    """[4, 4] from the world to a camera at a place that looks along an axis."""
    aside = np.eye(3)[int(np.argmin(np.abs(axis)))]
    right = np.cross(aside, axis)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(axis, right), axis])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, -turn @ place
    return matrix
