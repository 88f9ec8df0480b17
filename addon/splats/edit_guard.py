"""Edit guard: splat objects that must not change while an edit of them runs."""

from collections.abc import Sequence
from weakref import WeakSet

import bpy
from bpy.app.handlers import persistent
from mathutils import Matrix

from .. import attributes
from ..interface.blocks import with_uid
from . import copy_metadata, objects

_GUARDS: "WeakSet[EditGuard]" = WeakSet()


class EditGuard:
    """An object whose splats are read, then changed some steps later; detects other changes in
    between. It is looked up at each use, because undo replaces objects."""

    def __init__(self, ob: bpy.types.Object) -> None:
        """Start watching, until `close`; the view layer must be up to date.

        Raises:
            ValueError: as `objects.check_writable`.
        """
        objects.check_writable(ob)
        self.name = ob.name
        self.mesh_uid = ob.data.session_uid
        self.is_changed = False
        """True if the splats were or may have been changed."""
        self._uid, self._count = ob.session_uid, len(ob.data.vertices)
        self._mode, self._stood = bpy.context.mode, _stands(ob)
        _GUARDS.add(self)

    def there(self) -> bpy.types.Object:
        """The object.

        Raises:
            ValueError: it was removed, or its splats have changed.
        """
        ob = self.found()
        same = ob is not None and ob.data.session_uid == self.mesh_uid
        if self.is_changed or not same or len(ob.data.vertices) != self._count:
            raise ValueError(
                f"{self.name} was changed during the operation, so nothing was done: try again."
            )
        return ob

    def to_change(self) -> bpy.types.Object:
        """The object, for changing its splats now; other guards of them detect the change.

        Raises:
            ValueError: as `there`, or the splats are not writable.
        """
        return all_to_change([self])[0]

    def check_unmoved(self) -> None:
        """Raise ValueError if the object was moved since this was created."""
        ob = self.there()
        if _stands(ob) != self._stood:
            raise ValueError(
                f"{self.name} was moved during the operation, so nothing was done: try again."
            )

    def check_movable(self) -> None:
        """Raise ValueError if the splats cannot be replaced, before any reading."""
        copy_metadata.check_movable(self.there().data, self.name)

    def check_only_points(self) -> None:
        """`check_movable` for a changed number of splats."""
        copy_metadata.check_only_points(self.there().data, self.name)

    def copied_mesh(self) -> bpy.types.Mesh:
        """A copy of its mesh as its replacement; it shares memory until it is written.

        Raises:
            ValueError: as `there` and `check_movable`.
        """
        self.check_movable()
        return self.there().data.copy()

    def emptied_mesh(self) -> bpy.types.Mesh:
        """`copied_mesh` without points and vertex groups.

        Raises:
            ValueError: as `there` and `check_only_points`.
        """
        self.check_only_points()
        mesh = self.there().data
        copy = mesh.copy()
        copy_metadata.empty(copy)
        if attributes.has_selection(mesh):
            attributes.leave_points_unselected(copy)
        return copy

    def found(self) -> bpy.types.Object | None:
        """The object in its current state; None: it was removed."""
        return with_uid(bpy.data.objects, self._uid)

    def close(self) -> None:
        """Stop watching."""
        _GUARDS.discard(self)


def _stands(ob: bpy.types.Object) -> tuple[Matrix, Matrix]:
    """World matrix and basis matrix of an object."""
    return ob.matrix_world.copy(), ob.matrix_parent_inverse @ ob.matrix_basis


def all_to_change(guards: "Sequence[EditGuard]") -> list[bpy.types.Object]:
    """`EditGuard.to_change` of objects that are changed together, and may share their splats."""
    obs = [guard.there() for guard in guards]
    for guard, ob in zip(guards, obs, strict=True):
        objects.check_writable(ob)
        if bpy.context.mode != guard._mode:  # undo steps of a mode store only its own object
            raise ValueError(
                f"The mode was changed during the operation, so nothing was done to {guard.name}: "
                "try again in Object Mode."
            )
    meshes = {guard.mesh_uid for guard in guards}
    for other in _GUARDS:
        other.is_changed |= other not in guards and other.mesh_uid in meshes
    return obs


@persistent
def _changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if not _GUARDS:
        return
    changed = {
        update.id.original.session_uid
        for update in depsgraph.updates
        if update.is_updated_geometry and isinstance(update.id, bpy.types.Mesh)
    }
    for guard in _GUARDS:
        guard.is_changed |= guard.mesh_uid in changed


@persistent
def _undone(*_: object) -> None:
    for guard in _GUARDS:
        guard.is_changed = True


HANDLERS = {"depsgraph_update_post": _changed, "undo_post": _undone, "redo_post": _undone}
