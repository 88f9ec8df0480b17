"""What a view shows of the splats of an object: where they are, which are in front, which colour a
pixel has."""

from collections.abc import Iterator

import bpy
import numpy as np

from .. import attributes, compat
from ..cameras.captures import RenderCamera
from ..cameras.formulas import project
from ..core import Rendered, render
from ..render.viewport import smaller
from ..splats import filters, objects

LARGEST = 512
"""Pixels of the larger side of the picture whose depths say what is in front."""
_SLACK = 4.0
"""Widths of that picture's pixels by which a splat in front may lie behind the surface, besides its
own size: surfaces are slanted."""
_BLOCK = 1 << 15
"""Splats looked at at once."""
_FAINTEST = 0.05
"""Opacity of a pixel below which nothing is seen there."""


def pixels(ob: bpy.types.Object, view: RenderCamera) -> tuple[np.ndarray, np.ndarray]:
    """Where a view shows the centers of the N splats of an object.

    Returns:
        [N, 2] float32, pixels from the top left, and [N] bool: which of them lie beyond the view's
        near plane and within its picture.
    """
    means = attributes.column(ob.data, attributes.POSITION)
    K, viewmat = (matrix.astype(np.float32) for matrix in (view.K, _viewmat(ob, view)))
    found, there = np.zeros((len(means), 2), np.float32), np.zeros(len(means), bool)
    for part in _blocks(len(means)):
        with np.errstate(all="ignore"):  # what lies behind the view is left out
            at, depths = project(means[part], K, viewmat, orthographic=view.orthographic)
            inside = depths > view.near
            for axis, end in enumerate((view.width, view.height)):
                inside &= (at[:, axis] >= 0) & (at[:, axis] < end)
        found[part], there[part] = np.where(inside[:, None], at, 0), inside
    return found, there


def in_front(ob: bpy.types.Object, view: RenderCamera, at: np.ndarray) -> np.ndarray:
    """[N] bool: splats whose center does not lie behind the surface that a view shows of an object.

    The surface is where half of the light is blocked by the object's own splats, those that its
    filters hide apart; the rasterizer says where, on a picture of `LARGEST` pixels. A splat may lie
    behind it by its own size, its largest standard deviation, and by as much as `_SLACK` pixels of
    that picture are wide at this depth.

    Args:
        ob: A splat object in Object Mode.
        view: From where.
        at: [N, 2], as `pixels` gives it.

    Raises:
        ValueError: attributes are missing or not finite, or the object is scaled unevenly.
    """
    small = smaller(view, -(-max(view.width, view.height) // LARGEST))
    viewmat = _viewmat(ob, view)
    surface = _drawn(ob, small, depths=True).median_depth
    assert surface is not None
    means = attributes.column(ob.data, attributes.POSITION)
    scales = attributes.column(ob.data, attributes.SCALE)
    row = viewmat[2].astype(np.float32)
    larger = np.float32(np.cbrt(abs(np.linalg.det(viewmat[:3, :3]))))
    found = np.empty(len(means), bool)
    for part in _blocks(len(means)):
        before = _looked_up(surface, at[part], view)
        pixel = (1 if view.orthographic else before) / np.float32(small.K[0, 0])
        size = larger * np.abs(scales[part].T.copy()).max(axis=0)  # by axis: the other way is slow
        depths = means[part] @ row[:3] + row[3]
        # Where the light is never blocked, nothing is behind anything.
        found[part] = (before <= 0) | (depths <= before + _SLACK * pixel + size)
    return found


def _looked_up(picture: np.ndarray, at: np.ndarray, view: RenderCamera) -> np.ndarray:
    """[B] values of a smaller picture [H, W] of a view at its pixels [B, 2]."""
    height, width = picture.shape
    column = np.clip(at[:, 0] * np.float32(width / view.width), 0, width - 1).astype(np.int32)
    line = np.clip(at[:, 1] * np.float32(height / view.height), 0, height - 1).astype(np.int32)
    return picture[line, column]


def _blocks(count: int) -> Iterator[slice]:
    """So many splats in parts that stay in a cache, several times faster than all at once."""
    return (slice(at, at + _BLOCK) for at in range(0, count, _BLOCK))


def color_at(ob: bpy.types.Object, view: RenderCamera, point: np.ndarray) -> np.ndarray:
    """[3] sRGB values that an object's splats show at a pixel, without what depends on the view.

    Args:
        ob: A splat object in Object Mode.
        view: From where.
        point: [2] pixels from the top left.

    Raises:
        ValueError: nothing is seen there, or as `in_front`.
    """
    left, top = (int(v) for v in np.floor(point))
    if not (0 <= left < view.width and 0 <= top < view.height):
        raise ValueError("There is no view under the cursor: pick a color within the 3D view.")
    drawn = _drawn(ob, view, depths=False, window=(left, top, 1, 1))
    if drawn.alpha[0, 0] < _FAINTEST:
        raise ValueError(f"There are no splats of {ob.name} under the cursor.")
    return np.clip(drawn.rgb[0, 0] / drawn.alpha[0, 0], 0, 1)


def _drawn(
    ob: bpy.types.Object,
    view: RenderCamera,
    *,
    depths: bool,
    window: tuple[int, int, int, int] | None = None,
) -> Rendered:
    """A picture of an object alone, without what its filters hide and what depends on the view."""
    matrix = compat.matrix_to_numpy(ob.matrix_world)
    objects.moved(attributes.NO_SPLATS, matrix, ob.name)  # refuses a scale that is uneven
    splats = attributes.read(ob.data, rest=False)
    if filters.filters_of(ob).leave_out_anything:
        splats = splats.subset(filters.visible_mask(ob))
    return render(
        splats,
        view.K,
        view.viewmat @ matrix,
        view.width,
        view.height,
        near=view.near,
        antialias=bool(ob.get(objects.ANTIALIAS, False)),
        orthographic=view.orthographic,
        depths=depths,
        window=window,
    )


def _viewmat(ob: bpy.types.Object, view: RenderCamera) -> np.ndarray:
    """[4, 4] float64 from the object's space to the view's."""
    return view.viewmat @ compat.matrix_to_numpy(ob.matrix_world)
