"""A panorama out of sharp pictures of the sides of a cube around the camera."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from ..cameras.captures import RenderCamera
from ..cameras.panorama import Panorama
from .color import NOTHING
from .scene import Model

Window = tuple[int, int, int, int]
"""Left, top, width and height, pixels."""
_AXES = np.array(
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
_DETAIL = 1.25
"""Pixels of a side, in its middle, for each of the panorama."""
_LARGEST = 8192
"""Pixels along a side."""
_EDGE = 2
"""Pixels around a side, between which its outermost directions fall."""
_INSIDE = (0.25, 0.75)
"""Where in a pixel one looks, along each axis."""
_NEAREST = 0.5
"""Depth on a side, in distances, of what is nearest: less than in the corners of the cube."""
_AT_ONCE = 1 << 18
"""Pixels of the panorama that are looked up together."""


def unfold(
    panorama: Panorama,
    window: Window | None,
    draw: Callable[[RenderCamera, Window], dict[str, np.ndarray]],
) -> dict[str, np.ndarray]:
    """The passes of a panorama; only what it sees of the cube's sides is drawn.

    Args:
        panorama: The camera.
        window: The part that is wanted; None: all.
        draw: Gives the passes of a part of a picture, their bottom rows first.

    Returns:
        "Combined" [h, w, 4], the mean of four looks a pixel between the four nearest pixels of a
        side; "Depth" [h, w], where it was drawn, the distance along the middle of the pixel. The
        bottom rows first; nothing where the panorama sees nothing.
    """
    window = window or (0, 0, panorama.width, panorama.height)
    side = 2 * (min(int(np.ceil(panorama.density * _DETAIL)), _LARGEST // 2 - _EDGE) + _EDGE)
    focal = side / 2 - _EDGE
    pictures = {}
    for face, part in _parts(panorama, window, focal, side).items():
        camera = RenderCamera(
            viewmat=_turned(_AXES[face]) @ panorama.viewmat,
            K=np.array([[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1.0]]),
            width=side,
            height=side,
            near=panorama.near * _NEAREST,
            orthographic=False,
            name="panorama",
        )
        drawn = draw(camera, part)
        pictures[face] = part, {name: values[::-1] for name, values in drawn.items()}
    passes = {"Combined": _resampled(panorama, window, focal, side, pictures)}
    if any("Depth" in drawn for _, drawn in pictures.values()):
        passes["Depth"] = _distances(panorama, window, focal, side, pictures)
    return {name: np.ascontiguousarray(values[::-1]) for name, values in passes.items()}


def beyond(model: Model, panorama: Panorama) -> Model:
    """What is farther away than a panorama's near end, which is a ball, the same for all sides."""
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
    """Where pixels look: of each side that is met, its number, the pixels (rows and columns of the
    band), places on it, x and y in pixels, and distances for each unit along its axis."""
    left, top, width, _ = window
    x, y = np.meshgrid(
        left + np.arange(width) + inside[0], top + np.arange(rows.start, rows.stop) + inside[1]
    )
    directions, seen = panorama.directions(x, y)
    along = np.abs(directions)
    axis = along.argmax(-1)
    negative = np.take_along_axis(directions, axis[..., None], -1)[..., 0] < 0
    faces = np.array([[1, 4, 0], [3, 5, 2]])[negative.astype(int), axis]
    for face in np.unique(faces[seen]):
        where = np.nonzero(seen & (faces == face))
        own = directions[where] @ _AXES[face].T
        yield (
            int(face),
            where,
            own[:, 0] / own[:, 2] * focal + side / 2,
            own[:, 1] / own[:, 2] * focal + side / 2,
            1 / own[:, 2],
        )


def _every_look(window: Window) -> Iterator[tuple[slice, tuple[float, float]]]:
    for rows in _bands(window):
        for inside in ((a, b) for a in _INSIDE for b in _INSIDE):
            yield rows, inside


def _parts(panorama: Panorama, window: Window, focal: float, side: int) -> dict[int, Window]:
    """What is needed of each side that is met."""
    found: dict[int, np.ndarray] = {}
    for rows, inside in _every_look(window):
        for face, _, x, y, _ in _looks(panorama, window, rows, inside, focal, side):
            ends = np.array([x.min(), y.min(), -x.max(), -y.max()])
            found[face] = np.minimum(found.get(face, ends), ends)
    parts = {}
    for face in sorted(found):
        low = np.maximum(np.floor(found[face][:2]) - _EDGE, 0).astype(int)
        high = np.minimum(np.ceil(-found[face][2:]) + _EDGE, side).astype(int)
        parts[face] = int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])
    return parts


def _resampled(
    panorama: Panorama, window: Window, focal: float, side: int, pictures: _Pictures
) -> np.ndarray:
    out = np.zeros((window[3], window[2], 4), np.float32)
    for rows, inside in _every_look(window):
        band = out[rows]
        for face, where, x, y, _ in _looks(panorama, window, rows, inside, focal, side):
            part, drawn = pictures[face]
            band[where] += _between(drawn["Combined"], x - part[0], y - part[1])
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
    """Of the nearest pixel of a side, because means of depths lie where nothing is."""
    out = np.full((window[3], window[2]), NOTHING, np.float32)
    for rows in _bands(window):
        band = out[rows]
        looks = _looks(panorama, window, rows, (0.5, 0.5), focal, side)
        for face, where, x, y, far in looks:
            part, drawn = pictures.get(face, ((0, 0, 0, 0), {}))
            if drawn:
                column = np.clip((x - part[0]).astype(int), 0, part[2] - 1)
                row = np.clip((y - part[1]).astype(int), 0, part[3] - 1)
                depth = drawn["Depth"][row, column]
                band[where] = np.where(depth < NOTHING, depth * far, NOTHING)
    return out
