"""Metrics file: metrics.json, validated because it may be damaged or edited."""

import math
import re
from pathlib import Path
from typing import Any

from ..errors import DatasetError
from ..json_text import parse_json
from ..quoting import as_typed, first_few
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
    return sound, f"{file} is damaged: {first_few(odd)} cannot be; {again}" if odd else ""


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
    return kind is None or value is None or _fits(value, kind)


def _fits(value: Any, kind: Any) -> bool:
    """True if a value has a kind of `_KEYS`."""
    match kind:
        case list():
            return isinstance(value, list) and all(_fits(one, kind[0]) for one in value)
        case dict():
            return isinstance(value, dict) and all(
                _fits(value.get(key), inner) for key, inner in kind.items()
            )
        case type():
            return isinstance(value, kind) and (kind is not int or is_number(value))
    return kind(value)


def _is_counts(value: Any) -> bool:
    return isinstance(value, dict) and all(_fits(one, int) for one in value.values())


def _is_row(value: Any) -> bool:
    """True for an object with numbers, as of curves; `phase` is a text."""
    return isinstance(value, dict) and all(
        item is None or _fits(item, str if key == "phase" else is_number)
        for key, item in value.items()
    )


def _is_exposure(value: Any) -> bool:
    known_by = value.get("known_by") if isinstance(value, dict) else None
    kinds = {"learnt": bool, "why": str, "stops_apart": is_number}
    return _fits(value, kinds) and (known_by is None or isinstance(known_by, str))


def _is_numbers(value: Any) -> bool:
    return isinstance(value, dict) and all(is_number(one) for one in value.values())


def _is_cameras(value: Any) -> bool:
    kinds = {"degrees": is_number, "extents": is_number}
    return isinstance(value, dict) and all(_fits(one, kinds) for one in value.values())


def _is_worst_view(value: Any) -> bool:
    kinds = {"view": str, "value": is_number}
    return isinstance(value, dict) and all(
        one is None or _fits(one, kinds) for one in value.values()
    )


def _is_pair(value: Any) -> bool:
    return isinstance(value, list) and [type(name) for name in value] == [str, str]


_TRUST = {"between": _is_pair, "trust": is_number}

_KEYS: tuple[tuple[re.Pattern[str], Any], ...] = tuple(
    (re.compile(names), kind)
    for names, kind in (
        (r"split|reason|mask_mode|gscore|lpips_net|trained_at|model|psnr_masked_of", str),
        (r"\w+_reason", str),
        (r"psnr\w*|ssim\w*|d_ssim|ms_ssim|lpips\w*|fps|train_seconds", is_number),
        (r"steps|splats|sh_degree|storage_bytes|peak_memory_bytes", int),
        (r"train_views|test_views|decided", [str]),
        (r"decisions", [{"topic": str, "text": str}]),
        (r"history|evals", [_is_row]),
        (r"views", [dict]),
        (r"machine|depth", dict),
        (r"asked", _is_counts),
        (r"exposure", _is_exposure),
        (r"poses", {"why": str, "cameras": _is_cameras}),
        (r"blurs|transients", _is_numbers),
        (r"worst_view", _is_worst_view),
        (r"not_covered", [str]),
        (r"trust", [_TRUST]),
        (r"trust_lowest", _TRUST),
        (r"trust_median", is_number),
    )
)
"""Kind of the values other than null by key of metrics.json, the first match: a type, a list of one
kind, an object with kinds by key, or a check."""
