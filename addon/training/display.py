"""Display of a running training in the open file, its splats and its preview picture, by the poll
timer; the end of trainings when Blender quits.
"""

from pathlib import Path
from typing import Any

import bpy

from .. import preferences, run_links
from ..cameras.objects import note_moves
from ..capture.folders import same_folder
from ..interface import editable_check
from ..interface.option_labels import error_text
from ..interface.windows import push_undo
from ..nodes import display as display_nodes
from ..paths import absolute, output_folder
from ..process import poll_timer
from ..splats.error_maps import drop_maps
from ..splats.objects import hide_points
from ..splats.splat_files import match_capture_origin
from ..splats.write_chunked import ChunkedWrite, replace
from . import lookups, registry, run_state
from .loader import Loaded
from .results import (
    Place,
    capture_of,
    is_own,
    note_filled,
    result_object,
    shown_object,
)
from .training_job import Job
from .verb_jobs import released_at_quit


def place_of(job: Job) -> Place | None:
    """Place of a job's results in the open file: its own scene first, then any with its output."""
    own = [scene for scene in bpy.data.scenes if editable_check.keeps(scene)]
    scenes = sorted(own, key=lambda scene: scene.session_uid != job.scene_uid)
    for scene in scenes:
        for holder in run_links.holders(scene):
            if _leads_to(scene, holder, job):
                return Place(scene, holder)
    return None


def _leads_to(scene: bpy.types.Scene, holder: Any, job: Job) -> bool:
    """True if a holder's output folder is that of a job."""
    try:
        if holder == scene.gscore:
            folder = output_folder(scene, preferences.get().output_folder)
        else:
            folder = absolute(holder.output_path, "Output")
    except ValueError:
        return False
    mine = same_folder(folder, job.output)
    return mine and any(run_links.belongs_to(holder, source) for source in job.sources)


def waits(job: Job) -> bool:
    """True while work is pending: a running trainer, or splats to show here."""
    if not job.state.ended or job.loader.busy:
        return True
    return job.awaits_import and place_of(job) is not None


def is_importing() -> bool:
    """True while splats or their node groups are being created, so that the next poll is due
    soon."""
    return any(job.filling is not None or job.preparations for job in registry.jobs())


def update(job: Job) -> bool:
    """Run the next step of showing a job's picture or splats; True if there was one.

    Does nothing while Blender renders, because the render thread reads the same data.
    """
    if bpy.app.is_job_running("RENDER"):
        return False
    place = place_of(job)
    if place is None:
        job.live_seconds = 0.0
        return False
    if job.preparations:
        job.preparations.pop(0)()
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
        # `images.load` opens the file, which may take 0.1 s the first time.
        image = bpy.data.images.new(name, 1, 1)
        image.source = "FILE"
        holder.preview = image
    image.filepath = str(path)
    image.reload()
    return image


def _remove_discarded(job: Job, place: Place) -> bool:
    """Remove the live splats of a discarded run; True if there were any."""
    ob = shown_object(place.holder, job.output, job.sources)
    over = job.state.status == run_state.DISCARDED and not job.resumed
    if not over or ob is None or not is_own(ob, job) or ob.mode != "OBJECT":
        return False
    mesh = ob.data
    bpy.data.objects.remove(ob)
    if mesh.users == 0:
        bpy.data.meshes.remove(mesh)
    if (root := capture_of(place.scene, job.source)) is not None:
        hide_points(place.scene, root, hidden=False)
    push_undo("Discard Training")
    return True


def _update_splats(job: Job, place: Place) -> bool:
    """Run the next step of importing splats into the scene; True if there was one."""
    result = job.state.result
    if job.awaits_import and not job.result_requested and result is not None:
        job.result_requested = True
        job.load(result, final=True)
    ob = place.holder.result
    if ob is not None and ob.mode != "OBJECT":
        return False  # wait while the user edits the object
    if job.filling is None:
        loaded = job.loader.take()
        if loaded is None:
            return False
        if loaded.problem:
            _give_up(job, loaded, loaded.problem)
            return True
        job.filling = ChunkedWrite(loaded)
        if ob is None:
            job.preparations = (
                display_nodes.builders()
            )  # another file may be open than at the start
            return True
    filling = job.filling
    if not filling.loaded.final and (job.result_requested or not place.scene.gscore.live_splats):
        filling.drop()  # outdated
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
        match_capture_origin(ob, filling.loaded.origin)
        note_filled(ob, job, filling.loaded)
        job.awaits_import = job.awaits_import and not filling.loaded.final
        if (root := capture_of(place.scene, job.source)) is not None:
            if filling.loaded.final:
                note_moves(root, filling.loaded.moves)
            if ob != before:
                hide_points(place.scene, root)
        if filling.loaded.final:
            drop_maps(ob)  # of the previous splats
        if filling.loaded.final or ob != before:
            push_undo("Training Result" if filling.loaded.final else "Live Splats")
    except ValueError as error:
        bpy.data.meshes.remove(mesh)
        _give_up(job, filling.loaded, error_text(error))
    return True


def _give_up(job: Job, loaded: Loaded, problem: str) -> None:
    """Report why splats are not shown; a final result is not tried again."""
    job.state.warn(problem)
    if loaded.final:
        job.awaits_import = False
        job.state.sentence += " The splats could not be shown."


def _collect() -> bool:
    """Run one task of milliseconds per poll: read events, show a picture, import splats.

    Reading and display alternate, because continuous redraws leave so few polls that each one
    finds new events.
    """
    stale = False
    for job in registry.jobs():
        shown = job.has_events and update(job)
        job.has_events = not shown and job.poll()
        if job.has_events and job.state.ended:
            lookups.runs.expire()
            lookups.depth_runs.expire()
        stale |= shown or job.has_events or update(job)
    return stale


_POLLER = poll_timer.Poller(_collect, lambda: any(map(waits, registry.jobs())), is_importing)
APPENDED = (
    (poll_timer.POLLERS, _POLLER),
    (poll_timer.POLLERS, poll_timer.Poller(lookups.collect, lookups.busy)),
)
on_register, on_unregister = released_at_quit(registry.release_all)
