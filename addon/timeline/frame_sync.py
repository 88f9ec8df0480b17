"""Frame sync: keeps the meshes of sequence objects on their current frame, and detects edits.

Scripts and renders of other engines get the right frame immediately. In a window the mesh follows
in short steps while nothing plays; until then only the add-on's renderers show the frame.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial

import bpy
from bpy.app.handlers import persistent

from ..core import GsError
from ..interface.blocks import with_uid
from ..interface.option_labels import error_text
from ..interface.windows import redraw_views
from ..process import poll_timer
from ..process.incremental_tasks import Check, Steps, TaskRunner, run_in_thread
from ..splats import live_display, objects
from ..splats.mesh_buffers import Points
from ..splats.write_chunked import ChunkedWrite, filled
from . import mesh, settings
from .frame_at import Moment, moment_of
from .library import LIBRARY, Frame
from .settings import is_sequence, plays

TAKE_FRAMES: set[str] = set()
"""Render engines that take frames from memory instead of meshes."""
_log = logging.getLogger(__name__)


@dataclass
class _State:
    """State of the session."""

    coming: TaskRunner | None = None
    """Running update of a mesh."""
    owner: int = 0
    """Session uid of its object."""
    refused: str = ""
    """`FrameFile.label` of the last frame that could not be written to a mesh."""
    logged: set[str] = field(default_factory=set)
    """Errors already printed to the console."""
    problems: dict[int, str] = field(default_factory=dict)
    """Sync errors by session uid of the object."""
    suspended_sync: int = 0
    """Number of renderers that sample several times within a frame."""


_state = _State()


def problem_of(ob: bpy.types.Object) -> str:
    """Sync error of an object's mesh; empty if none."""
    return _state.problems.get(ob.session_uid, "")


def update_meshes(scene: bpy.types.Scene) -> None:
    """Write the current frames of a scene to its objects' meshes, synchronously."""
    for ob in _players(scene):
        try:
            _bring_one(ob, scene)
        except (GsError, ValueError) as error:
            _report(ob, error_text(error))


def catch_up(ob: bpy.types.Object) -> None:
    """Write the current frame of an object to its mesh, synchronously; edited meshes stay.

    Raises:
        GsError, ValueError: the frame cannot be read, or the mesh cannot be written.
    """
    if ob.type != "MESH" or not plays(ob) or ob.mode == "EDIT":
        return
    note_edits([ob])
    if not plays(ob):
        return
    if _state.owner == ob.session_uid:
        _drop_coming()
    _bring_one(ob, bpy.context.scene)


def _drop_coming() -> None:
    if _state.coming is not None:
        _state.coming.cancel()
    _state.coming = None


@contextmanager
def suspended_sync() -> Iterator[None]:
    """Suspend mesh updates while a renderer that needs no meshes samples a frame's times."""
    _state.suspended_sync += 1
    try:
        yield
    finally:
        _state.suspended_sync -= 1


def note_edits(obs: list[bpy.types.Object]) -> None:
    """Pause objects with an edited mesh, and resume those whose edits were undone."""
    for ob in obs:
        if not is_sequence(ob) or not ob.is_editable or ob.mode == "EDIT":
            continue
        edited = mesh.was_edited(ob)
        if ob.gscore_sequence.edited != edited:
            ob.gscore_sequence.edited = edited


def settings_changed(ob: bpy.types.Object) -> None:
    """Apply changed settings of an object."""
    for scene in bpy.data.scenes:
        if bpy.app.background and scene.objects.get(ob.name) is ob:
            update_meshes(scene)
    redraw_views()
    poll_timer.ensure()


