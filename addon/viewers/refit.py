"""Refit splats to Blender's drawing from scripts and operators: start, and import the result."""

from collections.abc import Iterable
from functools import partial
from pathlib import Path

import bpy
from mathutils import Matrix

from .. import compat, stored_paths
from ..cameras.capture_transform import note_origin, noted_origin
from ..core import RefitDone, RefitProgress, offset_between
from ..interface import editable_check
from ..interface.base_operator import Condition, make_active_in
from ..interface.windows import push_undo
from ..process.incremental_tasks import Steps
from ..render.compositing_scene import collections_in, splats_of_run
from ..splats import objects, settings
from ..splats.error_maps import finished_run_of, is_map, refits_of, run_of
from ..splats.objects import active_splats, has_trained, in_question
from ..training.loader import Loaded
from ..training.verb_job import Verb, VerbJob
from ..training.verb_jobs import JOBS, Cancelling, Starting, loaded_mesh, own_arguments

EEVEE, CYCLES = "blender", "blender-cycles"
_LABELS = {EEVEE: "EEVEE", CYCLES: "Cycles"}
"""Names of the engines by the viewer of `gscore refit`."""


def _message(job: VerbJob) -> str:
    return f"Splats fitted to {_LABELS[job.done.viewer]} were made as a new object."


VERB = Verb(
    running="The splats of {} are being refitted already; wait, or stop it.",
    kept="Stopped; no splats were made.",
    less="close other programs, then refit again",
    progress=(RefitProgress,),
    done=RefitDone,
    message=_message,
    waits=True,
)
"""`gscore refit` of a run, the folder of which is `source`."""


def refit(ob: bpy.types.Object, viewer: str, *, wait: bool = False) -> VerbJob:
    """Fit the splats of an object's training to an engine of Blender, as a new object.

    Args:
        ob: A splat object that comes from a training.
        viewer: `EEVEE` or `CYCLES`.
        wait: Return when the job has ended and the new object is in the scene.

    Raises:
        ValueError: something is missing or in the way; the message says what to do.
    """
    if not compat.splat_cloud_type():
        raise ValueError("Native splats need Blender 5.3.")
    editable_check.check(ob)  # it is hidden in the end
    run = finished_run_of(ob)
    output = run / f"refit_{viewer}.ply"
    line = ["refit", str(run), "--for-viewer", viewer, "-o", str(output)]
    line += ["--views", "0", "--events", "jsonl", *own_arguments(ob)]  # measuring takes minutes
    arrive = partial(_arriving, uid=ob.session_uid)
    return JOBS.start(VERB, line, source=run, arrive=arrive, wait=wait)


def viewer_of(scene: bpy.types.Scene) -> str:
    """The viewer for a scene's engine: Cycles, else EEVEE."""
    return CYCLES if scene.render.engine == "CYCLES" else EEVEE


def fitted_to(ob: bpy.types.Object) -> str:
    """Name of the engine that an object's splats are fitted to; empty: none."""
    path = stored_paths.read(ob, stored_paths.REFIT)
    return _LABELS.get(Path(path).stem.removeprefix("refit_"), "")


def job_of(ob: bpy.types.Object) -> VerbJob | None:
    """The last refit of the run of splats or refitted splats, running or ended."""
    path = stored_paths.read(ob, stored_paths.REFIT)
    try:
        return JOBS.of_source(VERB, Path(path).parent if path else run_of(ob))
    except ValueError:
        return None


def _arriving(job: VerbJob, *, uid: int) -> Steps[Iterable[str]]:
    """Import the splats in place of those of the run, which are hidden."""
    mesh, loaded = yield from loaded_mesh(Path(job.done.path))
    scene, splats = splats_of_run(job.source, uid)
    if splats is None:
        bpy.data.meshes.remove(mesh)
        raise ValueError(f"The splats were removed; the refitted ones are {job.done.path}.")
    mesh.name = f"{splats.name} {_LABELS[job.done.viewer]}"
    made = _made(mesh, splats, scene, loaded)
    for ob in (splats, *_maps(scene, job.source), *refits_of(scene, job.source)):
        objects.hide(ob, scene)
        ob.hide_render = True
    stored_paths.write(made, stored_paths.REFIT, job.done.path)
    for layer in scene.view_layers:
        if layer.objects.active == splats and made.name in layer.objects:
            make_active_in(layer, made)
    push_undo(RefitSplats.bl_label)
    return ()


def _made(
    mesh: bpy.types.Mesh, splats: bpy.types.Object, scene: bpy.types.Scene, loaded: Loaded
) -> bpy.types.Object:
    """An object for the mesh at the place of the splats, with their filters, as native splats."""
    collection = collections_in(splats, scene)[0]
    made = objects.around(mesh, loaded.typical_size, collection=collection, parent=splats.parent)
    before = noted_origin(splats)
    origin = before if loaded.origin is None else loaded.origin
    # Not by matrix_world, which is stale where splats are hidden.
    for name in ("parent_type", "parent_bone", "matrix_parent_inverse"):
        setattr(made, name, getattr(splats, name))
    shift = Matrix.Translation(offset_between(origin, before))
    made.matrix_basis = splats.matrix_basis @ shift
    note_origin(made, origin)
    source = stored_paths.read(splats, stored_paths.SOURCE)
    stored_paths.write(made, stored_paths.SOURCE, source)
    for name in settings.FILTERS:
        setattr(made.gscore, name, getattr(splats.gscore, name))
    made.gscore.display = "NATIVE"
    return made


def _maps(scene: bpy.types.Scene, run: Path) -> list[bpy.types.Object]:
    """The error maps of a run."""
    return [ob for ob in scene.objects if is_map(ob) and run_of(ob) == run]


class RefitSplats(Starting, bpy.types.Operator):
    """Fit the training's splats to EEVEE, or to Cycles if it is the scene's engine, in the
    background, so that they look as trained there. They become a new object, and these splats are
    hidden; edits of the splats are not in it"""

    bl_idname = "gscore.refit_splats"
    bl_label = "Refit for Blender"
    needs = Condition(
        lambda context: (
            bool(compat.splat_cloud_type())
            and has_trained(context)
            and not is_map(active_splats(context))
        ),
        "Select splats that come from a training, no error map; native splats need Blender 5.3",
    )

    def start(self, context: bpy.types.Context) -> VerbJob:
        """Start."""
        return refit(active_splats(context), viewer_of(context.scene), wait=self.wait)


class StopRefit(Cancelling, bpy.types.Operator):
    """Cancel the refit; no splats are made"""

    bl_idname = "gscore.stop_refit"
    bl_label = "Stop"
    none = "No splats are being refitted."

    def job_of(self, scene: bpy.types.Scene) -> VerbJob | None:
        """The refit of the run of the panel's splats."""
        ob = in_question(bpy.context)
        return None if ob is None else job_of(ob)
