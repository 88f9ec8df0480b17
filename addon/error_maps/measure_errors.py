"""Measure errors of a run from scripts and operators: start, and show the result."""

from pathlib import Path

import bpy

from .. import preferences, stored_paths
from ..attributes import NO_SPLATS
from ..cameras.camera_colors import hide
from ..cameras.objects import root_of
from ..capture.figures import MEASURED
from ..interface import undo
from ..interface.option_labels import error_words
from ..nodes import display as display_nodes
from ..process import poll_timer
from ..splats import objects
from ..splats.error_maps import MAP, drop_maps, is_map, run_of, show_map, siblings
from ..splats.write_chunked import ChunkedWrite, replace
from ..training.launch import follow, launch
from . import colors
from .errors_job import ErrorsJob
from .job_registry import JOBS

FILE = "errors.ply"
"""Name of the error map in the folder `MEASURED` of the run."""


def measure(
    ob: bpy.types.Object, *, wait: bool = False, python: str | Path | None = None
) -> ErrorsJob:
    """Measure the run of a splat object on all its photos, training photos included.

    Args:
        ob: A splat object that comes from a training.
        wait: Return when the job has ended and the error map is in the scene.
        python: The Python that measures; None: that of the preferences.

    Raises:
        ValueError: something is missing or in the way; the message says what to do.
    """
    run = run_of(ob)
    other = JOBS.of_source(run)
    if other is not None and (other.busy or other.wanted):
        raise ValueError(f"{run} is being measured already; wait, or stop it.")
    if not (run / "point_cloud.ply").is_file():
        raise ValueError(f"{run} has no finished training; complete the training first.")
    folder = run / MEASURED
    line = ["eval", str(run), "-o", str(folder), "--split", "all", "--overwrite"]
    line += ["--error-map", str(folder / FILE), "--events", "jsonl"]
    source = stored_paths.read(ob, stored_paths.SOURCE)
    if source and Path(source).is_dir():
        line += ["-s", source]
    if threads := preferences.get().threads:
        line += ["--threads", str(threads)]
    job = launch(lambda program: ErrorsJob(program, line, source=run, after=other), python)
    JOBS.add(job)
    poll_timer.ensure()
    follow(lambda: wait and (not job.ended or job.wanted))
    return job


def job_of(ob: bpy.types.Object) -> ErrorsJob | None:
    """The last errors job of an object's run, running or ended."""
    try:
        return JOBS.of_source(run_of(ob))
    except ValueError:
        return None


def remove(ob: bpy.types.Object) -> None:
    """Remove the error map of an object's run, show its splats, and restore camera colors."""
    splats, _ = siblings(ob)
    drop_maps(ob)
    root = root_of(splats[0]) if splats else None
    if root is not None and colors.shown(root):
        hide(root)


def bring_in(job: ErrorsJob) -> bool:
    """Do the next step of importing an error map; return whether there was one."""
    if not job.wanted or bpy.app.is_job_running("RENDER") or bpy.context.mode != "OBJECT":
        return False
    if job.filling is None:
        loaded = job.loader.take()
        if loaded is None:
            return False
        if loaded.problem:
            job.wanted = False
            job.warnings.append(loaded.problem)
            return True
        job.filling, job.chores = ChunkedWrite(loaded), display_nodes.builders()
    if job.chores:
        job.chores.pop(0)()
        return True
    mesh = job.filling.step()
    if mesh is None:
        return True
    job.filling, job.wanted = None, False
    try:
        _show(job, mesh)
    except ValueError as error:
        bpy.data.meshes.remove(mesh)
        job.warnings.append(error_words(error))
    undo.push("Measure Errors")
    return True


def _show(job: ErrorsJob, mesh: bpy.types.Mesh) -> None:
    """Make the error map's object at the transform of the splats, and color the cameras."""
    found = (o for o in bpy.context.scene.objects if objects.is_splats(o) and not is_map(o))
    ob = next((o for o in found if stored_paths.read(o, stored_paths.RUN) == str(job.source)), None)
    if ob is None:
        raise ValueError(
            f"The splats were removed from the scene; the map is in {job.source / MEASURED}."
        )
    maps = siblings(ob)[1]
    shown = maps[0] if maps else _made(ob)
    replace(shown, mesh)
    show_map(ob, True)
    root = root_of(ob)
    if root is not None:
        colors.show(root, job.figures)


def _made(ob: bpy.types.Object) -> bpy.types.Object:
    """An empty object for the error map of `ob`, with its transform."""
    made = objects.create(
        NO_SPLATS, f"{ob.name} errors", collection=ob.users_collection[0], parent=ob.parent
    )
    made[MAP] = True
    for key in (stored_paths.RUN, stored_paths.SOURCE):
        stored_paths.write(made, key, stored_paths.read(ob, key))
    if ob.get(objects.ANTIALIAS):
        made[objects.ANTIALIAS] = True
    made.gscore.point_size = ob.gscore.point_size
    made.matrix_world = ob.matrix_world
    return made
