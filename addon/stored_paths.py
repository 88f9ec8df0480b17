"""Stored paths of a .blend file: resolved against its folder, remapped when it is saved elsewhere.

Blender does that for the paths of its own datablocks, not for those of add-ons.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
from bpy.app.handlers import persistent

from .paths import relative

SOURCE, PHOTO, RUN, REFIT = "gs_source", "gs_photo", "gs_run", "gs_refit"
"""Custom properties of objects with the path of a capture, a photo, a run, refitted splats."""


def read(ob: bpy.types.Object, key: str) -> str:
    """The path in a custom property, absolute; empty without one."""
    text = str(ob.get(key, ""))
    return os.path.normpath(bpy.path.abspath(text, library=ob.library)) if text else ""


def write(ob: bpy.types.Object, key: str, path: str | Path) -> None:
    """Store a path in a custom property, relative to the .blend file if near it."""
    ob[key] = relative(Path(path)) if str(path) else ""


@dataclass(frozen=True)
class _Place:
    """Owner and key of a stored path."""

    owner: Any
    key: str

    @property
    def text(self) -> str:
        if isinstance(self.owner, bpy.types.Object):
            return str(self.owner[self.key])
        return getattr(self.owner, self.key)

    def put(self, text: str) -> None:
        if isinstance(self.owner, bpy.types.Object):
            self.owner[self.key] = text
        else:
            setattr(self.owner, self.key, text)


_before: list[tuple[_Place, str]] = []
"""Stored paths before the running save."""


def _places() -> Iterator[_Place]:
    for scene in bpy.data.scenes:
        if scene.library is None:
            settings = scene.gscore
            # capture_path last: if it differs from `outcome_of`, another capture was chosen.
            keys = ("outcome_of", "output_path", "capture_path")
            yield from (_Place(settings, key) for key in keys)
            for links in settings.outcomes:
                yield from (_Place(links, key) for key in ("capture_path", "output_path"))
    for ob in bpy.data.objects:
        if ob.library is None:
            yield from (_Place(ob, key) for key in (SOURCE, PHOTO, RUN, REFIT) if key in ob)
            yield _Place(ob.gscore_sequence, "folder")


@persistent
def _save_begins(filepath: str = "", *_: object) -> None:
    """Write paths for the folder that the file is saved to.

    Relative paths stay relative where possible; paths of a file that was never saved become
    relative, as Blender's own do.
    """
    _before.clear()
    old = bpy.data.filepath
    if not filepath or (old and Path(old).parent == Path(filepath).parent):
        return
    for place in _places():
        text = place.text
        if text.strip() and text.startswith("//") == bool(old):
            _before.append((place, text))
            path = Path(os.path.normpath(bpy.path.abspath(text)))
            place.put(relative(path, Path(filepath).parent))


@persistent
def _save_ended(filepath: str = "", *_: object) -> None:
    """Restore the paths if a copy was saved or the save failed: the open file has not moved."""
    if bpy.data.filepath != filepath:
        for place, text in _before:
            place.put(text)
    _before.clear()


HANDLERS = {
    "save_pre": _save_begins,
    "save_post": _save_ended,
    "save_post_fail": _save_ended,
}
