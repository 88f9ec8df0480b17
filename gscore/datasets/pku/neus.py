"""NeuS layout of multi-view video frames: projection matrices in an npz."""

import re
import zipfile
from pathlib import Path

import numpy as np

from ...config import DataConfig
from ...errors import DatasetError, FormatError
from ...io.images.read_image import read_info
from ...io.npy import read_npy
from ...quoting import brief
from ...scene import FARTHEST, PointCloud
from ...text_format import count_text
from ..capture import Capture, View, listing
from ..poses import pinhole_camera, rigid_matrix
from .photos import mattes, photo_folder_name, pictures_by_camera

_FILE = "cameras_sphere.npz"
_MATRIX_BYTES = 1 << 16


def read_neus(
    config: DataConfig, case: Path, path: Path, frame: int, photos_required: bool
) -> Capture:
    """`data_NeuS/<frame>`: `images`, `mask` and the `world_mat_<i>` of cameras_sphere.npz.

    `scale_mat_<i>`, which moves the people into the unit sphere, is not applied: the world stays
    that of structure from motion.

    Raises:
        DatasetError: photos are missing, or their number differs from that of the cameras.
        FormatError: the npz is corrupt or its matrices are not cameras.
    """
    projections = _projections(path / _FILE)
    images = photo_folder_name(path, config.images)
    photos = pictures_by_camera(path / images)
    # Matrices follow the order of the sorted photos, not their numbers.
    if len(photos) != len(projections):
        raise DatasetError(
            f"{path / _FILE} has {count_text(len(projections), 'camera')}, {path / images} has "
            f"{len(photos)} "
            f"numbered photos ({listing([photo.name for photo in photos.values()])}). Copy the "
            f"frame again."
        )
    soft = mattes(path, images)
    views = []
    for i, (number, photo) in enumerate(photos.items()):
        info = read_info(photo)
        where, key = str(path / _FILE), f"world_mat_{i}"
        K, viewmat = _decompose(projections[i])
        views.append(
            View(
                name=photo.name,
                image=photo,
                viewmat=rigid_matrix(where, key, viewmat),
                camera=pinhole_camera(where, key, K, info.width, info.height),
                mask=soft.get(number),
            )
        )
    return Capture(root=path, views=views, points=PointCloud.none())


def _projections(path: Path) -> list[np.ndarray]:
    """[3, 4] float64 projection matrices `world_mat_0`, `world_mat_1`, ..."""
    if not path.is_file():
        raise DatasetError(f"There is no {path} with the cameras. Copy the frame again.")
    try:
        with zipfile.ZipFile(path) as stored:
            matrices = re.compile(r"world_mat_\d+\.npy")
            count = sum(1 for name in stored.namelist() if matrices.fullmatch(name))
            projections = [_matrix(stored, f"world_mat_{i}.npy") for i in range(count)]
    except Exception as error:  # damaged archives raise about ten kinds
        raise FormatError(
            f"{path} cannot be read as an npz with world_mat_0, world_mat_1, ...: {brief(error)}. "
            f"Copy the frame again."
        ) from error
    for i, matrix in enumerate(projections):
        if matrix.shape not in ((3, 4), (4, 4)) or not (np.abs(matrix) <= FARTHEST).all():
            raise FormatError(
                f"{path}: world_mat_{i} is {matrix.tolist()}, expected 4 x 4 numbers up to "
                f"{FARTHEST:g}. Copy the frame again."
            )
    if not projections:
        raise FormatError(f"{path} has no world_mat_0. Copy the frame again.")
    return [matrix[:3] for matrix in projections]


def _matrix(stored: zipfile.ZipFile, name: str) -> np.ndarray:
    with stored.open(name) as file:
        raw = file.read(_MATRIX_BYTES)  # limits the unpacked size
    return read_npy(raw).astype(np.float64)


def _decompose(projection: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """K [3, 3] with K[2, 2] = 1 and world to camera [4, 4], from K [R | t] [3, 4] up to scale."""
    # RQ by QR of the flipped matrix: with J the exchange matrix, M = R Q from (J M)^T = Q' R'.
    flip = np.eye(3)[::-1]
    q, r = np.linalg.qr((flip @ projection[:, :3]).T)
    K, rotation = flip @ r.T @ flip, flip @ q.T
    signs = np.diag(np.where(np.diag(K) < 0, -1.0, 1.0))
    K, rotation = K @ signs, signs @ rotation
    translation = np.linalg.solve(K, projection[:, 3]) if np.linalg.det(K) else np.zeros(3)
    if np.linalg.det(rotation) < 0:  # the projection had a negative sign
        rotation, translation = -rotation, -translation
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = rotation, translation
    K = K / K[2, 2] if K[2, 2] else np.zeros((3, 3))
    return np.triu(K), viewmat
