"""Paint target: one stroke on a splat object, with its editable attributes, changes and display.

Blender's mesh is written once, at the end of a stroke, because each write makes Blender evaluate
the object and its displays. Until then only the live display gets the changes.
"""

from collections.abc import Sequence
from functools import partial

import bpy
import numpy as np

from .. import attributes
from ..cameras.render_camera import RenderCamera
from ..interface.blocks import with_uid
from ..process.incremental_tasks import Check, Steps, run_in_thread
from ..render import viewport_copies
from ..render.mesh_copies import HIDDEN, SELECTED, read_marks
from ..splats import live_display, objects
from ..timeline.settings import plays
from .brush import CLONE, SELECT, Brush, Stroke
from .clone_stroke import CloneStroke, begin_clone
from .visible_splats import VisibleSplats, copy_visible


def begin_stroke(
    ob: bpy.types.Object,
    brush: Brush,
    view: RenderCamera | None,
    *,
    start: np.ndarray | None = None,
    source: np.ndarray | None = None,
    front_only: bool = False,
    only_selected: bool = False,
) -> "Steps[PaintedObject | CloneStroke]":
    """Collect the splats that a stroke can paint or copy, without hidden and filtered ones.

    Args:
        ob: A splat object in Object Mode, whose matrix is up to date.
        brush: The brush.
        view: The painted view; points are in pixels from its top left. None: points are positions
            in Blender's world.
        start: First point of a stroke of CLONE.
        source: Position in Blender's world, [3], around which that copies.
        front_only: Leave out splats behind the visible surface.
        only_selected: Leave out unselected splats.

    Raises:
        ValueError: Edit Mode, attributes are missing or not finite, a mesh that cannot be written,
            an uneven scale with `front_only`, `front_only` without a view, or none is selected.
        GsError: the rasterizer cannot draw the view.
    """
    objects.check_writable(ob)
    if view is None and front_only:
        raise ValueError("Front Only needs a view: turn it off to paint in world space.")
    marks, count = read_marks(ob.data), len(ob.data.vertices)
    marks = np.zeros(count, np.uint8) if marks is None else marks
    may = (marks & HIDDEN) == 0
    if only_selected:
        may &= (marks & SELECTED) != 0
        if not may.any():
            raise ValueError(f"{ob.name}: select some splats, or turn Only Selected off.")
    if brush.does == CLONE:
        assert start is not None and source is not None
        where = {"start": start, "source": source, "front_only": front_only}
        return (yield from begin_clone(ob, brush, view, may, **where))
    uid, name, follows = ob.data.session_uid, ob.name, live_display.SESSION.works and not plays(ob)
    shows_live = ob.gscore.display == "SPLATS" and follows
    splats = yield from copy_visible(ob, view, drawn=front_only)
    found = yield from run_in_thread(partial(_within, splats, may, front_only), "Finding splats")
    return PaintedObject(uid, name, brush, marks, *found, shows_live=shows_live)


