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

_KEPT = ("output_path", "result", "preview", "guide_surface", "guide_free", "train_within")


class RunLinks(bpy.types.PropertyGroup):
    """What belongs to a capture that is not the chosen one."""

    capture_path: StringProperty(
        name="Capture",
        description="Folder of the capture",
        subtype="DIR_PATH",
        options=compat.BLEND_RELATIVE,
    )
    output_path: StringProperty(
        name="Output",
        description="Folder of its results",
        subtype="DIR_PATH",
        options=compat.BLEND_RELATIVE,
    )
    result: PointerProperty(
        name="Result", description="Object that shows its splats", type=bpy.types.Object
    )
    preview: PointerProperty(
        name="Test View", description="Picture of one of its test views", type=bpy.types.Image
    )
    guide_surface: PointerProperty(
        name="Surface Mesh", description="Its surface meshes", type=bpy.types.Collection
    )
    guide_free: PointerProperty(
        name="Free-Space Mesh", description="Its free-space meshes", type=bpy.types.Collection
    )
    train_within: PointerProperty(
        name="Only Within", description="The object around its subject", type=bpy.types.Object
    )


def follow_capture(settings: Any) -> None:
    """Bring out what belongs to the capture that is chosen now, and put the rest away.

    A capture whose folder is not there any more is taken to have moved to the one that is chosen.
    Without a chosen capture everything stays as it is.

    Args:
        settings: `Scene.gscore`, whose `capture_path` was just set.
    """
    if settings.outcome_of == settings.capture_path:
        return  # also while both are rewritten because the file is saved elsewhere
    before, now = _folder(settings.outcome_of), _folder(settings.capture_path)
    if now is None:
        return
    if before is not None and before.exists() and not same_folder(before, now):
        _put_away(settings)
        _bring_out(settings, now)
    settings.outcome_of = settings.capture_path


def holders(scene: bpy.types.Scene) -> Iterator[Any]:
    """The scene's settings and its waiting outcomes: all that say where a capture's splats go."""
    yield scene.gscore
    yield from scene.gscore.outcomes


def holds(holder: Any, source: Path) -> bool:
    """Whether a holder is of a capture, or of none in particular; does not look at the disk."""
    if not holder.capture_path.strip():
        return True
    try:
        return means_capture(absolute(holder.capture_path, "Capture"), source)
    except ValueError:
        return False


def _put_away(settings: Any) -> None:
    if any(getattr(settings, name) for name in _KEPT):
        waiting = settings.outcomes.add()
        waiting.capture_path = settings.outcome_of
        for name in _KEPT:
            setattr(waiting, name, getattr(settings, name))
    for name in _KEPT:
        settings.property_unset(name)


def _bring_out(settings: Any, capture: Path) -> None:
    for place, waiting in enumerate(settings.outcomes):
        own = _folder(waiting.capture_path)
        if own is not None and same_folder(own, capture):
            for name in _KEPT:
                setattr(settings, name, getattr(waiting, name))
            settings.outcomes.remove(place)
            return


def _folder(text: str) -> Path | None:
    """The capture that a path means, or None where it means none."""
    try:
        return find_capture(absolute(text, "Capture"))
    except ValueError:
        return None


CLASSES = (RunLinks,)
