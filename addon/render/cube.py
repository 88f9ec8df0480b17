"""Cube map of a panorama: sharp pictures of patches of a cube around the camera, resampled.

Splats are sorted by depth along the camera's axis, and their projection is exact only on that
axis. Therefore each side of the cube is nine patches with their own axes: the difference at the
border of two patches is half of that between whole sides. Patches overlap and are cross-faded,
because the difference would show as an edge.
"""

from collections.abc import Callable, Iterator

import numpy as np

from ..cameras.panorama import Panorama
from ..cameras.render_camera import RenderCamera
from .color import NOTHING
from .model import Model
from .picture import Window

_SIDES = np.array(
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    ],
    np.float64,
)
"""Right, down and forward of the sides, in the camera's axes: ahead, right, behind, left, below,
above."""
_ALONG = 3
"""Patches along a side, of equal angles."""
_OVERLAP = 0.25
"""Extent of a patch into its neighbors, in patches."""
_DETAIL = 1.25
"""Pixels at the middle of a patch per pixel of the panorama."""
_LARGEST = 8192
"""Limit of the side of a patch, px."""
_EDGE = 2
"""Margin around a patch for interpolation at its outermost directions, px."""
_INSIDE = (0.25, 0.75)
"""Positions of samples within a pixel, along each axis."""
_NEAREST = 0.8
"""Near depth of a patch in units of distance: less than the depth of its corners."""
SPLAT_INDEX = "Splat Index"
_NEAREST_PIXEL = {"Depth": NOTHING, SPLAT_INDEX: -1}
"""Passes that are not interpolated, and their values where there are no splats."""
_AT_ONCE = 1 << 18
"""Pixels of the panorama that are sampled together."""


def _patches() -> tuple[np.ndarray, float]:
    """Right, down and forward of all patches [P, 3, 3], and the largest half width of a patch per
    unit forward."""
    middles = np.tan(((np.arange(_ALONG) + 0.5) / _ALONG - 0.5) * np.pi / 2)
    low, high = (
        np.tan(((np.arange(_ALONG) + end) / _ALONG - 0.5) * np.pi / 2)
        for end in (-_OVERLAP, 1 + _OVERLAP)
    )
    axes, reach = [], 0.0
    for side in _SIDES:
        for row, column in np.ndindex(_ALONG, _ALONG):
            forward = np.array([middles[column], middles[row], 1.0])
            forward /= np.linalg.norm(forward)
            right = np.cross([0.0, 1.0, 0.0], forward)
            right /= np.linalg.norm(right)
            own = np.stack([right, np.cross(forward, right), forward])
            corners = [
                own @ (x, y, 1.0)
                for x in (low[column], high[column])
                for y in (low[row], high[row])
            ]
            reach = max(reach, *(float(np.abs(c[:2]).max() / c[2]) for c in corners))
            axes.append(own @ side)
    return np.array(axes), reach


_AXES, _REACH = _patches()


