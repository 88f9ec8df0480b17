"""The files that the training of a region begins with, made while Blender goes on."""

from pathlib import Path

import bpy
import numpy as np

from .. import attributes
from ..core import write_region, write_splat_file
from ..process.background import Task
from ..splats import objects
from ..splats.files import source_matrix_of_data
from ..splats.leaving import Leaving


class Start:
    """The splats of an object and a box, on their way into two files: read bit by bit, then turned
    into their capture's world and written in a thread."""

    def __init__(
        self, ob: bpy.types.Object, box: np.ndarray, *, splats_file: Path, region_file: Path
    ) -> None:
        """Take the splats as they are.

        Args:
            ob: The splat object.
            box: [4, 4] of the region, as `write_region` takes it.
            splats_file: The PLY to write.
            region_file: The JSON to write.

        Raises:
            ValueError: the object has no splats, or they cannot be read or moved to their capture.
        """
        if not ob.data.vertices:
            raise ValueError(f"{ob.name} has no splats to train.")
        self._box, self._splats_file, self._region_file = box, splats_file, region_file
        self._name, self._matrix = ob.name, source_matrix_of_data(ob)
        objects.moved(attributes.NO_SPLATS, self._matrix, self._name)  # refuses what cannot be
        self._antialiased = bool(ob.get(objects.ANTIALIAS))
        self._leaving: Leaving | None = Leaving(ob)
        self._columns: dict[str, np.ndarray] = {}
        self._task: Task | None = None

    def step(self) -> bool:
        """Do some more; whether both files are there.

        Raises:
            ValueError: the splats cannot be read, or a file cannot be written.
        """
        if self._leaving is not None:
            found = self._leaving.step()
            if found is not None:
                self._leaving, self._columns = None, found
                self._task = Task(self._write)
            return False
        assert self._task is not None
        if self._task.running:
            return False
        if self._task.problem:
            raise ValueError(self._task.problem)
        return True

    def drop(self) -> None:
        """Leave it."""
        if self._leaving is not None:
            self._leaving.drop()
        if self._task is not None:
            self._task.cancel()

    def _write(self, task: Task) -> None:
        splats = attributes.as_splats(self._columns)
        splats = objects.moved(splats, self._matrix, self._name)
        task.check()
        write_splat_file(self._splats_file, splats, antialiased=self._antialiased)
        write_region(self._region_file, self._box)
