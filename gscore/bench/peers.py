"""Peer curves: results of other programs, from the JSON format of docs/metrics.md."""

import math
from pathlib import Path
from typing import Any

from ..errors import FormatError
from ..io.files import read_bytes
from ..json_text import parse_json
from ..quoting import brief, quoted
from .time_error import Curve
from .training import Point


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