def unfold(
    panorama: Panorama,
    window: Window | None,
    draw: Callable[[RenderCamera, Window], dict[str, np.ndarray]],
) -> dict[str, np.ndarray]:
    """The passes of a panorama; only visible parts of the cube are drawn.

    Args:
        panorama: The camera.
        window: The part to draw; None: all.
        draw: Returns the passes of a part of a picture, the bottom row first.

    Returns:
        "Combined" [h, w, 4] and further passes [h, w, C], each the mean of four bilinear samples
        per pixel; if they were drawn "Depth" [h, w], the distance along the middle of the pixel,
        and `SPLAT_INDEX` [h, w] there. The bottom row first; empty outside of the panorama's field
        of view.
    """
    window = window or (0, 0, panorama.width, panorama.height)
    half = min(int(np.ceil(panorama.density * _DETAIL * _REACH)), _LARGEST // 2 - _EDGE)
    focal, side = half / _REACH, 2 * (half + _EDGE)
    pictures = {}
    for patch, part in _parts(panorama, window, focal, side).items():
        turned = np.eye(4)
        turned[:3, :3] = _AXES[patch]
        camera = RenderCamera(
            viewmat=turned @ panorama.viewmat,
            K=np.array([[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1.0]]),
            width=side,
            height=side,
            near=panorama.near * _NEAREST,
            orthographic=False,
            name="panorama",
        )
        drawn = draw(camera, part)
        pictures[patch] = part, {name: values[::-1] for name, values in drawn.items()}
    passes = {}
    for name in {"Combined"}.union(*(drawn for _, drawn in pictures.values())):
        if name in _NEAREST_PIXEL:
            passes[name] = _nearest(panorama, window, focal, side, pictures, name)
        else:
            passes[name] = _resampled(panorama, window, focal, side, pictures, name)
    return {name: np.ascontiguousarray(values[::-1]) for name, values in passes.items()}


def beyond(model: Model, panorama: Panorama) -> Model:
    """The splats beyond a panorama's near distance, a ball that is the same for all patches."""
    to_camera = panorama.viewmat @ model.matrix
    places = model.splats.means @ to_camera[:3, :3].T + to_camera[:3, 3]
    far = np.linalg.norm(places, axis=1) > panorama.near
    return model if far.all() else model.subset(far)


_Pictures = dict[int, tuple[Window, dict[str, np.ndarray]]]
_Pixels = tuple[np.ndarray, np.ndarray]
"""Rows and columns."""


def _bands(window: Window) -> Iterator[slice]:
    """Rows of a window, some at a time."""
    rows = max(1, _AT_ONCE // window[2])
    for first in range(0, window[3], rows):
        yield slice(first, min(first + rows, window[3]))


def _looks(
    panorama: Panorama,
    window: Window,
    rows: slice,
    inside: tuple[float, float],
    focal: float,
    side: int,
) -> Iterator[tuple[int, _Pixels, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Samples by patch: its number, the pixels (rows and columns of the band), its weights in them,
    x and y on the patch in pixels, and distance per unit along its axis."""
    left, top, width, _ = window
    x, y = np.meshgrid(
        left + np.arange(width) + inside[0], top + np.arange(rows.start, rows.stop) + inside[1]
    )
    directions, visible = panorama.directions(x, y)
    for patch, where, share in _shares(directions, visible):
        own = directions[where] @ _AXES[patch].T
        yield (
            patch,
            where,
            share,
            own[:, 0] / own[:, 2] * focal + side / 2,
            own[:, 1] / own[:, 2] * focal + side / 2,
            1 / own[:, 2],
        )


def _shares(
    directions: np.ndarray, visible: np.ndarray
) -> Iterator[tuple[int, _Pixels, np.ndarray]]:
    """Number, pixels and weights of each patch that visible ([h, w]) directions [h, w, 3]
    hit. Weights fall to 0 towards a patch's edges; those of a pixel add up to 1."""
    total, found = np.zeros(visible.shape), []
    widest = np.tan((1 + 2 * _OVERLAP / _ALONG) * np.pi / 4)
    for number, side in enumerate(_SIDES):
        own = directions @ side.T
        where = np.nonzero(visible & (np.abs(own[..., :2]).max(-1) < widest * own[..., 2]))
        x, y, z = own[where].T
        columns, rows = _ramps(np.arctan2(x, z)), _ramps(np.arctan2(y, z))
        for row, column in np.ndindex(_ALONG, _ALONG):
            share = rows[row] * columns[column]
            met = np.flatnonzero(share)
            pixels = where[0][met], where[1][met]
            total[pixels] += share[met]
            found.append(((number * _ALONG + row) * _ALONG + column, pixels, share[met]))
    for patch, pixels, share in found:
        if len(share):
            yield patch, pixels, share / total[pixels]


def _ramps(angles: np.ndarray) -> np.ndarray:
    """Weights [_ALONG, n] of rows or columns of patches at angles [n] from a side's axis."""
    middles = np.arange(_ALONG)[:, None] + 0.5
    away = np.abs((angles / (np.pi / 2) + 0.5) * _ALONG - middles)
    return np.clip((0.5 + _OVERLAP - away) / (2 * _OVERLAP), 0, 1)


def _every_look(window: Window) -> Iterator[tuple[slice, tuple[float, float]]]:
    for rows in _bands(window):
        for inside in ((a, b) for a in _INSIDE for b in _INSIDE):
            yield rows, inside


def _parts(panorama: Panorama, window: Window, focal: float, side: int) -> dict[int, Window]:
    """The window to draw of each patch that is hit."""
    found: dict[int, np.ndarray] = {}
    for rows, inside in _every_look(window):
        for patch, _, _, x, y, _ in _looks(panorama, window, rows, inside, focal, side):
            ends = np.array([x.min(), y.min(), -x.max(), -y.max()])
            found[patch] = np.minimum(found.get(patch, ends), ends)
    parts = {}
    for patch in sorted(found):
        low = np.maximum(np.floor(found[patch][:2]) - _EDGE, 0).astype(int)
        high = np.minimum(np.ceil(-found[patch][2:]) + _EDGE, side).astype(int)
        parts[patch] = int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])
    return parts


def _resampled(
    panorama: Panorama, window: Window, focal: float, side: int, pictures: _Pictures, name: str
) -> np.ndarray:
    channels = max((drawn[name].shape[-1] for _, drawn in pictures.values()), default=4)
    out = np.zeros((window[3], window[2], channels), np.float32)
    for rows, inside in _every_look(window):
        band = out[rows]
        for patch, where, share, x, y, _ in _looks(panorama, window, rows, inside, focal, side):
            part, drawn = pictures[patch]
            found = _between(drawn[name], x - part[0], y - part[1])
            band[where] += share[:, None].astype(np.float32) * found
    return out / np.float32(len(_INSIDE) ** 2)


def _between(picture: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Bilinear samples [n, C] of a picture [H, W, C]."""
    height, width = picture.shape[:2]
    x, y = np.clip(x - 0.5, 0, width - 1), np.clip(y - 0.5, 0, height - 1)
    left, top = x.astype(int), y.astype(int)
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    u, v = (x - left).astype(np.float32)[:, None], (y - top).astype(np.float32)[:, None]
    upper = picture[top, left] * (1 - u) + picture[top, right] * u
    lower = picture[below, left] * (1 - u) + picture[below, right] * u
    return upper * (1 - v) + lower * v


def _nearest(
    panorama: Panorama, window: Window, focal: float, side: int, pictures: _Pictures, name: str
) -> np.ndarray:
    """A pass at the nearest pixel of the patch with the largest weight; not interpolated, because a
    mean of two depths may be in empty space. Depths become distances."""
    empty = _NEAREST_PIXEL[name]
    out = np.full((window[3], window[2]), empty, np.float32)
    for rows in _bands(window):
        band = out[rows]
        largest = np.zeros(band.shape)
        looks = _looks(panorama, window, rows, (0.5, 0.5), focal, side)
        for patch, pixels, share, x, y, far in looks:
            part, drawn = pictures.get(patch, ((0, 0, 0, 0), {}))
            own = share > largest[pixels]
            if drawn and own.any():
                where, x, y, far = (pixels[0][own], pixels[1][own]), x[own], y[own], far[own]
                largest[where] = share[own]
                column = np.clip((x - part[0]).astype(int), 0, part[2] - 1)
                row = np.clip((y - part[1]).astype(int), 0, part[3] - 1)
                found = drawn[name][row, column]
                scale = far if name == "Depth" else 1
                band[where] = np.where(found == empty, empty, found * scale)
    return out
