"""Replayed edits: what was erased, graded and added, as volumes on the object, for new splats of
the same capture.
"""

import base64
import json
import zlib
from dataclasses import asdict, dataclass
from typing import Any

import bpy
import numpy as np

from .. import attributes
from ..cameras.capture_transform import origin_of
from ..core import offset_between
from ..interface import editable_check
from ..process.incremental_tasks import Check
from . import added, filters, point_attributes
from .filters import Filters
from .point_attributes import Column

KEY = "gs_edits"
"""Custom property of an object: its edits in their order, JSON."""
DUE = "gs_edits_due"
"""Custom property of an object: its splats were replaced after its edits."""
_CELLS = 64
"""Cells along the longest side of a volume."""
_BIAS = 1 << 20
"""Offset of cell numbers, so that three fit an integer of 63 bits."""


@dataclass(frozen=True, kw_only=True)
class Volume:
    """Cells of space."""

    side: float
    keys: np.ndarray
    """[K] int64, sorted: the packed numbers of the cells."""

    @property
    def box(self) -> np.ndarray:
        """[4, 4] float64, from the cube [-1, 1]^3 to the box around the cells."""
        x, y, z = (self.keys >> 42), (self.keys >> 21), self.keys
        cells = np.stack([x, y & (2 * _BIAS - 1), z & (2 * _BIAS - 1)], axis=1) - _BIAS
        low, high = cells.min(axis=0) * self.side, (cells.max(axis=0) + 1) * self.side
        matrix = np.diag([*(high - low) / 2, 1.0])
        matrix[:3, 3] = (low + high) / 2
        return matrix

    def contains(self, means: np.ndarray) -> np.ndarray:
        """Positions [N, 3] inside, [N] bool."""
        return np.isin(_packed(_numbers(means, self.side)), self.keys)

    def stored(self) -> dict[str, Any]:
        """For JSON."""
        packed = base64.b64encode(zlib.compress(self.keys.tobytes())).decode()
        return {"side": self.side, "keys": packed}

    @classmethod
    def read(cls, stored: dict[str, Any]) -> "Volume":
        """From `stored`."""
        keys = np.frombuffer(zlib.decompress(base64.b64decode(stored["keys"])), np.int64)
        return cls(side=stored["side"], keys=keys)


def _numbers(means: np.ndarray, side: float) -> np.ndarray:
    numbers = np.floor(means.astype(np.float64) / side)
    return np.clip(numbers, 1 - _BIAS, _BIAS - 2).astype(np.int64)


def _packed(numbers: np.ndarray) -> np.ndarray:
    x, y, z = (numbers + _BIAS).T
    return (x << 42) | (y << 21) | z


def volume_of(means: np.ndarray, chosen: np.ndarray, scales: np.ndarray) -> Volume:
    """The cells of the chosen splats and the cells next to them, without those of other splats.

    Args:
        means: Positions [N, 3].
        chosen: [N] bool, at least one.
        scales: Standard deviations [N, 3].
    """
    inside = means[chosen]
    side = max(
        float(np.ptp(inside, axis=0).max()) / _CELLS,
        2 * float(np.median(scales[chosen].max(axis=1))),
        float(np.abs(inside).max()) / (_BIAS / 2),
        1e-9,
    )
    cells = np.unique(_numbers(inside, side), axis=0)
    steps = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)
    keys = np.unique(_packed((cells[:, None] + steps).reshape(-1, 3)))
    others = np.setdiff1d(_packed(_numbers(means[~chosen], side)), _packed(cells))
    return Volume(side=side, keys=np.setdiff1d(keys, others))


def edits_of(ob: bpy.types.Object) -> list[dict[str, Any]]:
    """The recorded edits of an object; none if they cannot be read."""
    try:
        found = json.loads(ob.get(KEY, "[]"))
    except ValueError:
        return []
    return found if isinstance(found, list) else []


def store(ob: bpy.types.Object, edits: list[dict[str, Any]]) -> None:
    """Record edits on an object in place of those before, unless it is linked."""
    if editable_check.keeps(ob):
        ob[KEY] = json.dumps(edits)


def note_replaced(ob: bpy.types.Object) -> None:
    """Note that a training has replaced the splats of an object, and so undone its edits."""
    if KEY in ob:
        ob[DUE] = True


def _record(ob: bpy.types.Object, edit: dict[str, Any]) -> None:
    origin = origin_of(ob)
    edit["origin"] = None if origin is None else origin.tolist()
    store(ob, [*edits_of(ob), edit])


