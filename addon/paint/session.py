"""Paint session in 3D views: its mouse and key events from start to end."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from typing import Any

import bpy
import numpy as np

from ..cameras.render_camera import RenderCamera
from ..compat import matrix_to_numpy
from ..interface import editable_check
from ..interface.incremental_operator import INTERVAL
from ..interface.windows import push_undo, redraw_views
from ..process.incremental_tasks import Steps, TaskRunner
from ..render.viewport import view_camera
from ..splats import objects
from ..splats.operators import check_shown
from . import paint_target, visible_splats
from .brush import CLONE, OPACITY, SELECT
from .clone_stroke import CloneStroke
from .cursor import Cursor
from .settings import LARGEST_RADIUS, BrushSettings

UNDO = "Paint Splats"
"""Name of a stroke's undo step."""
STEP = 1.1
"""Factor of the radius for the keys [ and ]."""
_MOVES = {"MOUSEMOVE", "INBETWEEN_MOUSEMOVE"}
_NUMPAD = "NUMPAD_"
_NUMPAD_WITH_CTRL = tuple(f"{_NUMPAD}{digit}" for digit in range(1, 10))
"""Numpad keys that rotate a view with Ctrl too; with Ctrl, 0 and others change the scene."""
_NAVIGATION = (
    "MIDDLEMOUSE",
    "WHEEL",
    "TRACKPAD",
    "MOUSEROTATE",
    "MOUSESMARTZOOM",
    "NDOF",
    _NUMPAD,
    "HOME",
    "ACCENT_GRAVE",
)
"""Prefixes of view navigation events."""
_UNTOUCHED = ("TIMER", "WINDOW", "NONE")
"""Prefixes of events that always pass through: timers, windows."""
_MODIFIERS = {f"{side}_{key}" for side in ("LEFT", "RIGHT") for key in ("CTRL", "SHIFT", "ALT")}
"""Modifier keys."""
_PANELS = {"N", "T"}
"""Keys that toggle the regions at a view's sides."""
_BUTTONS = {"LEFTMOUSE", "RIGHTMOUSE"}
"""Mouse buttons; with Alt they rotate views, if enabled in the preferences."""
_ENDS, _ENTERS = {"ESC", "RET", "NUMPAD_ENTER"}, {"LEFTMOUSE", "RET", "NUMPAD_ENTER"}
_DROPS = {"ESC", "RIGHTMOUSE"}


class Answer(Enum):
    """Handling of an event."""

    TAKEN = "RUNNING_MODAL"
    """The brush used the event."""
    PASSED = "PASS_THROUGH"
    """The event passes through."""
    ENDED = "FINISHED"
    """Painting has ended."""


@dataclass(frozen=True)
class Spot:
    """Mouse position in a view."""

    region: bpy.types.Region
    """Main region of a 3D view."""
    x: float
    """Pixels from its lower left."""
    y: float

    @property
    def view(self) -> RenderCamera:
        """Camera of the region."""
        own = self.region.data
        return view_camera(
            matrix_to_numpy(own.view_matrix),
            matrix_to_numpy(own.window_matrix),
            self.region.width,
            self.region.height,
            perspective=own.is_perspective,
        )

    @property
    def point(self) -> np.ndarray:
        """Pixels from the top left of the view, [2]."""
        return np.array([self.x, self.region.height - self.y])


class _Search(TaskRunner):
    """Work at the start or end of a stroke, or for a click, while the mouse moves on."""

    def __init__(
        self,
        context: bpy.types.Context,
        steps: Steps[Any],
        then: "Callable[[_Search], None]",
        *,
        way: list[np.ndarray] | None = None,
    ) -> None:
        """Start the search.

        Args:
            context: Context of the event.
            steps: The search, in steps.
            then: Called with the finished search.
            way: The mouse path of a stroke so far; None: it is no stroke.
        """
        super().__init__(steps)
        self.then, self.way, self.is_released = then, way, False
        self._manager, self._timer = context.window_manager, None
        if not bpy.app.background:  # so that events arrive even if the mouse rests
            self._timer = self._manager.event_timer_add(INTERVAL, window=context.window)

    def end(self) -> None:
        """Cancel the search and remove the timer."""
        self.cancel()
        if self._timer is not None:
            self._manager.event_timer_remove(self._timer)


