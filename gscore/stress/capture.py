"""Toy capture that trains in milliseconds: coloured blobs, photographed from a circle."""

import hashlib
import math
from dataclasses import dataclass, replace

import numpy as np

from ..io.images.pixels import as_uint8
from ..raster.api import render
from ..scene import Cameras, PointCloud, Scene
from ..sh import rgb_to_sh0, sh0_to_rgb
from ..splats import Splats
from ..transforms import Similarity
from .case import EmptyTestError

SIZE = 48
"""Side of the photos, px."""
VIEWS = 8


@dataclass
class ToyPhotos:
    """The part of a dataset that the trainer uses."""

    scene: Scene
    train: list[int]
    test: list[int]
    images: list[np.ndarray]
    masks: list[np.ndarray | None]
    mask_mode: str = "none"
    nbytes: int = 0
    warnings: tuple[str, ...] = ()

    def content_hash(self) -> str:
        """Hash of all photos and masks."""
        digest = hashlib.sha256()
        for picture in (*self.images, *(m for m in self.masks if m is not None)):
            digest.update(picture.tobytes())
        return digest.hexdigest()

    def image(self, index: int) -> np.ndarray:
        """[H, W, 3] uint8."""
        return self.images[index]

    def mask(self, index: int) -> np.ndarray | None:
        """[H, W] uint8, or None."""
        return self.masks[index]


def toy_splats(seed: int = 0, count: int = 150) -> Splats:
    """Coloured blobs in a ball of radius 1, opaque enough to be visible in every picture."""
    rng = np.random.default_rng(seed)
    means = rng.normal(size=(count, 3)) * 0.45
    return Splats(
        means=means.astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        scales=np.log(rng.uniform(0.06, 0.2, (count, 3))).astype(np.float32),
        opacities=np.full(count, 2.0, np.float32),
        sh0=rgb_to_sh0(rng.random((count, 1, 3))).astype(np.float32),
        shN=np.zeros((count, 0, 3), np.float32),
    )


def facing_origin(center: np.ndarray) -> np.ndarray:
    """[4, 4] world to camera of a camera at `center` that faces the origin; y is down."""
    z = -center / np.linalg.norm(center)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    viewmat = np.eye(4)
    viewmat[:3, :3] = np.stack([x, np.cross(z, x), z])
    viewmat[:3, 3] = -viewmat[:3, :3] @ center
    return viewmat


def toy_cameras(views: int = VIEWS, size: int = SIZE) -> Cameras:
    """Cameras on a wavy circle of radius 3, all facing the origin."""
    viewmats = []
    for i in range(views):
        angle = 2 * math.pi * i / views
        center = np.array([3 * math.sin(angle), 0.7 * math.cos(2 * angle), -3 * math.cos(angle)])
        viewmats.append(facing_origin(center))
    focal = 1.1 * size
    K = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]])
    return Cameras(
        viewmats=np.stack(viewmats),
        Ks=np.repeat(K[None], views, axis=0),
        widths=np.full(views, size),
        heights=np.full(views, size),
        names=tuple(f"view_{i:02}.png" for i in range(views)),
    )


def toy_photos(
    seed: int = 0,
    *,
    held_out: tuple[int, ...] = (),
    splats: Splats | None = None,
    views: int = VIEWS,
    size: int = SIZE,
) -> ToyPhotos:
    """Pictures of `toy_splats`, or of `splats`, with points near the splats."""
    splats, cameras = splats or toy_splats(seed), toy_cameras(views, size)
    images = []
    for K, viewmat in zip(cameras.Ks, cameras.viewmats, strict=True):
        rgb = render(splats, K, viewmat, size, size, device="cpu").rgb
        if not rgb.mean() > 0.1:
            raise EmptyTestError("a photo of the toy capture is nearly black")
        images.append(as_uint8(rgb))
    rng = np.random.default_rng(seed + 1)
    points = splats.means.astype(np.float64) + rng.normal(size=splats.means.shape) * 0.03
    colors = np.clip(sh0_to_rgb(splats.sh0[:, 0]) * 255, 0, 255).astype(np.uint8)
    return ToyPhotos(
        scene=Scene(cameras=cameras, points=PointCloud(points=points, colors=colors)),
        train=[i for i in range(views) if i not in held_out],
        test=list(held_out),
        images=images,
        masks=[None] * views,
    )


def moved(photos: ToyPhotos, *, scale: float, shift: np.ndarray) -> ToyPhotos:
    """The same photos in a scaled world with another origin.

    Args:
        photos: The capture.
        scale: New units per old unit.
        shift: [3] float64, position of the old origin in new units.
    """
    away = Similarity(scale=1 / scale, shift=shift)
    scene, points = photos.scene, photos.scene.points
    return replace(
        photos,
        scene=replace(
            scene,
            cameras=away.cameras_from_training(scene.cameras),
            points=replace(points, points=away.points_from_training(points.points)),
        ),
    )
