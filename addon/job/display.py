"""Shows in the open file what a training leaves on the disk: splats and a picture."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .. import outcomes, preferences, stored_paths
from ..attributes import NO_SPLATS
from ..cameras.objects import is_kind, note_moves, points_of
from ..capture.folders import same_folder
from ..interface import undo, writable
from ..paths import absolute, output_folder
from ..splats import files, objects
from ..splats.error_maps import drop_maps
from ..splats.filling import Filling, replace
from ..splats.objects import ANTIALIAS
from . import registry, session
from .job import Job
from .loader import Loaded

_FILLED = "gs_filled"
"""Custom property of a result: its `signature` as it came, to know whether it was edited."""
_FILLED_BY = "gs_job"
"""Custom property of a result: the id of the job that filled it last."""


@dataclass(frozen=True)
class Place:
    """Where the open file shows what a job makes."""

    scene: bpy.types.Scene
    holder: Any
    """Has `result` and `preview`: the scene's settings, or the outcome of a capture that is not the
    chosen one."""


def place_of(job: Job) -> Place | None:
    """Where the open file shows what a job makes: its own scene first, then any of that output."""
    own = [scene for scene in bpy.data.scenes if writable.keeps(scene)]
    scenes = sorted(own, key=lambda scene: scene.session_uid != job.scene_uid)
    for scene in scenes:
        for holder in outcomes.holders(scene):
            if _leads_to(scene, holder, job):
                return Place(scene, holder)
    return None


def _leads_to(scene: bpy.types.Scene, holder: Any, job: Job) -> bool:
    """Whether a holder's results are those of a job."""
    try:
        if holder == scene.gscore:
            folder = output_folder(scene, preferences.get().output_folder)
        else:
            folder = absolute(holder.output_path, "Output")
    except ValueError:
        return False
    mine = same_folder(folder, job.output)
    return mine and any(outcomes.holds(holder, source) for source in job.sources)


def waits(job: Job) -> bool:
    """Whether there is something to wait for: a running trainer, or splats to be shown here."""
    if not job.state.ended or job.loader.busy:
        return True
    return job.result_wanted and place_of(job) is not None


def filling() -> bool:
    """Whether splats are on their way, so that the next beat should come soon."""
    return any(job.filling is not None for job in registry.jobs())


def update(job: Job) -> bool:
    """Do the next small thing for a job: show its picture or its splats; whether it did.

    Nothing is touched while Blender renders, which reads the same data in another thread.
    """
    if bpy.app.is_job_running("RENDER"):
        return False
    place = place_of(job)
    if place is None:
        job.live_seconds = 0.0
        return False
    if job.chores:
        job.chores.pop(0)()
        return True
    prefs = preferences.get()
    job.live_seconds = prefs.live_seconds if place.scene.gscore.live_splats else 0.0
    job.live_most = prefs.live_most
    preview = job.state.preview
    if preview is not None and preview.path != job.preview_shown:
        job.preview_shown = preview.path
        show_picture(place.holder, Path(preview.path), f"Test View of {job.source.name}")
        return True
    return _remove_discarded(job, place) or _update_splats(job, place)


def show_picture(holder: Any, path: Path, name: str) -> bpy.types.Image:
    """Show a picture as a capture's test view, in every image editor that shows it."""
    image = holder.preview
    if image is None:
        # `images.load` looks into the file, which may take a tenth of a second the first time.
        image = bpy.data.images.new(name, 1, 1)
        image.source = "FILE"
        holder.preview = image
    image.filepath = str(path)
    image.reload()
    return image


def result_object(place: Place, job: Job, loaded: Loaded) -> bpy.types.Object:
    """The object that shows the splats of a run: the one it has, or a new and empty one.

    One that was edited stays as it is, as does one of an earlier run that this one was not asked to
    replace; the splats go into a new one.
    """
    scene = place.scene
    ob = shown_object(place.holder, job.output, job.sources)
    if ob is not None and scene.objects.get(ob.name) is ob:
        own = job.may_replace or ob.get(_FILLED_BY) == job.id
        edited = was_edited(ob)
        if own and not edited:
            return ob
        for key in (stored_paths.RUN, _FILLED, _FILLED_BY):
            ob.pop(key, None)
        why = "was edited" if edited else "is of an earlier training"
        job.state.warn(f"{ob.name} {why} and is kept; the training goes into a new object.")
    root = capture_of(scene, job.source)
    collection = root.users_collection[0] if root and root.users_collection else scene.collection
    name = _name(job.source)
    ob = objects.create(NO_SPLATS, name, collection=collection, parent=root)
    _note_run(ob, job.output, job.source)
    if loaded.typical_size:
        ob.gscore.point_size = 0.5 * loaded.typical_size
    if job.antialias:
        ob[ANTIALIAS] = True
    if root is None:
        # Else as a first camera that was held level: COLMAP's own worlds have no up.
        files.place(ob, files.UP_AXES["-Y"] if loaded.upright is None else loaded.upright)
    place.holder.result = ob
    return ob


