"""Run links of captures: the output folder, splats, test view and guides of each.

`Scene.gscore` has the links of the chosen capture. Those of the other captures are stored in
`Scene.gscore.outcomes` and come back when their capture is chosen again.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
from bpy.props import PointerProperty, StringProperty

from . import compat
from .capture.folders import means_capture, same_folder
from .core import find_capture
from .paths import absolute


class LinkProperties:
    """Links of one capture, shared by the scene's settings and the stored links of others."""

    output_path: StringProperty(
        name="Output",
        description="Folder for the results of the training; empty: chosen when training starts",
        subtype="DIR_PATH",
        options=compat.BLEND_RELATIVE,
    )
    result: PointerProperty(
        name="Result",
        description="Object with the splats of the training",
        type=bpy.types.Object,
    )
    preview: PointerProperty(
        name="Test View",
        description="Test view rendered from the current splats",
        type=bpy.types.Image,
    )
    guide_surface: PointerProperty(
        name="Surface Mesh",
        description="Collection of meshes onto which splats are pulled: walls, floors, a scan. "
        "Objects visible in the viewport are used, with modifiers",
        type=bpy.types.Collection,
    )
    guide_free: PointerProperty(
        name="Free-Space Mesh",
        description="Collection of meshes with free space up to the cameras of all photos: splats "
        "there are removed. Objects visible in the viewport are used, with modifiers",
        type=bpy.types.Collection,
    )
    train_within: PointerProperty(
        name="Limit to Object",
        description="Crop box, mesh or empty whose bounding box limits the training: only pixels "
        "that show the box are used. Import the cameras first, then place it",
        type=bpy.types.Object,
        poll=lambda settings, ob: ob.type in {"MESH", "EMPTY"} and not ob.get("gs_kind"),
    )


_KEPT = tuple(LinkProperties.__annotations__)


class RunLinks(LinkProperties, bpy.types.PropertyGroup):
    """Links of a capture other than the chosen one."""

    capture_path: StringProperty(
        name="Capture",
        description="Folder of the capture",
        subtype="DIR_PATH",
        options=compat.BLEND_RELATIVE,
    )


def follow_capture(settings: Any) -> None:
    """Load the links of the capture that was just chosen, and store those of the previous one.

    If the previous capture's folder no longer exists, it counts as moved to the chosen one.
    Without a chosen capture nothing changes.

    Args:
        settings: `Scene.gscore`, whose `capture_path` was just set.
    """
    if settings.outcome_of == settings.capture_path:
        return  # also while saving the file elsewhere rewrites both
    before, now = _folder(settings.outcome_of), _folder(settings.capture_path)
    if now is None:
        return
    if before is not None and before.exists() and not same_folder(before, now):
        _store(settings)
        _load(settings, now)
    settings.outcome_of = settings.capture_path


def holders(scene: bpy.types.Scene) -> Iterator[Any]:
    """The scene's settings and the stored links of its other captures."""
    yield scene.gscore
    yield from scene.gscore.outcomes


def belongs_to(holder: Any, source: Path) -> bool:
    """True if a holder belongs to a capture, or to no particular one; reads nothing from disk."""
    if not holder.capture_path.strip():
        return True
    try:
        return means_capture(absolute(holder.capture_path, "Capture"), source)
    except ValueError:
        return False


def _store(settings: Any) -> None:
    if any(getattr(settings, name) for name in _KEPT):
        stored = settings.outcomes.add()
        stored.capture_path = settings.outcome_of
        for name in _KEPT:
            setattr(stored, name, getattr(settings, name))
    for name in _KEPT:
        settings.property_unset(name)


def _load(settings: Any, capture: Path) -> None:
    for index, stored in enumerate(settings.outcomes):
        own = _folder(stored.capture_path)
        if own is not None and same_folder(own, capture):
            for name in _KEPT:
                setattr(settings, name, getattr(stored, name))
            settings.outcomes.remove(index)
            return


def _folder(text: str) -> Path | None:
    """The capture at a path; None if the path is empty or relative to an unsaved file."""
    try:
        return find_capture(absolute(text, "Capture"))
    except ValueError:
        return None
