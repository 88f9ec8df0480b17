"""Metrics file: metrics.json, validated because it may be damaged or edited."""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..errors import DatasetError
from ..json_text import parse_json
from ..quoting import as_typed
from .files import read_bytes

_LARGEST = 1 << 53
"""Largest number that is read: gscore writes no larger ones, and some exceed float."""


def read_metrics(path: Path) -> dict[str, Any]:
    """Read the metrics.json of a training or an evaluation in a folder.

    Returns:
        Its content without entries of an unexpected type; empty if the file is missing, broken or
        no regular file. `metrics_problem` has the reason.
    """
    return _read(path)[0]


def metrics_problem(path: Path) -> str:
    """Message about entries that `read_metrics` left out of a folder's metrics.json; empty if
    none."""
    return _read(path)[1]


def _read(path: Path) -> tuple[dict[str, Any], str]:
    file = path / "metrics.json"
    again = f"`{as_typed('eval', path)}` measures again."
    try:
        content = parse_json(read_bytes(file))
    except (DatasetError, ValueError):
        return {}, f"{file} is damaged; {again}" if file.exists() else ""
    if not isinstance(content, dict):
        return {}, f"{file} is damaged: an object was expected; {again}"
    odd = [key for key, value in content.items() if not _is_sound(key, value)]
    sound = {key: value for key, value in content.items() if key not in odd}
    names = ", ".join(key[:40] for key in odd[:3]) + (" and others" if len(odd) > 3 else "")
    return sound, f"{file} is damaged: {names} cannot be; {again}" if odd else ""


def is_number(value: Any) -> bool:
    """True for a finite int or float of usual size; False for booleans."""
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and -_LARGEST <= value <= _LARGEST
        and math.isfinite(value)
    )


def _is_sound(key: str, value: Any) -> bool:
    kind = next((kind for names, kind in _KEYS if names.fullmatch(key)), None)
    return kind is None or value is None or kind(value)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and is_number(value)


def _is_object(value: Any) -> bool:
    return isinstance(value, dict)


def _are_texts(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_text, value))


def _are_objects(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_object, value))


def _are_counts(value: Any) -> bool:
    return _is_object(value) and all(map(_is_whole, value.values()))


def _are_rows(value: Any) -> bool:
    """True for a list of objects with numbers, as of curves; `phase` is a text."""
    return _are_objects(value) and all(
        item is None or (_is_text(item) if key == "phase" else is_number(item))
        for row in value
        for key, item in row.items()
    )


def _is_exposure(value: Any) -> bool:
    """True for an object with `learnt`, `why`, `stops_apart` and `known_by`."""
    return (
        _is_object(value)
        and isinstance(value.get("learnt"), bool)
        and _is_text(value.get("why"))
        and is_number(value.get("stops_apart"))
        and (value.get("known_by") is None or _is_text(value["known_by"]))
    )


def _are_poses(value: Any) -> bool:
    """True for an object with `why`, and `degrees` and `extents` by name under `cameras`."""
    return (
        _is_object(value)
        and _is_text(value.get("why"))
        and _is_object(value.get("cameras"))
        and all(
            _is_object(one) and is_number(one.get("degrees")) and is_number(one.get("extents"))
            for one in value["cameras"].values()
        )
    )


def _are_decisions(value: Any) -> bool:
    """True for a list of objects with the texts `topic` and `text`."""
    return _are_objects(value) and all(
        _is_text(one.get("topic")) and _is_text(one.get("text")) for one in value
    )


_Kind = Callable[[Any], bool]
_KEYS: tuple[tuple[re.Pattern[str], _Kind], ...] = tuple(
    (re.compile(names), kind)
    for names, kind in (
        (r"split|reason|mask_mode|gscore|lpips_net|trained_at|model|psnr_masked_of", _is_text),
        (r"\w+_reason", _is_text),
        (r"psnr\w*|ssim\w*|d_ssim|ms_ssim|lpips\w*|fps|train_seconds", is_number),
        (r"steps|splats|sh_degree|storage_bytes|peak_memory_bytes", _is_whole),
        (r"train_views|test_views|decided", _are_texts),
        (r"decisions", _are_decisions),
        (r"history|evals", _are_rows),
        (r"views", _are_objects),
        (r"machine|depth", _is_object),
        (r"asked", _are_counts),
        (r"exposure", _is_exposure),
        (r"poses", _are_poses),
    )
)
"""Type check by key of metrics.json, for values other than null; the first match applies."""
