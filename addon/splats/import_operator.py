"""Import operator base of splat files: in short steps in a window, in one call for scripts."""

import bpy

from ..core import GsError, collected_warnings
from ..interface.base_operator import OnScene
from ..interface.incremental_operator import IncrementalOperator
from ..process.incremental_tasks import Pieces, stepped
from . import splat_files
from .async_import import AsyncImport


class ImportOperator(IncrementalOperator, OnScene):
    """Base of import operators, which define the files and the handling of the objects."""

    def import_requests(self, context: bpy.types.Context) -> list[splat_files.ImportRequest]:
        """Files to import; raises ValueError if there are none."""
        raise NotImplementedError

    def show(
        self, context: bpy.types.Context, made: list[bpy.types.Object], warnings: list[str]
    ) -> str:
        """Handle the objects, one per file; the text of the report."""
        raise NotImplementedError

    def pieces(self, context: bpy.types.Context) -> Pieces[str]:
        """Read in a thread, then write to Blender."""
        coming = AsyncImport(context, self.import_requests(context))
        made = yield from stepped(coming)
        return self.show(context, made, coming.warnings)

    def act(self, context: bpy.types.Context) -> str:
        """Import one or several files; none if one cannot be read."""
        made: list[bpy.types.Object] = []
        try:
            with collected_warnings() as warnings:
                for wanted in self.import_requests(context):
                    made.append(splat_files.import_requested(context, wanted))
        except (GsError, ValueError, OSError):
            for ob in made:
                bpy.data.meshes.remove(ob.data)
            raise
        return self.show(context, made, warnings)
