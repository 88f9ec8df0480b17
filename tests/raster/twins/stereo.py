"""Reference stereo: plane sweep and depth map check in float64, per pixel by definition; slow."""

from collections.abc import Sequence

import numpy as np

from gscore.raster.stereo_depth import Checked, StereoView, SweepResult, Warp

_NEAR = 2
"""Maximum distance of two peaks, in planes, that count as one."""


def sweep(
    reference: StereoView,
    sources: Sequence[StereoView],
    *,
    farthest: float,
    nearest: float,
    planes: int,
    radius: int = 3,
    best: int = 2,
    noise: float = 1.5,
) -> SweepResult:
    """Like `gscore.raster.stereo_depth.sweep`, arrays [H, W] float64."""
    depths = np.linspace(farthest, nearest, planes)
    volume = np.stack([_scores(reference, sources, d, radius, best, noise) for d in depths])
    found = _peaks(volume, depths)
    grey = reference.grey.astype(np.float64)
    mean = _window_sums(grey, radius) / (2 * radius + 1) ** 2
    square = _window_sums(grey**2, radius) / (2 * radius + 1) ** 2
    rim = np.zeros(grey.shape, bool)
    rim[radius:-radius, radius:-radius] = True
    known = rim & (found[0] > 0)
    return SweepResult(
        np.where(known, found[0], 0),
        np.where(known, found[1], -1),
        np.where(known, found[2], -1),
        np.sqrt(np.maximum(square - mean**2, 0)),
    )


def _window_sums(values: np.ndarray, radius: int) -> np.ndarray:
    """[H, W] sums over windows, zero padded."""
    padded = np.pad(values, radius)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (2 * radius + 1,) * 2)
    return windows.sum(axis=(2, 3))


def _scores(
    reference: StereoView,
    sources: Sequence[StereoView],
    inverse_depth: float,
    radius: int,
    best: int,
    noise: float,
) -> np.ndarray:
    """Scores [H, W] of one plane: the mean over the `best` highest correlations."""
    correlations = sorted_correlations(reference, sources, inverse_depth, radius, noise)
    return correlations[:best].mean(axis=0)


def sorted_correlations(
    reference: StereoView,
    sources: Sequence[StereoView],
    inverse_depth: float,
    radius: int,
    noise: float,
) -> np.ndarray:
    """[S, H, W] normalised cross-correlations with the sources, the best first."""
    count = (2 * radius + 1) ** 2
    floor = count * noise**2
    r = reference.grey.astype(np.float64) - 128
    mean = _window_sums(r, radius) / count
    spread = _window_sums(r * r, radius) - count * mean**2
    out = []
    for source in sources:
        s, seen = _seen(reference, source, inverse_depth, radius)
        total = _window_sums(s, radius)
        own = np.maximum(_window_sums(s * s, radius) - total**2 / count, 0)
        covariance = _window_sums(r * s, radius) - mean * total
        zncc = covariance / np.sqrt((np.maximum(spread, 0) + floor) * (own + floor))
        out.append(np.where(seen, zncc, -1))
    return -np.sort(-np.stack(out), axis=0)


def _seen(
    reference: StereoView, source: StereoView, inverse_depth: float, rim: int
) -> tuple[np.ndarray, np.ndarray]:
    """Grey values of the source at the pixels of a plane, less 128, and their validity."""
    height, width = source.grey.shape
    rows, columns = reference.grey.shape
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    u, v, front = _apply(reference.warp_to(source), x, y, inverse_depth)
    u, v = u - 0.5, v - 0.5
    seen = front & (u >= rim) & (u <= width - 1 - rim) & (v >= rim) & (v <= height - 1 - rim)
    u, v = np.clip(u, 0, width - 1), np.clip(v, 0, height - 1)
    left, top = u.astype(int), v.astype(int)
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    fu, fv, grey = u - left, v - top, source.grey.astype(np.float64)
    upper = grey[top, left] * (1 - fu) + grey[top, right] * fu
    lower = grey[below, left] * (1 - fu) + grey[below, right] * fu
    # Windows that extend beyond the reference are excluded by the caller.
    return upper * (1 - fv) + lower * fv - 128, seen


