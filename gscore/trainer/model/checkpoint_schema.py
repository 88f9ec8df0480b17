"""Checkpoint schema: checks of values and tensors before a run resumes; raises ValueError.

A checkpoint with a valid CRC may still come from another source, and the rasterizer trusts shapes.
"""

import math
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import torch

from ...quoting import quoted
from ...splats import PARAMETERS, Splats

_MOST = 1 << 53
"""Largest count: JSON numbers are not exact beyond."""


def as_int(what: str, value: Any, *, low: int = 0, high: int = _MOST) -> int:
    """Return `value` if it is an integer from `low` to `high`."""
    if type(value) is not int or not low <= value <= high:
        raise ValueError(f"{what} is {quoted(value)}, expected a whole number, {low} to {high}")
    return value


def as_float(what: str, value: Any, *, finite: bool = True, low: float = -math.inf) -> float:
    """Return `value` if it is a number of at least `low`, or NaN unless `finite`."""
    if type(value) is int:
        value = float(as_int(what, value, low=-_MOST))
    if type(value) is not float or (finite and not math.isfinite(value)) or value < low:
        raise ValueError(f"{what} is {quoted(value)}, expected a number")
    return value


def as_int_list(what: str, value: Any, allowed: Collection[int]) -> list[int]:
    """Return `value` if it is a list of `allowed` integers."""
    if not isinstance(value, list) or not all(type(v) is int and v in allowed for v in value):
        raise ValueError(f"{what} is {quoted(value)}, expected views of the capture")
    return list(value)


def as_measurements(what: str, value: Any) -> list[tuple[int, float]]:
    """Return `value` if it is a list of pairs: step or view, and number."""
    pairs = isinstance(value, list) and all(isinstance(v, list | tuple) for v in value)
    if not pairs or any(len(v) != 2 for v in value):
        raise ValueError(
            f"{what} is {quoted(value)}, expected pairs of a whole number and a number"
        )
    return [(as_int(what, at), as_float(what, found, finite=False)) for at, found in value]


def as_records(what: str, value: Any) -> list[dict[str, Any]]:
    """Return `value` if it is a list of objects with a step, numbers or null, and a text phase."""
    if not isinstance(value, list) or not all(isinstance(row, dict) for row in value):
        raise ValueError(f"{what} is {quoted(value)}, expected a list of objects")
    for row in value:
        as_int(f"a step of {what}", row.get("step"))
        for key, found in row.items():
            if found is not None and not (key == "phase" and isinstance(found, str)):
                as_float(f"{key} of {what}", found, finite=False)
    return list(value)


def as_str_list(what: str, value: Any) -> list[str]:
    """Return `value` if it is a list of strings."""
    if not isinstance(value, list) or not all(isinstance(text, str) for text in value):
        raise ValueError(f"{what} is {quoted(value)}, expected texts")
    return list(value)


def as_str_dict(what: str, value: Any) -> dict[str, str]:
    """Return `value` if it is an object of strings."""
    if not isinstance(value, dict) or not all(isinstance(text, str) for text in value.values()):
        raise ValueError(f"{what} is {quoted(value)}, expected an object of texts")
    return dict(value)


def as_int_dict(what: str, value: Any) -> dict[str, int]:
    """Return `value` if it is an object of whole numbers."""
    if not isinstance(value, dict):
        raise ValueError(f"{what} is {quoted(value)}, expected an object")
    return {name: as_int(f"{name} of {what}", count) for name, count in value.items()}


def check_tensors(tensors: Mapping[str, torch.Tensor], like: Mapping[str, np.ndarray]) -> None:
    """Raise ValueError or KeyError unless a model's tensors fit each other and `like`, those of
    another model of the run; the numbers of splats and of SH coefficients may differ."""
    splats = Splats(**{name: tensors[f"param/{name}"].numpy() for name in PARAMETERS})
    for name in PARAMETERS:
        expected = tensors[f"param/{name}"]
        _same(f"m1/{name}", tensors[f"m1/{name}"], expected.shape, expected.dtype)
        _same(f"m2/{name}", tensors[f"m2/{name}"], expected.shape, expected.dtype)
    for key in tensors:
        if key.startswith("gathered/"):
            _same(key, tensors[key], tensors["param/shN"].shape, torch.float32)
        elif key.startswith("row/") and key not in like:
            raise ValueError(f"{key} is not known")
    for key, array in like.items():
        dtype = torch.from_numpy(array).dtype
        if key == "drift":
            _same(key, tensors[key], array.shape, dtype)
        elif key.startswith("row/"):
            _same(key, tensors[key], (len(splats),), dtype)


def _same(
    name: str, tensor: torch.Tensor, shape: torch.Size | tuple[int, ...], dtype: torch.dtype
) -> None:
    if tensor.shape != shape or tensor.dtype != dtype:
        raise ValueError(
            f"{name} is {list(tensor.shape)} {tensor.dtype}, expected {list(shape)} {dtype}"
        )
