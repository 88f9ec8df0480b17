"""Selections in a view: selected splats, and splats hidden in Edit Mode."""

from collections.abc import Sequence
from dataclasses import replace
from enum import Enum

import bpy
import numpy as np

from .mesh_copies import HIDDEN, SELECTED, shown, tinted_splats
from .model import Model
from .scene import Placed


class Tinted(Enum):
    """Objects whose selection a view shows."""

    NONE = 0
    EDITED = 1
    """Objects in Edit Mode."""
    ALL = 2


def tinted_in(space: bpy.types.SpaceView3D, *, own: bool) -> Tinted:
    """The objects whose selection a 3D view shows.

    Args:
        space: The view.
        own: Whether it is in the engine's Rendered shading, which shows selections in Edit Mode
            only, as with other engines.
    """
    if not space.overlay.show_overlays:
        return Tinted.NONE
    return Tinted.EDITED if own else Tinted.ALL


def marks_of(placed: Placed, tinted: Tinted) -> np.ndarray | None:
    """Marks of the drawn splats of an object, [N] uint8; None: no marks.

    Args:
        placed: The object. Its hidden points count in Edit Mode only, as for meshes.
        tinted: Objects whose selection counts.
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
    """A model without hidden splats, and with selected splats tinted, except in holdouts.

    Args:
        model: Model of all splats.
        placed: Its objects.
        tinted: As for `marks_of`.
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
