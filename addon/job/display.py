"""Shows in the open file what a training leaves on the disk: splats and a picture."""

import zlib
from pathlib import Path

import bpy
import numpy as np

from .. import preferences, splat_io, splat_object, stored_paths, undo
from ..camera_objects import is_kind
from ..core import Splats
from ..paths import output_folder
from ..render.scene import ANTIALIAS
from . import registry, session
from .filling import Filling, replace
from .job import Job
from .loader import Loaded

_FILLED = "gs_filled"
"""Custom property of a result: its `_signature` as it came, to know whether it was edited."""
EMPTY = Splats(
    means=np.zeros((0, 3), np.float32),
    quats=np.zeros((0, 4), np.float32),
    scales=np.zeros((0, 3), np.float32),
    opacities=np.zeros(0, np.float32),
    sh0=np.zeros((0, 1, 3), np.float32),
    shN=np.zeros((0, 0, 3), np.float32),
)
"""No splats."""


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


def filling() -> bool:
    """Whether splats are on their way, so that the next beat should come soon."""
    return any(job.filling is not None for job in registry.jobs())


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
    if job.chores:
        job.chores.pop(0)()
        return True
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
        # `images.load` looks into the file, which may take a tenth of a second the first time.
        image = bpy.data.images.new(f"Test View of {scene.name}", 1, 1)
        image.source = "FILE"
        scene.gscore.preview = image
    image.filepath = str(path)
    image.reload()
    return image


def result_object(scene: bpy.types.Scene, job: Job, loaded: Loaded) -> bpy.types.Object:
    """The object that shows the splats of a run: the one it has, or a new and empty one.

    One that was edited stays as it is, and the splats go into a new one.
    """
    ob = scene.gscore.result
    same_run = ob is not None and _is_of(ob, job)
    if same_run and scene.objects.get(ob.name) is ob:
        if ob.get(_FILLED, "") in ("", _signature(ob)):
            return ob
        del ob[stored_paths.RUN], ob[_FILLED]
        job.state.warn(f"{ob.name} was edited and is kept; the training goes into a new object.")
    root = _root(scene, job.source)
    collection = root.users_collection[0] if root and root.users_collection else scene.collection
    name = f"{job.source.name} splats"
    ob = splat_object.create(EMPTY, name, collection=collection, parent=root)
    stored_paths.write(ob, stored_paths.RUN, job.output)
    if loaded.typical_size:
        ob.gscore.point_size = 0.5 * loaded.typical_size
    if job.antialias:
        ob[ANTIALIAS] = True
    if root is None:
        # Else as a first camera that was held level: COLMAP's own worlds have no up.
        splat_io.place(ob, splat_io.UP_AXES["-Y"] if loaded.upright is None else loaded.upright)
    scene.gscore.result = ob
    return ob


def _is_of(ob: bpy.types.Object, job: Job) -> bool:
    """Whether an object shows the splats of a job's run."""
    run = stored_paths.read(ob, stored_paths.RUN)
    return bool(run) and registry.same_folder(Path(run), job.output)


def _signature(ob: bpy.types.Object) -> str:
    """Tells whether splats were deleted, added or moved; 15 ms for a million."""
    positions = np.empty(3 * len(ob.data.vertices), np.float32)
    ob.data.attributes["position"].data.foreach_get("vector", positions)
    return f"{len(positions) // 3}-{zlib.crc32(positions):08x}"


def _remove_discarded(job: Job, scene: bpy.types.Scene) -> bool:
    """Take back the live splats of a run that was discarded; whether there were any."""
    ob = scene.gscore.result
    over = job.state.status == session.DISCARDED and not job.resumed
    if not over or ob is None or not _is_of(ob, job) or ob.mode != "OBJECT":
        return False
    mesh = ob.data
    bpy.data.objects.remove(ob)
    if mesh.users == 0:
        bpy.data.meshes.remove(mesh)
    undo.push("Discard Training")
    return True


def _update_splats(job: Job, scene: bpy.types.Scene) -> bool:
    """Do the next step on the way of splats from a file to the scene; whether there was one."""
    result = job.state.result
    if job.result_wanted and not job.result_requested and result is not None:
        job.result_requested = True
        job.loader.request(result, final=True)
    ob = scene.gscore.result
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
    if not filling.loaded.final and (job.result_requested or not scene.gscore.live_splats):
        filling.drop()  # late
        job.filling = None
        return True
    mesh = filling.step()
    if mesh is None:
        return True
    job.filling = None
    try:
        before = scene.gscore.result
        ob = result_object(scene, job, filling.loaded)
        replace(ob, mesh)
        ob[_FILLED] = _signature(ob)
        job.result_wanted = job.result_wanted and not filling.loaded.final
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


def _root(scene: bpy.types.Scene, source: Path) -> bpy.types.Object | None:
    """The empty that carries the alignment of the capture."""
    for ob in scene.objects:
        text = stored_paths.read(ob, stored_paths.SOURCE)
        if is_kind(ob, "capture") and text and registry.same_folder(Path(text), source):
            return ob
    return None
