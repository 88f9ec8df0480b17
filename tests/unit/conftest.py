"""Fixtures of the unit tests: random rotations, damaged copies of a file, small captures."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
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
from gscore.io.colmap.lenses import MODELS_BY_NAME
from gscore.io.images.png import write_png
from gscore.transforms import rotmat_to_quat


@pytest.fixture
def rng() -> np.random.Generator:
    """Seeded generator."""
    return np.random.default_rng(20)


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Folder with real captures; the test is skipped without it."""
    root = os.environ.get("GSCORE_DATA")
    if not root:
        pytest.skip("GSCORE_DATA is not set")
    return Path(root) / "data"


@pytest.fixture(scope="session")
def mutations() -> Callable[[bytes], Iterator[bytes]]:
    """Damaged copies of a file: cut at many lengths, bytes flipped, counts raised, noise."""

    def damage(good: bytes) -> Iterator[bytes]:
        rng = np.random.default_rng(5)
        cuts = sorted({0, 1, 3, 7, 8, *rng.integers(0, len(good), 40).tolist(), len(good) - 1})
        yield from (good[:cut] for cut in cuts)
        for _ in range(120):
            raw = bytearray(good)
            for at in rng.integers(0, len(raw), int(rng.integers(1, 6))):
                raw[at] = int(rng.integers(0, 256))
            yield bytes(raw)
        for at in [0, 4, 8, *rng.integers(0, max(1, len(good) - 8), 30).tolist()]:
            yield good[:at] + b"\xff" * 8 + good[at + 8 :]
            yield good[:at] + (10**12).to_bytes(8, "little") + good[at + 8 :]
        yield from (rng.bytes(size) for size in (8, 64, 1000))
        yield good + good

    return damage


def _look_at(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """[4, 4] world to camera, OpenCV axes, world +y down."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    viewmat = np.eye(4)
    viewmat[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    viewmat[:3, 3] = -viewmat[:3, :3] @ position
    return viewmat


@dataclass
class SmallCapture:
    """A COLMAP capture on disk with known values of every quantity."""

    root: Path
    model: ColmapModel
    photos: dict[str, np.ndarray] = field(default_factory=dict)


@pytest.fixture
def make_capture(tmp_path: Path) -> Callable[..., SmallCapture]:
    """Write a capture: cameras in a ring around coloured points, and photos of them.

    Each point is a disc of its own colour, radius 3 px, so that colours and positions can be read
    back from the photos.
    """

    def make(
        *,
        root: Path | None = None,
        views: int = 9,
        size: tuple[int, int] = (64, 48),
        model: str = "PINHOLE",
        params: list[float] | None = None,
        names: list[str] | None = None,
        black: bool = False,
        points: int = 6,
        alpha: bool = False,
        write: bool = True,
    ) -> SmallCapture:
        root = root or tmp_path / "capture"
        width, height = size
        if params is None:
            named = {"f": 60.0, "fx": 60.0, "fy": 62.0, "cx": width / 2 + 1.5, "cy": height / 2 - 1}
            params = [named.get(name, 0.0) for name in MODELS_BY_NAME[model].params]
        camera = ColmapCamera(
            model=model, width=width, height=height, params=np.array(params, float)
        )
        rng = np.random.default_rng(3)
        xyz = rng.uniform(-0.6, 0.6, (points, 3))
        rgb = rng.integers(40, 255, (points, 3)).astype(np.uint8)
        names = names or [f"view_{i:02d}.png" for i in range(views)]
        images, photos = [], {}
        for i, name in enumerate(names):
            angle = 2 * np.pi * i / len(names)
            position = np.array([3 * np.cos(angle), -0.8, 3 * np.sin(angle)])
            viewmat = _look_at(position, np.zeros(3))
            in_camera = xyz @ viewmat[:3, :3].T + viewmat[:3, 3]
            projected = in_camera @ camera.K.T
            xys = projected[:, :2] / projected[:, 2:]
            photo = np.full((height, width, 4 if alpha else 3), 20, np.uint8)
            if alpha:
                photo[..., 3] = 0
            row, column = np.mgrid[0:height, 0:width] + 0.5
            for k in np.argsort(-in_camera[:, 2]):
                disc = np.hypot(column - xys[k, 0], row - xys[k, 1]) < 3
                photo[disc, :3] = rgb[k]
                photo[disc, 3:] = 255
            photos[name] = photo
            images.append(
                ColmapImage(
                    id=i + 1,
                    name=name,
                    camera_id=1,
                    qvec=rotmat_to_quat(viewmat[:3, :3]),
                    tvec=viewmat[:3, 3].copy(),
                    xys=xys,
                    point3D_ids=np.arange(points, dtype=np.int64) * 7 + 11,
                )
            )
            if write:
                write_png(root / "images" / name, photo)
        colmap = ColmapModel(
            cameras={1: camera},
            images=images,
            points=ColmapPoints(
                ids=np.arange(points, dtype=np.int64) * 7 + 11,
                xyz=xyz,
                rgb=np.zeros_like(rgb) if black else rgb,
                error=np.full(points, 0.5),
                track_lengths=np.full(points, len(names), np.int32),
            ),
        )
        if write:
            write_model(colmap, root / "sparse" / "0")
        return SmallCapture(root=root, model=colmap, photos=photos)

    return make
