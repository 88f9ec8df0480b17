"""Histogram gizmos in 3D views, with handles that drag the filter limits, and their drawing."""

from typing import ClassVar

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from ..interface import editable_check, viewport_text
from ..interface.blocks import with_uid
from ..interface.windows import push_undo, redraw_views
from ..splats.objects import in_question
from .boxes import Box, OverlappingRegions, placed
from .counting import HIDDEN, OPACITY, SHOWN, SIZE, Histogram
from .histogram_cache import HISTOGRAMS
from .limits import Handle, handles, limits_of

_KINDS = OPACITY, SIZE
"""Kinds of the histograms, from left to right."""
_REACH = 10.0
"""Distance at which the mouse still grabs a box or a handle, pixels."""
_FINE = 0.1
"""Factor of a handle's motion to the mouse's while Shift is pressed."""


def problem(context: bpy.types.Context, view: bpy.types.Region) -> str:
    """Reason why a view shows no histograms although they are enabled; empty if it shows them.

    Args:
        context: Context of the view's area.
        view: Main region of the area.
    """
    ob = in_question(context)
    if not context.space_data.show_gizmo:
        return "Gizmos are off in this view; the switch is in its header."
    if ob is not None and (kept := editable_check.problem(ob)):
        return kept
    if len(_boxes(context, view)) < len(_KINDS):
        return "This view is too small for all histograms."
    return ""


def in_view(
    context: bpy.types.Context, kind: str
) -> tuple[bpy.types.Object, Histogram, Box] | None:
    """Splat object, histogram of a kind and box in the context's view; None: the view shows
    none."""
    ob = in_question(context) if context.window_manager.gscore_histograms else None
    if ob is None or not editable_check.keeps(ob):
        return None
    found, box = HISTOGRAMS.of(ob).get(kind), box_of(context, kind)
    return None if found is None or box is None else (ob, found, box)


def box_of(context: bpy.types.Context, kind: str) -> Box | None:
    """Box of the histogram of a kind in the context's region; None: it does not fit."""
    boxes, number = _boxes(context, context.region), _KINDS.index(kind)
    return boxes[number] if number < len(boxes) else None


def _boxes(context: bpy.types.Context, view: bpy.types.Region) -> list[Box]:
    over: dict[str, list[Box]] = {}
    for one in context.area.regions:
        if one.type != "WINDOW" and min(one.width, one.height) > 1:  # others are closed
            box = Box(one.x - view.x, one.y - view.y, one.width, one.height)
            over.setdefault(one.alignment, []).append(box)
    return placed(
        Box(0, 0, view.width, view.height),
        OverlappingRegions(
            left=over.get("LEFT", ()),
            right=over.get("RIGHT", ()),
            above=over.get("TOP", ()),
            below=over.get("BOTTOM", ()),
            floating=[box for name in ("FLOAT", "NONE") for box in over.get(name, ())],
        ),
        len(_KINDS),
        context.preferences.system.ui_scale,
    )


