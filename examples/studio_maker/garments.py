"""Blouse, skirt and belt: cut around the body, then draped on it."""

import numpy as np

from .body import LEFT_ARM, RIGHT_ARM, TRUNK, trunk
from .cloth import drape
from .shapes import limb, mesh, smooth_interp, union

WAIST = 1.066
"""Height of the seam between blouse and skirt, metres."""


def blouse_shape(p):
    """Loose shell around trunk and arms."""
    d = trunk(p) - 0.014
    for s, e, w in (LEFT_ARM, RIGHT_ARM):
        shoulder = np.array(s[:3]) - (0, 0, 0.014)
        sleeve = limb(p, [(*shoulder, 0.062), (*e[:3], 0.062), (*w[:3], 0.042)])
        d = union(0.05, d, sleeve)
    return d


def blouse_openings(p):
    """Signed distances [3, ...] to the planes of waist, neck and cuffs; positive is cut away."""
    cuffs = np.full(p.shape[:-1], -1.0)
    waist = WAIST + 0.004 - p[..., 2]
    for joints in (LEFT_ARM, RIGHT_ARM):
        elbow, wrist = np.array(joints[1][:3]), np.array(joints[2][:3])
        length = np.linalg.norm(wrist - elbow)
        along = (p - elbow) @ ((wrist - elbow) / length) - 0.90 * length
        near = limb(p, [(*elbow, 0.0), (*(wrist + 0.2 * (wrist - elbow)), 0.0)]) < 0.075
        cuffs = np.where(near, np.maximum(cuffs, along), cuffs)
        waist = np.where(near, -1.0, waist)
    neck = (p[..., 2] - 1.466 - 0.45 * (p[..., 1] - 0.02)) / np.hypot(1, 0.45)
    neck = np.where(np.abs(p[..., 0]) < 0.11, neck, -1.0)
    return np.stack([waist, neck, cuffs])


def trim(vertices, faces, openings):
    """Remove the mesh where `openings` is positive; rim vertices are moved to the boundary."""
    d = openings(vertices)
    faces = faces[np.all(np.any(d[:, faces] < 0, axis=2), axis=0)]
    used, index = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used].astype(np.float64), index.reshape(faces.shape)
    for _ in range(3):
        d = openings(vertices)
        slope = np.stack([openings(vertices + 1e-4 * e) - d for e in np.eye(3)], -1) / 1e-4
        step = (
            np.where(d > 0, d, 0)[..., None]
            * slope
            / np.maximum(np.sum(slope**2, -1, keepdims=True), 1e-6)
        )
        vertices = vertices - np.clip(step, -0.02, 0.02).sum(0)
    return vertices, faces


def blouse_uv(vertices, faces):
    """[F, 4, 2] in metres: cylinders around trunk and sleeves, seams at back and under the arms."""
    center, corner = vertices[faces].mean(1), vertices[faces]
    axes = [(np.array([0, 0.01, 1.5]), np.array([0, 0, -1.0]), np.array([0, -1.0, 0]), 0.13)]
    distance = [trunk(center)]
    for joints in (LEFT_ARM, RIGHT_ARM):
        for a, b in ((0, 1), (1, 2)):
            start, end = np.array(joints[a][:3]), np.array(joints[b][:3])
            axis = (end - start) / np.linalg.norm(end - start)
            out = np.array([np.sign(start[0]), -0.3, 0.0])
            axes.append((start, axis, out - axis * (out @ axis), 0.05))
            distance.append(limb(center, [(*start, joints[a][3]), (*end, joints[b][3])]))
    part = np.argmin(np.stack(distance), 0)
    uv = np.empty((*faces.shape, 2))
    for i, (start, axis, out, radius) in enumerate(axes):
        out = out / np.linalg.norm(out)
        side = np.cross(axis, out)

        def angle(q, start=start, side=side, out=out):
            return np.arctan2((q - start) @ side, (q - start) @ out)

        mine = part == i
        middle = angle(center[mine])[:, None]
        turn = middle + (angle(corner[mine]) - middle + np.pi) % (2 * np.pi) - np.pi
        down = (corner[mine] - start) @ axis
        away = np.linalg.norm(corner[mine] - start - down[..., None] * axis, axis=-1)
        # Near the neck the cloth is horizontal, so v also increases with the distance to the axis.
        uv[mine] = np.stack([turn * radius + 0.61 * i, down + (0.7 * away if i == 0 else 0)], -1)
    return uv


def blouse(body, obstacles, step=0.0085):
    """Vertices, faces and uv (metres) of the draped blouse, woven at about `step` metres."""
    vertices, faces = mesh(blouse_shape, (-0.46, -0.27, 0.86), (0.40, 0.20, 1.54), step)
    vertices, faces = trim(vertices, faces, blouse_openings)
    uv = blouse_uv(vertices, faces)
    edge = blouse_openings(vertices).max(0)
    pinned = np.where(edge > -0.010, 1.0, 0.0)
    shape = drape(
        vertices, faces, pinned, [body, *obstacles], frames=60, mass=0.1, bending=0.15, growth=0.12
    )
    return shape, faces, uv