class Session:
    """Sequence of strokes, each an undo step, on the splat object that is active at its start. No
    scene data are kept between events, because undo may replace them."""

    def __init__(self) -> None:
        self.ended = False
        """Set to end painting at the next event."""
        self.cursor = Cursor()
        self._stroke: paint_target.PaintedObject | CloneStroke | None = None
        self._stroke_region = 0
        self._search: _Search | None = None
        self._sizing: tuple[float, float] | None = None
        """Radius before F was pressed, and x of the mouse."""
        self._undone = False

    @property
    def painting(self) -> bool:
        """True during a stroke, from its search to its end."""
        collects = self._search is not None and self._search.way is not None
        return self._stroke is not None or collects

    @property
    def busy(self) -> bool:
        """True during a stroke or another search."""
        return self._stroke is not None or self._search is not None

    def close(self) -> None:
        """End the session; a running stroke is cancelled."""
        self.cursor.close()
        self._end_search()
        if self._stroke is not None:
            with suppress(ValueError):  # the painted object is gone
                self._drop()
        redraw_views()

    def take(self, context: bpy.types.Context, event: bpy.types.Event) -> Answer:
        """Handle an event.

        Raises:
            GsError, ValueError: it cannot be done, with the reason; painting continues.
        """
        if self.ended:
            return Answer.ENDED
        self._step_search()
        if self._undone:
            self._undone = False
            ob = objects.active_splats(context)
            if objects.is_splats(ob):
                paint_target.show_as_kept(ob)
                redraw_views()
        spot = spot_of(context.window, event.mouse_x, event.mouse_y)
        brush = context.window_manager.gscore_paint
        if event.type.startswith(_UNTOUCHED):
            answer = Answer.PASSED
        elif self.painting:
            answer = self._go_on(spot, event)
        elif self._sizing is not None:
            answer = self._size(brush, event)
        else:
            answer = self._begin(context, spot, brush, event)
        self._place_cursor(spot, brush)
        return answer

    def _begin(
        self,
        context: bpy.types.Context,
        spot: Spot | None,
        brush: BrushSettings,
        event: bpy.types.Event,
    ) -> Answer:
        """Handle an event outside strokes."""
        key, pressed = event.type, event.value == "PRESS"
        if spot is None or key in _MOVES or (event.alt and key in _BUTTONS):
            return Answer.PASSED
        if key in _ENDS and pressed:
            return Answer.ENDED
        if key == "LEFTMOUSE" and pressed:
            if event.shift:
                self._click(context, spot, visible_splats.color_at, _set_color)
            elif event.ctrl and brush.does == CLONE:
                self._click(context, spot, visible_splats.place_at, _set_source)
            else:
                self._begin_stroke(context, spot, brush, inverted=event.ctrl)
        elif key == "S" and pressed:
            self._click(context, spot, visible_splats.color_at, _set_color)
        elif key == "F" and pressed:
            self._sizing = brush.radius, event.mouse_x
        elif key in {"LEFT_BRACKET", "RIGHT_BRACKET"} and pressed:
            brush.radius *= STEP if key == "RIGHT_BRACKET" else 1 / STEP
        elif key == "Z" and (event.ctrl or event.oskey):
            self._undone = True  # handled at the next event, after Blender's undo
            return Answer.PASSED
        elif key in _PANELS | _MODIFIERS or _navigates(key, ctrl=event.ctrl):
            return Answer.PASSED
        # All other keys would change the scene: delete, move, another mode.
        return Answer.TAKEN

    def _begin_stroke(
        self, context: bpy.types.Context, spot: Spot, brush: BrushSettings, *, inverted: bool
    ) -> None:
        self._step_search(wait=True)
        steps = paint_target.begin_stroke(
            paintable(context),
            brush.brush(inverted=inverted),
            spot.view,
            start=spot.point,
            source=np.array(context.scene.cursor.location, np.float64),
            front_only=brush.front_only,
            only_selected=brush.only_selected,
        )
        self._stroke_region = spot.region.as_pointer()
        self._begin_search(context, steps, self._go, way=[spot.point])

    def _begin_search(self, *work: Any, way: list[np.ndarray] | None = None) -> None:
        self._search = _Search(*work, way=way)
        self._step_search(wait=bpy.app.background)

    def _step_search(self, *, wait: bool = False) -> None:
        """Run a step of the search, or with `wait` all steps.

        Raises:
            GsError, ValueError: the search has failed.
        """
        search = self._search
        if search is None:
            return
        try:
            while not (done := search.step()) and wait:
                pass
        except BaseException:
            self._end_search()
            raise
        if not done:
            return
        self._end_search()
        search.then(search)

    def _go(self, search: _Search) -> None:
        """Begin the stroke that was searched for."""
        self._stroke = search.result
        for point in search.way:
            self._stroke.to(point)
        self._stroke.show()
        redraw_views()
        if search.is_released:
            self._finish()

    def _end_search(self) -> None:
        search, self._search = self._search, None
        if search is not None:
            search.end()

    def _finish(self) -> None:
        stroke, self._stroke = self._stroke, None
        self._begin_search(bpy.context, stroke.finish(), _push, way=[])

    def _go_on(self, spot: Spot | None, event: bpy.types.Event) -> Answer:
        """Handle an event during a stroke."""
        if event.type in _MOVES:
            if spot is not None and spot.region.as_pointer() == self._stroke_region:
                self._go_to(spot, shown=event.type == "MOUSEMOVE")
        elif event.type == "LEFTMOUSE" and event.value == "RELEASE":
            if self._search is not None:
                self._search.is_released = True
            else:
                self._finish()
        elif event.type in _DROPS and event.value == "PRESS":
            self._drop()
        return Answer.TAKEN

    def _go_to(self, spot: Spot, *, shown: bool) -> None:
        if self._search is not None:
            if not self._search.is_released:
                self._search.way.append(spot.point)
            return
        self._stroke.to(spot.point)
        if shown:  # else more mouse moves are queued
            self._stroke.show()
            redraw_views()

    def _drop(self) -> None:
        self._end_search()
        stroke, self._stroke = self._stroke, None
        if stroke is not None:
            stroke.cancel()
        redraw_views()

    def _size(self, brush: BrushSettings, event: bpy.types.Event) -> Answer:
        """Handle an event while the mouse sets the radius."""
        radius, x = self._sizing
        if event.type in _ENTERS and event.value == "PRESS":
            self._sizing = None
        elif event.type in _DROPS and event.value == "PRESS":
            brush.radius, self._sizing = radius, None
        elif event.type == "MOUSEMOVE":
            brush.radius = min(max(radius + event.mouse_x - x, 1), LARGEST_RADIUS)
        return Answer.TAKEN

    def _click(
        self,
        context: bpy.types.Context,
        spot: Spot,
        found_at: Callable[..., Steps[Any]],
        then: Callable[[_Search], None],
    ) -> None:
        """Search for something of the splats under the mouse."""
        self._step_search(wait=True)
        steps = found_at(paintable(context), spot.view, spot.point)
        self._begin_search(context, steps, then)

    def _place_cursor(self, spot: Spot | None, brush: BrushSettings) -> None:
        before = self.cursor.state
        region = 0 if spot is None else spot.region.as_pointer()
        if self._sizing is None:  # else it only changes its radius
            place = (0.0, 0.0) if spot is None else (spot.x, spot.y)
            self.cursor.region, self.cursor.place = region, place
        self.cursor.radius, self.cursor.hardness = brush.radius, brush.hardness
        self.cursor.to_source = None
        if isinstance(self._stroke, CloneStroke) and self._stroke.to_source is not None:
            x, y = self._stroke.to_source.tolist()
            self.cursor.to_source = x, -y
        if self.cursor.state != before:
            redraw_views()

    def sentence(self, brush: BrushSettings) -> str:
        """Key hints for the status bar."""
        if self._sizing is not None:
            return (
                f"Radius {brush.radius:.0f} px   |   move the mouse, click to keep, Esc to cancel"
            )
        keys = ["drag to paint"]
        if brush.does == OPACITY:
            keys.append("Ctrl for the opposite")
        elif brush.does == SELECT:
            keys.append("Ctrl to deselect")
        elif brush.does == CLONE:
            keys = ["drag to copy", "Ctrl click to set the source, the 3D cursor"]
        else:
            keys.append("S or Shift click to pick the color under the cursor")
        keys += ["F or [ ] for the radius", "Ctrl Z to undo", "Enter or Esc to end"]
        label = brush.bl_rna.properties["does"].enum_items[brush.does].name
        return f"{label}, {brush.radius:.0f} px   |   {', '.join(keys)}"


