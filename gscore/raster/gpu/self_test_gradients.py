"""Gradients of a device in its self-test: repeated, and compared with those of the CPU."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ...splats import PARAMETERS
from .. import _native
from ..header import OUT_DEPTH, OUT_INVERSE_DEPTH
from ..request import Settings
from .gpu_raster import GpuRaster
from .header import GRADIENTS
from .self_test_pictures import SelfTestScene, blank_pictures

_MEDIAN, _TAIL = 2e-5, 2e-3
"""Twice the errors that docs/accuracy.md allows each of card and CPU: median and 99.9th percentile
of |difference| / |row of the CPU's gradient|."""
_ROW_FLOOR, _NUMBER_FLOOR = 0.01, 0.1
"""Rows shorter than this share of the median row count as that long; rows of a single number, whose
sums cancel, the second share."""


def gradient_scenes() -> Iterator[SelfTestScene]:
    """Scenes of all kinds that have gradients."""
    settings = Settings(background=(0.25, 0.5, 0.125), outputs=OUT_INVERSE_DEPTH | GRADIENTS)
    make = partial(SelfTestScene, settings=settings)
    yield make(name="gradients of random splats", count=900)
    yield make(name="gradients of needles", count=150, length=1e2, sigma=(3e-2, 3e-1))
    yield make(name="gradients of large splats", count=300, sigma=(20.0, 200.0))
    dots = replace(settings, antialias=True)
    yield make(name="gradients of antialiased dots", count=900, sigma=(0.05, 0.6), settings=dots)
    for degree in (0, 1, 2):
        yield make(name=f"gradients of degree {degree}", count=200, degree=degree)
    depths = replace(settings, outputs=settings.outputs | OUT_DEPTH)
    yield make(name="gradients of degree 4 and of depths", count=200, degree=4, settings=depths)
    yield make(name="gradients of a lower degree", settings=replace(settings, sh_degree=1))
    yield make(name="gradients of one pixel", count=40, width=1, height=1)
    yield make(name="gradients of no splats", count=0)


def gradients(scene: SelfTestScene, raster: Any, *, fewer: bool = False) -> dict[str, np.ndarray]:
    """Gradients of a random function of a scene's pictures, by the names of gs_splat_grads.

    `fewer`: the function has no depths and no alpha.
    """
    splats, pictures = scene.splats(), blank_pictures(scene)
    rng = np.random.default_rng(2)
    v = {name: rng.normal(size=p.shape).astype(np.float32) for name, p in pictures.items()}
    found = {name: np.zeros_like(a) for name, a in zip(PARAMETERS, splats, strict=True)}
    found |= {"means2d": np.zeros((scene.count, 2), np.float32)}
    found |= {"viewmat": np.zeros((4, 4), np.float32)}
    view, settings = scene.view(), scene.settings
    raster.forward(splats, view, settings, pictures)
    raster.backward(splats, view, settings, {"rgb": v["rgb"]} if fewer else v, found)
    return found


def _compared(scene: SelfTestScene, raster: GpuRaster) -> tuple[list[str], dict[str, Any]]:
    """Oracle: the CPU's gradients within the tolerance; the same bits in a second pass."""
    first, second = gradients(scene, raster), gradients(scene, raster)
    problems = [
        f"the gradient of {name} changes when it is computed again"
        for name, found in first.items()
        if found.tobytes() != second[name].tobytes()
    ]
    with _native.pool.lend() as cpu:
        true = gradients(scene, cpu)
    return problems + gradient_problems(first, true), {}


def gradient_problems(
    gradients: Mapping[str, np.ndarray], true: Mapping[str, np.ndarray]
) -> list[str]:
    """Problems of gradients by their names, as parts of sentences; `true`: the CPU's."""
    problems = []
    for name, found in gradients.items():
        errors = row_errors(found, true[name])
        if errors.size == 0:
            continue
        for what, error, most in (
            ("median", float(np.median(errors)), _MEDIAN),
            ("99.9th percentile", float(np.quantile(errors, 0.999)), _TAIL),
        ):
            if not error <= most:
                problems.append(
                    f"the gradient of {name} differs from the CPU's by {error:.1e} ({what})"
                )
    return problems


def row_errors(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """|difference| / |row of the truth|, [numbers], for rows that are not zero in both."""
    if true.size == 0:
        return np.zeros(0)
    if true.shape == (4, 4):
        found, true = found.reshape(1, 16), true.reshape(1, 16)
    rows = true.reshape(len(true), -1).astype(np.float64)
    difference = np.abs(found.reshape(rows.shape) - rows)
    length = np.linalg.norm(rows, axis=1)
    seen = (length > 0) | difference.any(axis=1)
    if not seen.any():
        return np.zeros(0)
    floor = (_NUMBER_FLOOR if rows.shape[1] == 1 else _ROW_FLOOR) * float(np.median(length[seen]))
    return (difference[seen] / np.maximum(length[seen], max(floor, 1e-30))[:, None]).ravel()


def gradient_checks() -> Iterator[tuple[str, Callable[[GpuRaster], Any]]]:
    """Name and function of each test."""
    for scene in gradient_scenes():
        yield scene.name, partial(_compared, scene)
