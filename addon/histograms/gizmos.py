"""Histograms in 3D views, whose handles the mouse drags to limit what is shown."""

from typing import ClassVar

import bpy

from ..interface import writable
from ..interface.views import redraw_views
from ..splats.objects import in_question
from .boxes import Box, placed
from .counted import COUNTED
from .counting import OPACITY, SIZE, Histogram
from .drawing import draw
from .limits import Handle, handles, of_object

_KINDS = OPACITY, SIZE
"""From left to right."""
_REACH = 10.0
"""Pixels around a box, or a handle, at which the mouse still takes it."""
_FINE = 0.1
"""Share of the mouse's way that a handle goes while Shift is held."""


def shown(context: bpy.types.Context) -> tuple[bpy.types.Object, dict[str, Histogram]] | None:
    """The splats whose histograms a view shows, and these; None: it shows none."""
    ob = in_question(context) if context.window_manager.gscore_histograms else None
    if ob is None or not writable.keeps(ob):
        return None
    found = COUNTED.of(ob)
    return (ob, found) if found else None


def box_of(context: bpy.types.Context, kind: str) -> Box | None:
    """Where the histogram of a kind lies in the context's region; None: there is no room."""
    region, scale = context.region, context.preferences.system.ui_scale
    over = [
        Box(one.x - region.x, one.y - region.y, one.width, one.height)
        for one in context.area.regions
        if one != region and min(one.width, one.height) > 1  # others are closed
    ]
    view = Box(0, 0, region.width, region.height)
    boxes = placed(view, over, len(_KINDS), scale)
    return boxes[_KINDS.index(kind)] if boxes else None


class HistogramGizmo(bpy.types.Gizmo):
    """One histogram and its handles."""

    bl_idname = "GSCORE_GT_histogram"
    __slots__ = ("before", "held", "hovered", "kind", "place", "x")

    def setup(self) -> None:
        """Nothing is held."""
        self.kind: str = OPACITY
        self.held: Handle | None = None
        self.hovered: Handle | None = None
        self.before, self.place, self.x = 0.0, 0.0, 0.0
        self.use_draw_modal = True

    def draw(self, context: bpy.types.Context) -> None:
        """Draw it, if there is something to show and room for it."""
        found, box = shown(context), box_of(context, self.kind)
        if found is None or box is None:
            return
        ob, histogram = found[0], found[1][self.kind]
        there = handles(self.kind)
        near = self.held or (self.hovered if self.is_highlight else None)
        draw(
            box,
            histogram,
            self.kind.capitalize(),
            of_object(ob, self.kind),
            [handle.place(histogram, ob) for handle in there],
            there.index(near) if near else None,
            context.preferences.system.ui_scale,
        )

    def test_select(self, context: bpy.types.Context, location: tuple[float, float]) -> int:
        """0 where the mouse takes a handle, else -1."""
        found, box = shown(context), box_of(context, self.kind)
        if found is None or box is None:
            return -1
        x, y = location
        reach = _REACH * context.preferences.system.ui_scale
        if not (box.x - reach <= x <= box.right + reach and box.y - reach <= y <= box.top):
            return -1
        ob, histogram = found[0], found[1][self.kind]
        place = (x - box.x) / box.width
        # Of two at one place, the one that has somewhere to go.
        self.hovered = min(
            handles(self.kind),
            key=lambda one: (
                abs(one.place(histogram, ob) - place),
                (place - one.place(histogram, ob)) * (-1 if one.is_upper else 1),
            ),
        )
        return 0

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Take the handle that is nearest; it comes to a mouse that is far from it."""
        found, box = shown(context), box_of(context, self.kind)
        if found is None or box is None or self.hovered is None:
            return {"CANCELLED"}
        ob, histogram = found[0], found[1][self.kind]
        self.held = self.hovered
        self.before = getattr(ob.gscore, self.held.setting)
        self.place, self.x = self.held.place(histogram, ob), event.mouse_region_x
        there = (self.x - box.x) / box.width
        if abs(there - self.place) * box.width > _REACH * context.preferences.system.ui_scale:
            self._go(ob, histogram, there)
        return {"RUNNING_MODAL"}

    def modal(
        self, context: bpy.types.Context, event: bpy.types.Event, tweak: set[str]
    ) -> set[str]:
        """Follow the mouse."""
        found, box = shown(context), box_of(context, self.kind)
        if found is not None and box is not None and event.mouse_region_x != self.x:
            way = (event.mouse_region_x - self.x) / box.width
            self.x = event.mouse_region_x
            place = self.place + way * (_FINE if "PRECISE" in tweak else 1.0)
            self._go(found[0], found[1][self.kind], place)
        return {"RUNNING_MODAL"}

    def exit(self, context: bpy.types.Context, cancel: bool) -> None:
        """Let go: an undo step, or as it was before."""
        found, held = shown(context), self.held
        self.held = None
        if found is None or held is None:
            return
        if cancel:
            setattr(found[0].gscore, held.setting, self.before)
        elif getattr(found[0].gscore, held.setting) != self.before:
            name = found[0].gscore.bl_rna.properties[held.setting].name
            bpy.ops.ed.undo_push(message=name)

    def _go(self, ob: bpy.types.Object, histogram: Histogram, place: float) -> None:
        assert self.held is not None
        self.place = place
        self.held.move(histogram, ob, place)


class HistogramGizmos(bpy.types.GizmoGroup):
    """The histograms of the splats that the panel is about"""

    bl_idname = "GSCORE_GGT_histograms"
    bl_label = "Histograms of Splats"
    bl_space_type = "VIEW_3D"
    bl_region_type = "WINDOW"
    bl_options: ClassVar = {"PERSISTENT"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """They are wanted, and there are splats whose limits can be changed."""
        return shown(context) is not None

    def setup(self, context: bpy.types.Context) -> None:
        """One gizmo a histogram."""
        for kind in _KINDS:
            self.gizmos.new(HistogramGizmo.bl_idname).kind = kind


CLASSES = (HistogramGizmo, HistogramGizmos)


def on_register() -> None:
    """Make the switch one of all windows: no file keeps it, and undo leaves it."""
    bpy.types.WindowManager.gscore_histograms = bpy.props.BoolProperty(
        name="Handles in View",
        description="Show the histograms at the lower end of 3D views, with handles that the mouse "
        "drags: splats beyond them are hidden. Shift is for small steps; at its end a handle "
        "limits nothing",
        update=lambda self, context: redraw_views(),
    )


def on_unregister() -> None:
    """Take the switch away."""
    del bpy.types.WindowManager.gscore_histograms
