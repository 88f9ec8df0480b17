"""Selections in a view: selected splats, and splats hidden in Edit Mode."""

from collections.abc import Sequence
from dataclasses import replace
from enum import Enum

import bpy
import numpy as np

from .marks import shown, tinted_splats
from .mesh_copies import HIDDEN, SELECTED
from .model import Model
from .scene import Placed


class Tinted(Enum):
    """The objects of which a view shows what is selected."""

    NONE = 0
    EDITED = 1
    """Those in Edit Mode."""
    ALL = 2


def tinted_in(space: bpy.types.SpaceView3D, *, own: bool) -> Tinted:
    """Of which objects a 3D view shows what is selected.

    Args:
        space: The view.
        own: Whether it is in the engine's Rendered shading, which is that of renders but for what
            is edited, as other engines have it.
    """
    if not space.overlay.show_overlays:
        return Tinted.NONE
    return Tinted.EDITED if own else Tinted.ALL


def marks_of(placed: Placed, tinted: Tinted) -> np.ndarray | None:
    """[N] uint8 marks of the splats that are drawn of an object, or None where none has any.

    Args:
        placed: The object. Its hidden points count in Edit Mode alone, as those of meshes do.
        tinted: Whether those that are selected count.
    """
    selected = tinted is Tinted.ALL or (tinted is Tinted.EDITED and placed.edited)
    wanted = SELECTED * selected | HIDDEN * placed.edited
    if placed.frozen.marks is None or not wanted:
        return None
    marks = placed.frozen.marks & np.uint8(wanted)
    if not marks.any():
        return None
    return marks if placed.filters is None else marks[placed.frozen.kept(placed.filters)]


def marked(model: Model, placed: Sequence[Placed], tinted: Tinted) -> Model:
    """A model without what is hidden, and with what is selected tinted, but for what cuts holes.

    Args:
        model: Of all splats.
        placed: Its objects.
        tinted: As `marks_of`.
    """
    found = [marks_of(one, Tinted.NONE if one.holdout else tinted) for one in placed]
    if all(marks is None for marks in found):
        return model
    every = [
        np.zeros(count, np.uint8) if marks is None else marks
        for marks, (_, count) in zip(found, model.owners, strict=True)
    ]
    there = [int(np.count_nonzero(shown(marks))) for marks in every]
    owners = tuple((owner, n) for (owner, _), n in zip(model.owners, there, strict=True))
    marks, shares = np.concatenate(every), model.shares
    if shares is not None and sum(there) < len(marks):
        shares = shares.subset(shown(marks))
    return replace(model, splats=tinted_splats(model.splats, marks), shares=shares, owners=owners)