def record_filters(ob: bpy.types.Object, limits: Filters) -> None:
    """Record that the splats that filters hide were deleted."""
    stored = asdict(limits)
    stored["crop"] = None if limits.crop is None else limits.crop.tolist()
    _record(ob, {"filters": stored})


def record_erased(ob: bpy.types.Object, volume: Volume) -> None:
    """Record that the splats in a volume were deleted."""
    _record(ob, {"erased": volume.stored()})


def record_grade(ob: bpy.types.Object, grade: dict[str, Any], volume: Volume | None) -> None:
    """Record a grade of the splats in a volume; None: of all."""
    _record(ob, {"grade": grade, "volume": None if volume is None else volume.stored()})


def record_healed(ob: bpy.types.Object, region: np.ndarray, *, sphere: bool) -> None:
    """Record that a hole was filled; arguments as `added.healed`."""
    _record(ob, {"healed": region.tolist(), "sphere": sphere})


def record_cloned(
    ob: bpy.types.Object, matrix: np.ndarray, volume: Volume, *, opacity: float = 1.0
) -> None:
    """Record that the splats in a volume were copied; `matrix` and `opacity` as `added.cloned`."""
    _record(ob, {"cloned": matrix.tolist(), "volume": volume.stored(), "opacity": opacity})


def is_added(edit: dict[str, Any]) -> bool:
    """True if an edit added splats."""
    return "healed" in edit or "cloned" in edit


def added_again(
    edit: dict[str, Any], table: list[Column], shift: np.ndarray, name: str, check: Check
) -> list[Column]:
    """The splats that an edit of `is_added` adds to others; `shift` as `shift_of`, the rest as
    `added.cloned`.

    Raises:
        ValueError: the hole cannot be filled.
    """
    to_own, to_edit = np.eye(4), np.eye(4)
    to_own[:3, 3], to_edit[:3, 3] = -shift, shift
    if "healed" in edit:
        region = to_own @ np.array(edit["healed"])
        return added.healed(table, region, sphere=edit["sphere"], check=check)
    places = point_attributes.of_splats(table)[attributes.POSITION] + shift.astype(np.float32)
    chosen = Volume.read(edit["volume"]).contains(places)
    matrix, opacity = to_own @ np.array(edit["cloned"]) @ to_edit, edit.get("opacity", 1.0)
    return added.cloned(table, chosen, matrix, name, check, opacity=opacity)


def sparing(
    edits: list[dict[str, Any]], shifts: list[np.ndarray], means: np.ndarray, scales: np.ndarray
) -> list[dict[str, Any]]:
    """Recorded edits that no longer erase places where splats were restored; no bpy.

    Args:
        edits: The edits.
        shifts: `shift_of` each.
        means: Positions [N, 3] of the restored splats in the space of the object.
        scales: Their standard deviations [N, 3].
    """
    out = []
    for edit, shift in zip(edits, shifts, strict=True):
        places = means + shift.astype(np.float32)
        if "erased" in edit:
            volume = Volume.read(edit["erased"])
            again = _packed(_numbers(places, volume.side))
            kept = Volume(side=volume.side, keys=np.setdiff1d(volume.keys, again))
            edit = {**edit, "erased": kept.stored()}
        elif "filters" in edit:
            volume = volume_of(places, np.ones(len(places), bool), scales)
            edit = {**edit, "spared": [*edit.get("spared", []), volume.stored()]}
        out.append(edit)
    return out


def shift_of(ob: bpy.types.Object, edit: dict[str, Any]) -> np.ndarray:
    """[3], what takes positions of an object to the coordinates of an edit."""
    origin = edit.get("origin")
    return offset_between(origin_of(ob), None if origin is None else np.array(origin))


def keeps(edit: dict[str, Any], columns: dict[str, np.ndarray], shift: np.ndarray) -> np.ndarray:
    """Splats that an edit keeps, [N] bool; `columns` as `filters.passing`."""
    moved = {**columns, "position": columns["position"] + shift.astype(np.float32)}
    if "filters" in edit:
        stored = dict(edit["filters"])
        stored["crop"] = None if stored["crop"] is None else np.array(stored["crop"])
        kept = filters.passing(moved, Filters(**stored))
        for volume in edit.get("spared", []):
            kept |= Volume.read(volume).contains(moved["position"])
        return kept
    if "erased" in edit:
        return ~Volume.read(edit["erased"]).contains(moved["position"])
    return np.ones(len(columns["position"]), bool)
