"""Start files of a region training, written incrementally while Blender stays usable."""

from functools import partial
from pathlib import Path

import bpy
import numpy as np

from .. import attributes
from ..cameras.capture_transform import box_of_capture, origin_of
from ..core import write_region, write_splat_file
from ..process.incremental_tasks import Check, Pieces, TaskRunner, run_in_thread
from ..splats import objects
from ..splats.read_chunked import ChunkedRead
from ..splats.splat_files import source_matrix_of_data


class Start:
    """The splats of an object and a box, written to two files: read in chunks, then transformed
    into their capture's world and written in a thread."""

    def __init__(
        self, ob: bpy.types.Object, box: np.ndarray, *, splats_file: Path, region_file: Path
    ) -> None:
        """Begin the copy of the current splats.

        Args:
            ob: The splat object.
            box: The region, [4, 4], as for `write_region`.
            splats_file: The PLY to write.
            region_file: The JSON to write.

        Raises:
            ValueError: the object has no splats, or they cannot be read or moved to their capture.
        """
        if not ob.data.vertices:
            raise ValueError(f"{ob.name} has no splats to train.")
        self._origin, box = origin_of(ob), box_of_capture(box, ob)
        self._box, self._splats_file, self._region_file = box, splats_file, region_file
        self._name, self._matrix = ob.name, source_matrix_of_data(ob)
        objects.moved(attributes.NO_SPLATS, self._matrix, self._name)  # raises for a bad matrix
        self._antialiased = bool(ob.get(objects.ANTIALIAS))
        self._going = TaskRunner(self._made(ChunkedRead(ob)))
        self._going.step()  # once started, cancelling it removes the copy

    def step(self) -> bool:
        """Do one step; return whether both files are complete.

        Raises:
            ValueError: the splats cannot be read.
            GsError: a file cannot be written.
        """
        return self._going.step()

    def drop(self) -> None:
        """Cancel the copy."""
        self._going.cancel()

    def _made(self, taken: ChunkedRead) -> Pieces[None]:
        columns = yield from taken.read()
        yield from run_in_thread(partial(self._write, columns), "Writing the region's splats")

    def _write(self, columns: dict[str, np.ndarray], check: Check) -> None:
        splats = objects.moved(attributes.as_splats(columns), self._matrix, self._name)
        check()
        write_splat_file(
            self._splats_file, splats, antialiased=self._antialiased, origin=self._origin
        )
        write_region(self._region_file, self._box)
