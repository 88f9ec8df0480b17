"""Error map operators: measure the errors of a result, and show them."""

import bpy
from bpy.props import BoolProperty

from ..cameras.camera_colors import hide
from ..cameras.objects import root_of
from ..capture.figures import measured
from ..interface.base_operator import BaseOperator, Condition, Undoable
from ..splats.objects import active_splats, has_trained, is_splats
from ..training.verb_job import VerbJob
from ..training.verb_jobs import Cancelling, Starting
from . import measure_errors


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
        return measure_errors.measure(active_splats(context), wait=self.wait)


class StopErrors(Cancelling, bpy.types.Operator):
    """Cancel the measurement; no error map is made"""

    bl_idname = "gscore.stop_errors"
    bl_label = "Stop"
    none = "Nothing is being measured."

    def job_of(self, scene: bpy.types.Scene) -> VerbJob | None:
        """The errors job of the active object's run."""
        ob = active_splats(bpy.context)
        return measure_errors.job_of(ob) if is_splats(ob) else None


class ColorByError(Undoable, _OfRun, bpy.types.Operator):
    """Color the cameras by the errors of their photos, or restore their colors"""

    bl_idname = "gscore.color_by_error"
    bl_label = "Color Cameras"

    show: BoolProperty(
        name="Show",
        description="Color the cameras; off: restore their colors",
        default=True,
        options={"SKIP_SAVE"},
    )

    def run(self, context: bpy.types.Context) -> str:
        """Color the cameras, or restore their colors."""
        ob = active_splats(context)
        root = root_of(ob)
        if root is None:
            raise ValueError(f"{ob.name} has no cameras here: use Import Cameras first.")
        if not self.show:
            hide(root)
            return ""
        figures = measured(measure_errors.run_of(ob))
        if figures is None:
            raise ValueError("Press Measure Errors first: the training was not measured since.")
        if not measure_errors.color_cameras(root, figures):
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
        measure_errors.show_map(active_splats(context), self.show)


class RemoveErrors(Undoable, _OfRun, bpy.types.Operator):
    """Remove the error map, and restore the colors of the cameras"""

    bl_idname = "gscore.remove_errors"
    bl_label = "Remove Errors"

    def run(self, context: bpy.types.Context) -> None:
        """Remove."""
        measure_errors.remove(active_splats(context))
