"""Restore Splats: bring back splats of the training that were deleted."""

from typing import Any

import bpy
import numpy as np

from ..core import Splats, in_unit_shape
from ..interface.base_operator import Condition
from ..process.incremental_tasks import Check, Steps, run_in_thread
from . import filters, objects, replay, separate_join, splat_files
from .edit_guard import EditGuard
from .edit_operators import Editing
from .error_maps import finished_run_of
from .filters import Filters
from .read_chunked import read_chunked

_KNOWN = 0.5
"""Least share of an object's splats that are those of the file."""


class RestoreSplats(Editing, bpy.types.Operator):
    """Bring back splats of the training that were deleted: those that the crop shows, or all
    without a crop. Other edits stay"""

    bl_idname = "gscore.restore_splats"
    bl_label = "Restore Splats"
    needs = Condition(objects.has_trained, "Select splats that come from a training")
    leaves_edit_mode = False

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Read the file, compare, and add what is missing."""
        ob = guard.there()
        guard.check_only_points()
        path = finished_run_of(ob) / "point_cloud.ply"
        request = splat_files.import_request(path, parent=ob.parent)
        limits = filters.filters_of(ob)
        limits = Filters(
            crop=limits.crop, crop_shape=limits.crop_shape, crop_invert=limits.crop_invert
        )
        columns = yield from read_chunked(ob, ["position"])
        places = columns["position"]

        def missing(check: Check) -> Splats:
            return _missing(splat_files.read(request, check).splats, places, limits, guard.name)

        found = yield from run_in_thread(missing, f"Comparing with {path.name}")
        if not len(found):
            where = "inside the crop" if limits.crop is not None else "of it"
            return f"No splats {where} are missing."
        ob = guard.there()
        edits = replay.edits_of(ob)
        shifts = [replay.shift_of(ob, one) for one in edits]

        def sparing(check: Check) -> list[dict[str, Any]]:
            return replay.sparing(edits, shifts, found.means, np.exp(found.scales))

        edits = yield from run_in_thread(sparing, self.bl_label)
        ob = guard.there()
        other = objects.create(found, f"{ob.name} restored", collection=ob.users_collection[0])
        other.parent, other.matrix_parent_inverse = ob.parent, ob.matrix_parent_inverse.copy()
        other.matrix_basis = ob.matrix_basis.copy()
        if objects.ANTIALIAS in ob:
            other[objects.ANTIALIAS] = ob[objects.ANTIALIAS]
        context.view_layer.update()
        second = EditGuard(other)
        try:
            ob = yield from separate_join.joined(guard, [second])
        finally:
            second.close()
            if (left := second.found()) is not None:
                bpy.data.objects.remove(left)
        if edits:
            replay.store(ob, edits)
        return f"Restored {len(found):,} splats; {ob.name} has {len(ob.data.vertices):,}."


def _missing(file: Splats, places: np.ndarray, limits: Filters, name: str) -> Splats:
    """Splats of a file that are not at any of the places [N, 3] and pass the crop.

    Raises:
        ValueError: the places are those of another training.
    """
    there = np.isin(_rows(file.means), _rows(places))
    if there.sum() < _KNOWN * len(places):
        raise ValueError(
            f"{name} differs from the file of its training: that was trained again since, or the "
            "transform of the splats was applied. Import the file beside it instead."
        )
    wanted = ~there
    if limits.crop is not None:
        sphere = limits.crop_shape == filters.SPHERE
        wanted &= in_unit_shape(file.means, limits.crop, sphere=sphere) != limits.crop_invert
    return file.subset(wanted)


def _rows(means: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(means, np.float32).view("V12")[:, 0]
