"""A layout that records the content of panels, for Blenders without a window."""

from types import SimpleNamespace
from typing import Any

import bpy


class Layout:
    """Records the add-on's calls of a UILayout, and checks names as Blender does."""

    def __init__(self, notes: list[str] | None = None, fields: list[str] | None = None) -> None:
        self.notes: list[str] = [] if notes is None else notes
        """Texts of labels and bars, names of operators and properties, in order."""
        self.fields: list[str] = [] if fields is None else fields
        """Labels of fields that differ from the names of their properties."""
        self.enabled = True
        self.scale_y = 1.0

    def _part(self, **_: Any) -> "Layout":
        return Layout(self.notes, self.fields)

    row = column = box = split = _part

    def label(self, *, text: str = "", icon: str = "NONE", icon_value: int = 0) -> None:
        """Record a text."""
        self.notes.append(text)

    def progress(self, *, factor: float, text: str) -> None:
        """Record a progress bar."""
        assert 0 <= factor <= 1
        self.notes.append(f"[{factor:.0%}] {text}")

    def template_icon(self, icon_value: int, *, scale: float) -> None:
        """Record a picture."""
        assert icon_value > 0 and scale > 0
        self.notes.append("[picture]")

    def prop(self, owner: Any, name: str, *, text: str | None = None, **_: Any) -> None:
        """Record a property."""
        assert name in owner.bl_rna.properties, name
        self.fields += [] if text is None else [text]
        self.notes.append(f"<{name}>")

    def prop_enum(self, owner: Any, name: str, value: str, *, text: str) -> None:
        """Record a button that sets a choice."""
        assert value in owner.bl_rna.properties[name].enum_items, value
        self.notes.append(f"({text})")

    def template_list(
        self,
        kind: str,
        _: str,
        owner: Any,
        items: str,
        active_owner: Any,
        active: str,
        *,
        rows: int,
    ) -> None:
        """Record a list."""
        assert hasattr(bpy.types, kind) and rows > 0
        assert items in owner.bl_rna.properties and active in active_owner.bl_rna.properties
        self.notes.append(f"[list: {len(getattr(owner, items))}]")

    def menu(self, name: str, *, text: str, icon: str) -> None:
        """Record a menu with its items."""
        offered = Layout()
        getattr(bpy.types, name).draw(SimpleNamespace(layout=offered), bpy.context)
        self.notes.append(f"[menu: {' '.join(offered.notes)}]")

    def operator(self, name: str, *, text: str | None = None, **_: Any) -> SimpleNamespace:
        """Record a button."""
        room, verb = name.split(".")
        kind = getattr(getattr(bpy.ops, room), verb).get_rna_type()
        self.notes.append(f"({text if text is not None else kind.name})")
        return SimpleNamespace()

    @property
    def text(self) -> str:
        """All recorded text, with wrapped sentences joined."""
        return " ".join(self.notes)


def drawn(panel: type) -> str:
    """Text of a panel for the current scene; empty if it is not shown."""
    return _layout(panel).text


def labels(panel: type) -> list[str]:
    """Labels of the fields of a panel that differ from the properties' own names."""
    return _layout(panel).fields


def _layout(panel: type) -> Layout:
    poll, layout = getattr(panel, "poll", None), Layout()
    if poll is None or poll(bpy.context):
        panel.draw(SimpleNamespace(layout=layout), bpy.context)
    assert "`--" not in layout.text, layout.text  # marked options are shown by their labels
    return layout
