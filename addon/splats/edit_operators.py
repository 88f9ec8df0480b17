"""Edit operators of splats: grade, separate, join, delete, rotate; Object and Edit Mode."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, ClassVar

import bpy
import numpy as np
from bpy.props import BoolProperty, FloatProperty, FloatVectorProperty

from .. import attributes, stored_paths
from ..core import ConfigError, count_text, rgb_to_sh0, sh0_to_rgb
from ..interface.base_operator import Condition, make_active
from ..interface.blocks import with_uid
from ..interface.incremental_operator import IncrementalOperator
from ..process.incremental_tasks import Check, Steps, run_in_thread
from ..srgb import LUMINANCE
from . import edit, filters, objects, point_attributes, separate_join
from .edit_guard import EditGuard
from .operators import OnSplats, edit_vertices
from .point_attributes import Column
from .read_chunked import ChunkedRead, read_chunked
from .replay import (
    DUE,
    KEY,
    Volume,
    added_again,
    edits_of,
    is_added,
    keeps,
    record_erased,
    record_filters,
    record_grade,
    shift_of,
    store,
    volume_of,
)

_BLOCK = 1 << 14
"""Splats per block, so that intermediate results stay in the cache."""


@dataclass(frozen=True, kw_only=True)
class Grade:
    """Grading operations in this order on sRGB values; three values are per channel."""

    lift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """New value of black; white stays."""
    gamma: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Above 1 brightens the midtones; black and white stay."""
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """New value of white; black stays."""
    saturation: float = 1.0
    """0 for grey."""


def graded(base: np.ndarray, grade: Grade) -> np.ndarray:
    """[N, 4] float32: graded `radiance:base` [N, 4], bit-identical for a neutral grade.

    View-dependent coefficients stay unchanged; values below 0, which they may raise again, keep
    their sign.
    """
    out = base.copy()
    if grade != Grade():
        for at in range(0, len(base), _BLOCK):
            out[at : at + _BLOCK, :3] = _colors(base[at : at + _BLOCK, :3], grade)
    return out


def _colors(sh0: np.ndarray, grade: Grade) -> np.ndarray:
    """[K, 3] float64 coefficients of colours [K, 3]."""
    colors = sh0_to_rgb(sh0.astype(np.float64))
    lift, gamma, gain = (np.array(v) for v in (grade.lift, grade.gamma, grade.gain))
    colors = lift + colors * (1 - lift)
    if (gamma != 1).any():
        colors = np.sign(colors) * np.abs(colors) ** (1 / gamma)
    colors *= gain
    grey = (colors @ LUMINANCE)[:, None]
    return rgb_to_sh0(grey + (colors - grey) * grade.saturation)


class Editing(IncrementalOperator, OnSplats):
    """Base of edits that leave Edit Mode for the edit, and return to it."""

    leaves_edit_mode: ClassVar = True
    """True if the operator is available in Edit Mode."""

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The points."""
        return (objects.active_splats(context).data,)

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Leave Edit Mode, edit, and enter it again."""
        ob = objects.active_splats(context)
        objects.catch_up(ob)
        if not self.leaves_edit_mode:
            objects.check_writable(ob)
        uid, edited = ob.session_uid, ob.mode == "EDIT"
        if edited:
            bpy.ops.object.mode_set(mode="OBJECT")
        guard = None
        try:
            objects.check_writable(ob)
            context.view_layer.update()  # else the guard would detect earlier changes
            guard = EditGuard(ob)
            return (yield from self.edit(context, guard))
        finally:
            if guard is not None:
                guard.close()
            if edited:
                _edit_again(context, uid)

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """The edit in steps; raises ValueError if it is not possible."""
        raise NotImplementedError


def _edit_again(context: bpy.types.Context, uid: int) -> None:
    """Return to Edit Mode of an object, if it exists and no other mode is active."""
    ob = with_uid(bpy.data.objects, uid)
    if ob is None or context.mode != "OBJECT" or ob.name not in context.view_layer.objects:
        return
    if ob.visible_get():
        edit_vertices(context, ob)


