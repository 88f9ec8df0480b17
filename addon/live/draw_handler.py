"""Draw handler: draws splats over the 3D views of this Blender session, and where
the engine's picture is not ready; a notice where the graphics card does not draw them.
"""

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import bpy
import gpu
from bpy.app.handlers import persistent

from ..compat import draws_into_views, matrix_to_numpy
from ..interface import viewport_text
from ..interface.option_labels import error_text
from ..interface.windows import redraw_views
from ..process.incremental_tasks import Pace
from ..render import viewport, viewport_copies
from ..render.engine import final_cache
from ..render.operators import changes_colors
from ..render.regions import drawn_window
from ..render.scene import Placed, Source, sources
from ..render.selections import tinted_in
from ..splats import settings as splat_settings
from ..splats.live_display import SESSION
from ..splats.objects import is_splats
from . import view_context
from .card import Card
from .view_context import cuts_of, has_lines_in_front, is_hidden_by_others, is_own, keeps_colors
from .views import View


class LiveFallback:
    """Live drawing, for `render.viewport.FALLBACKS`."""

    def __init__(self, views: Mapping[int, View]) -> None:
        """Keep the known views, by the pointer of their region."""
        self._views = views

    def draws_live(self, context: bpy.types.Context) -> bool:
        """Whether splats are drawn live there. Their colours must match the picture's, except with
        a photo behind them, which shows its own colours too."""
        wanted = SESSION.works and context.scene.gscore_render.live
        return wanted and (not changes_colors(context.scene) or self.stays(context))

    def moves(self, context: bpy.types.Context) -> bool:
        """Whether its view has just changed, so that a picture would be outdated."""
        view = self._views.get(context.region.as_pointer())
        return view is not None and view.level.moving

    def stays(self, context: bpy.types.Context) -> bool:
        """Whether there is a photo behind the splats, which Blender would draw over a picture; no
        picture is needed then, unless there are holdouts."""
        return "BACK" in view_context.photo_depths(context)

    def covers_photos(self, context: bpy.types.Context) -> bool:
        """Whether there are pictures behind the splats and none in front, which it would cover."""
        return SESSION.works and view_context.photo_depths(context) == {"BACK"}


POLL = 0.02
"""Seconds between two checks whether a view must be redrawn."""
_TRIES = 3
"""Attempts after a failure of the graphics card."""
_PAUSE = 1.0
"""Seconds before each."""
_FORGIVEN = 60.0
"""Seconds without a failure after which the count starts again."""
_log = logging.getLogger(__name__)


@dataclass
class _State:
    """State of the session."""

    card: Card | None = None
    views: dict[int, View] = field(default_factory=dict)
    """Views by the pointer of their region."""
    failures: int = 0
    """Consecutive failures of the graphics card."""
    paused_until: float = float("-inf")
    """Monotonic seconds before which nothing is drawn."""
    scene: gpu.types.GPUFrameBuffer | None = None
    """Blender's target of the view being drawn, valid during its drawing only."""
    problems: dict[int, str] = field(default_factory=dict)
    """Messages of views, by the pointer of their region."""
    unfinished: set[int] = field(default_factory=set)
    """Pointers of regions whose last redraw compiled or copied a part, but not all."""
    pace: Pace = field(default_factory=Pace)
    """Pace of `_poll`: the slower redraws are, the more each may copy and upload."""


_state = _State()


_STAND_IN = LiveFallback(_state.views)


def view_of(region: bpy.types.Region) -> View | None:
    """The live view of a region, if there is one."""
    return _state.views.get(region.as_pointer())


def problem_of(region: bpy.types.Region) -> str:
    """Why a region shows no live splats; empty if it does."""
    own = _state.problems.get(region.as_pointer(), "")
    return " ".join(filter(None, (SESSION.problem, own)))


