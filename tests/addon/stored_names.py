"""Names of the running add-on that .blend files, preferences and scripts store."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

from addon import preferences
from addon.attributes import columns
from addon.cameras import sfm_points
from addon.core import Splats
from addon.nodes import display, materials
from addon.render import composite_nodes

ADDON = Path(__file__).parents[2] / "addon"
OWNERS = (bpy.types.Scene, bpy.types.Object, bpy.types.WindowManager)


def stored_names(splats: Splats) -> dict[str, list[str]]:
    """Sorted names by kind; a property follows its owner after a dot, an enum's item its property.

    Args:
        splats: Splats of SH degree 4, whose attributes are listed.
    """
    operators = {
        f"gscore.{name}": getattr(bpy.ops.gscore, name).get_rna_type()
        for name in dir(bpy.ops.gscore)
    }
    settings = {
        f"{owner.__name__}.{key}": prop
        for owner in OWNERS
        for key, prop in owner.bl_rna.properties.items()
        if key.startswith("gscore")
    }
    trees = [one for build in display.builders() if hasattr(one := build(), "interface")]
    trees += [sfm_points._node_group(), composite_nodes.group()]
    none = np.zeros((0, 3))
    attributes = [*columns(splats), *sfm_points.columns(none, none.astype(np.uint8), none[:, 0])]
    found = {
        "operators": {n for name, rna in operators.items() for n in _members(name, rna)},
        "properties": {n for name, prop in settings.items() for n in _of_property(name, prop)},
        "preferences": set(_members("preferences", preferences.get().bl_rna)),
        "node groups": {n for tree in trees for n in _sockets(tree)},
        "attributes": {name for name, *_ in attributes} | {materials.COLOR, materials.OPACITY},
        "custom properties": {text for text in _texts() if re.fullmatch(r"gs_\w+", text)},
        "engines and panels": {n for n in dir(bpy.types) if re.match(r"GSCORE_(?!OT_)", n)}
        | {
            cls.bl_idname
            for cls in bpy.types.RenderEngine.__subclasses__()
            if cls.__module__.startswith("addon")
        },
    }
    return {kind: sorted(names) for kind, names in found.items()}


def _members(owner: str, rna: bpy.types.Struct) -> Iterator[str]:
    """The owner, and its properties with their items."""
    yield owner
    for key, prop in rna.properties.items():
        if key not in ("rna_type", "name", "bl_idname"):
            yield from _of_property(f"{owner}.{key}", prop)


def _of_property(name: str, prop: bpy.types.Property) -> Iterator[str]:
    """A property; with its items, or the members of its group."""
    yield name
    group = getattr(prop, "fixed_type", None)
    if prop.type == "ENUM":
        yield from (f"{name}.{item.identifier}" for item in prop.enum_items)
        return
    known = group and bpy.types.PropertyGroup.bl_rna_get_subclass_py(group.identifier)
    if known and issubclass(known, bpy.types.PropertyGroup):
        yield from _members(name, group)


def _sockets(tree: bpy.types.NodeTree) -> Iterator[str]:
    """A node group and its sockets."""
    yield tree.name
    yield from (f"{tree.name}.{item.in_out}.{item.name}" for item in tree.interface.items_tree)


def _texts() -> set[str]:
    """The texts in the add-on's source."""
    nodes = (n for path in ADDON.rglob("*.py") for n in ast.walk(ast.parse(path.read_text("utf8"))))
    return {n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)}
