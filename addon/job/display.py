"""Shows in the open file what a training leaves on the disk: splats and a picture."""

from pathlib import Path

import bpy

from .. import preferences, splat_object
from ..camera_objects import is_kind
from ..paths import output_folder
from . import registry, session
from .job import Job
from .loader import Loaded

RUN_KEY = "gs_run"
"""Custom property of a result: the output folder it came from."""


def scene_of(job: Job) -> bpy.types.Scene | None:
    """The scene of the open file whose output is that of the job."""
    default = preferences.get().output_folder
    for scene in bpy.data.scenes:
        try:
            folder = output_folder(scene, default)
        except ValueError:
            continue
        if registry.same_folder(folder, job.output):
            return scene
    return None


def waits(job: Job) -> bool:
    """Whether there is something to wait for: a running trainer, or splats to be shown here."""
    if not job.state.ended or job.loader.busy:
        return True
    return job.result_wanted and scene_of(job) is not None


def update(job: Job) -> bool:
    """Do the next small thing for a job: show its picture or its splats; whether it did.

    Nothing is touched while Blender renders, which reads the same data in another thread.
    """
    if bpy.app.is_job_running("RENDER"):
        return False
    scene = scene_of(job)
    if scene is None:
        job.live_seconds = 0.0
        return False
    prefs = preferences.get()
    job.live_seconds = prefs.live_seconds if scene.gscore.live_splats else 0.0
    job.live_most = prefs.live_most
    preview = job.state.preview
    if preview is not None and preview.path != job.preview_shown:
        job.preview_shown = preview.path
        show_picture(scene, Path(preview.path))
        return True
    return _remove_discarded(job, scene) or _update_splats(job, scene)


def show_picture(scene: bpy.types.Scene, path: Path) -> bpy.types.Image:
    """Show a picture as the scene's test view, in every image editor that shows it."""
    image = scene.gscore.preview
    if image is None:
        image = bpy.data.images.load(str(path))
        image.name = f"Test View of {scene.name}"
        scene.gscore.preview = image
    else:
        image.filepath = str(path)
        image.reload()
    return image


def show_splats(scene: bpy.types.Scene, loaded: Loaded, job: Job) -> bpy.types.Object:
    """Show splats as the scene's result: in the object of the same run, or in a new one.

    Raises:
        ValueError: the object is being edited, or its mesh cannot be written.
    """
    assert loaded.splats is not None
    ob = scene.gscore.result
    same_run = ob is not None and ob.get(RUN_KEY) == str(job.output)
    if same_run and scene.objects.get(ob.name) is ob:
        splat_object.refresh(ob, loaded.splats)
        return ob
    root = _root(scene, job.source)
    collection = root.users_collection[0] if root and root.users_collection else scene.collection
    name = f"{job.source.name} splats"
    ob = splat_object.create(loaded.splats, name, collection=collection, parent=root)
    ob[RUN_KEY] = str(job.output)
    scene.gscore.result = ob
    return ob


def _remove_discarded(job: Job, scene: bpy.types.Scene) -> bool:
    """Take back the live splats of a run that was discarded; whether there were any."""
    ob = scene.gscore.result
    over = job.state.status == session.DISCARDED and not job.resumed
    if not over or ob is None or ob.get(RUN_KEY) != str(job.output) or ob.mode != "OBJECT":
        return False
    mesh = ob.data
    bpy.data.objects.remove(ob)
    if mesh.users == 0:
        bpy.data.meshes.remove(mesh)
    return True


def _update_splats(job: Job, scene: bpy.types.Scene) -> bool:
    result = job.state.result
    if job.result_wanted and not job.result_requested and result is not None:
        job.result_requested = True
        job.loader.request(result, final=True)
    ob = scene.gscore.result
    if ob is not None and ob.mode != "OBJECT":
        return False  # what the user edits stays; splats wait
    loaded = job.take_loaded()
    if loaded is None:
        return False
    if loaded.final:
        job.result_wanted = False
    elif job.result_requested or not scene.gscore.live_splats:
        return False  # late
    problem = loaded.problem
    if loaded.splats is not None:
        try:
            show_splats(scene, loaded, job)
        except (ValueError, RuntimeError) as error:
            problem = str(error)
    if problem:
        job.state.warn(problem)
        if job.state.ended and job.state.status != session.FAILED:
            job.state.sentence += " The splats could not be shown."
    return True


def _root(scene: bpy.types.Scene, source: Path) -> bpy.types.Object | None:
    """The empty that carries the alignment of the capture."""
    for ob in scene.objects:
        text = ob.get("gs_source")
        if is_kind(ob, "capture") and text and registry.same_folder(Path(text), source):
            return ob
    return None
