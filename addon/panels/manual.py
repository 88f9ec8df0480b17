"""Manual: the add-on's pages for *Online Manual* in context menus, and a button that opens them."""

from pathlib import Path
from typing import ClassVar

import bpy

from ..interface.base_operator import BaseOperator

_ROOT = Path(__file__).parents[2]
_PLACES = (_ROOT / "manual.html", _ROOT / "docs" / "blender.md")
"""In the extension, and in a checkout."""
_SECTIONS = {
    "trainer_python": "install",
    "capture": "capture",
    "sfm": "capture",
    "cameras": "cameras",
    "depth": "depth",
    "training": "train",
    "splats": "result",
    "splats.edit_operators": "edit",
    "splats.select_operators": "edit",
    "paint": "paint",
    "error_maps": "error-maps",
    "region_training": "steer-training",
    "render": "render",
    "live": "displays",
    "timeline": "sequences",
    "sequence": "sequences",
}
"""Rooms, or modules of them, and the headings under which they stand; else the whole way."""
_WHOLE_WAY = "from-photos-to-splats"


def page() -> Path:
    """The manual's file.

    Raises:
        ValueError: it is missing.
    """
    found = next((place for place in _PLACES if place.is_file()), None)
    if found is None:
        raise ValueError(f"There is no {_PLACES[0]}; install the add-on again.")
    return found


def manual_map() -> tuple[str, list[tuple[str, str]]]:
    """The manual's address, and the anchor of each operator and setting of the add-on."""
    own, found = __package__.removesuffix("panels"), []
    for kind in (*bpy.types.Operator.__subclasses__(), *bpy.types.PropertyGroup.__subclasses__()):
        if not kind.__module__.startswith(own):
            continue
        if issubclass(kind, bpy.types.Operator):
            name = f"bpy.ops.{kind.bl_idname}*"
        else:
            name = f"bpy.types.{kind.__name__}.*"
        found.append((name.lower(), f"#{_section(kind.__module__.removeprefix(own))}"))
    return page().as_uri(), found


def draw_help(layout: bpy.types.UILayout) -> None:
    """Draw the help button in the header of a panel."""
    layout.operator(OpenManual.bl_idname, text="", icon="HELP", emboss=False)


class OpenManual(BaseOperator, bpy.types.Operator):
    """Open the manual of Train Splats in the web browser; it is stored on this computer"""

    bl_idname = "gscore.open_manual"
    bl_label = "Manual"
    bl_options: ClassVar = {"REGISTER"}

    def act(self, context: bpy.types.Context) -> str:
        """Open it."""
        bpy.ops.wm.url_open(url=page().as_uri())
        return ""


def _section(module: str) -> str:
    room = module.partition(".")[0]
    return _SECTIONS.get(module) or _SECTIONS.get(room) or _WHOLE_WAY


CLASSES = (OpenManual,)


def on_register() -> None:
    """Register the map for *Online Manual*."""
    bpy.utils.register_manual_map(manual_map)


def on_unregister() -> None:
    """Unregister the map."""
    bpy.utils.unregister_manual_map(manual_map)
