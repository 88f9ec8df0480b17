"""How cost grows with splats, pixels and threads: each point in a process of its own, and the
straight line through the points."""

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

SPLATS = (10_000, 30_000, 100_000, 300_000, 1_000_000, 2_000_000)
SIZES = ((400, 250), (640, 400), (1280, 800), (1920, 1200), (2560, 1600), (3584, 2240))
"""0.1 to 8 megapixels."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """The straight line through some points, and how well it fits."""

    base: float
    """At zero."""
    slope: float
    r2: float
    """Share of the variance that the line explains."""


@dataclass(frozen=True, kw_only=True)
class Series:
    """Costs over one quantity."""

    quantity: str
    """`splats`, `pixels` or `threads`."""
    rows: list[dict[str, Any]]
    """What `gscore bench step --json` says of each point."""
    lines: dict[str, Line]
    """Lines of step_ms and of each part over the quantity; empty for threads."""


def fit_line(xs: Sequence[float], ys: Sequence[float]) -> Line:
    """Least squares, each point weighted by 1 / y^2, as errors are relative."""
    x, y = np.asarray(xs, np.float64), np.asarray(ys, np.float64)
    weight = 1 / np.maximum(np.abs(y), 1e-12)
    columns = np.stack([np.ones_like(x), x], axis=1) * weight[:, None]
    (base, slope), *_ = np.linalg.lstsq(columns, y * weight, rcond=None)
    rest, spread = y - (base + slope * x), y - y.mean()
    total = float((spread**2).sum())
    r2 = 1 - float((rest**2).sum()) / total if total > 0 else 1.0
    return Line(base=float(base), slope=float(slope), r2=r2)


def bench_scaling(
    *,
    splats: Sequence[int] = SPLATS,
    sizes: Sequence[tuple[int, int]] = SIZES,
    threads: Sequence[int],
    cloud: int = 100_000,
    steps: int = 20,
    on_row: Callable[[str, dict[str, Any]], None] | None = None,
) -> list[Series]:
    """Measure steps of the synthetic cloud: over splats at 640 x 400 px, over pixels and over
    threads with `cloud` splats.

    Args:
        splats: Sizes of the cloud.
        sizes: Widths and heights, px.
        threads: Numbers of threads.
        cloud: Splats where another quantity varies.
        steps: Steps a point.
        on_row: Called with the quantity and each row as it is done.
    """
    plans: list[tuple[str, list[tuple[int, int, int, int]]]] = [
        ("splats", [(count, 640, 400, 0) for count in splats]),
        ("pixels", [(cloud, width, height, 0) for width, height in sizes]),
        ("threads", [(cloud, 640, 400, count) for count in threads]),
    ]
    found = []
    for quantity, points in plans:
        rows = []
        for point in points:
            row = _measure(*point, steps=steps)
            rows.append(row)
            if on_row is not None:
                on_row(quantity, row)
        found.append(Series(quantity=quantity, rows=rows, lines=_lines(quantity, rows)))
    return found


def _lines(quantity: str, rows: list[dict[str, Any]]) -> dict[str, Line]:
    if quantity == "threads" or len(rows) < 3:
        return {}
    xs = [r["splats"] if quantity == "splats" else r["width"] * r["height"] for r in rows]
    parts = {"step": [r["step_ms"] for r in rows]}
    for name in rows[0]["raster_ms"]:
        parts[name] = [r["raster_ms"][name] for r in rows]
    return {name: fit_line(xs, ys) for name, ys in parts.items()}


def _measure(count: int, width: int, height: int, threads: int, *, steps: int) -> dict[str, Any]:
    command = [sys.executable, "-m", "gscore", "bench", "step", "--json"]
    command += ["--splats", str(count), "--width", str(width), "--height", str(height)]
    command += ["--threads", str(threads), "--steps", str(steps)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)
