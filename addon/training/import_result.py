"""Import operator for the result of a finished run that the open file does not have yet."""

import bpy

from ..interface.base_operator import make_active
from ..splats import framed, splat_files
from ..splats.file_operators import ImportOperator
from . import results, start_training


class ImportResult(ImportOperator, bpy.types.Operator):
    """Import the splats of the run in the output folder, aligned with the capture"""

    bl_idname = "gscore.import_result"
    bl_label = "Show Trained Splats"

    def import_requests(self, context: bpy.types.Context) -> list[splat_files.ImportRequest]:
        """The splats of the run."""
        # Read now, because the panel may name another run during the import.
        self._source, self._run = start_training.run_of(context.scene)
        info = self._run.info
        if info.splats is None:
            raise ValueError(f"{info.path} contains no splats yet: continue its training.")
        return [
            splat_files.import_request(
                info.splats, parent=results.capture_of(context.scene, self._source)
            )
        ]

    def show(
        self, context: bpy.types.Context, made: list[bpy.types.Object], warnings: list[str]
    ) -> str:
        """Make the object the result of the training."""
        self.warn(warnings)
        ob = results.adopt(context.scene, made[0], self._run, self._source)
        if context.mode == "OBJECT" and ob.name in context.view_layer.objects:
            make_active(context, ob)
            context.view_layer.update()
            framed.turn_views(context.scene, ob)
            self.warn(framed.set_camera(context.scene, ob, may_add=False))
        return f"{ob.name} has the {len(ob.data.vertices):,} splats of {self._run.info.path}."


CLASSES = (ImportResult,)
