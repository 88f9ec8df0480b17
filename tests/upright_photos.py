"""A capture of photos that were held upright, stored as their EXIF orientations say."""

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gscore.io.colmap.folder import write_model
from gscore.io.colmap.model import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints
from gscore.transforms import rotmat_to_quat
from tests.unit.png_files import chunk

SIZE = 48, 36
"""Width and height of a photo as stored, pixels."""
MIRRORED = (2, 4, 5, 7)


def stored(shown: np.ndarray, orientation: int) -> np.ndarray:
    """The array whose first row and column are where CIPA DC-008 has them in the shown one: 1 top
    and left, 2 top and right, 3 bottom and right, 4 bottom and left, 5 left and top, 6 right and
    top, 7 right and bottom, 8 left and bottom."""
    if orientation in (5, 6, 7, 8):
        row_from_right, column_from_bottom = orientation in (6, 7), orientation in (7, 8)
        shown = shown[::-1] if column_from_bottom else shown
        return np.swapaxes(shown[:, ::-1] if row_from_right else shown, 0, 1)
    shown = shown[::-1] if orientation in (3, 4) else shown
    return shown[:, ::-1] if orientation in (2, 3) else shown


def png(pixels: np.ndarray, orientation: int) -> bytes:
    """A file of pixels [H, W, 3] uint8 with that orientation in EXIF."""
    exif = b"MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0)
    height, width = pixels.shape[:2]
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
        + chunk(b"eXIf", exif) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    )  # fmt: skip


def upright_capture(folder: Path, orientations: Sequence[int], seed: int = 0) -> np.ndarray:
    """Write a capture of photos around a middle, the upper half of each white as it was held.

    Args:
        folder: It becomes the capture.
        orientations: EXIF's of each photo; those that mirror, not together with others, because
            cameras of mirrored photos are found in a mirrored world.
        seed: Of the rotation of the world.

    Returns:
        [3] up in the world of the capture.
    """
    rng = np.random.default_rng(seed)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    world = q * np.sign(np.linalg.det(q))
    if orientations[0] in MIRRORED:
        world = world @ np.diag([-1.0, 1.0, 1.0])
    (folder / "images").mkdir(parents=True)
    width, height = SIZE
    images = []
    for i, orientation in enumerate(orientations):
        shape = (width, height) if orientation >= 5 else (height, width)
        shown = np.zeros((*shape, 3), np.uint8)
        shown[: shape[0] // 2] = 255
        name = f"photo_{i:02}.png"
        pixels = np.ascontiguousarray(stored(shown, orientation))
        (folder / "images" / name).write_bytes(png(pixels, orientation))
        angle = 2 * np.pi * i / len(orientations)
        eye = np.array([6 * np.cos(angle), 6 * np.sin(angle), 2.0 + (i % 3)])
        z = -eye / np.linalg.norm(eye)
        x = np.cross(z, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        held = np.stack([x, np.cross(z, x)])
        rows, columns = np.mgrid[: shape[0], : shape[1]]
        grid = stored(np.stack([columns, rows], axis=-1), orientation)  # of the shown picture
        axes = np.stack([grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]])
        rotation = np.vstack([axes @ held, z])
        turned = rotation @ world.T
        images.append(
            ColmapImage(
                id=i + 1, name=name, camera_id=1, qvec=rotmat_to_quat(turned),
                tvec=-rotation @ eye, xys=np.zeros((0, 2)), point3D_ids=np.zeros(0, np.int64),
            )
        )  # fmt: skip
    points = rng.uniform(-1, 1, (200, 3)) @ world.T
    params = np.array([50.0, 50.0, width / 2, height / 2])
    model = ColmapModel(
        cameras={1: ColmapCamera(model="PINHOLE", width=width, height=height, params=params)},
        images=images,
        points=ColmapPoints(
            ids=np.arange(200), xyz=points, rgb=np.full((200, 3), 128, np.uint8),
            error=np.full(200, 0.5), track_lengths=np.full(200, 2, np.int32),
        ),
    )  # fmt: skip
    write_model(model, folder / "sparse/0")
    return world[:, 2]
