"""Figures and table of the curves of `gscore bench time-error`."""

import math
from pathlib import Path

from ...bench.time_error import Curve, labels, time_to_psnr
from ...io.files import atomic_write
from ...report.curves import Series
from ...report.figure import figure
from ...text_format import markdown_table

_PSNR, _SSIM, _SPLATS = "psnr", "1-ssim", "splats"


def figure_files(output: Path, name: str) -> list[Path]:
    """Files written by `write_curves`."""
    return [_file(output, name, key) for key in (_PSNR, _SSIM, _SPLATS)]


def write_curves(output: Path, name: str, curves: list[Curve]) -> None:
    """Write PSNR and 1 - SSIM over time, and PSNR over splats, of the capture `name`."""
    medians = [(label, c.median()) for label, c in zip(labels(curves), curves, strict=True)]
    pictures = {
        _PSNR: ("PSNR, dB", lambda p: p.psnr, False),
        _SSIM: ("1 - SSIM", lambda p: 1 - p.ssim, True),
    }
    for key, (label, value, log_y) in pictures.items():
        series = [
            Series(
                label=one,
                points=[(p.seconds, value(p)) for p in points if math.isfinite(value(p))],
                dots=True,
            )
            for one, points in medians
        ]
        series = [s for s in series if s.points]
        if not series:
            continue
        text = figure(
            series,
            title=f"{name}: held-out {label.split(',')[0]} over training time",
            x_label="seconds in training steps",
            y_label=label,
            log_x=True,
            log_y=log_y,
        )
        atomic_write(_file(output, name, key), text.encode())
    ends = [
        Series(
            label=f"{curve.label}, {curve.width} px", points=[(p[-1].splats, p[-1].psnr)], dots=True
        )
        for curve, (_, p) in zip(curves, medians, strict=True)
        if p[-1].splats and math.isfinite(p[-1].psnr)
    ]
    if ends:
        text = figure(
            ends,
            title=f"{name}: PSNR over number of splats at the end",
            x_label="splats",
            y_label="PSNR, dB",
            log_x=True,
        )
        atomic_write(_file(output, name, _SPLATS), text.encode())


def table(name: str, curves: list[Curve]) -> str:
    """Seconds to PSNR levels of each curve in Markdown, one table per picture width."""
    rows = time_to_psnr(curves)
    widths = list(dict.fromkeys(row["width"] for row in rows))
    tables = []
    for width in widths:
        own = [row for row in rows if row["width"] == width]
        head = name if len(widths) == 1 else f"{name}, {width} px"
        aims = [f"s to {aim} dB" for aim in own[0]["seconds"]]
        rows_of_width = [
            [row["label"], f"{row['psnr']:.2f}"]
            + ["-" if s is None else f"{s:.1f}" for s in row["seconds"].values()]
            for row in own
        ]
        tables.append(markdown_table([head, "final PSNR", *aims], rows_of_width))
    return "\n\n".join(tables)


def _file(output: Path, name: str, key: str) -> Path:
    return output / f"{name}-{key}.svg"
