"""`gscore bench scaling`: cost by splats, pixels, threads and views."""

import argparse
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...bench.synthetic import SyntheticPhotos
from ...io.ply.splats import write_splats
from ...json_text import parse_json
from ...metrics.machine import cores, machine
from ...quoting import quoted
from ...raster import native_library
from ...text_format import count_text
from ..parser import add_option
from ..terminal.output import print_json
from ..terminal.status import Rows, Status
from .shared import check_numbers, run_child

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


def _bench(
    args: argparse.Namespace, on_row: Callable[[str, dict[str, Any]], None]
) -> list[Scaling]:
    """Measure steps of the synthetic cloud: over splats at 640 x 400 px; over pixels, threads and
    views with `args.cloud` splats. Views are JPEG files, measured with all photos in memory and
    with a cache of CACHE_MB, for at least one step per view.

    Args:
        args: Arguments of the command.
        on_row: Called with the quantity and each finished row.
    """
    found, cloud, steps = [], args.cloud, args.steps

    def series(quantity: str, points: Iterable[dict[str, Any]]) -> None:
        rows = []
        for point in points:
            rows.append(point)
            on_row(quantity, point)
        found.append(Scaling(quantity=quantity, rows=rows, lines=_lines(quantity, rows)))

    series("splats", (_cloud(count, 640, 400, 0, steps) for count in args.splats))
    series("pixels", (_cloud(cloud, width, height, 0, steps) for width, height in args.sizes))
    series("threads", (_cloud(cloud, 640, 400, count, steps) for count in args.threads))
    with tempfile.TemporaryDirectory(prefix="gscore-") as folder:
        series("views", _views(Path(folder), args.views, cloud, steps))
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    option = partial(add_option, parser)
    option("--splats SPLATS*", "numbers of splats", int, default=SPLATS)
    option("--sizes WxH*", "sizes of the picture, px", size, default=SIZES)
    option("--threads THREADS*", "numbers of threads; default: 1 to all cores", int)
    option("--views VIEWS*", "numbers of photos", int, default=VIEW_COUNTS)
    option("--cloud CLOUD", "number of splats while other quantities vary", int, default=100_000)
    option("--steps STEPS", "steps per point (20)", int, default=20)


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    if args.threads is None:
        args.threads = range(1, cores() + 1)
    check_numbers(args, 1, "splats", "threads", "views", "cloud", "steps")
    with Status(sys.stderr) as status:
        rows = Rows(status, "Measuring", quiet=args.json)
        series = _bench(args, lambda quantity, row: rows(_row(quantity, row)))
    if args.json:
        content = {"machine": machine(), "isa": native_library.isa()}
        print_json(content | {"series": [asdict(one) for one in series]})
    else:
        for one in series:
            sys.stdout.write(_series_text(one))
    return 0


def size(text: str) -> tuple[int, int]:
    """Parse WxH, px."""
    width, _, height = text.partition("x")
    try:
        found = int(width), int(height)
    except ValueError:
        found = 0, 0
    if min(found) < 1:
        raise argparse.ArgumentTypeError(f"a size looks like 640x400, got {quoted(text)}")
    return found


def _row(quantity: str, row: dict[str, Any]) -> str:
    stages = "  ".join(f"{name} {ms:.1f}" for name, ms in row["raster_ms"].items())
    memory, cache = row["peak_memory_bytes"], row.get("cache_mb")
    kept = "" if quantity != "views" else f", {count_text(row['views'], 'view')}"
    kept += "" if cache is None else f", {cache} MB of photos kept"
    return (
        f"{quantity}: {count_text(row['splats'], 'splat')}, {row['width']} x {row['height']} px, "
        f"{count_text(row['threads'], 'thread')}{kept}: {row['step_ms']:.1f} ms, "
        f"{row['pairs_per_pixel']:.0f} pairs per pixel, "
        f"{'-' if memory is None else round(memory / 1e6)} MB; {stages}"
    )


def _series_text(series: Scaling) -> str:
    unit, scale = ("1,000 splats", 1e3) if series.quantity == "splats" else ("megapixel", 1e6)
    return "".join(
        f"{series.quantity}, {name}: {line.base:.2f} ms + {line.slope * scale:.4f} ms per {unit}, "
        f"r2 {line.r2:.3f}\n"
        for name, line in series.lines.items()
    )
