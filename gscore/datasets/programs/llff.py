"""LLFF poses: the poses_bounds.npy of many NeRF scenes.

Schema: "Using your own poses without running COLMAP" of the readme of Fyusion/LLFF, and its
`pose_utils.py`: a row for each photo in the order of the sorted names, a 3 x 5 matrix row by row
and two depths. The first three columns are the camera's axes down, right and backwards in the
world, the fourth its position, the fifth height, width and focal length in pixels.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import DatasetError, FormatError
from ...io.files import read_bytes
from ...io.npy import read_npy
from ...text_format import count_text
from ...transforms import invert_rigid
from ..poses import rigid_matrix
from .posed import PosedPhoto, PosedPhotos, brown_camera

_NUMBERS = 17


def read_llff(path: Path, names: Sequence[str]) -> PosedPhotos:
    """Read poses and the shared lens, whose principal point is the middle of the photo.

    Args:
        path: The file.
        names: Names of all photos, sorted.

    Raises:
        DatasetError: the file is missing, or there are more or fewer photos than poses.
        FormatError: it is not an array of 17 numbers per row, or a pose or size is unusable.
    """
    try:
        rows = read_npy(read_bytes(path)).astype(np.float64)
    except ValueError as error:
        raise FormatError(f"{path} is not an array of poses: {error}. Copy it again.") from error
    if rows.ndim != 2 or rows.shape[1] != _NUMBERS:
        raise FormatError(
            f"{path} has the shape {rows.shape}, expected rows of {_NUMBERS} numbers. Make it "
            "again with LLFF's imgs2poses.py."
        )
    if len(rows) != len(names):
        raise DatasetError(
            f"{path} has {count_text(len(rows), 'pose')} for {count_text(len(names), 'photo')}, "
            "without their names, so they cannot be matched. Keep only the photos that it was made "
            "from."
        )
    return PosedPhotos(photos=[_shot(f"{path}: row {i}", *pair)
                        for i, pair in enumerate(zip(rows, names, strict=True))])  # fmt: skip


def _shot(where: str, row: np.ndarray, name: str) -> PosedPhoto:
    stated = row[:15].reshape(3, 5)
    down, right, back, center, (height, width, focal) = stated.T
    pose = rigid_matrix(where, "the pose", np.column_stack([right, down, -back, center]))
    if not all(0 < side < 2**31 for side in (height, width)):
        raise FormatError(f"{where}: the size {width:g} x {height:g} is invalid. Make it again.")
    size = (round(width), round(height))
    lens = brown_camera(where, size, focal=(focal, focal), center=(size[0] / 2, size[1] / 2))
    return PosedPhoto(name=name, viewmat=invert_rigid(pose), camera=lambda _: lens, size=size)
