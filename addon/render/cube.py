"""A panorama out of sharp pictures of patches of a cube around the camera.

Splats are sorted along the axis of a picture, and their outlines are those of a projection that is
exact on that axis. So each side of the cube is nine patches with axes of their own: where two of
them meet, a picture differs by half of what it does where whole sides meet.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

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
_DETAIL = 1.25
"""Pixels of a patch, in its middle, for each of the panorama."""
_LARGEST = 8192
"""Pixels along a patch."""
_EDGE = 2
"""Pixels around a patch, between which its outermost directions fall."""
_INSIDE = (0.25, 0.75)
"""Where in a pixel one looks, along each axis."""
_NEAREST = 0.8
"""Depth on a patch, in distances, of what is nearest: less than in the corners of any."""
_AT_ONCE = 1 << 18
"""Pixels of the panorama that are looked up together."""


def _patches() -> tuple[np.ndarray, float]:
    """Right, down and forward of all patches [P, 3, 3], and how far a patch reaches to its sides,
    for each unit forward."""
    middles = np.tan(((np.arange(_ALONG) + 0.5) / _ALONG - 0.5) * np.pi / 2)
    ends = np.tan((np.arange(_ALONG + 1) / _ALONG - 0.5) * np.pi / 2)
    axes, reach = [], 0.0
    for side in _SIDES:
        for row, column in np.ndindex(_ALONG, _ALONG):
            forward = np.array([middles[column], middles[row], 1.0])
            forward /= np.linalg.norm(forward)
            right = np.cross([0.0, 1.0, 0.0], forward)
            right /= np.linalg.norm(right)
            own = np.stack([right, np.cross(forward, right), forward])
            corners = [
                own @ (x, y, 1.0) for x in ends[column : column + 2] for y in ends[row : row + 2]
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
    """The passes of a panorama; only what it sees of the cube is drawn.

    Args:
        panorama: The camera.
        window: The part that is wanted; None: all.
        draw: Gives the passes of a part of a picture, their bottom rows first.

    Returns:
        "Combined" [h, w, 4] and what else was drawn [h, w, 1], the mean of four looks a pixel
        between the four nearest pixels of a patch; "Depth" [h, w], where it was drawn, the distance
        along the middle of the pixel. The bottom rows first; nothing where the panorama sees
        nothing.
    """
    window = window or (0, 0, panorama.width, panorama.height)
    half = min(int(np.ceil(panorama.density * _DETAIL * _REACH)), _LARGEST // 2 - _EDGE)
    focal, side = half / _REACH, 2 * (half + _EDGE)
    pictures = {}
    for patch, part in _parts(panorama, window, focal, side).items():
        camera = RenderCamera(
            viewmat=_turned(_AXES[patch]) @ panorama.viewmat,
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
        if name == "Depth":
            passes[name] = _distances(panorama, window, focal, side, pictures)
        else:
            passes[name] = _resampled(panorama, window, focal, side, pictures, name)
    return {name: np.ascontiguousarray(values[::-1]) for name, values in passes.items()}


def beyond(model: Model, panorama: Panorama) -> Model:
    """What is farther away than a panorama's near end: a ball, the same for all patches."""
    to_camera = panorama.viewmat @ model.matrix
    places = model.splats.means @ to_camera[:3, :3].T + to_camera[:3, 3]
    far = np.linalg.norm(places, axis=1) > panorama.near
    if far.all():
        return model
    shares = None if model.shares is None else model.shares.subset(far)
    return replace(model, splats=model.splats.subset(far), shares=shares)


_Pictures = dict[int, tuple[Window, dict[str, np.ndarray]]]


def _turned(axes: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = axes
    return matrix


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
) -> Iterator[tuple[int, tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray, np.ndarray]]:
    """Where pixels look: of each patch that is met, its number, the pixels (rows and columns of the
    band), places on it, x and y in pixels, and distances for each unit along its axis."""
    left, top, width, _ = window
    x, y = np.meshgrid(
        left + np.arange(width) + inside[0], top + np.arange(rows.start, rows.stop) + inside[1]
    )
    directions, seen = panorama.directions(x, y)
    patchs = _patch_of(directions)
    for patch in np.unique(patchs[seen]):
        where = np.nonzero(seen & (patchs == patch))
        own = directions[where] @ _AXES[patch].T
        yield (
            int(patch),
            where,
            own[:, 0] / own[:, 2] * focal + side / 2,
            own[:, 1] / own[:, 2] * focal + side / 2,
            1 / own[:, 2],
        )


def _patch_of(directions: np.ndarray) -> np.ndarray:
    """The patches [...] through which directions [..., 3] look."""
    axis = np.abs(directions).argmax(-1)
    negative = np.take_along_axis(directions, axis[..., None], -1)[..., 0] < 0
    side = np.array([[1, 4, 0], [3, 5, 2]])[negative.astype(int), axis]
    own = np.einsum("...ij,...j->...i", _SIDES[side], directions)
    angles = np.arctan2(own[..., :2], own[..., 2:])
    place = np.clip(((angles / (np.pi / 2) + 0.5) * _ALONG).astype(int), 0, _ALONG - 1)
    return (side * _ALONG + place[..., 1]) * _ALONG + place[..., 0]


def _every_look(window: Window) -> Iterator[tuple[slice, tuple[float, float]]]:
    for rows in _bands(window):
        for inside in ((a, b) for a in _INSIDE for b in _INSIDE):
            yield rows, inside


def _parts(panorama: Panorama, window: Window, focal: float, side: int) -> dict[int, Window]:
    """What is needed of each patch that is met."""
    found: dict[int, np.ndarray] = {}
    for rows, inside in _every_look(window):
        for patch, _, x, y, _ in _looks(panorama, window, rows, inside, focal, side):
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
    out = np.zeros((window[3], window[2], 4 if name == "Combined" else 1), np.float32)
    for rows, inside in _every_look(window):
        band = out[rows]
        for patch, where, x, y, _ in _looks(panorama, window, rows, inside, focal, side):
            part, drawn = pictures[patch]
            band[where] += _between(drawn[name], x - part[0], y - part[1])
    return out / np.float32(len(_INSIDE) ** 2)


def _between(picture: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Values [n, C] of a picture [H, W, C] between its pixels' middles."""
    height, width = picture.shape[:2]
    x, y = np.clip(x - 0.5, 0, width - 1), np.clip(y - 0.5, 0, height - 1)
    left, top = x.astype(int), y.astype(int)
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    u, v = (x - left).astype(np.float32)[:, None], (y - top).astype(np.float32)[:, None]
    upper = picture[top, left] * (1 - u) + picture[top, right] * u
    lower = picture[below, left] * (1 - u) + picture[below, right] * u
    return upper * (1 - v) + lower * v


def _distances(
    panorama: Panorama, window: Window, focal: float, side: int, pictures: _Pictures
) -> np.ndarray:
    """Of the nearest pixel of a patch, because means of depths lie where nothing is."""
    out = np.full((window[3], window[2]), NOTHING, np.float32)
    for rows in _bands(window):
        band = out[rows]
        looks = _looks(panorama, window, rows, (0.5, 0.5), focal, side)
        for patch, where, x, y, far in looks:
            part, drawn = pictures.get(patch, ((0, 0, 0, 0), {}))
            if drawn:
                column = np.clip((x - part[0]).astype(int), 0, part[2] - 1)
                row = np.clip((y - part[1]).astype(int), 0, part[3] - 1)
                depth = drawn["Depth"][row, column]
                band[where] = np.where(depth < NOTHING, depth * far, NOTHING)
    return out