def ring(z, offset, n):
    """[n, 3] points around the trunk at height z, `offset` metres outside the skin, back first."""
    rows = np.array(TRUNK[::-1])
    a, b, y = (smooth_interp(np.array([z]), rows[:, 0], rows[:, i])[0] for i in (1, 2, 3))
    t = np.linspace(0, 2 * np.pi, n, endpoint=False) + np.pi / 2
    c, s = np.cos(t), np.sin(t)
    r = (np.abs(c) ** 2.3 + np.abs(s) ** 2.3) ** (-1 / 2.3)
    return np.stack([(a + offset) * r * c, (b + offset) * r * s + y, np.full(n, z)], -1)


def grid_faces(rows, columns):
    """Quads of a tube of `rows` rings of `columns` vertices, facing out when the rings go down."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    k = (j + 1) % columns
    return np.stack(
        [i * columns + j, (i + 1) * columns + j, (i + 1) * columns + k, i * columns + k], -1
    ).reshape(-1, 4)


def skirt(body, rng, *, rows=60, columns=288, length=0.68):
    """Vertices, faces and uv (metres) of a draped skirt cut as a cone."""
    flare = np.radians(40)
    top = ring(WAIST, 0.012, columns)
    center = np.array([0, 0.005, WAIST])
    out = top - center
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    s = np.linspace(0, length, rows)
    angle = np.linspace(0, 2 * np.pi, columns, endpoint=False)
    wave = sum(np.cos(k * angle + rng.uniform(0, 6.28)) / k for k in (9, 11, 14)) * 0.035
    reach = s[:, None] * np.sin(flare) * (1 + wave)
    drop = s[:, None] * np.cos(flare) * np.ones(columns)
    vertices = top + reach[..., None] * out - drop[..., None] * np.array([0, 0, 1.0])
    hem = rng.uniform(0, 6.28)
    vertices[..., 2] += 0.004 * np.sin(3 * angle + hem) * (s[:, None] / length)
    faces = grid_faces(rows, columns)
    r0 = 0.125 / np.sin(flare)
    turn = np.linspace(0, 2 * np.pi, columns + 1) * np.sin(flare)
    flat = (r0 + s)[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], -1)
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    uv = np.stack([flat[i, j], flat[i + 1, j], flat[i + 1, j + 1], flat[i, j + 1]], -2).reshape(
        -1, 4, 2
    )
    pinned = np.zeros((rows, columns))
    pinned[:2] = 1.0
    shape = drape(
        vertices.reshape(-1, 3), faces, pinned.ravel(), [body], frames=90, mass=0.12, bending=0.6
    )
    return shape, faces, uv


def belt(n=160):
    """Vertices, faces and uv of a belt, 4.6 cm wide and rounded at the rims."""
    profile = ((-0.023, 0.016), (-0.021, 0.0195), (0.0, 0.0205), (0.021, 0.0195), (0.023, 0.016))
    rings = np.stack([ring(WAIST - dz, off, n) for dz, off in profile])
    faces = grid_faces(len(profile), n)
    u = np.arange(n) / n * 0.8
    i, j = np.meshgrid(np.arange(len(profile) - 1), np.arange(n), indexing="ij")
    v = np.array([p[0] for p in profile])
    uv = np.stack(
        [
            np.stack([u[j] + du * 0.8 / n, v[i + dv]], -1)
            for dv, du in ((0, 0), (1, 0), (1, 1), (0, 1))
        ],
        -2,
    )
    return rings.reshape(-1, 3), faces, uv.reshape(-1, 4, 2)


def cuff_rings(joints, n=40):
    """Vertices and faces of a cuff at the end of a sleeve."""
    elbow, wrist = np.array(joints[1][:3]), np.array(joints[2][:3])
    axis = (wrist - elbow) / np.linalg.norm(wrist - elbow)
    side = np.cross(axis, (0, 0, 1.0))
    side /= np.linalg.norm(side)
    up = np.cross(side, axis)
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)[:, None]
    circle = np.cos(angle) * side + np.sin(angle) * up
    at = elbow + axis * np.linalg.norm(wrist - elbow) * 0.90
    profile = (
        (-0.018, 0.036),
        (-0.016, 0.0435),
        (0.0, 0.0425),
        (0.022, 0.0405),
        (0.026, 0.039),
        (0.024, 0.030),
    )
    rings = np.stack([at + dz * axis + r * circle for dz, r in profile])
    return rings.reshape(-1, 3), grid_faces(len(profile), n)


def binding(vertices, faces, near, radius=0.0045, n=8):
    """Vertices and faces of a round band sewn over the open rim whose points satisfy `near`."""
    edges = np.concatenate([faces[:, [i, (i + 1) % 4]] for i in range(4)])
    key, count = np.unique(np.sort(edges, 1), axis=0, return_counts=True)
    rim = {tuple(e) for e in key[count == 1].tolist()}
    after = {a: b for a, b in edges.tolist() if (min(a, b), max(a, b)) in rim and near(vertices[a])}
    loop = [min(after)]
    while after[loop[-1]] != loop[0]:
        loop.append(after[loop[-1]])
    path = vertices[loop]
    for _ in range(6):
        path = (np.roll(path, 1, 0) + 2 * path + np.roll(path, -1, 0)) / 4
    along = np.roll(path, -1, 0) - np.roll(path, 1, 0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    out = path - path.mean(0)
    out -= along * np.sum(out * along, 1, keepdims=True)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    up = np.cross(along, out)
    turn = np.linspace(0, 2 * np.pi, n, endpoint=False)[:, None, None]
    tube = path + radius * (np.cos(turn) * out + np.sin(turn) * up * 1.6)
    faces = grid_faces(n + 1, len(path))
    return tube.reshape(-1, 3), faces % (n * len(path))