def _apply(
    warp: Warp, x: np.ndarray, y: np.ndarray, inverse_depth: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r, t = warp.rotation, warp.translation
    u, v, w = (r[i, 0] * x + r[i, 1] * y + r[i, 2] + inverse_depth * t[i] for i in range(3))
    front = w > 1e-12
    w = np.where(front, w, 1.0)
    return np.where(front, u / w, 0.0), np.where(front, v / w, 0.0), front


def _peaks(volume: np.ndarray, depths: np.ndarray) -> np.ndarray:
    """[3, H, W] interpolated inverse depth, score and second best score of a volume [D, H, W]."""
    step = depths[1] - depths[0]
    out = np.stack([np.zeros(volume.shape[1:]), *np.full((2, *volume.shape[1:]), -1.0)])
    for y, x in np.ndindex(volume.shape[1:]):
        scores = np.concatenate([[-2.0], volume[:, y, x], [-2.0]])
        best, place, second_best = -1.0, -1, -1.0
        for i in range(len(depths)):
            left, here, right = scores[i : i + 3]
            if not (here >= left and here > right):
                continue
            higher, far = here > best, i - place > _NEAR
            if far:
                second_best = max(second_best, best if higher else here)
            if higher:
                best, place = here, i
        if 0 < place < len(depths) - 1:
            left, right = scores[place], scores[place + 2]
            offset = np.clip(0.5 * (right - left) / max(2 * best - left - right, 1e-12), -0.5, 0.5)
            top = min(best + 0.25 * (right - left) * offset, 1.0)
            out[:, y, x] = depths[place] + offset * step, top, second_best
    return out


def check(
    reference: StereoView,
    inverse_depth: np.ndarray,
    neighbours: Sequence[tuple[StereoView, np.ndarray]],
    *,
    pixels: float = 1.0,
    relative: float = 0.01,
    passed: float = 0.05,
) -> Checked:
    """Like `gscore.raster.stereo_depth.check`, with the mean in float64."""
    rows, columns = inverse_depth.shape
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    known = np.isfinite(inverse_depth) & (inverse_depth > 0)
    own = np.where(known, inverse_depth, 1.0).astype(np.float64)
    agree, contradict = np.zeros((2, rows, columns), np.uint8)
    total = own.copy()
    for view, theirs in neighbours:
        height, width = theirs.shape
        u, v, front = _apply(reference.warp_to(view), x, y, own)
        inside = known & front & (u >= 0) & (v >= 0) & (u < width) & (v < height)
        column, line = (np.where(inside, a, 0).astype(int) for a in (u, v))
        there = theirs[line, column].astype(np.float64)
        inside &= np.isfinite(there) & (there > 0)
        there = np.where(inside, there, 1.0)
        back = view.warp_to(reference)
        bx, by, in_front = _apply(back, column + 0.5, line + 0.5, there)
        w = back.rotation[2, 0] * (column + 0.5) + back.rotation[2, 1] * (line + 0.5)
        w = w + back.rotation[2, 2] + there * back.translation[2]
        seen = there / np.where(in_front, w, 1.0)
        agrees = inside & in_front & (np.hypot(bx - x, by - y) <= pixels)
        agrees &= np.abs(seen - own) <= relative * own
        warp = reference.warp_to(view)
        forth = warp.rotation[2, 0] * x + warp.rotation[2, 1] * y + warp.rotation[2, 2]
        expected = own / np.where(front, forth + own * warp.translation[2], 1.0)
        agree += agrees
        contradict += inside & ~agrees & (there * (1 + passed) < expected)
        total += np.where(agrees, seen, 0)
    fused = np.where(known, total / (agree + 1), 0)
    return Checked(np.where(known, agree, 0), np.where(known, contradict, 0), fused)