def _players(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    return [ob for ob in scene.objects if ob.type == "MESH" and plays(ob)]


def _bring_one(ob: bpy.types.Object, scene: bpy.types.Scene) -> None:
    moment = moment_of(ob, scene.frame_current_final, wait=True)
    if moment is None:
        return
    if not _is_there(ob, moment):
        mesh.fill_mesh(ob, moment.frame())
    _state.problems.pop(ob.session_uid, None)


def _is_there(ob: bpy.types.Object, moment: Moment) -> bool:
    return mesh.file_label(ob) == moment.file_label


def _report(ob: bpy.types.Object, problem: str) -> None:
    _state.problems[ob.session_uid] = problem
    if problem not in _state.logged:
        _state.logged.add(problem)
        _log.warning("%s", problem)


def _behind() -> Iterator[tuple[bpy.types.Object, Moment]]:
    """Objects with an outdated mesh, and their state; none during live playback."""
    windows = bpy.context.window_manager.windows
    shown = {window.scene.name: window.scene for window in windows}
    for scene in shown.values() or [bpy.context.scene]:
        for ob in _players(scene):
            moment = moment_of(ob, scene.frame_current_final)
            if moment is None or not _may_follow(ob):
                continue
            done = _is_there(ob, moment) or moment.failed() or moment.file_label == _state.refused
            if not done:
                yield ob, moment


def _may_follow(ob: bpy.types.Object) -> bool:
    return bool(ob.is_editable and ob.data.is_editable and ob.mode != "EDIT")


def _collect() -> bool:
    """Run a short step; True if panels need a redraw."""
    came = LIBRARY.take_change()
    if came:
        redraw_views()
    if bpy.app.is_job_running("RENDER"):
        return came
    if _state.coming is not None:
        return _go_on() or came
    windows = bpy.context.window_manager.windows
    playing = any(window.screen.is_animation_playing for window in windows)
    for ob, moment in _behind():
        shows_mesh = ob.gscore.display != "SPLATS" or not live_display.SESSION.works
        if (not playing or shows_mesh) and _begin(ob, moment):
            break
    return came


def _begin(ob: bpy.types.Object, moment: Moment) -> bool:
    """Start to fill an object's mesh, if its frame is in memory."""
    frame = moment.ready()
    if frame is not None:
        _state.owner = ob.session_uid
        _state.coming = TaskRunner(_writing(ob.session_uid, frame))
    return frame is not None


def _prepared(frame: Frame, check: Check) -> tuple[Points, str]:
    columns = tuple(frame.columns())
    return Points(count=len(frame.vertices), columns=columns), mesh.mark_of(columns)


def _go_on() -> bool:
    """Continue to fill the current mesh; True if it is complete."""
    coming, _state.coming = _state.coming, None
    if not coming.step():
        _state.coming = coming
        return False
    return coming.result


def _writing(owner: int, frame: Frame) -> Steps[bool]:
    """Write a frame to a new mesh, and show it; False: it cannot be shown."""
    try:
        points, mark = yield from run_in_thread(partial(_prepared, frame), "")
    except Exception:  # any error of the frame
        _state.refused = frame.file.label
        return False
    [made] = yield from filled([ChunkedWrite(points)])
    ob = with_uid(bpy.data.objects, owner)
    if ob is None or not plays(ob) or not _may_follow(ob):
        bpy.data.meshes.remove(made)
        return False
    mesh.note(made, frame.file, mark)
    try:
        mesh.exchange(ob, made)
    except ValueError as error:
        bpy.data.meshes.remove(made)
        _state.refused = frame.file.label
        _report(ob, error_text(error))
        return True
    _state.problems.pop(owner, None)
    return True


def _waits() -> bool:
    if _state.coming is not None or LIBRARY.busy or LIBRARY.fresh:
        return True
    return not bpy.app.is_job_running("RENDER") and next(_behind(), None) is not None


_POLLER = poll_timer.Poller(_collect, _waits, lambda: _state.coming is not None or LIBRARY.busy)


@persistent
def _frame_changed(scene: bpy.types.Scene, *_: object) -> None:
    if _state.suspended_sync:
        return
    if _at_once(scene):
        update_meshes(scene)
    elif not bpy.app.is_job_running("RENDER") and _players(scene):  # else another thread draws
        poll_timer.ensure()


@persistent
def _render_begins(scene: bpy.types.Scene, *_: object) -> None:
    if scene.render.engine not in TAKE_FRAMES:
        update_meshes(scene)


def _at_once(scene: bpy.types.Scene) -> bool:
    """True if meshes are needed now: by a script, or a render of another engine."""
    renders = bpy.app.is_job_running("RENDER") and scene.render.engine not in TAKE_FRAMES
    return bpy.app.background or renders


@persistent
def _changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Check changed meshes for edits."""
    changed = {u.id.original for u in depsgraph.updates if isinstance(u.id, bpy.types.Mesh)}
    if changed:
        note_edits([ob for ob in scene.objects if ob.type == "MESH" and ob.data in changed])


@persistent
def _undone(*_: object) -> None:
    """Check meshes after undo, which may contain other frames."""
    obs = [ob for ob in bpy.data.objects if ob.type == "MESH" and is_sequence(ob)]
    if obs:
        note_edits(obs)
        poll_timer.ensure()


@persistent
def _file_loaded(*_: object) -> None:
    _state.coming, _state.refused = None, ""
    _state.logged.clear()
    _state.problems.clear()
    LIBRARY.clear()
    if any(_players(scene) for scene in bpy.data.scenes):
        poll_timer.ensure()


HANDLERS = {
    "frame_change_post": _frame_changed,
    "render_pre": _render_begins,
    "depsgraph_update_post": _changed,
    "undo_post": _undone,
    "redo_post": _undone,
    "load_post": _file_loaded,
}


APPENDED = (
    (settings.CHANGED, settings_changed),
    (objects.CATCH_UP, catch_up),
    (poll_timer.POLLERS, _POLLER),
)


def on_unregister() -> None:
    """Drop all frames."""
    _drop_coming()
    LIBRARY.close()
