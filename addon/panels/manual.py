"""Manual: the add-on's pages for *Online Manual* in context menus, and a button that opens them."""

from pathlib import Path
from typing import ClassVar

import bpy

from ..interface.base_operator import BaseOperator

_ROOT = Path(__file__).parents[2]
_INSTALLED, _DOCS = _ROOT / "manual.html", _ROOT / "docs"
"""All pages in one in the extension; the pages in a checkout."""
_SECTIONS = {
    "trainer_python": "blender/install.md#install",
    "capture": "blender/cameras.md#capture",
    "sfm": "blender/cameras.md#capture",
    "cameras": "blender/cameras.md#cameras",
    "depth": "blender/training.md#depth",
    "training": "blender/training.md#train",
    "splats": "blender/splats.md#result",
    "splats.edit_operators": "blender/editing.md#edit",
    "splats.restore": "blender/editing.md#edit",
    "splats.heal_operators": "blender/editing.md#heal-and-clone",
    "splats.select_operators": "blender/editing.md#edit",
    "paint": "blender/editing.md#paint",
    "error_maps": "blender/splats.md#error-maps",
    "surface": "blender/splats.md#surface",
    "viewers": "blender/splats.md#native-splats",
    "region_training": "blender/steering.md#steer-training",
    "render": "blender/rendering.md#render",
    "render.estimate_light": "blender/rendering.md#relighting",
    "live": "blender/splats.md#displays",
    "timeline": "blender/sequences.md#sequences",
    "sequence": "blender/sequences.md#sequences",
}
"""Sections by folder or module of the add-on."""
_TOUR = "blender.md#from-photos-to-splats"
"""The section of all others."""


def page() -> Path:
    """The manual's first page.

    Raises:
        ValueError: it is missing.
    """
    found = next((p for p in (_INSTALLED, _DOCS / "blender.md") if p.is_file()), None)
    if found is None:
        raise ValueError(f"{_INSTALLED} is missing; install the add-on again.")
    return found


def manual_map() -> tuple[str, list[tuple[str, str]]]:
    """The manual's address, and the rest of the address for each operator and setting."""
    own, found = __package__.removesuffix("panels"), []
    first = page()
    for kind in (*bpy.types.Operator.__subclasses__(), *bpy.types.PropertyGroup.__subclasses__()):
        if not kind.__module__.startswith(own):
            continue
        if issubclass(kind, bpy.types.Operator):
            name = f"bpy.ops.{kind.bl_idname}*"
        else:
            name = f"bpy.types.{kind.__name__}.*"
        module = kind.__module__.removeprefix(own)
        section = _SECTIONS.get(module) or _SECTIONS.get(module.partition(".")[0]) or _TOUR
        if first == _INSTALLED:
            section = f"{first.name}#{section.partition('#')[2]}"
        found.append((name.lower(), f"/{section}"))
    return first.parent.as_uri(), found


def draw_help(layout: bpy.types.UILayout) -> None:
    """Draw the help button in the header of a panel."""
    layout.operator(OpenManual.bl_idname, text="", icon="HELP", emboss=False)


class OpenManual(BaseOperator, bpy.types.Operator):
    """Open the manual of Train Splats in the web browser; it is stored on this computer"""

    bl_idname = "gscore.open_manual"
    bl_label = "Manual"
    bl_options: ClassVar = {"REGISTER"}

    def run(self, context: bpy.types.Context) -> None:
        """Open it."""
        bpy.ops.wm.url_open(url=page().as_uri())


def on_register() -> None:
    """Register the map for *Online Manual*."""
    bpy.utils.register_manual_map(manual_map)


def on_unregister() -> None:
    """Unregister the map."""
    bpy.utils.unregister_manual_map(manual_map)