class GradeSplats(Editing, bpy.types.Operator):
    """Change the colors of the selected splats, or of all; their view dependence stays"""

    bl_idname = "gscore.grade_splats"
    bl_label = "Grade Splats"

    lift: FloatVectorProperty(
        name="Lift", description="New value of black", min=-1.0, max=0.99, default=(0, 0, 0)
    )
    gamma: FloatVectorProperty(
        name="Gamma",
        description="Above 1 brightens the midtones",
        min=0.05,
        max=20.0,
        default=(1, 1, 1),
    )
    gain: FloatVectorProperty(
        name="Gain", description="New value of white", min=0.0, max=20.0, default=(1, 1, 1)
    )
    saturation: FloatProperty(
        name="Saturation", description="Color saturation; 0: gray", min=0.0, max=10.0, default=1.0
    )
    only_selected: BoolProperty(
        name="Only Selected",
        description="Change only selected splats; by default on if there are any",
        options={"SKIP_SAVE"},
    )

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Grade."""
        ob = guard.there()
        selected, whole = attributes.selected(ob.data), len(ob.data.vertices)
        if self.options.is_invoke and not self.properties.is_property_set("only_selected"):
            self.only_selected = bool(selected.any())
        some = selected if self.only_selected else slice(None)
        grade = Grade(
            lift=tuple(self.lift),
            gamma=tuple(self.gamma),
            gain=tuple(self.gain),
            saturation=self.saturation,
        )
        partly = self.only_selected and selected.any() and not selected.all()
        columns = yield from read_chunked(ob, filters.ATTRIBUTES if partly else [attributes.BASE])
        base = columns[attributes.BASE]

        def change(check: Check) -> tuple[int, Volume | None]:
            base[some] = graded(base[some], grade)
            if not partly:
                return len(base[some]), None
            places = columns[attributes.POSITION]
            return len(base[some]), volume_of(places, selected, columns[attributes.SCALE])

        count, volume = yield from run_in_thread(change, self.bl_label)
        ob = guard.to_change()
        mesh = ob.data
        kind = mesh.attributes[attributes.BASE].data_type
        attributes.fill(mesh, attributes.BASE, kind, base.ravel())
        mesh.update()
        if count:
            record_grade(ob, asdict(grade), volume)
        return f"Graded {count:,} of {whole:,} splats."


class SeparateSplats(Editing, bpy.types.Operator):
    """Move the selected splats with all their attributes into a new object"""

    bl_idname = "gscore.separate_splats"
    bl_label = "Separate Splats"

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Separate."""
        made = yield from separate_join.separated(guard, attributes.selected(guard.there().data))
        return f"Moved {len(made.data.vertices):,} splats to {made.name}."


