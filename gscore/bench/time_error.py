"""Run time against error: held-out quality over seconds of training, for variants and seeds."""

import json
import statistics
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..config import TrainConfig
from ..datasets import Dataset
from ..errors import FormatError
from .training import Point, train_measured

_POINTS = 12
"""Measurements along a training, evenly spread over the logarithm of the step."""
_BELOW = (1.0, 0.5, 0.0)
"""dB below the best final PSNR for which the table tells the time."""


@dataclass(frozen=True, kw_only=True)
class Variant:
    """One way to train."""

    label: str
    config: TrainConfig
    photos: Dataset


@dataclass(frozen=True, kw_only=True)
class Curve:
    """What one variant, or another program, reached when."""

    label: str
    width: int
    """Of the first photo, px."""
    height: int
    seeds: list[list[Point]]
    """Measurements of each seed."""

    def median(self) -> list[Point]:
        """The median over seeds of every measurement."""
        count = min(len(points) for points in self.seeds)
        columns = [[points[i] for points in self.seeds] for i in range(count)]
        return [
            Point(
                step=column[0].step,
                seconds=statistics.median(p.seconds for p in column),
                splats=round(statistics.median(p.splats for p in column)),
                psnr=statistics.median(p.psnr for p in column),
                ssim=statistics.median(p.ssim for p in column),
            )
            for column in columns
        ]


def measured_steps(iterations: int, count: int = _POINTS) -> list[int]:
    """About `count` steps from a fiftieth of the run to its end, evenly spread in factors."""
    first = max(iterations // 50, 1)
    return sorted({int(s) for s in np.geomspace(first, iterations, count).round()})


def measure_variant(
    variant: Variant,
    seeds: Sequence[int],
    *,
    on_step: Callable[[str, int, int, int], None] | None = None,
) -> Curve:
    """Train a variant once a seed.

    Args:
        variant: What to train.
        seeds: Seeds, at least one.
        on_step: Called with label, seed, step and number of steps after each step.
    """
    at = measured_steps(variant.config.iterations)
    runs = []
    for seed in seeds:

        def stepped(step: int, seed: int = seed) -> None:
            if on_step is not None:
                on_step(variant.label, seed, step, variant.config.iterations)

        found = train_measured(
            replace(variant.config, seed=seed), variant.photos, at=at, on_step=stepped
        )
        runs.append(found.points)
    cameras = variant.photos.scene.cameras
    return Curve(
        label=variant.label,
        width=int(cameras.widths[0]),
        height=int(cameras.heights[0]),
        seeds=runs,
    )


def time_to_psnr(curves: Sequence[Curve]) -> list[dict[str, Any]]:
    """When each curve first reached the best final PSNR less 1, 0.5 and 0 dB.

    Returns:
        One row a curve: `label`, `psnr` (final, dB) and `seconds`, a mapping from the PSNR aimed at
        to seconds, interpolated between measurements, or None where it was not reached.
    """
    best = max(curve.median()[-1].psnr for curve in curves)
    rows = []
    for curve in curves:
        points = curve.median()
        seconds = {f"{best - below:.2f}": _when(points, best - below) for below in _BELOW}
        rows.append({"label": curve.label, "psnr": points[-1].psnr, "seconds": seconds})
    return rows


def _when(points: Sequence[Point], aim: float) -> float | None:
    for place, point in enumerate(points):
        if point.psnr >= aim - 1e-9:
            if place == 0:
                return point.seconds
            before = points[place - 1]
            share = (aim - before.psnr) / max(point.psnr - before.psnr, 1e-9)
            return before.seconds + share * (point.seconds - before.seconds)
    return None


def curve_json(curve: Curve) -> dict[str, Any]:
    """A curve as JSON values; `read_curves` reads them."""
    return asdict(curve)


def read_curves(path: Path) -> tuple[str, list[Curve]]:
    """Curves of another program for one capture, from the small JSON that docs/benchmarks.md
    describes.

    Returns:
        The capture's name and the curves.

    Raises:
        FormatError: not such a file; says which value is missing or wrong.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        curves = [
            Curve(
                label=str(entry["label"]),
                width=int(entry["width"]),
                height=int(entry["height"]),
                seeds=[[_point(point) for point in points] for points in entry["seeds"]],
            )
            for entry in content["curves"]
        ]
        if not curves or not all(points for curve in curves for points in curve.seeds):
            raise ValueError("a curve has no points")
        return str(content["capture"]), curves
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}).") from error
    except KeyError as error:
        raise FormatError(f"{path}: the value {error} is missing.") from error
    except (TypeError, ValueError) as error:
        raise FormatError(f"{path}: not a file of curves ({error}).") from error


def _point(value: dict[str, Any]) -> Point:
    return Point(
        step=int(value.get("step", 0)),
        seconds=float(value["seconds"]),
        splats=int(value.get("splats", 0)),
        psnr=float(value["psnr"]),
        ssim=float(value.get("ssim", float("nan"))),
    )