def shown_object(holder: Any, output: Path, sources: Sequence[Path]) -> bpy.types.Object | None:
    """The object that shows the splats of a run, if a holder has it.

    Args:
        holder: See `Place`.
        output: Folder of the run.
        sources: Folders that the capture has, and had; an object of any other is not the run's.
    """
    ob = holder.result
    if ob is None:
        return None
    source = stored_paths.read(ob, stored_paths.SOURCE)
    of_capture = bool(source) and any(same_folder(Path(source), known) for known in sources)
    return ob if is_of_run(ob, output) and of_capture else None


def is_of_run(ob: bpy.types.Object, output: Path) -> bool:
    """Whether an object holds splats of the run in a folder."""
    run = stored_paths.read(ob, stored_paths.RUN)
    return bool(run) and same_folder(Path(run), output)


def _note_run(ob: bpy.types.Object, output: Path, source: Path) -> None:
    stored_paths.write(ob, stored_paths.RUN, output)
    stored_paths.write(ob, stored_paths.SOURCE, source)


def _name(source: Path) -> str:
    return f"{source.name} splats"


def adopt(scene: bpy.types.Scene, ob: bpy.types.Object, output: Path, source: Path) -> None:
    """Let an object with the splats of a run in `output` be what a scene shows of it."""
    ob.name = ob.data.name = _name(source)
    _note_run(ob, output, source)
    ob[_FILLED] = signature(ob)
    scene.gscore.result = ob
    if (root := capture_of(scene, source)) is not None:
        for collection in ob.users_collection:
            collection.objects.unlink(ob)
        writable.link_beside(ob, root)
        _hide_points(scene, root, True)


def was_edited(ob: bpy.types.Object) -> bool:
    """Whether splats of a result were deleted, added or moved since they came."""
    return ob.get(_FILLED, "") not in ("", signature(ob))


def signature(ob: bpy.types.Object) -> str:
    """Tells whether splats were deleted, added or moved; 15 ms for a million."""
    positions = np.empty(3 * len(ob.data.vertices), np.float32)
    ob.data.attributes["position"].data.foreach_get("vector", positions)
    return f"{len(positions) // 3}-{zlib.crc32(positions):08x}"


def _remove_discarded(job: Job, place: Place) -> bool:
    """Take back the live splats of a run that was discarded; whether there were any."""
    ob = shown_object(place.holder, job.output, job.sources)
    over = job.state.status == session.DISCARDED and not job.resumed
    if not over or ob is None or ob.get(_FILLED_BY) != job.id or ob.mode != "OBJECT":
        return False
    mesh = ob.data
    bpy.data.objects.remove(ob)
    if mesh.users == 0:
        bpy.data.meshes.remove(mesh)
    if (root := capture_of(place.scene, job.source)) is not None:
        _hide_points(place.scene, root, False)
    undo.push("Discard Training")
    return True


def _update_splats(job: Job, place: Place) -> bool:
    """Do the next step on the way of splats from a file to the scene; whether there was one."""
    result = job.state.result
    if job.result_wanted and not job.result_requested and result is not None:
        job.result_requested = True
        job.loader.request(result, final=True)
    ob = place.holder.result
    if ob is not None and ob.mode != "OBJECT":
        return False  # what the user edits stays; splats wait
    if job.filling is None:
        loaded = job.take_loaded()
        if loaded is None:
            return False
        if loaded.problem:
            _give_up(job, loaded, loaded.problem)
            return True
        job.filling = Filling(loaded)
    filling = job.filling
    if not filling.loaded.final and (job.result_requested or not place.scene.gscore.live_splats):
        filling.drop()  # late
        job.filling = None
        return True
    mesh = filling.step()
    if mesh is None:
        return True
    job.filling = None
    try:
        before = place.holder.result
        ob = result_object(place, job, filling.loaded)
        replace(ob, mesh)
        ob[_FILLED], ob[_FILLED_BY] = signature(ob), job.id
        job.result_wanted = job.result_wanted and not filling.loaded.final
        if (root := capture_of(place.scene, job.source)) is not None:
            if filling.loaded.final:
                note_moves(root, filling.loaded.moves)
            if ob != before:
                _hide_points(place.scene, root, True)
        if filling.loaded.final:
            drop_maps(ob)  # of what it showed before
        if filling.loaded.final or ob != before:
            undo.push("Training Result" if filling.loaded.final else "Live Splats")
    except ValueError as error:
        bpy.data.meshes.remove(mesh)
        _give_up(job, filling.loaded, str(error))
    return True


def _give_up(job: Job, loaded: Loaded, problem: str) -> None:
    """Say why splats are not shown; a result is not tried again."""
    job.state.warn(problem)
    if loaded.final:
        job.result_wanted = False
        job.state.sentence += " The splats could not be shown."


def _hide_points(scene: bpy.types.Scene, root: bpy.types.Object, hide: bool) -> None:
    """The SfM points of a capture would lie over its splats as black dots; the eye in the outliner
    shows them again."""
    points = points_of(root)
    for layer in scene.view_layers if points is not None else ():
        if points.name in layer.objects:
            points.hide_set(hide, view_layer=layer)


def capture_of(scene: bpy.types.Scene, source: Path) -> bpy.types.Object | None:
    """The empty that carries the alignment of a capture, if the scene has it."""
    for ob in scene.objects:
        text = stored_paths.read(ob, stored_paths.SOURCE)
        if is_kind(ob, "capture") and text and same_folder(Path(text), source):
            return ob
    return None
