"""Synthetic photos of a cloud, in memory or on disk, for machines without a capture."""

import hashlib
import io
from pathlib import Path

import numpy as np

from ..io.colmap.folder import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints, write_model
from ..io.files import atomic_write
from ..io.ply.splats import write_splats
from ..raster.api import render
from ..scene import Cameras, PointCloud, Scene
from ..splats import Splats

_VIEWS = 6
"""Camera positions around the cloud."""
_POINTS = 1000
"""Splats whose means become the points of a capture on disk."""
_QUALITY = 90
"""Quality of its JPEG files."""


def synthetic_scene(
    count: int = 100_000, width: int = 640, height: int = 360
) -> tuple[Splats, Cameras]:
    """A cloud of small splats in front of one camera, for machines without a capture."""
    rng = np.random.default_rng(0)
    z = rng.uniform(2, 5, count)
    means = np.stack(
        [rng.uniform(-0.65, 0.65, count) * z, rng.uniform(-0.375, 0.375, count) * z, z], axis=1
    )
    splats = Splats(
        means=means.astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        scales=(rng.normal(size=(count, 3)) * 0.7 + np.log(0.008)).astype(np.float32),
        opacities=(rng.normal(size=count) * 1.5 - 0.5).astype(np.float32),
        sh0=rng.normal(size=(count, 1, 3)).astype(np.float32),
        shN=(rng.normal(size=(count, 15, 3)) * 0.1).astype(np.float32),
    )
    focal = 500.0 * width / 640
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    cameras = Cameras(
        viewmats=np.eye(4)[None],
        Ks=K[None],
        widths=np.array([width]),
        heights=np.array([height]),
        names=("synthetic",),
    )
    return splats, cameras


class SyntheticPhotos:
    """Pictures of a synthetic cloud from a few positions, with the interface of a dataset."""

    def __init__(self, count: int, width: int, height: int) -> None:
        """Draw a cloud of `count` splats in views of `width` x `height` px."""
        self.splats, first = synthetic_scene(count, width, height)
        viewmats = np.repeat(first.viewmats, _VIEWS, axis=0)
        viewmats[:, 0, 3] = np.linspace(-0.1, 0.1, _VIEWS)
        cameras = Cameras(
            viewmats=viewmats,
            Ks=np.repeat(first.Ks, _VIEWS, axis=0),
            widths=np.repeat(first.widths, _VIEWS),
            heights=np.repeat(first.heights, _VIEWS),
            names=tuple(f"synthetic_{i}" for i in range(_VIEWS)),
        )
        points = PointCloud(
            points=self.splats.means.astype(np.float64), colors=np.zeros((count, 3), np.uint8)
        )
        self.scene = Scene(cameras=cameras, points=points)
        self.train = list(range(_VIEWS))
        self.test: list[int] = []
        self.mask_mode = "none"
        self._images = [self._photo(i, width, height) for i in self.train]

    def content_hash(self) -> str:
        """Hash of the pictures."""
        return hashlib.sha256(b"".join(i.tobytes() for i in self._images)).hexdigest()[:16]

    def image(self, index: int) -> np.ndarray:
        """[H, W, 3] uint8."""
        return self._images[index]

    def mask(self, index: int) -> None:
        """Always None: there are no masks."""

    def _photo(self, index: int, width: int, height: int) -> np.ndarray:
        cameras = self.scene.cameras
        rgb = render(
            self.splats,
            cameras.Ks[index],
            cameras.viewmats[index],
            width,
            height,
            depths=False,
            device="cpu",
        ).rgb
        # Half as bright, so that gradients are as large as early in a training.
        return (np.clip(rgb, 0, 1) * 127 + 0.5).astype(np.uint8)

    def write(self, folder: Path, views: int) -> None:
        """Write a capture of `views` photos, which repeat those of the few positions."""
        from PIL import Image

        folder.mkdir(parents=True, exist_ok=True)
        files = []
        for index in self.train:
            buffer = io.BytesIO()
            Image.fromarray(self._images[index]).save(buffer, "JPEG", quality=_QUALITY)
            files.append(buffer.getvalue())
        cameras, points = self.scene.cameras, self.scene.points.points[:_POINTS]
        images = []
        for i in range(views):
            name, place = f"{i:06d}.jpg", i % len(files)
            atomic_write(folder / "images" / name, files[place])
            images.append(
                ColmapImage(
                    id=i + 1,
                    name=name,
                    camera_id=1,
                    qvec=np.array([1.0, 0.0, 0.0, 0.0]),
                    tvec=cameras.viewmats[place, :3, 3].astype(np.float64),
                    xys=np.zeros((0, 2)),
                    point3D_ids=np.zeros(0, np.int64),
                )
            )
        K = cameras.Ks[0]
        camera = ColmapCamera(
            model="PINHOLE",
            width=int(cameras.widths[0]),
            height=int(cameras.heights[0]),
            params=np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]], np.float64),
        )
        model = ColmapModel(
            cameras={1: camera},
            images=images,
            points=ColmapPoints(
                ids=np.arange(1, len(points) + 1),
                xyz=points,
                rgb=np.full((len(points), 3), 128, np.uint8),
                error=np.full(len(points), -1.0),
                track_lengths=np.zeros(len(points), np.int32),
            ),
        )
        write_model(model, folder / "sparse" / "0")


def write_capture(folder: Path, splats: int, views: int, width: int, height: int) -> None:
    """Write `splats.ply` and `capture`, with photos of the splats, into a folder; SH degree 3."""
    photos = SyntheticPhotos(splats, width, height)
    write_splats(folder / "splats.ply", photos.splats)
    photos.write(folder / "capture", views)