class HistogramGizmo(bpy.types.Gizmo):
    """One histogram and its handles."""

    bl_idname = "GSCORE_GT_histogram"
    __slots__ = ("before", "begins", "grabbed", "histogram", "hovered", "kind", "place", "uid", "x")

    def setup(self) -> None:
        """Initialise without a grabbed handle."""
        self.kind: str = OPACITY
        self.hovered: Handle | None = None
        self.grabbed: Handle | None = None
        self.begins = False
        """True until the mouse moves."""
        self.uid = 0
        """Session uid of the object whose limit is dragged."""
        self.histogram: Histogram | None = None
        """Histogram at the start of the drag, kept while counts change."""
        self.before, self.place, self.x = 0.0, 0.0, 0.0
        self.use_draw_modal = True

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the histogram, if there is one and it fits."""
        if (there := in_view(context, self.kind)) is None:
            return
        ob, histogram, box = there
        own = handles(self.kind)
        near = self.grabbed or (self.hovered if self.is_highlight else None)
        draw(
            box,
            histogram,
            self.kind.capitalize(),
            limits_of(ob, self.kind),
            [handle.place(histogram, ob) for handle in own],
            own.index(near) if near else None,
            context.preferences.system.ui_scale,
        )

    def test_select(self, context: bpy.types.Context, location: tuple[float, float]) -> int:
        """0 if the mouse is over a handle, else -1."""
        if (there := in_view(context, self.kind)) is None:
            return -1
        ob, histogram, box = there
        x, y = location
        reach = _REACH * context.preferences.system.ui_scale
        if not (box.x - reach <= x <= box.right + reach and box.y - reach <= y <= box.top):
            return -1
        place = (x - box.x) / box.width
        # Of two at one position, the one that can move to the mouse.
        self.hovered = min(
            handles(self.kind),
            key=lambda one: (
                abs(one.place(histogram, ob) - place),
                (place - one.place(histogram, ob)) * (-1 if one.is_upper else 1),
            ),
        )
        return 0

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Grab the nearest handle, which jumps to a distant mouse."""
        if (there := in_view(context, self.kind)) is None or self.hovered is None:
            return {"CANCELLED"}
        ob, self.histogram, box = there
        self.uid, self.x, self.begins = ob.session_uid, event.mouse_region_x, True
        self._take(self.hovered, ob)
        place = (self.x - box.x) / box.width
        if abs(place - self.place) * box.width > _REACH * context.preferences.system.ui_scale:
            self._go(ob, place)
        return {"RUNNING_MODAL"}

    def modal(
        self, context: bpy.types.Context, event: bpy.types.Event, tweak: set[str]
    ) -> set[str]:
        """Follow the mouse while the view shows the same splats."""
        there, x = in_view(context, self.kind), event.mouse_region_x
        if there is None or there[0].session_uid != self.uid or x == self.x:
            return {"RUNNING_MODAL"}
        ob, _, box = there
        way, self.x = (x - self.x) / box.width, x
        if self.begins and (twin := self._twin(ob, box.width, up=way > 0)):
            self._take(twin, ob)
        self.begins = False
        self._go(ob, self.place + way * (_FINE if "PRECISE" in tweak else 1.0))
        return {"RUNNING_MODAL"}

    def exit(self, context: bpy.types.Context, cancel: bool) -> None:
        """Finish the drag: an undo step, or the previous limit if cancelled."""
        ob, handle = with_uid(bpy.data.objects, self.uid), self.grabbed
        self.grabbed = None
        if ob is None or handle is None:
            return
        if cancel:
            setattr(ob.gscore, handle.setting, self.before)
        elif getattr(ob.gscore, handle.setting) != self.before:
            push_undo(ob.gscore.bl_rna.properties[handle.setting].name)

    def _take(self, handle: Handle, ob: bpy.types.Object) -> None:
        assert self.histogram is not None
        self.grabbed, self.before = handle, getattr(ob.gscore, handle.setting)
        self.place = handle.place(self.histogram, ob)

    def _twin(self, ob: bpy.types.Object, width: float, *, up: bool) -> Handle | None:
        """The other handle, if it is within a pixel of the grabbed one and can move in this
        direction."""
        assert self.grabbed is not None and self.histogram is not None
        for other in handles(self.kind):
            apart = abs(other.place(self.histogram, ob) - self.place) * width
            if other != self.grabbed and other.is_upper == up and apart < 1:
                return other
        return None

    def _go(self, ob: bpy.types.Object, place: float) -> None:
        assert self.grabbed is not None and self.histogram is not None
        self.place = place
        self.grabbed.move(self.histogram, ob, place)


