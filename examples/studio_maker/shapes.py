"""Implicit shapes in numpy: distance functions, their smooth union, and a mesher (surface nets)."""

from itertools import pairwise

import numpy as np


def ellipsoid(p, center, radii):
    """Approximate distance to an ellipsoid with axes along x, y, z; p [..., 3] in metres."""
    q = p - np.asarray(center, p.dtype)
    r = np.asarray(radii, p.dtype)
    k0 = np.linalg.norm(q / r, axis=-1)
    k1 = np.linalg.norm(q / r**2, axis=-1)
    return k0 * (k0 - 1) / np.maximum(k1, 1e-9)


def cone(p, a, b, ra, rb):
    """Distance to the convex hull of two balls, at `a` with radius `ra` and at `b` with `rb`."""
    a, b = np.asarray(a, p.dtype), np.asarray(b, p.dtype)
    t = np.clip((p - a) @ (b - a) / np.sum((b - a) ** 2), 0, 1)
    return np.linalg.norm(p - a - t[..., None] * (b - a), axis=-1) - (ra + (rb - ra) * t)


def limb(p, joints, k=0.0):
    """Chain of cones; joints is a list of (x, y, z, radius)."""
    parts = [cone(p, j[:3], i[:3], j[3], i[3]) for j, i in pairwise(joints)]
    return union(k, *parts)


def stack(p, rows, power=2.3):
    """Approximate distance to a loft; rows of (z, half width, half depth, centre y), z falling."""
    rows = np.asarray(rows[::-1], p.dtype)
    z = p[..., 2]
    a, b, y = (smooth_interp(z, rows[:, 0], rows[:, i]) for i in (1, 2, 3))
    r = (np.abs(p[..., 0] / a) ** power + np.abs((p[..., 1] - y) / b) ** power) ** (1 / power)
    side = (r - 1) * np.minimum(a, b)
    return np.maximum(side, np.maximum(rows[0, 0] - z, z - rows[-1, 0]))


def smooth_interp(x, xs, ys):
    """Piecewise cubic through (xs, ys) with Catmull-Rom slopes, constant outside."""
    slope = np.gradient(ys, xs)
    x = np.clip(x, xs[0], xs[-1])
    i = np.clip(np.searchsorted(xs, x) - 1, 0, len(xs) - 2)
    h = xs[i + 1] - xs[i]
    t = (x - xs[i]) / h
    return (
        (1 + 2 * t) * (1 - t) ** 2 * ys[i]
        + t * (1 - t) ** 2 * h * slope[i]
        + t**2 * (3 - 2 * t) * ys[i + 1]
        + t**2 * (t - 1) * h * slope[i + 1]
    )


def union(k, *parts):
    """Smooth union of distances, rounded over about `k` metres."""
    d = parts[0]
    for e in parts[1:]:
        d = np.minimum(d, e) - (np.maximum(k - np.abs(d - e), 0) ** 2 / (4 * k) if k else 0)
    return d


def cut(k, d, tool):
    """Smooth subtraction of `tool` from `d`, rounded over about `k` metres."""
    return -union(k, -d, tool)


def gradient(f, p, h=1e-3):
    """Unit normals of the distance `f` at p [N, 3]."""
    g = np.stack([f(p + h * e) - f(p - h * e) for e in np.eye(3, dtype=p.dtype)], -1)
    return g / np.maximum(np.linalg.norm(g, axis=-1, keepdims=True), 1e-9)


def mesh(f, low, high, step):
    """Zero surface of the distance `f` inside a box, by surface nets (Gibson 1998).

    Args:
        f: function of points [..., 3] float32 to distances.
        low, high: corners of the box, metres.
        step: size of the grid's cells, metres.

    Returns:
        Vertices [V, 3] float32 and quads [F, 4] int64 that face outwards.
    """
    axes = [np.arange(a, b + step, step, dtype=np.float32) for a, b in zip(low, high, strict=True)]
    d = np.concatenate(
        [
            f(np.stack(np.meshgrid(x, *axes[1:], indexing="ij"), -1))
            for x in np.array_split(axes[0], 8)
        ]
    )
    d = np.where(d == 0, np.float32(1e-9), d)
    cells = tuple(n - 1 for n in d.shape)
    total, count = np.zeros((*cells, 3), np.float32), np.zeros(cells, np.float32)
    quads = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        da, db = (np.moveaxis(d, axis, 0)[s] for s in (slice(None, -1), slice(1, None)))
        cross = np.moveaxis((da > 0) != (db > 0), 0, axis)
        t = np.moveaxis(da / np.where(da == db, 1, da - db), 0, axis)
        at = np.argwhere(cross)
        point = at.astype(np.float32)
        point[:, axis] += t[cross]
        at = at[(at[:, u] > 0) & (at[:, v] > 0) & (at[:, u] < cells[u]) & (at[:, v] < cells[v])]
        for du, dv in ((0, 0), (0, 1), (1, 0), (1, 1)):
            c = np.argwhere(cross)
            c[:, u] -= du
            c[:, v] -= dv
            ok = np.all((c >= 0) & (c < cells), axis=1)
            np.add.at(total, tuple(c[ok].T), point[ok])
            np.add.at(count, tuple(c[ok].T), 1)
        corner = []
        for du, dv in ((1, 1), (0, 1), (0, 0), (1, 0)):
            c = at.copy()
            c[:, u] -= du
            c[:, v] -= dv
            corner.append(np.ravel_multi_index(tuple(c.T), cells))
        quad = np.stack(corner, 1)
        inside = d[tuple(at.T)] < 0
        quads.append(np.where(inside[:, None], quad, quad[:, ::-1]))
    quads = np.concatenate(quads)
    used, index = np.unique(quads, return_inverse=True)
    flat = total.reshape(-1, 3)[used] / count.reshape(-1)[used, None]
    return flat * step + np.array([a[0] for a in axes], np.float32), index.reshape(quads.shape)
