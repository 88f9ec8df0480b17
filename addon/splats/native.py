"""Blender's own Gaussian splats (5.3): point clouds that become splat objects of this add-on."""

from dataclasses import dataclass

import bpy
import numpy as np

from .. import attributes
from ..interface import writable
from . import objects
from .filling import Filling
from .leaving import Leaving


@dataclass(frozen=True, kw_only=True)
class _Read:
    """Splats as a mesh takes them."""

    count: int
    columns: tuple[tuple[str, str, np.ndarray], ...]


class Taking:
    """A splat object that is made of a point cloud bit by bit, where the cloud stands. The cloud
    stays, hidden. It is looked up when all is there: undo, or the user, may have taken it."""

    def __init__(self, cloud: bpy.types.Object, *, at_once: bool = False) -> None:
        """Begin; `at_once` as `Leaving`.

        Raises:
            ValueError: attributes are missing.
        """
        self.warnings: list[str] = []
        self._name, self._uid = cloud.name, cloud.session_uid
        self._leaving = Leaving(cloud, at_once=at_once)
        self._filling: Filling[_Read] | None = None
        self._size = 0.0

    @property
    def sentence(self) -> str:
        """How far it is."""
        share = 0.0 if self._filling is None else self._filling.share
        return f"Making a splat object of {self._name}: {share:.0%}"

    def step(self) -> list[bpy.types.Object] | None:
        """Do a small piece; the one object once it is there.

        Raises:
            ValueError: the cloud is gone, or its numbers are not finite; nothing of it is left.
        """
        try:
            return self._step()
        except ValueError:
            self.cancel()
            raise

    def _step(self) -> list[bpy.types.Object] | None:
        if self._filling is None:
            found = self._leaving.step()
            if found is not None:
                sizes = found[attributes.SCALE].max(axis=1, initial=0.0)
                self._size = float(np.median(sizes)) if len(sizes) else 0.0
                self._filling = Filling(_read(found))
            return None
        if not self._filling.fill():
            return None
        cloud = next((ob for ob in bpy.data.objects if ob.session_uid == self._uid), None)
        if cloud is None:
            raise ValueError(f"{self._name} is gone; its splats were not taken over.")
        return [self._stand(self._filling.take(), cloud)]

    def cancel(self) -> None:
        """Leave nothing."""
        self._leaving.drop()
        if self._filling is not None:
            self._filling.drop()

    def _stand(self, mesh: bpy.types.Mesh, cloud: bpy.types.Object) -> bpy.types.Object:
        mesh.name = f"{cloud.name} splats"
        collection = writable.taking(cloud.users_collection)[0]
        made = objects.around(mesh, self._size, collection=collection, parent=cloud.parent)
        made.matrix_parent_inverse = cloud.matrix_parent_inverse
        made.matrix_basis = cloud.matrix_basis
        cloud.hide_render = True
        for scene in bpy.data.scenes:
            objects.hide(cloud, scene)
        return made


def _read(found: dict[str, np.ndarray]) -> _Read:
    kinds = {attributes.BASE: "FLOAT_COLOR", attributes.ROTATION: "QUATERNION"}
    columns = tuple(
        (name, kinds.get(name, "FLOAT_VECTOR"), values.ravel()) for name, values in found.items()
    )
    return _Read(count=len(found[attributes.BASE]), columns=columns)
