"""Places of splats that Blender has turned or scaled while shapes and colors stayed.

Blender's Apply and Join, and turning points in Edit Mode, move vertices and leave the attributes
`rotation`, `scale` and `radiance:sh_*` as they were. How far shapes lag behind places follows from
the mesh alone: it keeps where some of its splats were when it was looked at last, as a custom
property. Undo, files and copies take that along, so that nothing has to be remembered beside them.

A mesh that was joined has parts with lags of their own; the attribute `gs_part` has the number of
each splat's part, and stays right when splats are deleted or copied.
"""

from collections import OrderedDict
from typing import Any, NamedTuple

import numpy as np

from . import spread
from .fitted import turn_between

KEY = "gs_places"
"""Custom property of a mesh: the last look at it, and the lags of its parts."""
PART = "gs_part"
"""Point attribute of meshes of which several parts lag differently."""
_MOST = 4096
"""Looks that are remembered, 1.5 kB each."""


class Note(NamedTuple):
    """What is known of a mesh since a look at it."""

    look: spread.Spread
    lags: np.ndarray
    """[P, 3, 3] float64: what the shapes of each part lack; the identity where they are right."""


_SEEN: OrderedDict[tuple[int, str], Note] = OrderedDict()
"""The latest look at splats of these shapes, to know them again in a mesh that took them in.

Undo cannot make it wrong: of given shapes, any earlier place and its lag lead to the same lag now.
"""


def of(mesh: Any) -> np.ndarray:
    """[P, 3, 3]: the lags that were noted of a mesh; of none, [1, 3, 3] of the identity."""
    note = _noted(mesh)
    return np.eye(3)[None] if note is None else note.lags


def is_behind(mesh: Any) -> bool:
    """Whether shapes of a mesh lag behind places; quick enough for drawing a panel."""
    return mesh.get(KEY) is not None and not _is_none(of(mesh))


def parts(mesh: Any) -> np.ndarray:
    """[N] int32: the part of each splat, a row of `of`.

    Raises:
        ValueError: the attribute that says it is gone.
    """
    found = np.zeros(len(mesh.vertices), np.int32)
    count = len(of(mesh))
    if count == 1:
        return found
    attribute = mesh.attributes.get(PART)
    if attribute is None or (attribute.data_type, attribute.domain) != ("INT", "POINT"):
        raise ValueError(
            f"{mesh.name} lacks the attribute {PART}, which tells apart what was joined: undo the "
            "Join, and use that of Edit Splats."
        )
    attribute.data.foreach_get("value", found)
    return np.clip(found, 0, count - 1)


def note(mesh: Any, lags: np.ndarray, numbers: np.ndarray | None = None) -> None:
    """Note lags of a mesh as it is now.

    Args:
        mesh: Of which `spread.has_splats` says yes.
        lags: [P, 3, 3].
        numbers: [N] int32, the part of each splat; None: they stay as they are.
    """
    if numbers is not None and len(lags) > 1:
        if PART not in mesh.attributes:
            mesh.attributes.new(PART, "INT", "POINT")
        mesh.attributes[PART].data.foreach_set("value", np.ascontiguousarray(numbers, np.int32))
    _write(mesh, Note(spread.look(mesh), lags))


def forget(mesh: Any) -> None:
    """The splats of a mesh are others now, or were put right."""
    mesh.pop(KEY, None)
    if (attribute := mesh.attributes.get(PART)) is not None:
        mesh.attributes.remove(attribute)


def is_miscounted(mesh: Any) -> bool:
    """Whether a mesh was never looked at, or has another number of splats than then."""
    found = mesh.get(KEY)
    return found is None or found["count"] != len(mesh.vertices)


def follow(mesh: Any) -> bool:
    """Find out what became of a mesh since the last look, and note it; whether that was news.

    Only where splats were added it is searched what they are.
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
    elif now.shapes != before.look.shapes:  # somebody has given it other splats
        _write(mesh, Note(now, np.eye(3)[None]))
    else:
        turn = turn_between(before.look.places, now.places)
        if turn is not None and _is_none(turn):
            _remember(before)
            return False
        # Where points were moved one by one, what lagged does so still.
        _write(mesh, Note(now, before.lags if turn is None else turn @ before.lags))
    return True


def _recount(mesh: Any, now: spread.Spread, before: Note) -> None:
    """Splats were added or deleted."""
    found = _joined(mesh, before) if now.count > before.look.count else []
    if not found:
        _write(mesh, Note(now, before.lags))
        return
    lags = np.concatenate([one.lags for one in found])
    if _is_none(lags):
        _write(mesh, Note(now, np.eye(3)[None]))
        return
    own = np.zeros(now.count, np.int32)
    if (attribute := mesh.attributes.get(PART)) is not None:
        attribute.data.foreach_get("value", own)
    numbers, at, first = np.empty(now.count, np.int32), 0, 0
    for one in found:
        rows = slice(at, at + one.look.count)
        numbers[rows] = first + np.clip(own[rows], 0, len(one.lags) - 1)
        at, first = rows.stop, first + len(one.lags)
    note(mesh, lags, numbers)


def _joined(mesh: Any, before: Note) -> list[Note]:
    """The meshes that a mesh was joined from, in its order, as they lie in it; none where it is not
    made of known ones alone."""
    known = [before, *reversed(_SEEN.values())]
    found: list[Note] = []
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
                found.append(Note(looks[count], turn @ one.lags))
                at += count
                break
        else:
            return []
    return found


def _is_none(lags: np.ndarray) -> bool:
    """Whether nothing lags, by more than rounding."""
    return bool(np.abs(lags - np.eye(3)).max() <= 1e-5)


def _noted(mesh: Any) -> Note | None:
    found = mesh.get(KEY)
    if found is None:
        return None
    places = np.array(found["places"], np.float64).reshape(-1, 3)
    lags = np.array(found["lags"], np.float64).reshape(-1, 3, 3)
    return Note(spread.Spread(int(found["count"]), str(found["shapes"]), places), lags)


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