def _within(
    splats: VisibleSplats, may: np.ndarray, front_only: bool, check: Check
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`radiance:base` [N, 4]; rows [M] of the splats to paint, a subset of `may` [N]; and their
    points [M, D]."""
    base, may = splats.columns[attributes.BASE], may & splats.shown()
    if splats.view is None:
        rows = np.flatnonzero(may)
        means = splats.columns[attributes.POSITION][rows]
        return base, rows, means @ splats.matrix[:3, :3].T + splats.matrix[:3, 3]
    at, there = splats.pixels()
    may &= there
    check()
    if front_only and may.any():
        may &= splats.in_front(at)
    rows = np.flatnonzero(may)
    return base, rows, at[rows]


class PaintedObject:
    """Target of one stroke, on the main thread, until its end or cancellation."""

    def __init__(
        self,
        uid: int,
        name: str,
        brush: Brush,
        marks: np.ndarray,
        base: np.ndarray,
        rows: np.ndarray,
        points: np.ndarray,
        *,
        shows_live: bool,
    ) -> None:
        """Prepare; paints nothing yet.

        Args:
            uid: Session uid of the mesh, of N splats.
            name: Name of the object.
            brush: The brush.
            marks: [N], as from `read_marks`.
            base: `radiance:base`, [N, 4].
            rows: Indices of the splats that can be painted, [M].
            points: Their positions for the brush, [M, D].
            shows_live: Update the live display during the stroke.
        """
        self._uid, self._name, self._brush = uid, name, brush
        self._marks, self._before, self._rows = marks, base, rows
        self._stroke = Stroke(points, brush)
        self._after = base.copy()
        self._selected = (marks & SELECTED) != 0
        self._touched = False
        self._live = shows_live
        self._follows = self._live or len(base) <= viewport_copies.EDITED_AT_ONCE

    def to(self, point: np.ndarray) -> None:
        """Extend the stroke to a point, [2] pixels of the view or [3] in the world."""
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
        """Show the stroke so far in viewports; with many splats, displays other than the live one
        show it at its end."""
        if self._live:
            self._show_live()
        elif self._follows and self._touched:
            self._write(self._after, self._selected)

    def finish(self) -> Steps[int]:
        """Write the stroke to the mesh in one step; return the number of splats it reached.

        Raises:
            ValueError: the splats were replaced meanwhile; nothing is changed.
        """
        yield from ()
        if not self._touched:
            return 0
        if self._live:
            self._show_live()
        self._write(self._after, self._selected)
        return int((self._stroke.share > 0).sum())

    def cancel(self) -> None:
        """Restore the state before the stroke."""
        written = self._follows and not self._live and self._touched
        self._after, self._selected = self._before, (self._marks & SELECTED) != 0
        if self._live:
            self._show_live()
        elif written:
            self._write(self._after, self._selected)

    def _show_live(self) -> None:
        if self._brush.does == SELECT:
            chosen = SELECTED * self._selected.astype(np.uint8)
            viewport_copies.SHARED.remark(self._uid, (self._marks & HIDDEN) | chosen)
        else:
            viewport_copies.SHARED.repaint(self._uid, self._after.copy())

    def _write(self, base: np.ndarray, selected: np.ndarray) -> None:
        mesh = with_uid(bpy.data.meshes, self._uid)
        if mesh is None or len(mesh.vertices) != len(base):
            raise ValueError(
                f"The splats of {self._name} were replaced during the stroke: paint it again."
            )
        reached = self._rows[self._stroke.share > 0]  # other rows may have changed meanwhile
        if self._brush.does == SELECT:
            now = attributes.selected(mesh)
            now[reached] = selected[reached]
            attributes.select(mesh, now)
        else:
            now = attributes.column(mesh, attributes.BASE, called=self._name)
            now[reached] = base[reached]
            kind = mesh.attributes[attributes.BASE].data_type
            attributes.fill(mesh, attributes.BASE, kind, now.reshape(-1))
        mesh.update()


def paint(
    ob: bpy.types.Object,
    points: Sequence[np.ndarray],
    brush: Brush,
    view: RenderCamera | None,
    *,
    source: np.ndarray | None = None,
    front_only: bool = False,
    only_selected: bool = False,
) -> Steps[int]:
    """Paint a whole stroke; return the number of splats it reached. Errors as `begin_stroke`.

    Args:
        ob: A splat object.
        points: The path, each point [2] pixels of the view or [3] in the world; at least one.
        brush: The brush.
        view: The painted view, or None.
        source: As in `begin_stroke`.
        front_only: Leave out splats behind the visible surface.
        only_selected: Leave out unselected splats.
    """
    how = {"front_only": front_only, "only_selected": only_selected}
    painted = yield from begin_stroke(ob, brush, view, start=points[0], source=source, **how)
    for point in points:
        painted.to(point)
    return (yield from painted.finish())


def show_as_kept(ob: bpy.types.Object) -> None:
    """Update the live display immediately with the colours and selection of an object's mesh.

    After undo it would update by itself, but some tenths of a second later.
    """
    if ob.mode == "EDIT" or not live_display.SESSION.works:
        return
    viewport_copies.SHARED.repaint(ob.data.session_uid, attributes.column(ob.data, attributes.BASE))
    viewport_copies.SHARED.remark(ob.data.session_uid, read_marks(ob.data))
