"""One stroke on a splat object: what it may paint, what it has painted, how that is kept and shown.

Blender's mesh is written once, at the end of a stroke: until then the live display is given what is
painted, because to write a mesh has Blender evaluate the object and everything that draws it anew.
"""

from collections.abc import Iterable

import bpy
import numpy as np

from .. import attributes, compat
from ..cameras.captures import RenderCamera
from ..render import copies
from ..render.frozen import HIDDEN, SELECTED, read_marks
from ..splats import filters, live, objects
from ..timeline.settings import plays
from . import sight
from .brush import SELECT, Brush
from .stroke import Stroke


class PaintedObject:
    """Used on the main thread, from the beginning of a stroke to its end or cancellation."""

    def __init__(
        self,
        ob: bpy.types.Object,
        brush: Brush,
        view: RenderCamera | None,
        *,
        front_only: bool = False,
        only_selected: bool = False,
    ) -> None:
        """Look which splats the stroke can paint; those that are hidden or filtered out it cannot.

        Args:
            ob: A splat object in Object Mode, whose matrix is up to date.
            brush: What is done.
            view: Where the stroke is painted, its points in pixels from the top left. None: its
                points are places in Blender's world.
            front_only: Leave out what lies behind the surface that the view shows.
            only_selected: Leave out what is not selected.

        Raises:
            ValueError: Edit Mode, attributes are missing or not finite, a mesh that cannot be
                written, an uneven scale with `front_only`, `front_only` without a view, or none is
                selected.
            GsError: the rasterizer cannot draw the view.
        """
        objects.check_writable(ob)
        mesh = ob.data
        self._uid, self._name, self._brush = mesh.session_uid, ob.name, brush
        self._before = attributes.column(mesh, attributes.BASE)
        marks = read_marks(mesh)
        count = len(self._before)
        self._marks = np.zeros(count, np.uint8) if marks is None else marks
        may = (self._marks & HIDDEN) == 0
        if only_selected:
            may &= (self._marks & SELECTED) != 0
            if not may.any():
                raise ValueError(f"{ob.name}: select some splats, or turn Only Selected off.")
        if count and filters.filters_of(ob).leave_out_anything:
            may &= filters.visible_mask(ob)
        self._rows, points = self._within_reach(ob, may, view, front_only=front_only)
        self._stroke = Stroke(points, brush)
        self._after = self._before.copy()
        self._selected = (self._marks & SELECTED) != 0
        self._touched = False
        self._live = ob.gscore.display == "SPLATS" and live.SESSION.works and not plays(ob)
        self._follows = self._live or count <= copies.EDITED_AT_ONCE

    @staticmethod
    def _within_reach(
        ob: bpy.types.Object, may: np.ndarray, view: RenderCamera | None, *, front_only: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rows [M] of the splats to paint, of those that may be [N], and their points [M, D]."""
        if not len(may):
            return np.zeros(0, np.int64), np.zeros((0, 3 if view is None else 2))
        if view is None:
            if front_only:
                raise ValueError("Front Only needs a view: turn it off to paint around places.")
            world = compat.matrix_to_numpy(ob.matrix_world)
            means = attributes.column(ob.data, attributes.POSITION)
            rows = np.flatnonzero(may)
            return rows, means[rows] @ world[:3, :3].T + world[:3, 3]
        found, there = sight.pixels(ob, view)
        may = may & there
        if front_only and may.any():
            may &= sight.in_front(ob, view, found)
        rows = np.flatnonzero(may)
        return rows, found[rows]

    def to(self, point: np.ndarray) -> None:
        """Go on to a point, [2] pixels of the view or [3] in the world."""
        reached = self._stroke.to(point)
        if not len(reached):
            return
        self._touched = True
        rows = self._rows[reached]
        if self._brush.does == SELECT:
            self._selected[rows] = not self._brush.inverted
        else:
            share = self._stroke.share[reached]
            self._after[rows] = self._brush.painted(self._before[rows], share)

    def show(self) -> None:
        """Have viewports show the stroke as far as it is; other displays than the live one, of many
        splats, at its end."""
        if self._live:
            self._show_live()
        elif self._follows and self._touched:
            self._write(self._after, self._selected)

    def finish(self) -> int:
        """Keep the stroke; how many splats it reached.

        Raises:
            ValueError: other splats have taken their place meanwhile; nothing is changed.
        """
        if not self._touched:
            return 0
        if self._live:
            self._show_live()
        self._write(self._after, self._selected)
        return int((self._stroke.share > 0).sum())

    def cancel(self) -> None:
        """Leave everything as it was before the stroke."""
        written = self._follows and not self._live and self._touched
        self._after, self._selected = self._before, (self._marks & SELECTED) != 0
        if self._live:
            self._show_live()
        elif written:
            self._write(self._after, self._selected)

    def _show_live(self) -> None:
        if self._brush.does == SELECT:
            chosen = SELECTED * self._selected.astype(np.uint8)
            copies.SHARED.remark(self._uid, (self._marks & HIDDEN) | chosen)
        else:
            copies.SHARED.repaint(self._uid, self._after.copy())

    def _write(self, base: np.ndarray, selected: np.ndarray) -> None:
        mesh = next((m for m in bpy.data.meshes if m.session_uid == self._uid), None)
        if mesh is None or len(mesh.vertices) != len(base):
            raise ValueError(
                f"The splats of {self._name} were replaced while the stroke was painted: paint it "
                "again."
            )
        if self._brush.does == SELECT:
            attributes.select(mesh, selected)
        else:
            kind = mesh.attributes[attributes.BASE].data_type
            attributes.fill(mesh, attributes.BASE, kind, base.reshape(-1))
        mesh.update()


def paint(
    ob: bpy.types.Object,
    points: Iterable[np.ndarray],
    brush: Brush,
    view: RenderCamera | None,
    *,
    front_only: bool = False,
    only_selected: bool = False,
) -> int:
    """Paint a whole stroke; how many splats it reached. Arguments and errors as `PaintedObject`.

    Args:
        ob: A splat object.
        points: The way, each [2] pixels of the view or [3] in the world.
        brush: What is done.
        view: Where the stroke is painted.
        front_only: Leave out what lies behind.
        only_selected: Leave out what is not selected.
    """
    painted = PaintedObject(ob, brush, view, front_only=front_only, only_selected=only_selected)
    for point in points:
        painted.to(point)
    return painted.finish()


def show_as_kept(ob: bpy.types.Object) -> None:
    """Have the live display show an object's colours and selection as its mesh has them, at once.

    After undo it would do so by itself, some tenths of a second later.
    """
    if ob.mode == "EDIT" or not live.SESSION.works:
        return
    copies.SHARED.repaint(ob.data.session_uid, attributes.column(ob.data, attributes.BASE))
    copies.SHARED.remark(ob.data.session_uid, read_marks(ob.data))
