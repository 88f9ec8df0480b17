"""Asynchronous import of splat files: read in a thread, written to Blender in short steps.

In a window a timer runs the steps. The scene, the collection and the parents are looked up at the
end, because undo or the user may have removed them.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from .. import attributes
from ..core import GsError, collected_warnings
from ..interface.blocks import with_uid
from ..interface.option_labels import error_words
from ..nodes import display
from ..process.background_task import BackgroundTask
from ..process.incremental_tasks import BUDGET
from . import objects, splat_files
from .splat_files import ImportRequest
from .write_chunked import ChunkedWrite

Columns = Sequence[tuple[str, str, np.ndarray]]
"""Attributes as `attributes.columns` returns them."""


@dataclass(frozen=True, kw_only=True)
class _Read:
    """Contents of a read file."""

    wanted: ImportRequest
    count: int
    columns: tuple[tuple[str, str, np.ndarray], ...]
    size: float
    """Typical size of a splat, from `objects.typical_size`."""
    antialiased: bool
    origin: np.ndarray | None
    comments: tuple[str, ...]
    note: str


class AsyncImport:
    """One import of some files: all of them, or none."""

    def __init__(
        self,
        context: bpy.types.Context,
        wanted: Sequence[ImportRequest],
        *,
        find: Callable[[ImportRequest], ImportRequest] = lambda wanted: wanted,
        note: Callable[[Columns], str] = lambda columns: "",
    ) -> None:
        """Start reading.

        Args:
            context: Its scene and collection receive the objects.
            wanted: At least one file.
            find: Resolves the file, if it must be searched for; runs in the thread.
            note: Summarises the attributes of each file, for `notes`; runs in the thread.
        """
        self.warnings: list[str] = []
        """Warnings for the user."""
        self._wanted, self._find, self._note = tuple(wanted), find, note
        self._scene = context.scene.session_uid
        self._collection = getattr(context.collection, "session_uid", 0)
        self._chores = display.builders()
        self._fillings: list[ChunkedWrite[_Read]] | None = None
        self._task = BackgroundTask(self._read)

    @property
    def notes(self) -> list[str]:
        """Results of `look`, one per file; empty before all are read."""
        return [filling.loaded.note for filling in self._fillings or ()]

    @property
    def sentence(self) -> str:
        """Progress sentence."""
        if self._fillings is None:
            return f"Reading {self._task.last_line or self._wanted[0].path.name}"
        share = sum(filling.share for filling in self._fillings) / len(self._fillings)
        return f"Importing {sum(f.loaded.count for f in self._fillings):,} splats: {share:.0%}"

    def step(self) -> list[bpy.types.Object] | None:
        """Run a short step; the objects once all are complete.

        Raises:
            ValueError: a file cannot be imported, or the scene was removed; nothing is left.
        """
        if self._fillings is None:
            # Not while the thread reads: both would compete for Python's lock.
            if not self._task.running:
                self._begin()
            return None
        until = time.perf_counter() + BUDGET
        while self._chores:
            self._chores.pop(0)()
            if time.perf_counter() > until:
                return None
        for filling in self._fillings:
            # Check filled ones again, because undo may have removed them.
            if filling.share < 1 or not filling.fill():
                filling.fill()
                return None
        return self._finish(self._fillings)

    def cancel(self) -> None:
        """Remove all partial results."""
        self._task.cancel()
        for filling in self._fillings or ():
            filling.drop()

    def _begin(self) -> None:
        if self._task.problem:
            raise ValueError(error_words(self._task.error) or self._task.problem)
        read, self.warnings = self._task.result
        self._fillings = [ChunkedWrite(one) for one in read]

    def _read(self, task: BackgroundTask) -> tuple[list[_Read], list[str]]:
        """Read all files; runs in the thread."""
        made = []
        with collected_warnings() as warnings:
            for request in self._wanted:
                task.report(request.path.name)
                wanted = self._find(request)
                try:
                    file = splat_files.read(wanted, task.check)
                    task.check()
                    columns = tuple(attributes.columns(file.splats))
                except MemoryError as error:
                    raise GsError(
                        f"{wanted.path} does not fit into memory; close other programs and import "
                        "it again."
                    ) from error
                task.check()
                made.append(
                    _Read(
                        wanted=wanted,
                        count=len(file.splats),
                        columns=columns,
                        size=objects.typical_size(file.splats),
                        antialiased=file.antialiased,
                        origin=file.origin,
                        comments=tuple(file.comments),
                        note=self._note(columns),
                    )
                )
        return made, list(warnings)

    # Quoted: see mesh_buffers.py.
    def _finish(self, fillings: "list[ChunkedWrite[_Read]]") -> list[bpy.types.Object]:
        scene = with_uid(bpy.data.scenes, self._scene)
        if scene is None:
            self.cancel()
            raise ValueError("The scene of this import was removed; import the splats again.")
        within = [scene.collection, *scene.collection.children_recursive]
        collection = with_uid(within, self._collection) or within[0]
        made = []
        for filling in fillings:
            read = filling.loaded
            mesh = filling.take()
            mesh.name = read.wanted.path.stem
            ob = objects.around(mesh, read.size, collection=collection)
            splat_files.set_up_object(ob, read.wanted, read)
            if read.wanted.parent and ob.parent is None:
                self.warnings.append(
                    f"The parent of {ob.name} was removed during the import; it has no parent."
                )
            made.append(ob)
        return made
