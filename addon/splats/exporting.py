"""Splat objects as one file: at once for scripts, bit by bit where a user waits."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from .. import attributes
from ..compat import matrix_to_numpy
from ..core import GsError, Splats, given_up_by, join_splats, write_splat_file
from ..process.background import Task
from . import filters, objects
from .files import BLENDER, SOURCE, note_of_up, source_matrix, source_matrix_of_data
from .filters import Filters
from .leaving import Leaving

Written = tuple[int, tuple[str, ...]]
"""Number of splats written, and sentences on what the format does not hold of them and on how many
were left out."""


@dataclass(frozen=True, kw_only=True)
class _Part:
    """What becomes of the splats of one object."""

    name: str
    matrix: np.ndarray
    """[4, 4] from the object's space to the file's."""
    filters: Filters | None
    """What is left out; None: nothing."""

    def made(self, columns: dict[str, np.ndarray]) -> Splats:
        """The splats of the file, of columns that `Leaving` read; ValueError as `objects.moved`."""
        keep = None if self.filters is None else _kept(columns, self.filters)
        splats = attributes.as_splats(columns)
        splats = splats if keep is None else splats.subset(keep)
        return objects.moved(splats, self.matrix, self.name)


def _kept(columns: dict[str, np.ndarray], limits: Filters) -> np.ndarray:
    """[N] bool: which splats filters let pass."""
    base = columns[attributes.BASE]
    if not len(base):
        return np.zeros(0, bool)
    means, scales = columns[attributes.POSITION], columns[attributes.SCALE]
    return filters.mask(means, scales, base[:, 3], limits)


def export_splats(
    obs: Sequence[bpy.types.Object],
    path: str | Path,
    *,
    world: str = SOURCE,
    filtered: bool = False,
) -> Written:
    """Write splat objects, edited and moved as they are, as one file.

    Args:
        obs: At least one; several are joined.
        path: The file to write; its ending says in which format.
        world: SOURCE for the world of the first object's photos (or of its file), BLENDER for the
            scene's.
        filtered: Leave out what the display filters hide.

    Raises:
        ValueError: no objects, no splats, or a matrix that is no similarity; nothing is written.
        GsError: the file cannot be written.
    """
    export = Export(obs, path, world=world, filtered=filtered, at_once=True)
    try:
        while not export.read():
            pass
        return export.write(lambda: None)
    finally:
        export.cancel()


class Export:
    """One file on its way: the splats of objects as they are when this is made are read bit by bit,
    then turned into the file's world and written in a thread."""

    def __init__(
        self,
        obs: Sequence[bpy.types.Object],
        path: str | Path,
        *,
        world: str,
        filtered: bool,
        at_once: bool = False,
    ) -> None:
        """Take the splats.

        Args:
            As `export_splats`, and `Leaving`.

        Raises:
            ValueError: as `export_splats`, but for what is wrong with the splats themselves.
        """
        if not obs:
            raise ValueError("There is nothing to export: select a splat object.")
        self._path = Path(bpy.path.abspath(str(path)))
        self._parts = _parts(obs, world, filtered)
        self._antialiased = all(ob.get(objects.ANTIALIAS) for ob in obs)
        self._comments = note_of_up(obs[0], world)
        self._columns: list[dict[str, np.ndarray]] = []
        self._leaving: list[Leaving] = []
        self._task: Task | None = None
        try:
            for ob in obs:
                self._leaving.append(Leaving(ob, at_once=at_once))
        except ValueError:
            self.cancel()
            raise

    @property
    def sentence(self) -> str:
        """How far it is."""
        if self._task is not None:
            return f"Writing {self._path.name}"
        share = len(self._columns) + sum(leaving.share for leaving in self._leaving)
        return f"Reading splats: {share / len(self._parts):.0%}"

    def step(self) -> Written | None:
        """Do a small piece; what was written once the file is there.

        Raises:
            ValueError: the splats cannot be read, or the file not be written; it is untouched.
        """
        if self._task is None:
            if self.read():
                self._task = Task(lambda task: self.write(task.check))
            return None
        if self._task.running:
            return None
        if self._task.problem:
            raise ValueError(self._task.problem)
        return self._task.result

    def cancel(self) -> None:
        """Leave the file untouched, and nothing of ours."""
        for leaving in self._leaving:
            leaving.drop()
        if self._task is not None:
            self._task.cancel()

    def read(self) -> bool:
        """Read some more; whether that is all. ValueError as `Leaving.step`."""
        found = self._leaving[0].step()
        if found is not None:
            self._columns.append(found)
            self._leaving.pop(0)
        return not self._leaving

    def write(self, check: Callable[[], None]) -> Written:
        """Write what was read; in any thread, once.

        Args:
            check: Raises where the file is no longer wanted.

        Raises:
            As `export_splats`.
        """
        try:
            return self._write(check)
        except MemoryError as error:
            raise GsError(
                "The splats do not fit into memory twice; close other programs and export again."
            ) from error

    def _write(self, check: Callable[[], None]) -> Written:
        total, parts = 0, []
        for part in self._parts:
            columns = self._columns.pop(0)
            total += len(columns[attributes.BASE])
            parts.append(part.made(columns))
            check()
        splats = join_splats(parts)
        if not len(splats):
            names = ", ".join(part.name for part in self._parts)
            raise ValueError(
                f"{names}: no splats left to export; relax the filters or undo deletions."
            )
        with given_up_by(check):
            made = write_splat_file(
                self._path, splats, antialiased=self._antialiased, comments=self._comments
            )
        hidden = total - len(splats)
        left = (f"{hidden:,} splats that the filters hide were left out.",) if hidden else ()
        return len(splats), (*made.notes, *left)


def _parts(obs: Sequence[bpy.types.Object], world: str, filtered: bool) -> list[_Part]:
    """One for each object; ValueError where a matrix is no similarity."""
    to_file = np.eye(4) if world == BLENDER else np.linalg.inv(source_matrix(obs[0]))
    found = []
    for ob in obs:
        own = source_matrix_of_data(ob) if world == SOURCE and ob == obs[0] else None
        matrix = to_file @ matrix_to_numpy(ob.matrix_world) if own is None else own
        objects.moved(attributes.NO_SPLATS, matrix, ob.name)  # refuses what cannot be
        limits = filters.filters_of(ob) if filtered else None
        hides = limits is not None and limits.leave_out_anything
        found.append(_Part(name=ob.name, matrix=matrix, filters=limits if hides else None))
    return found
