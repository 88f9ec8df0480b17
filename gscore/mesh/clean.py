"""Cleaning of a mesh: small parts, holes, smoothing, reduction to a number of triangles."""

from itertools import pairwise

import numpy as np

from ..extras import need

_SHRINK, _GROW = 0.5, -0.53
"""Steps of Taubin (1995): the second undoes the shrinking of the first."""
_LAST_RING = 8
"""Vertices of a ring around whose middle triangles close a hole."""


def without_small_parts(vertices: np.ndarray, triangles: np.ndarray, share: float) -> np.ndarray:
    """Triangles of the connected parts with at least `share` of the largest one's triangles.

    Args:
        vertices: [V, 3].
        triangles: [T, 3] int64.
        share: From 0 (all parts) to 1 (only the largest).
    """
    from scipy.sparse.csgraph import connected_components

    if not len(triangles) or share <= 0:
        return triangles
    part = connected_components(_neighbours(len(vertices), triangles), directed=False)[1]
    of_triangle = part[triangles[:, 0]]
    sizes = np.bincount(of_triangle)
    return triangles[sizes[of_triangle] >= share * sizes.max()]


def boundary_loops(triangles: np.ndarray) -> list[np.ndarray]:
    """Closed walks [n] int64 along the edges that have a triangle on one side only, in that
    triangle's direction; each edge is in one of them."""
    edges = _edges(triangles)
    size = int(edges.max(initial=-1)) + 1
    there = edges[:, 0] * size + edges[:, 1]
    back = edges[:, 1] * size + edges[:, 0]
    open_edges = edges[~np.isin(there, back)]
    following: dict[int, list[int]] = {}
    for start, end in open_edges.tolist():
        following.setdefault(start, []).append(end)
    loops = []
    for first in list(following):
        while following.get(first):
            loop, at = [], first
            while following.get(at):
                loop.append(at)
                at = following[at].pop()
            loops.append(np.array(loop))
    return loops


def close_holes(
    vertices: np.ndarray, triangles: np.ndarray, most: int | None
) -> tuple[np.ndarray, np.ndarray]:
    """Close holes by rings of triangles that shrink towards their middle, stretched as a membrane.

    Args:
        vertices: [V, 3] float64.
        triangles: [T, 3] int64.
        most: Most edges of a closed hole; None: all holes.

    Returns:
        Further vertices [N, 3], to be appended, and further triangles [M, 3].
    """
    points, faces, count = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], len(vertices)
    for loop in boundary_loops(triangles):
        if len(loop) < 3 or (most is not None and len(loop) > most):
            continue
        added, filling = _cap(vertices[loop], loop[::-1], count)
        points.append(added)
        faces.append(filling)
        count += len(added)
    added, filling = np.concatenate(points), np.concatenate(faces)
    if len(added):
        added = _relaxed(np.concatenate([vertices, added]), filling, len(vertices))
    return added, filling


