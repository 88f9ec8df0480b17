"""Shadow maps: which surfaces a lamp reaches past meshes; no bpy."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..core import ShadowMap, mesh_backs, mesh_depth, mesh_nearness, vertex_normals
from ..triangles import Triangles, joined, repeated

_SIZE = 1024
"""Pixels along a side of a map."""
_SKY_SIZE = 64
"""Pixels along a side of a map of the sky, per direction."""
_OUTSIDE = 1.3
"""Distance of a lamp from the middle of `Casters.ball`, in its radii, for a single map."""
_EDGES = 1 << 12
"""Triangles of a proxy by which the length of its edges is judged."""
_SLACK = 1.5
"""Distance by which proxies may be off the splats, in lengths of their edges."""
_LEAST, _MOST = 0.002, 0.03
"""Limits of that distance, in radii of `Casters.ball`."""
_DEEP = 3.0
"""Depth below a proxy, in `Casters.slack`, up to which its sides towards a lamp leave splats lit:
many are below the surface and show through those on it."""


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

    @cached_property
    def _normals(self) -> np.ndarray:
        """Normals of the vertices of `mesh` [V, 3]."""
        return vertex_normals(*self.mesh)

    def sunk(self, place: np.ndarray, axis: np.ndarray | None) -> Triangles:
        """`mesh` for the map of a lamp, with the sides towards it deeper along its rays: what is
        solid casts its shadow from the sides away from it. Arguments as for `shadow_map`."""
        vertices, triangles = self.mesh
        deeper = (_DEEP - 1) * self.slack
        if axis is None:
            rays = vertices - place
            facing = np.einsum("ij,ij->i", self._normals, rays) < 0
            steps = deeper * facing / np.maximum(np.linalg.norm(rays, axis=1), 1e-12)
        else:
            rays, steps = axis, deeper * (self._normals @ axis < 0)
        return Triangles(vertices + steps[:, None] * rays, triangles)


def ball_of(places: np.ndarray) -> tuple[np.ndarray, float]:
    """Center [3] and radius of a ball around the box of places [N, 3], at least one."""
    columns = np.ascontiguousarray(places.T)  # reducing rows of three is slow
    low, high = columns.min(1), columns.max(1)
    return (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-9)


def shadow_map(
    casters: Casters, place: np.ndarray, axis: np.ndarray | None, *, soft: bool, size: int = _SIZE
) -> ShadowMap:
    """Draw the meshes from a lamp.

    Args:
        casters: At least one mesh.
        place: World position [3].
        axis: Unit vector along which it shines [3], if it is a sun.
        soft: Whether it has a size: far sides of meshes are drawn too, but not of proxies, whose
            ground hides them, nor around a lamp among the meshes.
        size: Pixels along a side.
    """
    center, radius = casters.ball
    if axis is not None:
        scale = size / (2.02 * radius)
        ahead = max(2 * radius, radius - float(((casters.mesh.vertices - center) @ axis).min()))
        views = [_turned(axis, center - ahead * axis)]
    else:
        away = center - place
        distance = float(np.linalg.norm(away))
        if distance > _OUTSIDE * radius:
            scale = size / 2 * np.sqrt(distance**2 - radius**2) / (1.01 * radius)
            views = [_turned(away / distance, place)]
        else:
            # Wider by a pixel, so that no place is between two of them.
            scale, views = size / 2 - 1, [_turned(side, place) for side in _SIDES]
    K = np.array([[scale, 0, size / 2], [0, scale, size / 2], [0, 0, 1]])
    mesh = casters.sunk(place, axis) if casters.proxies else casters.mesh
    parallel, near = axis is not None, 1e-4 * radius
    depths = np.empty((len(views), size, size), np.float32)
    threads = 1 if len(views) > 1 else 0  # a single map is drawn in bands at once

    def draw(viewmat: np.ndarray, out: np.ndarray) -> float:
        given = mesh.vertices, mesh.triangles, K, viewmat, size, size
        if parallel:  # all meshes are in front
            return mesh_nearness(*given, threads=threads, out=out)[1]
        mesh_depth(*given, near=near, threads=threads, out=out)
        return 0.0

    with ThreadPoolExecutor(min(os.cpu_count() or 1, len(views))) as pool:
        farthest = list(pool.map(draw, views, depths))
    backs = None
    if soft and casters.meshes and len(views) == 1:
        given = mesh.vertices, mesh.triangles, K, views[0], size, size
        backs = mesh_backs(*given, orthographic=parallel, threads=0)
    turns = np.stack(views)[:, :3, :3]
    return ShadowMap(
        depths=depths,
        rotations=turns,
        place=-turns[0].T @ views[0][:3, 3],
        scale=float(scale),
        parallel=parallel,
        farthest=farthest[0],
        slack=casters.slack,
        backs=None if backs is None else backs[None],
    )


def sky_map(casters: Casters, axis: np.ndarray) -> ShadowMap:
    """Draw the meshes from the sky, which shines along an axis [3]; coarser than for a sun."""
    return shadow_map(casters, np.zeros(3), axis, soft=False, size=_SKY_SIZE)


def _turned(axis: np.ndarray, place: np.ndarray) -> np.ndarray:
    """[4, 4] from the world to a camera at a place that looks along an axis."""
    aside = np.eye(3)[int(np.argmin(np.abs(axis)))]
    right = np.cross(aside, axis)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(axis, right), axis])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, -turn @ place
    return matrix
