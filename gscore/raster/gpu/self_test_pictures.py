"""Pictures of a device in its self-test: repeated, and compared with those of the CPU."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from ...splats import SH_REST_BY_DEGREE
from ...text_format import count_text
from .. import _native
from ..header import DEPTH_OUTPUTS, MEDIAN_SPLAT, OUT_MEDIAN_DEPTH, TILE
from ..request import Frustum, Settings
from .gpu_raster import GpuRaster

_Result = tuple[list[str], dict[str, Any]]
_TOLERANCE = 2e-5
"""Largest difference of pictures, relative to max(1, their largest value): twice the error that
docs/accuracy.md allows each of them."""
_FLIPPED = 1e-3
"""Largest share of pixels in which rounding decided a comparison differently."""
_FOCAL = 60.0


@dataclass(frozen=True, kw_only=True)
class SelfTestScene:
    """Random splats in front of a camera, and how they are drawn."""

    name: str
    count: int = 600
    width: int = 67
    height: int = 45
    degree: int = 3
    sigma: tuple[float, float] = (0.5, 5.0)
    """Range of the standard deviations, px."""
    length: float = 1.0
    """Ratio of the first axis of a splat to the others."""
    orthographic: bool = False
    settings: Settings = field(default_factory=Settings)

    def splats(self) -> list[np.ndarray]:
        """`PARAMETERS`, in their order."""
        rng, n = np.random.default_rng(self.count + self.degree), self.count
        z = rng.uniform(1.5, 6.0, n)
        distance = np.ones(n) if self.orthographic else z
        place = rng.uniform(-0.55, 0.55, (n, 2)) * (self.width, self.height)
        means = np.concatenate([place / _FOCAL * distance[:, None], z[:, None]], axis=1)
        low, high = np.log(self.sigma)
        scales = rng.uniform(low, high, (n, 3)) + np.log(distance / _FOCAL)[:, None]
        scales[:, 0] += np.log(self.length)
        quats = rng.normal(size=(n, 4))
        opacities = rng.uniform(-2.0, 3.0, n)
        sh0 = 0.8 * rng.normal(size=(n, 1, 3))
        shN = 0.25 * rng.normal(size=(n, SH_REST_BY_DEGREE[self.degree], 3))
        arrays = (means, quats, scales, opacities, sh0, shN)
        return [a.astype(np.float32) for a in arrays]

    def view(self) -> Frustum:
        """The camera, slightly turned."""
        K = np.array(
            [[_FOCAL, 0, self.width / 2], [0, _FOCAL, self.height / 2], [0, 0, 1.0]], np.float64
        )
        angle = 0.05
        viewmat = np.eye(4)
        viewmat[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        size = self.width, self.height
        return Frustum(viewmat, K, *size, orthographic=self.orthographic)


def self_test_scenes() -> Iterator[SelfTestScene]:
    """All scenes: each kind of splat, output and setting occurs in one."""
    usual = Settings(background=(0.25, 0.5, 0.125), outputs=sum(DEPTH_OUTPUTS.values()))
    make = partial(SelfTestScene, settings=usual)
    yield make(name="random splats", count=3000)
    yield make(name="needles", count=150, length=1e4, sigma=(1e-3, 1e-2))
    yield make(name="large splats", count=300, sigma=(20.0, 200.0))
    dots = replace(usual, antialias=True)
    yield make(name="antialiased dots", count=2500, sigma=(0.05, 0.6), settings=dots)
    for degree in (0, 1, 2, 4):
        yield make(name=f"harmonics of degree {degree}", count=200, degree=degree)
    yield make(name="a lower degree", degree=3, settings=replace(usual, sh_degree=1))
    yield make(name="parallel rays", orthographic=True)
    yield make(name="colours alone", settings=replace(usual, outputs=0))
    numbers = replace(usual, outputs=OUT_MEDIAN_DEPTH | MEDIAN_SPLAT)
    yield make(name="median splats", settings=numbers)
    far = np.random.default_rng(1).uniform(1.5, 6.0, (45, 67)).astype(np.float32)
    far[::3] = np.nan
    yield make(name="depth limits", settings=replace(usual, far_depths=far))
    tiles = np.zeros((-(-45 // TILE), -(-67 // TILE)), np.uint8)
    tiles[1:, 1:3] = 1
    yield make(name="a window", settings=replace(usual, tiles=tiles))
    yield make(name="one pixel", count=40, width=1, height=1)
    yield make(name="no splats", count=0)


def picture_checks() -> Iterator[tuple[str, Callable[[GpuRaster], _Result]]]:
    """Name and function of each test."""
    for scene in self_test_scenes():
        yield scene.name, partial(compared, scene)


def blank_pictures(scene: SelfTestScene) -> dict[str, np.ndarray]:
    """Arrays for the pictures of a scene, by the names of gs_image."""
    size = scene.height, scene.width
    pictures = {"rgb": np.zeros((*size, 3), np.float32), "alpha": np.zeros(size, np.float32)}
    for name, bit in DEPTH_OUTPUTS.items():
        if scene.settings.outputs & bit:
            pictures[name] = np.zeros(size, np.float32)
    return pictures


def drawn(scene: SelfTestScene, raster: Any) -> dict[str, np.ndarray]:
    """Pictures and radii of a scene, by the names of gs_image."""
    pictures = blank_pictures(scene)
    pictures["radii"] = np.zeros(scene.count, np.int32)
    raster.forward(scene.splats(), scene.view(), scene.settings, pictures)
    return pictures


def compared(scene: SelfTestScene, raster: GpuRaster) -> _Result:
    """Oracle: the CPU's pictures within the tolerance; the same bits in a second drawing."""
    first, second = drawn(scene, raster), drawn(scene, raster)
    problems = [
        f"{name} changes when it is drawn again"
        for name, picture in first.items()
        if picture.tobytes() != second[name].tobytes()
    ]
    with _native.pool.lend() as cpu:
        true = drawn(scene, cpu)
    hidden = int(((first.pop("radii") > 0) != (true.pop("radii") > 0)).sum())
    if hidden > 1 + _FLIPPED * scene.count:
        problems.append(
            f"{hidden} of {count_text(scene.count, 'splat')} are drawn by one of card and CPU"
        )
    for name, picture in first.items():
        error = np.abs(picture - true[name]) / max(1.0, float(np.abs(true[name]).max()))
        wrong = int((~(error <= _TOLERANCE)).sum())  # NaN counts
        if wrong > 1 + _FLIPPED * error.size:
            worst = float(np.nanmax(np.where(np.isfinite(error), error, np.inf)))
            problems.append(f"{name} differs from the CPU's by up to {worst:.1e}")
    return problems, {}
