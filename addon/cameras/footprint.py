"""Footprint of captures in Blender's world, for placing new captures and framing views."""

from collections.abc import Sequence

import bpy
import numpy as np

from ..compat import matrix_to_numpy
from ..interface import framing
from . import objects as co
from . import sfm_points

_POINTS = 20_000
"""Largest sample of points."""
_GAP = 0.1
"""Gap between captures, in widths of the new one."""


def frame_capture(scene: bpy.types.Scene, root: bpy.types.Object) -> list[bpy.types.SpaceView3D]:
    """Frame a capture's cameras and most of its points in the 3D views of a scene's windows;
    returns these views."""
    views = framing.views_of(scene)
    reach = reach_of(matrix_to_numpy(root.matrix_basis), *co.parts_of(root)) if views else []
    for space in views if len(reach) else ():
        framing.show_ball(space, *framing.ball(reach))
    return views


def reach_of(
    matrix: np.ndarray, cameras: Sequence[bpy.types.Object], points: bpy.types.Object | None
) -> np.ndarray:
    """[N, 3] float64 positions of a capture's cameras and points in Blender's world; cameras are
    repeated to equal the number of points.

    Args:
        matrix: [4, 4] of the capture's empty.
        cameras: Direct children of the empty.
        points: Direct child of the empty; None: no points. In Edit Mode they are ignored.
    """
    places = np.array([co.local_matrix(ob)[:3, 3] for ob in cameras]).reshape(-1, 3)
    if points is not None and points.mode != "EDIT" and len(points.data.vertices):
        cloud = sfm_points.positions_of(points).astype(np.float64)
        cloud = cloud[:: -(-len(cloud) // _POINTS)]
        if len(places):
            places = places[np.linspace(0, len(places) - 1, len(cloud)).astype(int)]
        places = np.concatenate([places, cloud])
    return places @ matrix[:3, :3].T + matrix[:3, 3]


def place_next_to(
    matrix: np.ndarray, reach: np.ndarray, others: Sequence[bpy.types.Object]
) -> np.ndarray:
    """[4, 4], the matrix of a capture's empty, moved along +x until the capture overlaps no other.

    Args:
        matrix: [4, 4] of the empty.
        reach: [N, 3] of `reach_of` for this matrix.
        others: Empties of the other captures.
    """
    taken = [_box(reach_of(matrix_to_numpy(o.matrix_basis), *co.parts_of(o))) for o in others]
    taken = sorted((box for box in taken if box is not None), key=lambda box: box[0, 0])
    own = _box(reach)
    if own is None:
        return matrix
    moved, gap = 0.0, _GAP * (own[1, 0] - own[0, 0])
    for low, high in taken:  # from left to right, so that one pass suffices
        if (own[0] < high).all() and (own[1] > low).all():
            step = high[0] - own[0, 0] + gap
            own[:, 0] += step
            moved += step
    out = matrix.copy()
    out[0, 3] += moved
    return out


def _box(reach: np.ndarray) -> np.ndarray | None:
    """[2, 2] lowest and highest x and y of the bulk of a capture; None: it is empty."""
    if not len(reach):
        return None
    return np.quantile(reach[:, :2], [(1 - framing.MOST) / 2, (1 + framing.MOST) / 2], axis=0)
