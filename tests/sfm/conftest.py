"""Photos without cameras: a few small ones of the bundled capture, and pictures of splats."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import gscore

STUDIO = Path(__file__).parents[2] / "examples" / "studio"
NEAR = (0, 1, 2, 19, 20, 21, 39, 40)
"""Views of the studio from roughly one side."""


@pytest.fixture(scope="session")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight photos of half the size, in two folders, with spaces in their names."""
    folder = tmp_path_factory.mktemp("holiday")
    for i in NEAR:
        target = folder / ("left side" if i > 20 else "front") / f"view {i:03}.jpg"
        target.parent.mkdir(exist_ok=True)
        with Image.open(STUDIO / f"images/view_{i:03}.jpg") as photo:
            small = photo.resize((photo.width // 2, photo.height // 2), Image.Resampling.LANCZOS)
            small.save(target, quality=95)
    return folder


def cloud(seed: int) -> gscore.Splats:
    """Splats at random in a cube from -1 to 1."""
    rng = np.random.default_rng(seed)
    count = 700
    return gscore.Splats(
        means=rng.uniform(-1, 1, (count, 3)).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        scales=np.log(rng.uniform(0.01, 0.09, (count, 3))).astype(np.float32),
        opacities=np.full(count, 4.0, np.float32),
        sh0=rng.uniform(-1.7, 1.7, (count, 1, 3)).astype(np.float32),
        shN=np.zeros((count, 0, 3), np.float32),
    )


def render_cloud(folder: Path, seed: int, views: int) -> None:
    """Pictures of a random cloud of splats, PNG, from places on an arc around it."""
    splats, size = cloud(seed), 256
    K = np.array([[1.1 * size, 0, size / 2], [0, 1.1 * size, size / 2], [0, 0, 1]])
    for i in range(views):
        turn = 0.12 * i
        viewmat = np.eye(4)
        viewmat[:3, :3] = [
            [np.cos(turn), 0, np.sin(turn)],
            [0, 1, 0],
            [-np.sin(turn), 0, np.cos(turn)],
        ]
        viewmat[:3, 3] = [0, 0.1 * (i % 2), 3.2]
        rgb = gscore.render(splats, K, viewmat, size, size).rgb
        pixels = (np.clip(rgb, 0, 1) * 255).round().astype(np.uint8)
        folder.mkdir(parents=True, exist_ok=True)
        Image.fromarray(pixels).save(folder / f"s{seed}_{i}.png")
