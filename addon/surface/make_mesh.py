"""Make the mesh of a result's surface from scripts and operators: start, and import the mesh."""

from collections.abc import Iterable
from functools import partial

import bpy
from bpy.props import BoolProperty, IntProperty

from ..cameras.capture_transform import origin_of
from ..core import MeshDone, MeshProgress, read_surface
from ..interface.base_operator import Condition
from ..interface.editable_check import keeps
from ..interface.windows import push_undo
from ..process.incremental_tasks import Steps, run_in_thread
from ..render.compositing_scene import collections_in, splats_of_run
from ..render.proxy import MADE, attach
from ..splats.error_maps import finished_run_of, run_of
from ..splats.objects import active_splats, has_trained, proxy_of
from ..training.verb_job import Verb, VerbJob
from ..training.verb_jobs import JOBS, Cancelling, Starting, own_arguments
from . import fit_proxy
from .mesh_object import filled

FILE = "surface.ply"
"""Name of the mesh in the folder of the run."""
TRIANGLES = 200_000
"""Default number of triangles."""


def _message(job: VerbJob) -> str:
    return f"{job.done.triangles:,} triangles."


VERB = Verb(
    running="A mesh of {} is being made already; wait, or stop it.",
    kept="Stopped; no mesh was made.",
    less="close other programs, then make the mesh again",
    progress=(MeshProgress,),
    done=MeshDone,
    message=_message,
    waits=True,
)
"""`gscore mesh` of a run, the folder of which is `source`."""


def make_mesh(
    ob: bpy.types.Object,
    *,
    triangles: int = TRIANGLES,
    closed: bool = False,
    proxy: bool = False,
    wait: bool = False,
) -> VerbJob:
    """Make a mesh of the surface of a splat object's training.

    Args:
        ob: A splat object that comes from a training.
        triangles: Number of triangles; 0: all.
        closed: Close all holes, not only small ones.
        proxy: Make it the proxy of the splats, see `render.proxy`.
        wait: Return when the job has ended and the mesh is in the scene.

    Raises:
        ValueError: something is missing or in the way; the message says what to do.
    """
    run = finished_run_of(ob)
    line = ["mesh", str(run), "-o", str(run / FILE), "--events", "jsonl"]
    line += ["--holes", "closed" if closed else "small"]
    if triangles:
        line += ["--triangles", str(triangles)]
    line += own_arguments(ob)
    arrive = partial(_arriving, uid=ob.session_uid, proxy=proxy)
    return JOBS.start(VERB, line, source=run, arrive=arrive, wait=wait)


def job_of(ob: bpy.types.Object) -> VerbJob | None:
    """The last mesh job of an object's run, running or ended."""
    try:
        return JOBS.of_source(VERB, run_of(ob))
    except ValueError:
        return None


def _arriving(job: VerbJob, *, uid: int, proxy: bool) -> Steps[Iterable[str]]:
    """Import the mesh beside the splats of the run."""
    surface = yield from run_in_thread(lambda check: read_surface(job.done.path), "Reading")
    scene, splats = splats_of_run(job.source, uid)
    if splats is None:
        raise ValueError(f"The splats were removed; the mesh is {job.done.path}.")
    mesh = filled(surface, origin_of(splats), f"{splats.name} surface")
    made = proxy_of(splats) if proxy else None
    if made is not None and MADE in made and keeps(made):
        made.data = mesh
    else:
        made = bpy.data.objects.new(mesh.name, mesh)
        made.parent = splats.parent
        for collection in collections_in(splats, scene):
            collection.objects.link(made)
    made.matrix_world = splats.matrix_world
    if proxy:
        made[MADE] = True
        attach(scene, splats, made)
        yield from fit_proxy.note(splats, made)
    push_undo("Make Mesh")
    return ()


class MakeMesh(Starting, bpy.types.Operator):
    """Make a mesh of the surface of the training's splats, with colors, in the background. It
    collides, casts shadows and is exported as any mesh; edits of the splats do not change it"""

    bl_idname = "gscore.make_mesh"
    bl_label = "Make Mesh"
    needs = Condition(has_trained, "Select splats that come from a training")

    triangles: IntProperty(
        name="Triangles",
        description="Number of triangles to which the mesh is reduced; 0: all of them",
        default=TRIANGLES,
        min=0,
        soft_max=2_000_000,
    )
    closed: BoolProperty(
        name="Close Holes",
        description="Close all holes, where no photo shows a surface; off: only small ones",
        default=False,
    )
    proxy: BoolProperty(
        name="As Proxy",
        description="Let the mesh cast and catch shadows in place of the splats, seen by no camera",
        default=False,
    )

    def start(self, context: bpy.types.Context) -> VerbJob:
        """Start."""
        how = {name: getattr(self, name) for name in ("triangles", "closed", "proxy", "wait")}
        return make_mesh(active_splats(context), **how)


class StopMesh(Cancelling, bpy.types.Operator):
    """Cancel the mesh; none is made"""

    bl_idname = "gscore.stop_mesh"
    bl_label = "Stop"
    none = "No mesh is being made."

    def job_of(self, scene: bpy.types.Scene) -> VerbJob | None:
        """The mesh job of the active object's run."""
        ob = active_splats(bpy.context)
        return None if ob is None else job_of(ob)
