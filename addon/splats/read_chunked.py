"""Chunked reading of splats from Blender in short steps."""

import time
from collections.abc import Sequence
from functools import partial

import bpy
import numpy as np

from .. import attributes
from ..interface.temporary_data import Temporary
from ..process.incremental_tasks import BUDGET, Check, Steps, run_in_thread
from . import objects, point_attributes, vertex_groups
from .point_attributes import GROUP, TEXT, Column


class ChunkedRead:
    """The splats of an object at creation, independent of later changes.

    They are read from a copy of its mesh or point cloud, which shares unchanged memory.
    """

    def __init__(self, ob: bpy.types.Object, names: Sequence[str] | None = None) -> None:
        """Copy the mesh.

        Args:
            ob: Object with splats, in any mode.
            names: Vector attributes to read; None: all splat attributes.

        Raises:
            ValueError: attributes are missing, or as `objects.catch_up`.
        """
        objects.catch_up(ob)
        if ob.mode == "EDIT":
            ob.update_from_editmode()
        self._groups = [group.name for group in ob.vertex_groups]
        copy = ob.data.copy()
        self._temporary, self._of, self._data = Temporary(copy), ob.name, ob.data.name
        try:  # on the copy, because attributes are not accessible in Edit Mode
            known = attributes.names(copy, called=self._data)
            self._names = known if names is None else [n for n in names if n in known]
            for one in self._names:
                attributes.check_vectors(copy, one, called=self._data)
        except ValueError:
            self.drop()
            raise

    def read(self) -> Steps[dict[str, np.ndarray]]:
        """Read the attributes; with all names the input of `attributes.as_splats`.

        Raises:
            ValueError: the copy was removed, or has non-finite values.
        """
        copy = self._copy()
        kinds = {name: copy.attributes[name].data_type for name in self._names}
        columns = yield from self._read(kinds, [])
        yield from run_in_thread(partial(_check_finite, columns, self._data), self._sentence(1.0))
        return {column.name: column.values for column in columns}

    def table(self, *, whole: bool = True) -> Steps[list[Column]]:
        """Read all point attributes, selection and hiding.

        Args:
            whole: Also read vertex groups and strings; each takes a second for a million splats.

        Raises:
            ValueError: the copy was removed, or as `point_attributes.kinds`.
        """
        copy = self._copy()
        try:
            marks, kinds = point_attributes.marks(copy), point_attributes.kinds(copy, whole=whole)
        except ValueError:
            self.drop()
            raise
        return (yield from self._read(kinds, self._groups if whole else [])) + marks

    def _read(self, kinds: dict[str, str], groups: list[str]) -> Steps[list[Column]]:
        try:
            count = attributes.point_count(self._copy())
            # First, because removing an attribute also removes the group of the same name.
            own = (yield from self._weights(groups, count)) if groups else []
            columns = yield from run_in_thread(
                partial(point_attributes.zeroed, kinds, count), self._sentence(0.0)
            )
            until = time.perf_counter() + BUDGET
            for done, (name, kind, values) in enumerate(columns):
                if time.perf_counter() > until:
                    yield self._sentence(done / len(columns))
                    until = time.perf_counter() + BUDGET
                copy = self._copy()
                if kind == TEXT:
                    yield from self._text(name, values)
                    copy = self._copy()
                else:
                    point_attributes.copy_values(copy, name, values)
                if name != attributes.POSITION:  # free memory gradually
                    copy.attributes.remove(copy.attributes[name])
            return columns + own
        finally:
            self.drop()

    def _weights(self, groups: list[str], count: int) -> Steps[list[Column]]:
        made = yield from run_in_thread(
            lambda check: vertex_groups.made(groups, count), self._sentence(0.0)
        )
        until = time.perf_counter() + BUDGET
        for begin in range(0, count, vertex_groups.BLOCK):
            if time.perf_counter() > until:
                yield f"Reading vertex groups of {self._of}: {begin / count:.0%}"
                until = time.perf_counter() + BUDGET
            vertex_groups.read(self._copy(), begin, made)
        names = (f"{point_attributes.GROUP_NAME}{name}" for name in groups)
        return [Column(n, GROUP, w[:, None]) for n, w in zip(names, made, strict=True)]

    def _text(self, name: str, values: np.ndarray) -> Steps[None]:
        known: dict[bytes, bytes] = {}
        until = time.perf_counter() + BUDGET
        for begin in range(0, len(values), point_attributes.BLOCK):
            if time.perf_counter() > until:
                yield f"Reading {name} of {self._of}: {begin / len(values):.0%}"
                until = time.perf_counter() + BUDGET
            point_attributes.read_texts(self._copy(), name, begin, values, known)

    def drop(self) -> None:
        """Remove the copy."""
        self._temporary.drop()

    def _sentence(self, share: float) -> str:
        return f"Reading splats of {self._of}: {share:.0%}"

    def _copy(self) -> bpy.types.Mesh | bpy.types.PointCloud:
        copy = self._temporary.found()
        if copy is None:
            raise ValueError(f"{self._of} was removed before its splats were read: try again.")
        return copy


def _check_finite(columns: list[Column], called: str, check: Check) -> None:
    for name, _, values in columns:
        check()
        attributes.check_finite(values, name, called)


def read_chunked(
    ob: bpy.types.Object, names: Sequence[str] | None = None
) -> Steps[dict[str, np.ndarray]]:
    """The splats of an object at the first step; arguments and errors as `ChunkedRead`."""
    return (yield from ChunkedRead(ob, names).read())
