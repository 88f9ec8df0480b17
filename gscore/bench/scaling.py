"""Scaling bench: cost by splats, pixels, threads and views, each point in its own process, with a
line fitted to the points."""

import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..io.ply.splats import write_splats
from ..json_text import parse_json
from .child_process import run_child
from .synthetic import SyntheticPhotos

SPLATS = (10_000, 30_000, 100_000, 300_000, 1_000_000, 2_000_000)
SIZES = ((400, 250), (640, 400), (1280, 800), (1920, 1200), (2560, 1600), (3584, 2240))
"""0.1 to 8 megapixels."""
VIEW_COUNTS = (10, 30, 100, 300, 1000)
CACHE_MB = 64
"""Photo cache in the second row of each number of views, MB."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """A fitted line."""

    base: float
    """Value at zero."""
    slope: float
    r2: float
    """Coefficient of determination."""


@dataclass(frozen=True, kw_only=True)
class Scaling:
    """Costs over one quantity."""

    quantity: str
    """`splats`, `pixels`, `threads` or `views`."""
    rows: list[dict[str, Any]]
    """Output of `gscore bench step --json` for each point, without the machine; for views with
    `cache_mb`."""
    lines: dict[str, Line]
    """Lines of step_ms and of each part over splats or pixels; empty for the others."""


def fit_line(xs: Sequence[float], ys: Sequence[float]) -> Line:
    """Least-squares fit, each point weighted by 1 / y^2, as errors are relative."""
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
    views: Sequence[int] = VIEW_COUNTS,
    cloud: int = 100_000,
    steps: int = 20,
    on_row: Callable[[str, dict[str, Any]], None] | None = None,
) -> list[Scaling]:
    """Measure steps of the synthetic cloud: over splats at 640 x 400 px; over pixels, threads and
    views with `cloud` splats. Views are JPEG files, measured with all photos in memory and with a
    cache of CACHE_MB, for at least one step per view.

    Args:
        splats: Sizes of the cloud.
        sizes: Widths and heights, px.
        threads: Numbers of threads.
        views: Numbers of views.
        cloud: Number of splats while another quantity varies.
        steps: Steps per point.
        on_row: Called with the quantity and each finished row.
    """
    found = []

    def series(quantity: str, points: Iterable[dict[str, Any]]) -> None:
        rows = []
        for point in points:
            rows.append(point)
            if on_row is not None:
                on_row(quantity, point)
        found.append(Scaling(quantity=quantity, rows=rows, lines=_lines(quantity, rows)))

    series("splats", (_cloud(count, 640, 400, 0, steps) for count in splats))
    series("pixels", (_cloud(cloud, width, height, 0, steps) for width, height in sizes))
    series("threads", (_cloud(cloud, 640, 400, count, steps) for count in threads))
    with tempfile.TemporaryDirectory(prefix="gscore-") as folder:
        series("views", _views(Path(folder), views, cloud, steps))
    return found


def _lines(quantity: str, rows: list[dict[str, Any]]) -> dict[str, Line]:
    if quantity not in ("splats", "pixels") or len(rows) < 3:
        return {}
    xs = [r["splats"] if quantity == "splats" else r["width"] * r["height"] for r in rows]
    parts = {"step": [r["step_ms"] for r in rows]}
    for name in rows[0]["raster_ms"]:
        parts[name] = [r["raster_ms"][name] for r in rows]
    return {name: fit_line(xs, ys) for name, ys in parts.items()}


def _cloud(count: int, width: int, height: int, threads: int, steps: int) -> dict[str, Any]:
    size = ["--splats", str(count), "--width", str(width), "--height", str(height)]
    return _measure([*size, "--threads", str(threads), "--steps", str(steps)])


def _views(folder: Path, counts: Sequence[int], cloud: int, steps: int) -> Iterator[dict[str, Any]]:
    if not counts:
        return
    photos = SyntheticPhotos(cloud, 640, 400)
    write_splats(folder / "splats.ply", photos.splats)
    for count in counts:
        capture = folder / str(count)
        photos.write(capture, count)
        given = [
            str(capture),
            "--ply",
            str(folder / "splats.ply"),
            "--steps",
            str(max(steps, count)),
        ]
        yield _measure(given) | {"cache_mb": None}
        yield _measure([*given, "--cache-mb", str(CACHE_MB)]) | {"cache_mb": CACHE_MB}
        shutil.rmtree(capture)


def _measure(options: list[str]) -> dict[str, Any]:
    command = ["-m", "gscore", "bench", "step", "--json", *options]
    row = parse_json(run_child(command, what="measures a step"))
    del row["machine"]  # the same for all
    return row
