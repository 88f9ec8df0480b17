"""The histograms of an object's splats, counted anew when its mesh has changed."""

from functools import partial

import bpy
import numpy as np
from bpy.app.handlers import persistent

from .. import attributes
from ..interface.blocks import with_uid
from ..interface.views import redraw_views
from ..process import beat
from ..process.pieces import Check, Going, Pieces, aside, at_once
from .counting import OPACITY, SIZE, Histogram, of_opacities, of_sizes

MOST = 200_000
"""Splats that are counted; of more, every so many-th. Up to so many are counted at once."""


class Counted:
    """Those of the object that was asked for last."""

    def __init__(self) -> None:
        self._uid = 0
        """Session number of its mesh."""
        self._found: dict[str, Histogram] = {}
        self._stale = True
        self._going: Going | None = None

    def of(self, ob: bpy.types.Object) -> dict[str, Histogram]:
        """Of an object's own mesh, by kind; nothing where attributes are missing or not finite.

        Of many splats, and in Edit Mode, where they are out of reach, they are those of before
        until a thread has counted.
        """
        mesh = ob.data
        if mesh.session_uid != self._uid:
            self.clear()
            self._uid = mesh.session_uid
        if self._stale and self._going is None and not mesh.is_editmode and len(mesh.vertices):
            self._stale = False
            if len(mesh.vertices) <= MOST:
                self._found = at_once(_counting(self._uid))
            else:
                self._going = Going(_counting(self._uid))
                beat.ensure()
        return self._found

    def forget(self, uids: set[int]) -> None:
        """Count these meshes anew when they are asked for next."""
        self._stale |= self._uid in uids

    def clear(self) -> None:
        """Forget all."""
        if self._going is not None:
            self._going.cancel()
        self._found, self._stale, self._going = {}, True, None

    def collect(self) -> bool:
        """Go on counting; whether there is something new to show."""
        if self._going is None or not self._going.step():
            return False
        self._found, self._going = self._going.result, None
        redraw_views()
        return True

    def waits(self) -> bool:
        """Whether a count is under way."""
        return self._going is not None


def _counting(uid: int) -> Pieces[dict[str, Histogram]]:
    """The histograms of a mesh, read an attribute a piece."""
    columns: dict[str, np.ndarray] = {}
    for name, width in ((attributes.BASE, 4), (attributes.SCALE, 3)):
        mesh = with_uid(bpy.data.meshes, uid)
        count = 0 if mesh is None else len(mesh.vertices)
        values = yield from aside(partial(_memory, count * width), "")
        mesh = with_uid(bpy.data.meshes, uid)
        if mesh is None or mesh.is_editmode or len(mesh.vertices) != count or not count:
            return {}
        try:
            attribute = attributes.check_vectors(mesh, name)
        except ValueError:  # the panel says what is the matter
            return {}
        key, found = attributes.FORMATS[attribute.data_type]
        if found != width:
            return {}
        attribute.data.foreach_get(key, values)
        columns[name] = values.reshape(count, width)
    return (yield from aside(partial(_count, columns), ""))


def _memory(numbers: int, check: Check) -> np.ndarray:
    """For so many float32, written to: the system gives it out then, which takes a while."""
    made = np.empty(numbers, np.float32)
    made.fill(0)
    return made


def _count(columns: dict[str, np.ndarray], check: Check) -> dict[str, Histogram]:
    every = slice(None, None, -(-len(columns[attributes.BASE]) // MOST))
    opacities, sizes = columns[attributes.BASE][every, 3], columns[attributes.SCALE][every].max(1)
    if not (np.isfinite(opacities).all() and np.isfinite(sizes).all()):
        return {}
    return {OPACITY: of_opacities(opacities), SIZE: of_sizes(sizes)}


COUNTED = Counted()
_FOLLOWER = beat.Follower(COUNTED.collect, COUNTED.waits)


@persistent
def _changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Meshes were changed, by whomever."""
    meshes = {
        u.id.original.session_uid for u in depsgraph.updates if isinstance(u.id, bpy.types.Mesh)
    }
    COUNTED.forget(meshes)


HANDLERS = {"depsgraph_update_post": _changed}


def on_register() -> None:
    """Count in Blender's beat."""
    beat.FOLLOWERS.append(_FOLLOWER)


def on_unregister() -> None:
    """Count no more."""
    beat.FOLLOWERS.remove(_FOLLOWER)
    COUNTED.clear()
