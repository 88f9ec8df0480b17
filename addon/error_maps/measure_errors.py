"""Measure errors of a run from scripts and operators: start, and show the result on
splats and cameras; the operators.
"""

from collections.abc import Iterable
from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty

from .. import stored_paths
from ..attributes import NO_SPLATS
from ..cameras.camera_colors import ShowsColors, hide, marks, own_cameras, set_color, take
from ..cameras.objects import root_of
from ..capture.figures import MEASURED, Figures, measured
from ..core import EvalDone, EvalProgress, colorize
from ..interface.base_operator import BaseOperator, Condition, Undoable
from ..interface.windows import push_undo
from ..process.incremental_tasks import Steps
from ..splats import objects
from ..splats.error_maps import MAP, drop_maps, finished_run_of, is_map, run_of, show_map, siblings
from ..splats.objects import active_splats, has_trained, is_splats
from ..splats.write_chunked import replace
from ..srgb import decode
from ..training import lookups
from ..training.verb_job import Verb, VerbJob
from ..training.verb_jobs import JOBS, Cancelling, Starting, mesh_of, own_arguments

FILE = "errors.ply"
"""Name of the error map in the folder `MEASURED` of the run."""


def _message(job: VerbJob) -> str:
    """Read the figures of all photos; a sentence with the quality of the renders."""
    views = job.done.views
    job.report = Figures(path=job.source / MEASURED / "metrics.json", views=views)
    ranked = job.report.ranked
    if not ranked:
        return f"{len(views)} photos are reproduced exactly."
    return f"{len(views)} photos: {ranked[0][1]:.1f} dB (worst) to {ranked[-1][1]:.1f} dB (best)."


VERB = Verb(
    running="{} is being measured already; wait, or stop it.",
    kept="Stopped; nothing was measured.",
    less="close other programs, then measure again",
    progress=(EvalProgress,),
    done=EvalDone,
    message=_message,
    waits=True,
    expires=(lookups.figures,),
)
"""`gscore eval` of a run, the folder of which is `source`."""


def measure(ob: bpy.types.Object, *, wait: bool = False) -> VerbJob:
    """Measure the run of a splat object on all its photos, training photos included.

    Args:
        ob: A splat object that comes from a training.
        wait: Return when the job has ended and the error map is in the scene.

    Raises:
        ValueError: something is missing or in the way; the message says what to do.
    """
    run = finished_run_of(ob)
    folder = run / MEASURED
    line = ["eval", str(run), "-o", str(folder), "--split", "all", "--overwrite"]
    line += ["--error-map", str(folder / FILE), "--events", "jsonl"]
    line += own_arguments(ob)
    return JOBS.start(VERB, line, source=run, arrive=_arriving, wait=wait)


def job_of(ob: bpy.types.Object) -> VerbJob | None:
    """The last errors job of an object's run, running or ended."""
    try:
        return JOBS.of_source(VERB, run_of(ob))
    except ValueError:
        return None


def remove(ob: bpy.types.Object) -> None:
    """Remove the error map of an object's run, show its splats, and restore camera colors."""
    splats, _ = siblings(ob)
    drop_maps(ob)
    root = root_of(splats[0]) if splats else None
    if root is not None and are_colored(root):
        hide(root)


def _arriving(job: VerbJob) -> Steps[Iterable[str]]:
    """Import the error map."""
    mesh = yield from mesh_of(Path(job.done.error_map))
    try:
        _show(job, mesh)
    except ValueError:
        bpy.data.meshes.remove(mesh)
        raise
    push_undo("Measure Errors")
    return ()


def _show(job: VerbJob, mesh: bpy.types.Mesh) -> None:
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
        color_cameras(root, job.report)


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


_MARK = "error"
_DARKEST = 0.15
"""Position of the best photo in the color map, above 0 because black lines are hard to see."""


def color_cameras(root: bpy.types.Object, figures: Figures) -> int:
    """Color the cameras of a capture by the PSNR of their photos; return their number."""
    ranked, known = figures.ranked, figures.views
    low, high = (ranked[0][1], ranked[-1][1]) if ranked else (0.0, 0.0)
    shown = 0
    for ob in own_cameras(root):
        name = str(ob.get("gs_image", ""))
        if name not in known:
            take(ob)
            continue
        psnr = known[name]
        place = 0.0 if psnr is None or high <= low else (high - psnr) / (high - low)
        set_color(ob, _MARK, color_at(place))
        shown += 1
    return shown


def color_at(place: float) -> tuple[float, ...]:
    """Linear RGBA from the best, 0, to the worst, 1."""
    srgb = colorize(np.array(_DARKEST + (1 - _DARKEST) * place)) / 255.0
    return (*decode(srgb).tolist(), 1.0)


def are_colored(root: bpy.types.Object) -> bool:
    """Whether cameras of a capture are colored by errors."""
    return _MARK in marks(root)


class _OfRun(BaseOperator):
    """Base of the operators on the run of the active splat object."""

    needs = Condition(has_trained, "Select splats that come from a training")


class MeasureErrors(_OfRun, Starting, bpy.types.Operator):
    """Compare the result with all its photos, in the background. Colors the cameras by the errors
    of their photos, and adds an object with the splats colored by their errors"""

    bl_idname = "gscore.measure_errors"
    bl_label = "Measure Errors"

    def start(self, context: bpy.types.Context) -> VerbJob:
        """Start."""
        return measure(active_splats(context), wait=self.wait)


class StopErrors(Cancelling, bpy.types.Operator):
    """Cancel the measurement; no error map is made"""

    bl_idname = "gscore.stop_errors"
    bl_label = "Stop"
    none = "Nothing is being measured."

    def job_of(self, scene: bpy.types.Scene) -> VerbJob | None:
        """The errors job of the active object's run."""
        ob = active_splats(bpy.context)
        return job_of(ob) if is_splats(ob) else None


class ColorByError(ShowsColors, _OfRun, bpy.types.Operator):
    """Color the cameras by the errors of their photos, or restore their colors"""

    bl_idname = "gscore.color_by_error"
    bl_label = "Color Cameras"

    def run(self, context: bpy.types.Context) -> str:
        """Color the cameras, or restore their colors."""
        ob = active_splats(context)
        root = root_of(ob)
        if root is None:
            raise ValueError(f"{ob.name} has no cameras here: use Import Cameras first.")
        if not self.show:
            hide(root)
            return ""
        figures = measured(run_of(ob))
        if figures is None:
            raise ValueError("Press Measure Errors first: the training was not measured since.")
        if not color_cameras(root, figures):
            raise ValueError(f"None of the measured photos has a camera in {root.name}.")
        return ""


class ShowErrorMap(Undoable, _OfRun, bpy.types.Operator):
    """Show the error map, or the splats in their own colors"""

    bl_idname = "gscore.show_error_map"
    bl_label = "Color Splats"

    show: BoolProperty(
        name="Show",
        description="Show the error map instead of the splats; off: show the splats",
        default=True,
        options={"SKIP_SAVE"},
    )

    def run(self, context: bpy.types.Context) -> None:
        """Show the error map or the splats."""
        show_map(active_splats(context), self.show)


class RemoveErrors(Undoable, _OfRun, bpy.types.Operator):
    """Remove the error map, and restore the colors of the cameras"""

    bl_idname = "gscore.remove_errors"
    bl_label = "Remove Errors"

    def run(self, context: bpy.types.Context) -> None:
        """Remove."""
        remove(active_splats(context))