def _cap(around: np.ndarray, ring: np.ndarray, start: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles that close a hole.

    Args:
        around: [n, 3] float64, the vertices of its border.
        ring: [n] int64, their numbers, counter-clockwise from outside.
        start: Number of the first new vertex.
    """
    middle, places = around.mean(axis=0), around[::-1]
    points: list[np.ndarray] = []
    faces: list[tuple[int, int, int]] = []
    count = start
    while len(ring) > _LAST_RING:
        inner_places = (places[::2] + middle) / 2
        inner = np.arange(count, count + len(inner_places))
        count += len(inner)
        for k, own in enumerate(inner.tolist()):
            following = int(inner[(k + 1) % len(inner)])
            outer = [int(ring[i % len(ring)]) for i in range(2 * k, min(2 * k + 2, len(ring)) + 1)]
            faces += [(a, b, own) for a, b in pairwise(outer)]
            faces.append((outer[-1], following, own))
        points.append(inner_places)
        ring, places = inner, inner_places
    if len(ring) == 3:
        faces.append((int(ring[0]), int(ring[1]), int(ring[2])))
    else:
        points.append(middle[None])
        faces += [(int(ring[k - 1]), int(ring[k]), count) for k in range(len(ring))]
    return np.concatenate([np.zeros((0, 3)), *points]), np.array(faces, np.int64)


def _relaxed(vertices: np.ndarray, triangles: np.ndarray, fixed: int) -> np.ndarray:
    """[V - fixed, 3], the vertices beyond the first `fixed` ones, each moved to the mean of its
    neighbours: a membrane, without folds in convex holes (Tutte 1963)."""
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    near = _neighbours(len(vertices), triangles)[fixed:]
    degrees = diags_array(np.asarray(near.sum(axis=1)).ravel())
    system = (degrees - near[:, fixed:]).tocsc()
    return splu(system).solve(near[:, :fixed] @ vertices[:fixed])


def smoothed(vertices: np.ndarray, triangles: np.ndarray, steps: int) -> np.ndarray:
    """[V, 3], vertices after steps of Taubin (1995); vertices on borders move along them only.

    Args:
        vertices: [V, 3] float64.
        triangles: [T, 3] int64.
        steps: Number of steps.
    """
    if not steps or not len(triangles):
        return vertices
    from scipy.sparse import coo_array

    near = _neighbours(len(vertices), triangles)
    loops = boundary_loops(triangles)
    if loops:
        a = np.concatenate(loops)
        b = np.concatenate([np.roll(loop, -1) for loop in loops])
        border = np.zeros(len(vertices), bool)
        border[a] = True
        pairs = (np.concatenate([a, b]), np.concatenate([b, a]))
        along = coo_array((np.ones(len(pairs[0])), pairs), shape=near.shape).tocsr()
        near = near.multiply(~border[:, None]).tocsr() + along
    weight = np.asarray(near.sum(axis=1)).ravel()[:, None]
    alone = weight[:, 0] == 0
    weight[alone] = 1
    moved = vertices.copy()
    for _ in range(steps):
        for factor in (_SHRINK, _GROW):
            change = factor * (near @ moved / weight - moved)
            change[alone] = 0
            moved += change
    return moved


def reduced(
    vertices: np.ndarray, triangles: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """A mesh of about `count` triangles, by quadric errors (Garland and Heckbert 1997).

    Args:
        vertices: [V, 3] float64.
        triangles: [T, 3] int64.
        count: Triangles to keep; with more than there are, nothing changes.

    Raises:
        BackendError: fast-simplification is missing.
    """
    if count >= len(triangles):
        return vertices, triangles
    simplify = need("fast_simplification", "A reduced mesh").simplify
    middle = vertices.mean(axis=0)
    points, faces = simplify(
        vertices - middle, np.ascontiguousarray(triangles, np.int32), target_count=count
    )
    return np.asarray(points, np.float64) + middle, np.asarray(faces, np.int64)


def used(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of `vertices` [V, 3] that triangles [T, 3] use, and the triangles in terms of them."""
    rows, faces = np.unique(triangles, return_inverse=True)
    return rows, faces.reshape(-1, 3)


def vertex_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """[V, 3] float32, unit normals, each triangle weighted by its area; 0 without any."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    areas = np.cross(b - a, c - a)
    sums = np.stack(
        [
            np.bincount(triangles.ravel(), np.repeat(areas[:, i], 3), len(vertices))
            for i in range(3)
        ],
        axis=1,
    )
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.divide(sums, lengths, out=sums, where=lengths > 0).astype(np.float32)


def _edges(triangles: np.ndarray) -> np.ndarray:
    """[3 T, 2], directed edges."""
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def _neighbours(count: int, triangles: np.ndarray):
    """Sparse [V, V], 1 where vertices share an edge."""
    from scipy.sparse import coo_array

    a, b = _edges(triangles).T
    pairs = (np.concatenate([a, b]), np.concatenate([b, a]))
    near = coo_array((np.ones(len(pairs[0])), pairs), shape=(count, count)).tocsr()
    near.data[:] = 1
    return near