def shown(context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> list[Source]:
    """The splat objects drawn live in the view of a context."""
    space = context.space_data
    own = is_own(context)
    if space.shading.type == "WIREFRAME" or (own and not _STAND_IN.draws_live(context)):
        return []
    found = sources(depsgraph)
    viewport_copies.SHARED.keep_only(found)
    return [
        source
        for source in found
        if (own or source.ob.original.gscore.display == "SPLATS")
        and source.shown_by.visible_in_viewport_get(space)
    ]


def draw(context: bpy.types.Context) -> None:
    """Draw the view of a context; called by Blender after everything else in it."""
    pointer = context.region.as_pointer()
    if not SESSION.works or context.region_data is None:
        return
    over = viewport.OVER.get(pointer) if is_own(context) else None
    if over is None and pointer in viewport.EXACT and is_own(context):
        return
    if time.monotonic() < _state.paused_until:
        return
    try:
        if over is None:
            _draw(context, pointer)
        else:
            pixels = over.renderer.pixels
            if pixels is not None:  # over the background pictures that Blender has drawn over it
                over.draw_over(pixels)
        _state.problems.pop(pointer, None)
    except ValueError as error:
        _state.problems[pointer] = error_text(error)
    except Exception as error:  # drivers raise anything; Blender would print it at each redraw
        _failed(error, pointer)


def _draw(context: bpy.types.Context, pointer: int) -> None:
    depsgraph = context.evaluated_depsgraph_get()
    found = shown(context, depsgraph)
    # In the engine's own shading, filters apply as in renders.
    placed, _ = viewport_copies.SHARED.copied(
        found, always_filtered=not is_own(context), spare=_state.pace.spare
    )
    compiled = not found or _compiled()
    if not compiled or viewport_copies.SHARED.under_way(found):
        _state.unfinished.add(pointer)
        _ensure()
    if not placed or not compiled:
        return
    view = _state.views.get(pointer)
    if view is None:
        view = _state.views[pointer] = View(final_cache)
    try:
        _show(context, depsgraph, view, placed)
    finally:  # a missing picture may be ready soon
        if view.waits:
            _ensure()


def _compiled() -> bool:
    """Compile a program, or more where redraws are slow; return whether all are compiled."""
    until = time.perf_counter() + _state.pace.spare
    if _state.card is None:
        _state.card = Card()
    while not _state.card.step() and time.perf_counter() < until:
        pass
    return _state.card.ready


def _show(
    context: bpy.types.Context,
    depsgraph: bpy.types.Depsgraph,
    view: View,
    placed: list[Placed],
) -> None:
    rv3d = context.region_data
    matrix, window = (matrix_to_numpy(m) for m in (rv3d.view_matrix, rv3d.window_matrix))
    part = gpu.state.viewport_get()
    camera = viewport.view_camera(matrix, window, *part[2:], perspective=rv3d.is_perspective)
    front = has_lines_in_front(context, depsgraph)
    hides = is_hidden_by_others(context, depsgraph)
    antialias = context.scene.gscore_render.antialias
    cuts = cuts_of(context)
    tinted = tinted_in(context.space_data, own=is_own(context))
    region = drawn_window(context, window, *part[2:])
    read = partial(view.depths.read, *part, front=front) if hides else None
    picture = view.draw(
        *(_state.card, placed, camera, window, antialias, read),
        front=front,
        cuts=cuts,
        tinted=tinted,
        spare=_state.pace.spare,
    )
    if picture is not None:
        photo = view_context.in_front(context, window, *part[2:])
        rests = photo is None and picture.nearness is None and not view.level.moving
        within = _state.scene if rests and keeps_colors(context) else None
        _state.card.show(picture, part, photo, within, region)


def _failed(error: Exception, pointer: int) -> None:
    """Release everything on the graphics card and try again later; if that is hopeless, show
    points."""
    reason, now = error_text(error), time.monotonic()
    if now - _state.paused_until > _FORGIVEN:
        _state.failures = 0
    compiled = _state.card is not None and _state.card.ready
    refused = not compiled and not _state.failures
    _state.failures += 1
    _close_views()
    _state.card = None
    _calm()
    if _state.failures == 1:
        _log.exception("Splats cannot be drawn live.")
    if refused or _state.failures > _TRIES:
        SESSION.problem = (
            f"The graphics card cannot draw splats ({reason}); views show points. Rendered shading "
            "of the engine Gaussian Splats shows splats."
        )
        _log.warning(SESSION.problem)
        _soon(_show_points, 0.0)  # data must not change during drawing
        return
    _state.paused_until = now + _PAUSE
    _state.problems[pointer] = (
        f"The graphics card failed to draw splats ({reason}); the add-on tries again."
    )
    _soon(redraw_views, _PAUSE)


def _calm() -> None:
    """Reset the state of the graphics card for Blender, if possible."""
    try:
        gpu.state.blend_set("NONE")
        gpu.state.depth_test_set("NONE")
    except Exception:
        _log.debug("The state of the graphics card is lost.", exc_info=True)


def _soon(timer: Callable[[], None], seconds: float) -> None:
    if not bpy.app.timers.is_registered(timer):
        bpy.app.timers.register(timer, first_interval=seconds)


def _show_points() -> None:
    for ob in bpy.data.objects:
        if is_splats(ob):
            splat_settings.apply(ob)


def _ensure() -> None:
    if not bpy.app.timers.is_registered(_poll):
        bpy.app.timers.register(_poll, first_interval=POLL)


def _poll() -> float | None:
    _state.pace.begin()
    interval = POLL if _redraw_stale() else None
    _state.pace.end(interval)
    return interval


def _redraw_stale() -> bool:
    """Redraw views that have a new picture or have come to rest; return whether any is pending."""
    regions = {}
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                regions |= {r.as_pointer(): r for r in area.regions if r.type == "WINDOW"}
    for pointer in _state.views.keys() - regions.keys():
        _state.views.pop(pointer).close()
    unfinished = _state.unfinished & regions.keys()
    for pointer in unfinished:
        regions[pointer].tag_redraw()
    _state.unfinished.clear()  # a minimised window is not drawn and needs no more
    waiting = bool(unfinished)
    for pointer, view in _state.views.items():
        if view.stale(time.monotonic()):
            regions[pointer].tag_redraw()
        waiting |= view.waits
    return waiting


@persistent
def _changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if SESSION.there:
        viewport_copies.SHARED.forget_changed(depsgraph)


@persistent
def _file_loaded(*_: object) -> None:
    _close_views()
    viewport_copies.SHARED.clear()


def _close_views() -> None:
    for view in _state.views.values():
        view.close()
    for kept in (_state.views, _state.problems, _state.unfinished):
        kept.clear()


def _before_handler() -> None:
    _state.scene = None
    if not SESSION.works:
        return
    try:
        if draws_into_views():
            _state.scene = gpu.state.active_framebuffer_get()
    except Exception:  # the drawing that follows reports it
        _log.debug("The target of a view is not known.", exc_info=True)


def _draw_handler() -> None:
    draw(bpy.context)
    _state.scene = None


HANDLERS = {"depsgraph_update_post": _changed, "load_post": _file_loaded}
APPENDED = ((viewport.FALLBACKS, _STAND_IN),)


def on_register() -> None:
    """Draw live, unless Blender runs in the background."""
    SESSION.there = not bpy.app.background


def on_unregister() -> None:
    """Stop drawing, and release everything on the graphics card."""
    for timer in (_poll, redraw_views, _show_points):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
    _close_views()
    _state.card, _state.failures = None, 0
    SESSION.there, SESSION.problem = False, ""


_NOTICE_MARGIN = 12.0
"""Pixels at a resolution scale of 1."""
_NOTICE_COLOR = 1.0, 0.75, 0.2, 1.0


def _wrapped(text: str, width: float, scale: float) -> list[str]:
    """A text wrapped to a width in pixels."""
    found: list[str] = []
    for word in text.split():
        longer = f"{found[-1]} {word}" if found else word
        if found and viewport_text.width_of(longer, scale) <= width:
            found[-1] = longer
        else:
            found.append(word)
    return found


def _draw_notice() -> None:
    context = bpy.context
    overlay = context.space_data.overlay
    text = problem_of(context.region)
    if not text or not (overlay.show_overlays and overlay.show_text):
        return
    if not any(map(is_splats, context.scene.objects)):
        return
    scale = context.preferences.system.ui_scale
    sidebar = [r.width for r in context.area.regions if r.type == "UI"]  # overlaps the view
    shown = _wrapped(text, context.region.width - sum(sidebar) - 4 * _NOTICE_MARGIN * scale, scale)
    for number, line in enumerate(reversed(shown)):
        height = (_NOTICE_MARGIN + 1.5 * viewport_text.SIZE * number) * scale
        viewport_text.write(line, 2 * _NOTICE_MARGIN * scale, height, scale, _NOTICE_COLOR)


DRAWING = (
    (_before_handler, "PRE_VIEW"),
    (_draw_handler, "POST_VIEW"),
    (_draw_notice, "POST_PIXEL"),
)
