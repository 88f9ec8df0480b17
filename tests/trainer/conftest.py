"""A toy capture that takes milliseconds to train on, in memory and as a folder."""

import hashlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch

from gscore.io.colmap import write_model
from gscore.io.colmap_model import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints
from gscore.io.images import write_png
from gscore.raster.api import render
from gscore.scene import Cameras, PointCloud, Scene
from gscore.sh import rgb_to_sh0
from gscore.splats import Splats
from gscore.trainer.model import Model
from gscore.transforms import rotmat_to_quat

SIZE = 48
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
        digest = hashlib.sha256()
        for picture in (*self.images, *(m for m in self.masks if m is not None)):
            digest.update(picture.tobytes())
        return digest.hexdigest()

    def image(self, index: int) -> np.ndarray:
        return self.images[index]

    def mask(self, index: int) -> np.ndarray | None:
        return self.masks[index]


def toy_splats(seed: int = 0, count: int = 150) -> Splats:
    """Coloured blobs in a ball of radius 1, opaque enough that every picture shows something."""
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


def toy_cameras(views: int = VIEWS, size: int = SIZE) -> Cameras:
    """Cameras on a wavy circle of radius 3, all looking at the origin."""
    viewmats = []
    for i in range(views):
        angle = 2 * math.pi * i / views
        center = np.array([3 * math.sin(angle), 0.7 * math.cos(2 * angle), -3 * math.cos(angle)])
        z = -center / np.linalg.norm(center)
        x = np.cross([0.0, 1.0, 0.0], z)
        x /= np.linalg.norm(x)
        viewmat = np.eye(4)
        viewmat[:3, :3] = np.stack([x, np.cross(z, x), z])
        viewmat[:3, 3] = -viewmat[:3, :3] @ center
        viewmats.append(viewmat)
    focal = 1.1 * size
    K = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]])
    return Cameras(
        viewmats=np.stack(viewmats),
        Ks=np.repeat(K[None], views, axis=0),
        widths=np.full(views, size),
        heights=np.full(views, size),
        names=tuple(f"view_{i:02}.png" for i in range(views)),
    )


def toy_photos(seed: int = 0, *, held_out: tuple[int, ...] = ()) -> ToyPhotos:
    """Pictures of `toy_splats`, with points near where the splats are."""
    splats, cameras = toy_splats(seed), toy_cameras()
    images = []
    for K, viewmat in zip(cameras.Ks, cameras.viewmats, strict=True):
        rgb = render(splats, K, viewmat, SIZE, SIZE).rgb
        assert rgb.mean() > 0.1, "the toy capture must show something"
        images.append((np.clip(rgb, 0, 1) * 255 + 0.5).astype(np.uint8))
    rng = np.random.default_rng(seed + 1)
    points = splats.means.astype(np.float64) + rng.normal(size=splats.means.shape) * 0.03
    colors = np.clip((splats.sh0[:, 0] * 0.2820948 + 0.5) * 255, 0, 255).astype(np.uint8)
    return ToyPhotos(
        scene=Scene(cameras=cameras, points=PointCloud(points=points, colors=colors)),
        train=[i for i in range(VIEWS) if i not in held_out],
        test=list(held_out),
        images=images,
        masks=[None] * VIEWS,
    )


@pytest.fixture(scope="session")
def photos() -> ToyPhotos:
    """The toy capture, all views for training. Do not change it."""
    return toy_photos()


@pytest.fixture
def make_photos() -> Callable[..., ToyPhotos]:
    """`toy_photos(seed, held_out=...)`."""
    return toy_photos


@pytest.fixture(scope="session")
def known_splats() -> Splats:
    """What the pictures of the toy capture show. Do not change it."""
    return toy_splats()


@pytest.fixture(scope="session")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The toy capture as a COLMAP folder. Do not change it."""
    root = tmp_path_factory.mktemp("capture")
    photos = toy_photos()
    cameras, cloud = photos.scene.cameras, photos.scene.points
    K = cameras.Ks[0]
    camera = ColmapCamera(
        model="PINHOLE",
        width=SIZE,
        height=SIZE,
        params=np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]]),
    )
    images = [
        ColmapImage(
            id=i + 1,
            name=cameras.names[i],
            camera_id=1,
            qvec=rotmat_to_quat(cameras.viewmats[i, :3, :3]),
            tvec=cameras.viewmats[i, :3, 3],
            xys=np.zeros((0, 2)),
            point3D_ids=np.zeros(0, np.int64),
        )
        for i in range(VIEWS)
    ]
    n = len(cloud)
    points = ColmapPoints(
        ids=np.arange(1, n + 1),
        xyz=cloud.points,
        rgb=cloud.colors,
        error=np.full(n, 0.5),
        track_lengths=np.zeros(n, np.int32),
    )
    write_model(ColmapModel(cameras={1: camera}, images=images, points=points), root / "sparse/0")
    for name, image in zip(cameras.names, photos.images, strict=True):
        write_png(root / "images" / name, image)
    return root


@pytest.fixture
def marked_model() -> Callable[..., Model]:
    """`make(n)`: a model of n rows in which every number tells its row.

    Parameters hold the row, first moments 1000 + row, second moments 2000 + row, and the counter
    `seen` 3000 + row, so that a row that gets lost on the way shows.
    """

    def make(n: int, *, sh_rest: int = 3) -> Model:
        row = torch.arange(n, dtype=torch.float32)
        model = Model(
            {
                "means": row[:, None].repeat(1, 3),
                "quats": row[:, None].repeat(1, 4) + 1,
                "scales": row[:, None].repeat(1, 3) * 0.01 - 3,
                "opacities": row * 0.1 - 1,
                "sh0": row[:, None, None].repeat(1, 1, 3),
                "shN": row[:, None, None].repeat(1, sh_rest, 3),
            }
        )
        for name, p in model.params.items():
            shape = [n] + [1] * (p.ndim - 1)
            first = (1000 + row).reshape(shape).expand(p.shape).clone()
            model.replace(name, p, first, first + 1000, steps=7)
        model.rows["seen"] = 3000 + row
        return model

    return make


@pytest.fixture(autouse=True)
def one_torch_thread() -> Iterator[None]:
    """As in a run: torch has one thread."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(autouse=True)
def no_lpips(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Results must not depend on the network for LPIPS that this machine may have."""
    if request.node.get_closest_marker("data") is None:
        for name in ("GSCORE_DATA", "GSCORE_LPIPS"):
            monkeypatch.delenv(name, raising=False)
