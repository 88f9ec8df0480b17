"""Region of a splat object: the box of its crop object in the world of the capture."""

import bpy
import numpy as np

from ..splats.filters import SPHERE, crop_matrix, is_cropped
from ..splats.splat_files import source_matrix_of_data


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
