"""Lag of splats: positions that Blender has rotated or scaled without shapes and colors.

Blender's Apply and Join, and rotation of points in Edit Mode, transform vertices, but not the
attributes `rotation`, `scale` and `radiance:sh_*`. The missing transform, the lag, follows from the
mesh alone: a custom property stores earlier positions of some of its splats. Undo, files and copies
keep that property, so no other state is needed.

A joined mesh has parts with different lags; the attribute `gs_part` has the number of each splat's
part, and stays valid when splats are deleted or copied.
"""

from collections import OrderedDict
from typing import Any, NamedTuple

import numpy as np

from . import spread
from .fitted import turn_between

KEY = "gs_places"
"""Custom property of a mesh: its last sample, and the lags of its parts."""
PART = "gs_part"
"""Point attribute of meshes whose parts have different lags."""
_MOST = 4096
"""Number of cached samples, 1.5 kB each."""


class Note(NamedTuple):
    """Stored sample of a mesh with its lags."""

    look: spread.Spread
    lags: np.ndarray
    """[P, 3, 3] float64, transform that the shapes of each part lack; identity: none."""


_SEEN: OrderedDict[tuple[int, str], Note] = OrderedDict()
"""Latest sample of splats by count and shapes, to recognise them in a joined mesh.

Undo cannot invalidate it: for given shapes, any earlier positions with their lag give the same
current lag.
"""


def of(mesh: Any) -> np.ndarray:
    """[P, 3, 3] stored lags of a mesh; without any, [1, 3, 3] of the identity."""
    note = _noted(mesh)
    return np.eye(3)[None] if note is None else note.lags


def is_behind(mesh: Any) -> bool:
    """True if shapes of a mesh lag behind positions; fast enough for drawing a panel."""
    return mesh.get(KEY) is not None and not _is_none(of(mesh))


def parts(mesh: Any) -> np.ndarray:
    """[N] int32: the part of each splat, a row of `of`.

    Raises:
        ValueError: the attribute `gs_part` is missing.
    """
    numbers = np.zeros(len(mesh.vertices), np.int32)
    count = len(of(mesh))
    if count == 1:
        return numbers
    attribute = mesh.attributes.get(PART)
    if attribute is None or (attribute.data_type, attribute.domain) != ("INT", "POINT"):
        raise ValueError(
            f"{mesh.name} lacks the attribute {PART} of its joined parts: undo the Join, and use "
            "Join under Edit Splats."
        )
    attribute.data.foreach_get("value", numbers)
    return np.clip(numbers, 0, count - 1)


def note(mesh: Any, lags: np.ndarray, numbers: np.ndarray | None = None) -> None:
    """Store the lags of a mesh with its current positions.

    Args:
        mesh: A mesh for which `spread.has_splats` is true.
        lags: [P, 3, 3].
        numbers: [N] int32, the part of each splat; None: unchanged.
    """
    if numbers is not None and len(lags) > 1:
        if PART not in mesh.attributes:
            mesh.attributes.new(PART, "INT", "POINT")
        mesh.attributes[PART].data.foreach_set("value", np.ascontiguousarray(numbers, np.int32))
    _write(mesh, Note(spread.look(mesh), lags))


def forget(mesh: Any) -> None:
    """Remove the stored state, because the splats were replaced or corrected."""
    mesh.pop(KEY, None)
    if (attribute := mesh.attributes.get(PART)) is not None:
        mesh.attributes.remove(attribute)


def is_miscounted(mesh: Any) -> bool:
    """True if a mesh has no stored state, or one with another number of splats."""
    stored = mesh.get(KEY)
    return stored is None or stored["count"] != len(mesh.vertices)


def follow(mesh: Any) -> bool:
    """Detect transforms of a mesh since the stored state, and update it; True if it changed.

    Only if splats were added, their source meshes are searched for.
    """
    if not spread.has_splats(mesh):
        return False
    now, before = spread.look(mesh), _noted(mesh)
    if not np.isfinite(now.places).all():
        return False
    if before is None:
        _write(mesh, Note(now, np.eye(3)[None]))
    elif now.count != before.look.count:
        _recount(mesh, now, before)
    elif now.shapes != before.look.shapes:  # the splats were replaced
        _write(mesh, Note(now, np.eye(3)[None]))
    else:
        turn = turn_between(before.look.places, now.places)
        if turn is not None and _is_none(turn):
            _remember(before)
            return False
        # If points were moved individually, earlier lags stay.
        _write(mesh, Note(now, before.lags if turn is None else turn @ before.lags))
    return True


def _recount(mesh: Any, now: spread.Spread, before: Note) -> None:
    """Update the state after splats were added or deleted."""
    parts = _joined(mesh, before) if now.count > before.look.count else []
    if not parts:
        _write(mesh, Note(now, before.lags))
        return
    lags = np.concatenate([one.lags for one in parts])
    if _is_none(lags):
        _write(mesh, Note(now, np.eye(3)[None]))
        return
    own = np.zeros(now.count, np.int32)
    if (attribute := mesh.attributes.get(PART)) is not None:
        attribute.data.foreach_get("value", own)
    numbers, at, first = np.empty(now.count, np.int32), 0, 0
    for one in parts:
        rows = slice(at, at + one.look.count)
        numbers[rows] = first + np.clip(own[rows], 0, len(one.lags) - 1)
        at, first = rows.stop, first + len(one.lags)
    note(mesh, lags, numbers)


def _joined(mesh: Any, before: Note) -> list[Note]:
    """Samples of the meshes that a mesh was joined from, in its order; empty if some are
    unknown."""
    known = [before, *reversed(_SEEN.values())]
    parts: list[Note] = []
    at, total = 0, len(mesh.vertices)
    looks: dict[int, spread.Spread] = {}
    while at < total:
        looks.clear()
        for one in known:
            count = one.look.count
            if count > total - at:
                continue
            if count not in looks:
                looks[count] = spread.look(mesh, at, count)
            turn = None
            if looks[count].shapes == one.look.shapes:
                turn = turn_between(one.look.places, looks[count].places)
            if turn is not None:
                parts.append(Note(looks[count], turn @ one.lags))
                at += count
                break
        else:
            return []
    return parts


def _is_none(lags: np.ndarray) -> bool:
    """True if all lags are the identity, up to rounding."""
    return bool(np.abs(lags - np.eye(3)).max() <= 1e-5)


def _noted(mesh: Any) -> Note | None:
    stored = mesh.get(KEY)
    if stored is None:
        return None
    places = np.array(stored["places"], np.float64).reshape(-1, 3)
    lags = np.array(stored["lags"], np.float64).reshape(-1, 3, 3)
    return Note(spread.Spread(int(stored["count"]), str(stored["shapes"]), places), lags)


def _write(mesh: Any, note: Note) -> None:
    mesh[KEY] = {
        "count": note.look.count,
        "shapes": note.look.shapes,
        "places": note.look.places.ravel().tolist(),
        "lags": note.lags.ravel().tolist(),
    }
    _remember(note)


def _remember(note: Note) -> None:
    key = note.look.count, note.look.shapes
    _SEEN[key] = note
    _SEEN.move_to_end(key)
    if len(_SEEN) > _MOST:
        _SEEN.popitem(last=False)
