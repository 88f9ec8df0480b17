"""Captures for the depth experiment: fewer views, exact depth, and depth as a network errs."""

import json
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from gscore.io.colmap.folder import read_model, write_model
from gscore.io.colmap.model import ColmapImage, ColmapModel
from gscore.io.images.pillow_images import loaded
from gscore.io.images.png import write_png
from gscore.io.images.read_image import read_image

ROOT = Path(__file__).parents[2]
STUDIO_UNIT = 4.0

FULL = 65536
"""Inverse depth = value / FULL * the map's own range."""
BLUR, WARP, WAVES, NOISE = 3.0, 2.5, 0.05, 0.01
"""Errors of a simulated network: blur and displaced edges in px of a picture 480 px wide, slow
waves over the picture and noise as fine as the blur, both relative."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """A capture to experiment with."""

    name: str
    folder: Path
    depths: Path
    """Exact (or reference) inverse depth, 16 bit, <stem>.png."""
    unit: float
    """1/world unit of the value FULL in them."""
    test: tuple[str, ...]
    """Names of the held-out views, the same in all experiments."""


def studio() -> Source:
    """The bundled capture."""
    folder = ROOT / "examples" / "studio"
    return Source(
        name="studio",
        folder=folder,
        depths=folder / "depths",
        unit=STUDIO_UNIT,
        test=tuple((folder / "test.txt").read_text().split()),
    )


def train(folder: Path, out: Path, options: list[str]) -> dict[str, Any]:
    """Train as `gscore train` does, without checkpoints; returns what it prints as JSON."""
    command = [sys.executable, "-m", "gscore", "train", folder, "-o", out, "--overwrite"]
    command += ["--quiet", "--json", "--checkpoint-seconds", "0", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, command))}\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def few_views(source: Source, count: int, folder: Path) -> list[str]:
    """Write a capture with `count` training views far from each other, and all test views.

    Only points that at least two of the training views observe stay, as if SfM had had no more.

    Returns:
        Names of the training views.
    """
    model = read_model(source.folder)
    train = _spread(training_views(source), count)
    names = {image.name for image in train}
    ids, times = np.unique(
        np.concatenate([np.unique(image.point3D_ids) for image in train]), return_counts=True
    )
    known = ids[(times >= 2) & (ids != -1)]
    images = [
        replace(
            image,
            point3D_ids=np.where(np.isin(image.point3D_ids, known), image.point3D_ids, -1),
        )
        for image in model.images
        if image.name in names or image.name in source.test
    ]
    points, keep = model.points, np.isin(model.points.ids, known)
    lengths = dict(zip(ids.tolist(), times.tolist(), strict=True))
    points = replace(
        points,
        ids=points.ids[keep],
        xyz=points.xyz[keep],
        rgb=points.rgb[keep],
        error=points.error[keep],
        track_lengths=np.array([lengths[i] for i in points.ids[keep].tolist()], np.int32),
    )
    shutil.rmtree(folder, ignore_errors=True)
    write_model(
        ColmapModel(cameras=model.cameras, images=images, points=points), folder / "sparse" / "0"
    )
    for image in images:
        (folder / "images" / image.name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source.folder / "images" / image.name, folder / "images" / image.name)
        mask = source.folder / "masks" / f"{Path(image.name).stem}.png"
        if mask.is_file():
            (folder / "masks").mkdir(exist_ok=True)
            shutil.copy(mask, folder / "masks" / mask.name)
    (folder / "test.txt").write_text("".join(f"{name}\n" for name in source.test))
    return sorted(names)


def training_views(source: Source) -> list[ColmapImage]:
    """All views that are not held out."""
    return [i for i in read_model(source.folder).images if i.name not in source.test]


def write_depths(source: Source, names: list[str], folder: Path) -> None:
    """Exact depth maps of the training views, in `depths-exact`."""
    for name in names:
        path = source.depths / f"{Path(name).stem}.png"
        target = folder / "depths-exact" / path.name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, target)


def write_mono(source: Source, names: list[str], folder: Path, *, seed: int) -> None:
    """Depth maps of the training views as a network might give them, 16 bit each by its range."""
    for place, name in enumerate(sorted(names)):
        stem = Path(name).stem
        rng = np.random.default_rng([seed, place])
        values = monocular(exact(source, name), rng)
        low, high = float(values.min()), float(values.max())
        levels = (values - low) / ((high - low) or 1.0) * 65535
        write_png(folder / f"{stem}.png", (levels + 0.5).astype(np.uint16))


def exact(source: Source, name: str) -> np.ndarray:
    """[H, W] float64 inverse depth, 1/world unit, 0 where nothing is."""
    stored = read_depth_png(source.depths / f"{Path(name).stem}.png")
    return stored.astype(np.float64) / FULL * source.unit


def monocular(inverse_depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What a network might say: edges displaced and blurred, slow errors, noise, unknown affine.

    Args:
        inverse_depth: [H, W], exact.
        rng: Source of all of it.

    Returns:
        [H, W] of another scale and offset.
    """
    height, width = inverse_depth.shape
    px = width / 480

    def waves(sigma: float) -> np.ndarray:
        noise = gaussian_filter(rng.normal(size=(height, width)), sigma * px, mode="reflect")
        return noise / noise.std()

    rows, columns = np.mgrid[:height, :width].astype(float)
    moved = [rows + WARP * px * waves(20), columns + WARP * px * waves(20)]
    out = map_coordinates(inverse_depth, moved, order=1, mode="nearest")
    out = gaussian_filter(out, BLUR * px)
    out = out * (1 + WAVES * waves(60)) * (1 + NOISE * waves(BLUR))
    scale = np.exp(rng.uniform(-1, 1))
    offset = rng.uniform(-0.2, 0.2) * np.median(inverse_depth)
    return (out - offset) / scale


def read_depth_png(path: Path) -> np.ndarray:
    """[H, W] of a 16-bit grey PNG."""
    with loaded(path) as (image, _):
        return np.asarray(image).astype(np.uint16)


def photo(source: Source, name: str) -> np.ndarray:
    """[H, W, 3] uint8."""
    return read_image(source.folder / "images" / name)[..., :3]


def _spread(images: list[ColmapImage], count: int) -> list[ColmapImage]:
    """`count` images, each as far as possible from those before; the first is the first by name."""
    images = sorted(images, key=lambda image: image.name)
    centers = np.stack([-image.viewmat[:3, :3].T @ image.viewmat[:3, 3] for image in images])
    chosen = [0]
    distance = np.linalg.norm(centers - centers[0], axis=1)
    while len(chosen) < min(count, len(images)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(centers - centers[chosen[-1]], axis=1))
    return [images[i] for i in sorted(chosen)]
