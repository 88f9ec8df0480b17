"""Time-error bench: held-out error over seconds of training: variants, seeds, other programs."""

import itertools
import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..config import DataConfig, TrainConfig
from ..errors import FormatError
from ..events import finite
from ..io.files import read_bytes
from ..json_text import parse_json
from ..quoting import brief, quoted
from ..text_format import count_text
from .training import Point, Variant, first_size, train_measured

_POINTS = 12
"""Measurements along a training, evenly spread over the logarithm of the step."""
_BELOW = (1.0, 0.5, 0.0)
"""Distances from the best final PSNR whose times the table lists, dB."""


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Quality over time of one variant or another program."""

    label: str
    width: int
    """Width of the first measured picture, px."""
    height: int
    seeds: list[list[Point]]
    """Measurements of each seed, the same number for all."""
    trained_width: int | None = None
    """Width of the first training photo, px; None if unknown, like the fields below."""
    iterations: int | None = None
    max_splats: int | None = None

    def median(self) -> list[Point]:
        """The median over seeds of every measurement."""
        return [
            Point(
                step=column[0].step,
                seconds=statistics.median(p.seconds for p in column),
                splats=_median_splats([p.splats for p in column]),
                psnr=statistics.median(p.psnr for p in column),
                ssim=_median([p.ssim for p in column]),
            )
            for column in zip(*self.seeds, strict=True)
        ]


def _median_splats(values: Sequence[int]) -> int:
    return round(statistics.median(values)) if all(values) else 0


def _median(values: Sequence[float]) -> float:
    """Median; NaN if any value is."""
    return math.nan if any(map(math.isnan, values)) else statistics.median(values)


def labels(curves: Sequence[Curve]) -> list[str]:
    """Names of the curves, with the width of the pictures if widths differ."""
    if len({curve.width for curve in curves}) < 2:
        return [curve.label for curve in curves]
    return [f"{curve.label}, {curve.width} px" for curve in curves]


def measured_steps(iterations: int) -> list[int]:
    """About a dozen steps from 1/50 of the run to its end, evenly spaced in the logarithm."""
    first = max(iterations // 50, 1)
    return sorted({int(s) for s in np.geomspace(first, iterations, _POINTS).round()})


def measure_variant(
    variant: Variant,
    seeds: Sequence[int],
    *,
    along: bool = True,
    on_step: Callable[[str, int, int, int], None] | None = None,
) -> Curve:
    """Train a variant with each seed.

    Args:
        variant: The variant.
        seeds: Seeds, at least one.
        along: Measure a dozen times along a training; False: only at its end.
        on_step: Called with label, seed, step and number of steps after each step.
    """
    at = measured_steps(variant.config.iterations) if along else ()
    runs = []
    for seed in seeds:

        def stepped(step: int, seed: int = seed) -> None:
            if on_step is not None:
                on_step(variant.label, seed, step, variant.config.iterations)

        found = train_measured(
            replace(variant.config, seed=seed),
            variant.photos,
            at=at,
            eval_views=variant.eval_views,
            on_step=stepped,
        )
        runs.append(found.points)
    width, height = first_size(variant.eval_views)
    return Curve(
        label=variant.label,
        width=width,
        height=height,
        seeds=runs,
        trained_width=first_size(variant.photos)[0],
        iterations=variant.config.iterations,
        max_splats=variant.config.max_splats,
    )


def time_to_psnr(curves: Sequence[Curve]) -> list[dict[str, Any]]:
    """Times at which each curve first reached the best final PSNR minus 1, 0.5 and 0 dB, compared
    among curves with pictures of the same width.

    Returns:
        One row per curve: `label`, `width`, `psnr` (final, dB) and `seconds`, a mapping from target
        PSNR to seconds, interpolated between measurements, or None if not reached.
    """
    best: dict[int, float] = {}
    for curve in curves:
        end = curve.median()[-1].psnr
        if math.isfinite(end):
            best[curve.width] = max(end, best.get(curve.width, end))
    rows = []
    for curve in curves:
        points = curve.median()
        top = best.get(curve.width)
        aims = [] if top is None else [top - below for below in _BELOW]
        rows.append(
            {
                "label": curve.label,
                "width": curve.width,
                "psnr": points[-1].psnr,
                "seconds": {f"{aim:.2f}": _when(points, aim) for aim in aims},
            }
        )
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
    """A curve as JSON values, None for unknown ones; `read_peers` reads them."""
    content = finite(asdict(curve))
    for point in (point for points in content["seeds"] for point in points):
        point["splats"] = point["splats"] or None
    return content


def read_peers(path: Path) -> tuple[str, list[Curve]]:
    """Curves of another program for one capture.

    Returns:
        Name of the capture, and the curves.

    Raises:
        DatasetError: the file cannot be read.
        FormatError: not such a file; the message names the missing or wrong value.
    """
    try:
        content = parse_json(read_bytes(path))
        curves = [_curve(entry, f"curve {i}") for i, entry in enumerate(_list(content, "curves"))]
        return str(content["capture"]), curves
    except KeyError as error:
        raise FormatError(f"{path}: the value {brief(error)} is missing.") from error
    except (AttributeError, TypeError, ValueError, RecursionError) as error:
        raise FormatError(f"{path}: not a file of curves ({brief(error)}).") from error


def _curve(entry: dict[str, Any], where: str) -> Curve:
    where = f"{where}, {quoted(entry['label'])}"
    seeds = [
        [_point(point, f"{where}, seed {i}, point {j}") for j, point in enumerate(points)]
        for i, points in enumerate(_list(entry, "seeds", where))
    ]
    counts = sorted({len(points) for points in seeds})
    if len(counts) > 1 or not counts[0]:
        raise ValueError(
            f"{where}: all seeds need the same number of points, at least one, got {counts}; "
            "measure all runs at the same steps or times"
        )
    for points in seeds:
        times = [point.seconds for point in points]
        if times != sorted(times):
            raise ValueError(f"{where}: points must be sorted by seconds")
    return Curve(
        label=str(entry["label"]),
        width=_count(entry["width"], f"{where}: width", least=1),
        height=_count(entry["height"], f"{where}: height", least=1),
        seeds=seeds,
    )


def _point(value: dict[str, Any], where: str) -> Point:
    ssim = value.get("ssim")
    return Point(
        step=_count(value.get("step") or 0, f"{where}: step"),
        seconds=_number(value["seconds"], f"{where}: seconds"),
        splats=_count(value.get("splats") or 0, f"{where}: splats"),
        psnr=_number(value["psnr"], f"{where}: psnr"),
        ssim=math.nan if ssim is None else _number(ssim, f"{where}: ssim", least=-1, most=1),
    )


def _list(content: dict[str, Any], name: str, where: str = "") -> list[Any]:
    found = content[name]
    if not isinstance(found, list) or not found:
        raise ValueError(f"{where}{': ' * bool(where)}{name} must be a list of at least one entry")
    return found


def _count(value: Any, name: str, *, least: int = 0) -> int:
    number = _number(value, name, least=least)
    if number != int(number):
        raise ValueError(f"{name} must be a whole number, got {quoted(value)}")
    return int(number)


def _number(value: Any, name: str, *, least: float = 0, most: float = 1e12) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
        raise ValueError(f"{name} must be a number from {least:g} to {most:g}, got {quoted(value)}")
    return float(value)


@dataclass(frozen=True, kw_only=True)
class Size:
    """Size and length of a training."""

    preset: str
    """Preset with the other options."""
    max_splats: int
    width: int
    """Maximum width of photos, px."""
    iterations: int

    def __str__(self) -> str:
        return (
            f"{self.preset}, {self.width} px, {count_text(self.max_splats, 'splat')}, "
            f"{count_text(self.iterations, 'step')}"
        )


@dataclass(frozen=True, kw_only=True)
class SizeOutcome:
    """Time and metrics of a training of one size; medians over seeds."""

    size: Size
    seconds: float
    """Time spent in steps, s."""
    splats: int
    """Number of splats at the end."""
    psnr: float
    """Mean over the held-out views at the common size, dB."""
    ssim: float
    seeds: list[float]
    """PSNR of each seed."""

    @classmethod
    def of(cls, size: Size, curve: Curve) -> "SizeOutcome":
        """The end of the curve of a size."""
        end = curve.median()[-1]
        return cls(
            size=size,
            seconds=end.seconds,
            splats=end.splats,
            psnr=end.psnr,
            ssim=end.ssim,
            seeds=[points[-1].psnr for points in curve.seeds],
        )


def sizes_of(
    preset: str,
    data: DataConfig,
    config: TrainConfig,
    *,
    splats: Sequence[int],
    widths: Sequence[int],
    iterations: Sequence[int],
) -> list[tuple[Size, DataConfig, TrainConfig]]:
    """All combinations of the given numbers; empty sequences keep the value of the preset.

    Raises:
        ConfigError: an invalid number.
    """
    combinations = itertools.product(
        widths or (data.max_width,),
        splats or (config.max_splats,),
        iterations or (config.iterations,),
    )
    return [
        (
            Size(preset=preset, max_splats=n, width=width, iterations=steps),
            replace(data, max_width=width),
            replace(config, max_splats=n, iterations=steps),
        )
        for width, n, steps in combinations
    ]


def pareto_front(
    outcomes: Sequence[SizeOutcome], cost: Callable[[SizeOutcome], float]
) -> list[SizeOutcome]:
    """The Pareto front of cost and PSNR, by increasing cost."""
    front: list[SizeOutcome] = []
    known = [o for o in outcomes if math.isfinite(o.psnr)]
    for outcome in sorted(known, key=lambda o: (cost(o), -o.psnr)):
        if not front or outcome.psnr > front[-1].psnr:
            front.append(outcome)
    return front
