"""Captures on disk with known depth and SfM points."""

from pathlib import Path

import numpy as np
import pytest

from gscore.io.colmap.folder import (
    ColmapCamera,
    ColmapImage,
    ColmapModel,
    ColmapPoints,
    write_model,
)
from gscore.io.images.png import write_png
from gscore.transforms import rotmat_to_quat

from .scene import Scene

ANGLES = (-24, -16, -8, 0, 8, 16, 24)


def write_capture(
    folder: Path, scene: Scene, viewmats: list[np.ndarray], *, points: int = 60, radial: float = 0.0
) -> None:
    """Photos and a COLMAP model in which each view observes `points` of its own and its neighbours.

    `radial`: declare a camera with lens distortion; the photos stay undistorted.
    """
    known, owners = [], []
    for i, viewmat in enumerate(viewmats):
        view, _ = scene.shot(viewmat)
        write_png(folder / "images" / f"v{i:02d}.png", np.repeat(view.grey[..., None], 3, 2))
        if points:
            known.append(scene.points(viewmat, points, seed=i))
            owners += [i] * points
    xyz = np.concatenate(known) if known else np.zeros((0, 3))
    images = []
    for i, viewmat in enumerate(viewmats):
        local = xyz @ viewmat[:3, :3].T + viewmat[:3, 3]
        pixels = (local @ scene.K.T)[:, :2] / np.maximum(local[:, 2:], 1e-9)
        size = np.array([scene.width, scene.height])
        seen = ((pixels >= 0) & (pixels < size)).all(axis=1) & (local[:, 2] > 0)
        seen &= np.abs(np.array(owners, int) - i) <= 2
        images.append(
            ColmapImage(
                id=i + 1, name=f"v{i:02d}.png", camera_id=1,
                qvec=rotmat_to_quat(viewmat[:3, :3]), tvec=viewmat[:3, 3].copy(),
                xys=pixels[seen], point3D_ids=np.flatnonzero(seen) + 1,
            )
        )  # fmt: skip
    f, cx, cy = scene.K[0, 0], scene.K[0, 2], scene.K[1, 2]
    params = [f, cx, cy, radial] if radial else [f, f, cx, cy]
    camera = ColmapCamera(
        model="SIMPLE_RADIAL" if radial else "PINHOLE",
        width=scene.width, height=scene.height, params=np.array(params, np.float64),
    )  # fmt: skip
    model = ColmapModel(
        cameras={1: camera},
        images=images,
        points=ColmapPoints(
            ids=np.arange(1, len(xyz) + 1), xyz=xyz, rgb=np.full((len(xyz), 3), 99, np.uint8),
            error=np.full(len(xyz), 0.3), track_lengths=np.full(len(xyz), 3, np.int32),
        ),
    )  # fmt: skip
    write_model(model, folder / "sparse" / "0")


@pytest.fixture(scope="session")
def arc(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Seven photos on an arc. Do not write to it."""
    folder = tmp_path_factory.mktemp("arc")
    scene = Scene(160, 120)
    write_capture(folder, scene, [scene.viewmat(angle) for angle in ANGLES])
    return folder