class HistogramGizmos(bpy.types.GizmoGroup):
    """The histograms of the splats that the panel is about"""

    bl_idname = "GSCORE_GGT_histograms"
    bl_label = "Histograms of Splats"
    bl_space_type = "VIEW_3D"
    bl_region_type = "WINDOW"
    bl_options: ClassVar = {"PERSISTENT"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """True if the histograms are enabled and there are splats."""
        return context.window_manager.gscore_histograms and in_question(context) is not None

    def setup(self, context: bpy.types.Context) -> None:
        """One gizmo per histogram."""
        for kind in _KINDS:
            self.gizmos.new(HistogramGizmo.bl_idname).kind = kind


_SWITCH = bpy.props.BoolProperty(
    name="Handles in View",
    description="Show the histograms at the bottom of 3D views, with draggable handles. Splats "
    "beyond a handle are hidden; a handle at the end of the axis has no effect. Hold Shift for "
    "small steps",
    update=lambda self, context: redraw_views(),
)
# In the window manager: no file saves it, and undo does not change it.
PROPERTIES = ((bpy.types.WindowManager, "gscore_histograms", _SWITCH),)


_BACK = (0.1, 0.1, 0.1, 0.75)
_HANDLE, _BRIGHT = (0.75, 0.75, 0.75, 1.0), (1.0, 1.0, 1.0, 1.0)
_PADDING = 6.0
_GRIP = 6.0
"""Half the width of a handle's foot; pixels at interface scale 1, as all sizes here."""


def draw(
    box: Box,
    histogram: Histogram,
    title: str,
    limits: tuple[float, float],
    places: list[float],
    bright: int | None,
    scale: float,
) -> None:
    """Draw bars, handles and text, in pixels of the drawn region.

    Args:
        box: Box of the bars.
        histogram: Counts.
        title: Text above the bars.
        limits: Smallest and largest visible value; 0: no limit.
        places: Positions of the handles, in [0, 1].
        bright: Index of the handle under the mouse.
        scale: Interface scale of Blender.
    """
    pad = _PADDING * scale
    shapes = [(_rectangle(box.x - pad, box.y - pad, box.right + pad, box.top + pad), _BACK)]
    low, high = histogram.ends(*limits)
    tall = box.height * histogram.heights()
    edges = np.linspace(0, 1, len(tall) + 1)
    for i, height in enumerate(tall):
        middle = (edges[i] + edges[i + 1]) / 2
        color = (*SHOWN, 1.0) if low <= middle <= high else (*HIDDEN, 1.0)
        sides = box.x + box.width * edges[i : i + 2]
        shapes.append((_rectangle(sides[0], box.y, sides[1], box.y + height), color))
    for i, place in enumerate(places):
        color, x = (_BRIGHT if i == bright else _HANDLE), box.x + box.width * place
        shapes.append((_rectangle(x - scale, box.y, x + scale, box.top), color))
        left, low, right = x - _GRIP * scale, box.y - _GRIP * scale, x + _GRIP * scale
        shapes.append(([(left, low), (right, low), (x, box.y + _GRIP * scale)], color))
    _fill(shapes)
    text, above = limit_text(*limits), box.top + 1.5 * pad
    viewport_text.write(title, box.x, above, scale, _BRIGHT)
    viewport_text.write(
        text, box.right - viewport_text.width_of(text, scale), above, scale, _BRIGHT
    )


def limit_text(smallest: float, largest: float) -> str:
    """Limits in words."""
    low, high = map(_number, (smallest, largest))
    if smallest > 0 and largest > 0:
        return f"{low} to {high}"
    if smallest > 0:
        return f"{low} and more"
    return f"up to {high}" if largest > 0 else "all"


def _number(value: float) -> str:
    return np.format_float_positional(value, precision=2, fractional=False, trim="-")


def _rectangle(left: float, low: float, right: float, high: float) -> list[tuple[float, float]]:
    """Two triangles."""
    corners = (left, low), (right, low), (right, high), (left, high)
    return [corners[i] for i in (0, 1, 2, 0, 2, 3)]


def _fill(shapes: list[tuple[list[tuple[float, float]], tuple[float, ...]]]) -> None:
    """Draw triangles, each in the color of its shape."""
    shader = gpu.shader.from_builtin("FLAT_COLOR")
    places = [(x, y, 0.0) for corners, _ in shapes for x, y in corners]
    colors = [color for corners, color in shapes for _ in corners]
    gpu.state.blend_set("ALPHA")
    batch_for_shader(shader, "TRIS", {"pos": places, "color": colors}).draw(shader)
    gpu.state.blend_set("NONE")
