"""Wavy bob: strands that start on the scalp, follow the skull and hang down."""

import numpy as np

from .body import from_head, skull
from .shapes import gradient, mesh, smooth_interp

HAIRLINE = np.array(
    [
        (-0.10, 0.088),
        (-0.075, 0.070),
        (-0.045, 0.038),
        (-0.01, 0.012),
        (0.03, -0.040),
        (0.10, -0.060),
    ]
)
"""Lower limit of the hair on the scalp in the head's frame: y, z."""


def above_hairline(q):
    """Metres above the hairline, negative below."""
    return q[..., 2] - smooth_interp(q[..., 1], HAIRLINE[:, 0], HAIRLINE[:, 1])


def grow(rng, strands=9000, locks=260, steps=64, points=24, stride=0.0048):
    """[S, points, 3] world positions of strands, root first, and [S, points] radii."""
    scalp, _ = mesh(skull, (-0.11, -0.14, -0.16), (0.11, 0.14, 0.14), 0.002)
    scalp = scalp[above_hairline(scalp) > 0].astype(np.float64)
    root = scalp[rng.choice(len(scalp), strands)] + rng.normal(0, 0.001, (strands, 3))
    center = root[rng.choice(strands, locks, replace=False)]
    lock = np.argmin(((root[:, None] - center[None]) ** 2).sum(-1), 1)
    layer = 0.004 + 0.014 * rng.random(strands) ** 1.4
    layer = 0.5 * layer + 0.5 * layer[rng.integers(0, strands, locks)][lock]
    length = (-0.118 + rng.normal(0, 0.006, locks)[lock] + rng.normal(0, 0.008, strands)) - 0.02 * (
        root[:, 1] > 0
    )
    phase, waves = rng.uniform(0, 6.28, locks)[lock], rng.uniform(0.8, 1.25, locks)[lock]
    part = 0.022
    side = np.where(root[:, 0] > part, 1.0, -1.0)
    p = root.copy()
    spread = 0.9 * side * np.clip((0.03 - root[:, 1]) / 0.04, 0, 1) + 6 * root[:, 0] * (
        root[:, 1] > 0
    )
    d = gradient(skull, p) * 0.8 + np.stack(
        [spread, 0.30 + 2.0 * np.maximum(-root[:, 1], 0), 0 * side], -1
    )
    path = [p.copy()]
    for k in range(steps):
        fall = np.stack([0.05 * side, np.full(strands, 0.10), np.full(strands, -1.0)], -1)
        d = 0.84 * d / np.linalg.norm(d, axis=1, keepdims=True) + 0.16 * fall
        live = p[:, 2] > length
        sway = np.stack(
            [np.sin(phase + waves * k * 0.42), np.cos(phase + waves * k * 0.42), 0 * phase], -1
        )
        p = p + live[:, None] * (
            stride * d / np.linalg.norm(d, axis=1, keepdims=True) + 0.0011 * sway * min(1, k / 12)
        )
        depth = np.minimum(layer * min(1, (k + 1) / 6), layer) - skull(p)
        p = p + np.clip(depth, 0, 0.01)[:, None] * gradient(skull, p)
        # Keep the face free: in front of the ears, hair stays beside the cheeks.
        least = (
            0.064
            * np.clip((0.075 - p[:, 2]) / 0.05, 0, 1)
            * np.clip((-0.02 - p[:, 1]) / 0.02, 0, 1)
        )
        p[:, 0] = np.where(
            np.abs(p[:, 0]) < least, np.where(p[:, 0] < 0.3 * part, -1, 1) * least, p[:, 0]
        )
        path.append(p.copy())
    path = np.stack(path, 1)
    # Each strand ends at its own length: resample its path, then pull it to the mean of its lock.
    end = np.argmax(path[:, :, 2] <= length[:, None], axis=1)
    end = np.where(end == 0, steps, end)
    at = np.linspace(0, 1, points)[None] * end[:, None]
    i = np.clip(at.astype(int), 0, steps - 1)
    t = (at - i)[..., None]
    row = np.arange(strands)[:, None]
    path = path[row, i] * (1 - t) + path[row, i + 1] * t
    mean = np.stack(
        [
            np.stack([np.bincount(lock, path[:, j, c], locks) for c in range(3)], -1)
            for j in range(points)
        ],
        1,
    )
    mean /= np.maximum(np.bincount(lock, minlength=locks), 1)[:, None, None]
    pull = 0.45 * np.linspace(0, 1, points)[None, :, None] ** 1.2
    path = path * (1 - pull) + mean[lock] * pull
    front = (path[..., 1] < -0.015) & (path[..., 2] < -0.055) & (np.abs(path[..., 0]) < 0.053)
    path = path[~front.any(1)]
    radius = np.linspace(0.00065, 0.00025, points)[None] * np.ones((len(path), 1))
    return from_head(path), radius
