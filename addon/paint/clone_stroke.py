"""Clone stroke: splats from around a source, copied to where the brush moves."""

import bpy
import numpy as np

from .. import attributes
from ..cameras.camera_math import project
from ..cameras.render_camera import RenderCamera
from ..process.incremental_tasks import Check, Steps, run_in_thread
from ..splats import point_attributes, separate_join
from ..splats.added import appended, cloned
from ..splats.edit_guard import EditGuard
from ..splats.point_attributes import Column
from ..splats.read_chunked import ChunkedRead
from ..splats.replay import Volume, record_cloned, volume_of
from .brush import Brush, Stroke
from .visible_splats import VisibleSplats, check_inside, copy_visible

_FAINTEST = 1 / 255
"""Smallest weight of the brush for a copy."""


def begin_clone(
    ob: bpy.types.Object,
    brush: Brush,
    view: RenderCamera | None,
    may: np.ndarray,
    *,
    start: np.ndarray,
    source: np.ndarray,
    front_only: bool,
) -> "Steps[CloneStroke]":
    """Collect the splats that a stroke can copy: those that a shift from `source` to the surface at
    `start` brings under the brush.

    Args:
        ob: A splat object in Object Mode, whose matrix is up to date.
        brush: The brush.
        view: The painted view, or None.
        may: [N] bool, splats that may be copied.
        start: First point, [2] pixels of the view or [3] in the world. A pixel without splats is as
            deep as the source.
        source: Position in Blender's world [3].
        front_only: Leave out splats behind the visible surface at their own place.

    Raises:
        ValueError: attributes are missing or not finite, or lag behind positions; a mesh that
            cannot be written or has edges; a start outside the view; an uneven scale, or one of 0.
        GsError: the rasterizer cannot draw the view.
    """
    guard = EditGuard(ob)
    guard.check_only_points()
    separate_join.check_follow([ob])
    if view is not None:
        check_inside(view, start, "The stroke begins outside the picture: begin it inside.")
    splats = yield from copy_visible(ob, view, drawn=view is not None)

    def found(check: Check) -> CloneStroke:
        place = start if view is None else splats.place_at(start)
        if place is None:
            depth = float(view.viewmat[2, :3] @ source + view.viewmat[2, 3])
            place = splats.unprojected(start, depth)
        linear = splats.matrix[:3, :3]
        if not abs(np.linalg.det(linear)) > 1e-30:
            raise ValueError(f"{splats.name} has a scale of 0: set its scale to 1 first.")
        shift = np.linalg.inv(linear) @ (place - source)
        rows, points = _within(splats, may, shift, front_only, check)
        stroke = CloneStroke(guard, brush, shift, rows, points)
        if view is not None:
            with np.errstate(all="ignore"):  # behind the view
                how = source[None], view.K, view.viewmat
                (at,), (depth,) = project(*how, orthographic=view.orthographic)
            stroke.to_source = at - start if depth > view.near else None
        return stroke

    return (yield from run_in_thread(found, "Finding splats"))


def _within(
    splats: VisibleSplats, may: np.ndarray, shift: np.ndarray, front_only: bool, check: Check
) -> tuple[np.ndarray, np.ndarray]:
    """Rows [M] of the splats to copy, of those that may be [N], and points [M, D] of the copies."""
    may = may & splats.shown()
    if splats.view is None:
        rows = np.flatnonzero(may)
        means = splats.columns[attributes.POSITION][rows] + shift
        return rows, means @ splats.matrix[:3, :3].T + splats.matrix[:3, 3]
    if front_only:
        at, there = splats.pixels()
        may &= there
        check()
        if may.any():
            may &= splats.in_front(at)
    check()
    at, there = splats.pixels(shift)
    rows = np.flatnonzero(may & there)
    return rows, at[rows]


class CloneStroke:
    """One stroke of copies; nothing is changed until its end."""

    to_source: np.ndarray | None = None
    """From the brush to what it copies, [2] pixels; None: without a view, or behind it."""

    def __init__(
        self,
        guard: EditGuard,
        brush: Brush,
        shift: np.ndarray,
        rows: np.ndarray,
        points: np.ndarray,
    ) -> None:
        """Prepare.

        Args:
            guard: The object, of N splats; closed at the end of the stroke.
            brush: The brush.
            shift: From a splat to its copy, in the object's space, [3].
            rows: Indices of the splats that can be copied, [M], increasing.
            points: Positions of their copies for the brush, [M, D].
        """
        self._guard, self._brush, self._rows = guard, brush, rows
        self._matrix = np.eye(4)
        self._matrix[:3, 3] = shift
        self._stroke = Stroke(points, brush)

    def to(self, point: np.ndarray) -> None:
        """Extend the stroke to a point, [2] pixels of the view or [3] in the world."""
        self._stroke.to(point)

    def show(self) -> None:
        """Nothing: the copies appear at the end."""

    def cancel(self) -> None:
        """Forget the stroke."""
        self._guard.close()

    def finish(self) -> Steps[int]:
        """Add the copies, fainter where the brush fades; return their number.

        Raises:
            ValueError: the splats have changed meanwhile, or none are at the source; nothing is
                changed.
        """
        try:
            return (yield from self._finish())
        finally:
            self._guard.close()

    def _finish(self) -> Steps[int]:
        guard, share = self._guard, self._brush.strength * self._stroke.share
        if not self._stroke.share.any():
            raise ValueError(
                "No splats are at the source, the 3D cursor, or they are out of view, hidden or "
                "protected: Ctrl click where to copy from."
            )
        reached = share >= _FAINTEST
        if not reached.any():
            return 0
        table = yield from ChunkedRead(guard.there()).table()
        chosen = np.zeros(len(table[0].values), bool)
        chosen[self._rows[reached]] = True

        def copied(check: Check) -> Volume:
            volume = _volume(table, chosen)
            how = table, chosen, self._matrix, guard.name, check
            copies = cloned(*how, opacity=share[reached])
            table[:] = appended(table, copies, selected=False)
            return volume

        volume = yield from run_in_thread(copied, "Copying splats")
        every = np.arange(len(table[0].values))
        ob = yield from separate_join.kept(guard, table, every)
        record_cloned(ob, self._matrix, volume, opacity=self._brush.strength)
        return int(reached.sum())


def _volume(table: list[Column], chosen: np.ndarray) -> Volume:
    columns = point_attributes.of_splats(table, rest=False)
    return volume_of(columns[attributes.POSITION], chosen, columns[attributes.SCALE])