def _others(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The selected splat objects other than the active one."""
    own = objects.active_splats(context)
    return [o for o in context.selected_objects if objects.is_splats(o) and o != own]


class JoinSplats(Editing, bpy.types.Operator):
    """Join the other selected splat objects into the active one, with their transforms applied to
    positions, orientations, sizes and colors"""

    bl_idname = "gscore.join_splats"
    bl_label = "Join Splats"

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The points of the active object, the removed other objects, and their children."""
        others = _others(context)
        children = [child for other in others for child in other.children]
        return (*super().changes(context), *others, *children)

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Join."""
        ob, others = guard.there(), _others(context)
        separate_join.check_joinable(ob, others)  # before the selection changes
        make_active(context, ob)  # now, because 4.2 crashes after selected objects are removed
        guards = [EditGuard(other) for other in others]
        try:
            ob = yield from separate_join.joined(guard, guards)
        finally:
            for other in guards:
                other.close()
                left = other.found()
                if left is not None and left.name in context.view_layer.objects:
                    left.select_set(True)  # it was not joined
        return f"{ob.name} has {len(ob.data.vertices):,} splats."


class _EditingObject(Editing):
    """Base of edits, in Object Mode, that also change the object's settings or transform."""

    leaves_edit_mode = False

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The points, and the object."""
        ob = objects.active_splats(context)
        return ob.data, ob


class ApplyFilters(_EditingObject, bpy.types.Operator):
    """Delete the splats that the display filters hide, then reset the filters"""

    bl_idname = "gscore.apply_filters"
    bl_label = "Delete Hidden Splats"

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Delete."""
        limits = filters.filters_of(guard.there())
        count = yield from edit.apply_filters(guard)
        if count:
            record_filters(guard.found(), limits)
        return f"Deleted {count:,} splats, {len(guard.found().data.vertices):,} left."


class EraseSplats(Editing, bpy.types.Operator):
    """Delete the selected splats, and record where, so that Replay Edits erases new splats there"""

    bl_idname = "gscore.erase_splats"
    bl_label = "Erase Splats"

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Delete."""
        ob = guard.there()
        guard.check_only_points()
        chosen = attributes.selected(ob.data)
        if chosen.all() or not chosen.any():
            many = "all" if len(chosen) and chosen.all() else "none"
            raise ValueError(f"{guard.name}: select some splats to erase; {many} of them are.")
        table = yield from ChunkedRead(ob).table()
        columns = {column.name: column.values for column in table}
        places, scales = columns[attributes.POSITION], columns[attributes.SCALE]
        volume = yield from run_in_thread(
            lambda check: volume_of(places, chosen, scales), self.bl_label
        )
        ob = yield from separate_join.kept(guard, table, np.flatnonzero(~chosen))
        record_erased(ob, volume)
        return f"Erased {int(chosen.sum()):,} splats, {len(ob.data.vertices):,} left."


def _earlier(context: bpy.types.Context) -> bpy.types.Object | None:
    """The object whose edits are replayed on the active splats: themselves if a training replaced
    them since, a selected one with edits, else the only one of the same capture."""
    own = objects.active_splats(context)
    if own is None or DUE in own:
        return own
    edited = [ob for ob in context.scene.objects if ob != own and objects.is_splats(ob)]
    edited = [ob for ob in edited if KEY in ob]
    chosen = [ob for ob in edited if ob in context.selected_objects]
    source = stored_paths.read(own, stored_paths.SOURCE)
    same = [ob for ob in edited if source and stored_paths.read(ob, stored_paths.SOURCE) == source]
    found = chosen or same
    return found[0] if len(found) == 1 else None


class ReplayEdits(Editing, bpy.types.Operator):
    """Apply the recorded edits of earlier splats of the capture to the active ones: what Delete
    Hidden Splats and Erase Splats removed, Grade Splats, Heal Splats and Clone Splats"""

    bl_idname = "gscore.replay_edits"
    bl_label = "Replay Edits"
    needs = Condition(
        lambda context: _earlier(context) is not None,
        "Select edited splats of the same capture, then Shift-click the new ones",
    )

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Apply the edits in their order."""
        ob, other = guard.there(), _earlier(context)
        guard.check_only_points()
        name, own = other.name, [] if ob == other else edits_of(ob)
        edits = _due(edits_of(other), own)
        if not edits:
            raise ValueError(f"The edits of {name} have been replayed on {guard.name} already.")
        if any(map(is_added, edits)):
            separate_join.check_follow([ob])
        shifts = [shift_of(ob, one) for one in edits]
        table = yield from ChunkedRead(ob).table()
        before = len(ob.data.vertices)
        rows, vain = yield from run_in_thread(
            partial(_replayed, table, list(zip(edits, shifts, strict=True)), guard.name),
            self.bl_label,
        )
        if not len(rows):
            raise ValueError(f"The edits of {name} would erase all splats of {guard.name}.")
        own_left = np.count_nonzero(rows < before)
        ob = yield from separate_join.kept(guard, table, rows)
        store(ob, [*own, *edits])
        ob.pop(DUE, None)
        count = count_text(len(edits), "edit")
        text = f"Replayed {count} of {name}: {before - own_left:,} splats erased"
        if len(rows) > own_left:
            text += f", {len(rows) - own_left:,} added"
        more = f" {vain} of the edits found no hole to fill, or nothing to copy." if vain else ""
        return f"{text}.{more}"


def _replayed(
    table: list[Column], edits: list[tuple[dict[str, Any], np.ndarray]], name: str, check: Check
) -> tuple[np.ndarray, int]:
    """Apply edits, each with its shift, to a table in place; added splats are appended.

    Returns:
        The rows [K] of the table to keep, and the number of edits that should add splats and found
        no hole, or nothing to copy.
    """
    kept, vain = np.ones(len(table[0].values), bool), 0
    for one, shift in edits:
        check()
        if is_added(one):
            now = point_attributes.picked(table, np.flatnonzero(kept))
            try:
                more = added_again(one, now, shift, name, check)
            except ConfigError:
                more = []
            if not more or not len(more[0].values):
                vain += 1
                continue
            table[:] = point_attributes.joined([table, more])
            kept = np.append(kept, np.ones(len(more[0].values), bool))
            continue
        columns = {column.name: column.values for column in table}
        kept &= keeps(one, columns, shift)
        if "grade" in one:
            base, some = columns[attributes.BASE], kept.copy()
            if one["volume"] is not None:
                places = columns[attributes.POSITION] + shift.astype(np.float32)
                some &= Volume.read(one["volume"]).contains(places)
            made = {key: _tuple(value) for key, value in one["grade"].items()}
            base[some] = graded(base[some], Grade(**made))
    return np.flatnonzero(kept), vain


def _due(edits: list[dict[str, Any]], done: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The edits that are not among those done."""
    left, due = list(done), []
    for one in edits:
        if one in left:
            left.remove(one)
        else:
            due.append(one)
    return due


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


class ApplySplatTransform(_EditingObject, bpy.types.Operator):
    """Apply location, rotation and even scale to the splats, with their orientations and colors"""

    bl_idname = "gscore.apply_splat_transform"
    bl_label = "Apply Splat Transform"

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The points, the object and its children, which stay in place."""
        return *super().changes(context), *objects.active_splats(context).children

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Apply."""
        yield from edit.apply_transform(guard)
        return ""