def _push(search: _Search) -> None:
    """Make the end of a stroke that reached any splats an undo step."""
    if search.result:
        push_undo(UNDO)
        redraw_views()


def _set_color(search: _Search) -> None:
    bpy.context.window_manager.gscore_paint.color = search.result
    redraw_views()


def _set_source(search: _Search) -> None:
    bpy.context.scene.cursor.location = search.result
    redraw_views()


def _navigates(key: str, *, ctrl: bool) -> bool:
    """True if a key rotates or moves the view."""
    if ctrl and key.startswith(_NUMPAD):
        return key in _NUMPAD_WITH_CTRL
    return key.startswith(_NAVIGATION)


def paintable(context: bpy.types.Context) -> bpy.types.Object:
    """The active splat object, switched to Object Mode, with the shown frame of a sequence.

    Raises:
        GsError, ValueError: there is none, it is hidden, or Blender would not save the changes.
    """
    ob = objects.active_splats(context)
    if not objects.is_splats(ob):
        raise ValueError("Select a splat object to paint on.")
    check_shown(ob)
    editable_check.check(ob.data)
    objects.catch_up(ob)
    if ob.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    return ob


def spot_of(window: bpy.types.Window, x: int, y: int) -> Spot | None:
    """The main region of a 3D view under the mouse; None if there is none, or if another region,
    such as the sidebar or a header, covers it.

    Args:
        window: Window of the event.
        x: Pixels from its lower left.
        y: Pixels from its lower left.
    """
    for area in window.screen.areas:
        if area.type != "VIEW_3D":
            continue
        under = [r for r in area.regions if _holds(r, x, y)]
        if under and all(r.type == "WINDOW" for r in under):
            # The middle of a pixel, as in pictures.
            return Spot(under[0], x - under[0].x + 0.5, y - under[0].y + 0.5)
    return None


def _holds(region: bpy.types.Region, x: int, y: int) -> bool:
    inside = 0 <= x - region.x < region.width and 0 <= y - region.y < region.height
    return inside and region.width > 1 and region.height > 1
