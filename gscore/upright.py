"""Up direction of a capture's world from its cameras, and the rotation that makes it upright."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .scene import Cameras

_LEVEL = 0.05
"""Sine of the roll (3 degrees) up to which a photo is level and has its full weight."""
_PRIOR = 0.003
"""Weight of the mean image up direction relative to the horizons, as a squared sine."""
_STEEP = 0.35
"""Sine of the angle between optical axis and up (20 degrees) below which a picture has no top."""
_ROUNDS = 15
_NEAR = np.cos(np.radians(15))
"""Least cosine between up and an axis that is meant to be up."""

_X, _Y = np.eye(2)
_SHOWN = {
    1: (_X, _Y), 2: (-_X, _Y), 3: (-_X, -_Y), 4: (_X, -_Y),
    5: (_Y, _X), 6: (-_Y, _X), 7: (-_Y, -_X), 8: (_Y, -_X),
}  # fmt: skip
"""Right and down of the displayed picture by EXIF orientation (CIPA DC-008, tag 0x0112), along the
axes of the stored one."""


def find_up(viewmats: np.ndarray, orientations: Sequence[int] | None = None) -> np.ndarray:
    """Up direction of the world, estimated from how people hold cameras.

    The x axis of a level photo is horizontal, so up is perpendicular to all x axes; rolled photos
    have less weight. Where the x axes do not determine up (all cameras face one way), the mean of
    the image up directions decides. Captures in portrait orientation have y axes in one plane,
    while the x axes are not.

    Args:
        viewmats: [C, 4, 4] float64, world to camera, OpenCV axes; C >= 1.
        orientations: [C] EXIF orientations, 1 to 8, which turn the pictures of these cameras
            upright; other values count as 1. None: 1 for all.

    Returns:
        [3] float64, unit, world.
    """
    x, y, z = (viewmats[:, i, :3] for i in range(3))
    if orientations is not None:
        axes = np.array([_SHOWN.get(value, _SHOWN[1]) for value in orientations])
        x, y = np.einsum("caj,cji->aci", axes, viewmats[:, :2, :3])
    if _is_planar(y) and not _is_planar(x):
        up = np.linalg.eigh(y.T @ y)[1][:, 0]
        return up if up @ z.mean(axis=0) <= 0 else -up  # people look down rather than up
    weights = np.ones(len(x))
    up = np.zeros(3)
    for _ in range(_ROUNDS):
        total = weights.sum()
        scatter = (x * weights[:, None]).T @ x / total
        own = -(y * weights[:, None]).sum(axis=0) / total
        if np.linalg.norm(own) < 0.3:  # looking straight down, with all rolls
            own = own - z.mean(axis=0)
        if np.linalg.norm(own) < 1e-6:
            own = -y[0]
        up = np.linalg.solve(scatter + _PRIOR * np.eye(3), own)
        up /= np.linalg.norm(up)
        weights = _LEVEL / np.maximum(np.abs(x @ up), _LEVEL)
    return up


def up_of(cameras: Cameras) -> np.ndarray:
    """[3] float64, unit: up in the world, as the capture states it, else as `find_up` estimates."""
    return find_up(cameras.viewmats) if cameras.up is None else cameras.up


def up_axis(cameras: Cameras) -> str:
    """The axis of the world that is up, X to -Z, by `up_of`; empty if none is within `_NEAR`."""
    up = up_of(cameras)
    axis = int(np.abs(up).argmax())
    if abs(up[axis]) < _NEAR:
        return ""
    return ("-" if up[axis] < 0 else "") + "XYZ"[axis]


def upright_turns(cameras: Cameras) -> np.ndarray:
    """Quarter turns of each picture that bring up nearest to its top.

    A picture taken straight down or up gets the turns of the one before it.

    Returns:
        [C] int64, 0 to 3, counterclockwise as `numpy.rot90` turns pictures.
    """
    x, y = np.moveaxis(cameras.viewmats[:, :2, :3] @ up_of(cameras), 1, 0)
    turns = np.argmax([-y, x, y, -x], axis=0)
    sure = np.hypot(x, y) > _STEEP
    if not sure.any():
        return np.zeros(len(turns), np.int64)
    before = np.maximum.accumulate(np.where(sure, np.arange(len(turns)), np.argmax(sure)))
    return turns[before]


def turn_cameras(cameras: Cameras, turns: np.ndarray) -> Cameras:
    """The cameras of pictures after quarter turns.

    Args:
        cameras: As the pictures are stored.
        turns: [C] int, quarter turns counterclockwise, as `numpy.rot90` turns pictures.
    """
    viewmats, Ks = cameras.viewmats.copy(), cameras.Ks.copy()
    widths, heights = cameras.widths.copy(), cameras.heights.copy()
    for step in range(1, 4):
        at = turns >= step
        x, y = viewmats[at, 0].copy(), viewmats[at, 1].copy()
        viewmats[at, 0], viewmats[at, 1] = y, -x  # the new x is y, the new y is width - x
        fx, fy, cx, cy = Ks[at][:, [0, 1, 0, 1], [0, 1, 2, 2]].T
        Ks[at, 0, 0], Ks[at, 1, 1] = fy, fx
        Ks[at, 0, 2], Ks[at, 1, 2] = cy, widths[at] - cx
        widths[at], heights[at] = heights[at], widths[at]
    return replace(cameras, viewmats=viewmats, Ks=Ks, widths=widths, heights=heights)


def _is_planar(directions: np.ndarray) -> bool:
    """Whether unit vectors [C, 3] span a plane, but neither a line nor the space."""
    low, middle, _ = np.linalg.eigvalsh(directions.T @ directions / len(directions))
    return bool(low < 0.03 and middle > 0.15)
