"""Small captures written to disk, with cameras of every shape."""

import struct
import zlib
from pathlib import Path

import numpy as np

from addon.core import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints, write_colmap

ROOT = Path(__file__).parent.parent.parent
STUDIO = ROOT / "examples" / "studio"

ODD_CAMERAS = {
    1: ("PINHOLE", 1920, 1080, (1700.0, 1700.0, 960.0, 540.0)),
    2: ("PINHOLE", 1080, 1920, (1700.0, 1703.3, 551.5, 949.25)),
    3: ("SIMPLE_PINHOLE", 801, 533, (612.5, 380.0, 290.0)),
    4: ("PINHOLE", 640, 640, (500.0, 701.0, 320.0, 300.0)),
    5: ("PINHOLE", 640, 481, (911.0, 600.0, -40.0, 500.0)),
    6: ("OPENCV", 1000, 750, (800.0, 801.0, 505.0, 370.0, -0.1, 0.02, 0.001, -0.002)),
    7: ("SIMPLE_RADIAL", 999, 501, (400.0, 499.5, 250.5, 0.05)),
}
"""Landscape, portrait, odd sizes, principal points off centre and outside, fx != fy, distortion."""


def random_pose(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A quaternion wxyz and a translation of a few units."""
    quat = rng.normal(size=4)
    return quat / np.linalg.norm(quat), rng.uniform(-4, 4, 3)


def write_capture(
    folder: Path,
    rng: np.random.Generator,
    *,
    cameras: dict[int, tuple] | None = None,
    images: int = 14,
    points: int = 300,
    photos: bool = False,
) -> ColmapModel:
    """Write sparse/0 with random poses, points and observations; returns the model.

    Args:
        folder: The capture's folder.
        rng: Source of everything random.
        cameras: Model, width, height and parameters by id; None: ODD_CAMERAS.
        images: Number of images, named sub/v000.png and so on, over all cameras in turn.
        points: Number of points, each observed in two images.
        photos: Write a small PNG for each image too.
    """
    table = {
        camera_id: ColmapCamera(model=m, width=w, height=h, params=np.array(p))
        for camera_id, (m, w, h, p) in (cameras or ODD_CAMERAS).items()
    }
    ids = np.arange(10, 10 + points)
    seen: list[list[int]] = [[] for _ in range(images)]
    for i in range(points):
        for k in rng.choice(images, 2, replace=False):
            seen[k].append(i)
    listed = []
    for i in range(images):
        quat, shift = random_pose(rng)
        listed.append(
            ColmapImage(
                id=i + 3,
                name=f"sub/v{i:03}.png",
                camera_id=list(table)[i % len(table)],
                qvec=quat,
                tvec=shift,
                xys=rng.uniform(0, 400, (len(seen[i]), 2)),
                point3D_ids=ids[seen[i]],
            )
        )
    cloud = ColmapPoints(
        ids=ids,
        xyz=rng.normal(0, 2, (points, 3)),
        rgb=rng.integers(0, 256, (points, 3)).astype(np.uint8),
        error=rng.uniform(0.1, 2, points),
        track_lengths=np.full(points, 2, np.int32),
    )
    model = ColmapModel(cameras=table, images=listed, points=cloud)
    write_colmap(model, folder / "sparse" / "0")
    if photos:
        for image in listed:
            camera = table[image.camera_id]
            write_photo(folder / "images" / image.name, camera.width, camera.height)
    return model


def write_photo(path: Path, width: int, height: int, turn: int = 1) -> None:
    """A black PNG; `turn` is EXIF's orientation."""
    rows = zlib.compress(bytes((1 + 3 * width) * height))
    exif = b"MM\0*" + struct.pack(">IHHHIHH", 8, 1, 0x0112, 3, 1, turn, 0)
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    out = b"\x89PNG\r\n\x1a\n"
    for kind, body in ((b"IHDR", head), (b"eXIf", exif), (b"IDAT", rows), (b"IEND", b"")):
        out += struct.pack(">I", len(body)) + kind + body
        out += struct.pack(">I", zlib.crc32(kind + body))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(out)
