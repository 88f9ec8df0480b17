"""Region and start files of a region training, written incrementally while Blender stays usable."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import bpy
import numpy as np

from .. import attributes
from ..cameras.capture_transform import box_of_capture, origin_of
from ..core import write_region, write_splat_file
from ..process.incremental_tasks import Check, Steps, run_in_thread
from ..splats import objects
from ..splats.filters import SPHERE, crop_matrix, is_cropped
from ..splats.read_chunked import ChunkedRead
from ..splats.splat_files import source_matrix_of_data


def start_files(
    ob: bpy.types.Object, box: np.ndarray, *, splats_file: Path, region_file: Path
) -> Steps[None]:
    """Write the current splats of an object and a box: read in chunks, then transformed into their
    capture's world and written in a thread.

    Args:
        ob: The splat object.
        box: The region, [4, 4], as for `write_region`.
        splats_file: The PLY to write.
        region_file: The JSON to write.

    Raises:
        ValueError: the object has no splats, or they cannot be read or moved to their capture.
        GsError: a file cannot be written.
    """
    if not ob.data.vertices:
        raise ValueError(f"{ob.name} has no splats to train.")
    name, matrix, origin = ob.name, source_matrix_of_data(ob), origin_of(ob)
    objects.moved(attributes.NO_SPLATS, matrix, name)  # raises for a bad matrix
    more = {"antialiased": bool(ob.get(objects.ANTIALIAS)), "origin": origin}
    write: Callable[[attributes.Splats], object] = partial(write_splat_file, splats_file, **more)
    box = box_of_capture(box, ob)
    columns = yield from ChunkedRead(ob).read()

    def written(check: Check) -> None:
        splats = objects.moved(attributes.as_splats(columns), matrix, name)
        check()
        write(splats)
        write_region(region_file, box)

    yield from run_in_thread(written, "Writing the region's splats")


def region_of(ob: bpy.types.Object) -> np.ndarray:
    """Matrix [4, 4] float64 from the cube [-1, 1]^3 to the box of an object's crop object, in the
    world of the object's capture.

    Raises:
        ValueError: there is no crop box, or it has no volume.
    """
    if not is_cropped(ob):
        raise ValueError(f"{ob.name} has no crop object; add a crop box around the region first.")
    settings = ob.gscore
    if settings.crop_shape == SPHERE or settings.crop_invert:
        raise ValueError(
            "A region is the inside of a box: set the shape of the crop to Box, not inverted."
        )
    to_unit = crop_matrix(ob, settings.crop_object)
    if not abs(np.linalg.det(to_unit[:3, :3])) > 0:
        raise ValueError(f"{settings.crop_object.name} has no volume; scale it up on all axes.")
    return source_matrix_of_data(ob) @ np.linalg.inv(to_unit)
