"""Heal and clone operators: fill a hole from around it, copy splats, and remove what was added."""

from functools import partial

import bpy
import numpy as np
from bpy.props import FloatProperty, FloatVectorProperty
from mathutils import Euler, Matrix

from .. import attributes, compat
from ..interface.base_operator import Condition
from ..process.incremental_tasks import Check, Steps, run_in_thread
from . import filters, objects, point_attributes, separate_join
from .added import appended, cloned, healed
from .edit_guard import EditGuard
from .edit_operators import Editing
from .point_attributes import Column
from .read_chunked import ChunkedRead
from .replay import (
    Volume,
    edits_of,
    is_added,
    record_cloned,
    record_healed,
    shift_of,
    store,
    volume_of,
)


class HealSplats(Editing, bpy.types.Operator):
    """Fill a hole with splats from around it, on a smooth surface through its border: the hole in
    the crop box, or without a crop box where Erase Splats last removed splats"""

    bl_idname = "gscore.heal_splats"
    bl_label = "Heal Splats"

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Fill."""
        ob = guard.there()
        guard.check_only_points()
        separate_join.check_follow([ob])
        region, sphere = _hole(ob)
        table = yield from ChunkedRead(ob).table()

        def filled(check: Check) -> int:
            more = healed(table, region, sphere=sphere, check=check)
            table[:] = appended(table, more)
            return len(more[0].values)

        count = yield from run_in_thread(filled, f"Filling the hole of {guard.name}")
        ob = yield from separate_join.kept(guard, table, np.arange(len(table[0].values)))
        record_healed(ob, region, sphere=sphere)
        return f"Filled the hole with {count:,} splats."


def _hole(ob: bpy.types.Object) -> tuple[np.ndarray, bool]:
    """The region to fill in the space of an object's data: [4, 4] from the cube [-1, 1]^3, and True
    if it is the ellipsoid inside.

    Raises:
        ValueError: there is none.
    """
    limits = filters.filters_of(ob)
    if limits.crop is not None:
        if limits.crop_invert:
            raise ValueError("A hole is inside the crop: turn Invert of the crop off.")
        if not abs(np.linalg.det(limits.crop[:3, :3])) > 0:
            raise ValueError(f"{ob.gscore.crop_object.name} has no volume; scale it up.")
        return np.linalg.inv(limits.crop), limits.crop_shape == filters.SPHERE
    erased = [(one, Volume.read(one["erased"])) for one in edits_of(ob) if "erased" in one]
    erased = [pair for pair in erased if len(pair[1].keys)]  # of some all was restored
    if not erased:
        raise ValueError(
            f"Where is the hole of {ob.name}? Put a crop box around it, or remove splats by Erase."
        )
    edit, volume = erased[-1]
    region = volume.box
    region[:3, 3] -= shift_of(ob, edit)
    return region, False


class CloneSplats(Editing, bpy.types.Operator):
    """Copy the selected splats, with their middle at the 3D cursor; shapes and view dependence are
    rotated too"""

    bl_idname = "gscore.clone_splats"
    bl_label = "Clone Splats"

    place: FloatVectorProperty(
        name="Position",
        description="Middle of the copies in Blender's world; by default the 3D cursor",
        subtype="TRANSLATION",
        options={"SKIP_SAVE"},
    )
    rotation: FloatVectorProperty(
        name="Rotation", description="Rotation about the world's axes", subtype="EULER"
    )
    scale: FloatProperty(name="Scale", description="Size of the copies", min=1e-3, default=1.0)

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Copy."""
        ob = guard.there()
        guard.check_only_points()
        separate_join.check_follow([ob])
        chosen = attributes.selected(ob.data)
        if not chosen.any():
            raise ValueError(f"{guard.name}: select the splats to clone.")
        if not self.properties.is_property_set("place"):
            self.place = context.scene.cursor.location
        world = compat.matrix_to_numpy(ob.matrix_world)
        objects.moved(attributes.NO_SPLATS, world, guard.name)  # raises unless it is a similarity
        turn = Euler(self.rotation).to_matrix().to_4x4() @ Matrix.Scale(self.scale, 4)
        turn, place = compat.matrix_to_numpy(turn), np.array(self.place, np.float64)
        table = yield from ChunkedRead(ob).table()

        def copied(check: Check) -> tuple[np.ndarray, Volume]:
            columns = point_attributes.of_splats(table)
            places, scales = columns[attributes.POSITION], columns[attributes.SCALE]
            volume = volume_of(places, chosen, scales)
            middle = np.median(places[chosen].astype(np.float64), axis=0)
            there = turn.copy()
            there[:3, 3] = place - turn[:3, :3] @ (world[:3, :3] @ middle + world[:3, 3])
            matrix = np.linalg.inv(world) @ there @ world
            table[:] = appended(table, cloned(table, chosen, matrix, guard.name, check))
            return matrix, volume

        matrix, volume = yield from run_in_thread(copied, self.bl_label)
        ob = yield from separate_join.kept(guard, table, np.arange(len(table[0].values)))
        record_cloned(ob, matrix, volume)
        return f"Copied {int(chosen.sum()):,} splats."


def has_added(context: bpy.types.Context) -> bool:
    """True if splats are active that Heal or Clone added to."""
    ob = objects.active_splats(context)
    return objects.is_splats(ob) and attributes.HEALED in ob.data.attributes


class RemoveHealing(Editing, bpy.types.Operator):
    """Delete the splats that Heal Splats and Clone Splats added since the last training"""

    bl_idname = "gscore.remove_healing"
    bl_label = "Remove Healing"
    needs = Condition(has_added, "Select splats that Heal Splats or Clone Splats added to")

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Delete."""
        ob = guard.there()
        guard.check_only_points()
        table = yield from ChunkedRead(ob).table()
        left = yield from run_in_thread(partial(_own, table), self.bl_label)
        before = len(ob.data.vertices)
        if not len(left):
            raise ValueError(f"{guard.name} has only added splats: delete the object instead.")
        if len(left) < before:
            ob = yield from separate_join.kept(guard, table, left)
        if (mark := ob.data.attributes.get(attributes.HEALED)) is not None:
            ob.data.attributes.remove(mark)
        if edits := edits_of(ob):
            store(ob, [one for one in edits if not is_added(one)])
        if len(left) == before:
            return "No added splats are left; Replay Edits does not add them again either."
        return f"Removed {before - len(left):,} splats, {len(left):,} left."


def _own(table: list[Column], check: Check) -> np.ndarray:
    """Rows of the splats that were not added, [K]."""
    marks = next(column.values for column in table if column.name == attributes.HEALED)
    return np.flatnonzero(~marks[:, 0].astype(bool))
