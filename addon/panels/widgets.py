"""What the panels of the sidebar share."""

import textwrap

import bpy

from .. import preferences
from ..camera_lookup import panel_root
from ..capture import CaptureFacts
from ..job import facts, training
from ..job.job import Job


class TabPanel:
    """A panel in the tab "Train Splats" of the 3D view's sidebar."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Train Splats"


def sentence(
    layout: bpy.types.UILayout, context: bpy.types.Context, text: str, *, icon: str = "NONE"
) -> None:
    """A sentence over as many lines as the sidebar's width needs.

    Args:
        layout: Gets a column.
        context: Its region is the sidebar.
        text: The sentence.
        icon: Before the first line.
    """
    width = context.region.width if context.region else 260
    # A letter is about 6.2 px wide at a scale of 1; margins and the icon take 60 px.
    letters = int((width / context.preferences.system.ui_scale - 60) / 6.2)
    column = layout.column(align=True)
    column.scale_y = 0.8
    for number, line in enumerate(textwrap.wrap(text, max(letters, 20)) or [""]):
        first = number == 0 or icon == "NONE"
        column.label(text=line, icon=icon if first else "BLANK1")


def rows(layout: bpy.types.UILayout, pairs: list[tuple[str, str]]) -> None:
    """Labels with their values in two columns."""
    column = layout.column(align=True)
    for label, value in pairs:
        split = column.split(factor=0.36)
        split.label(text=label)
        split.label(text=value)


def found(context: bpy.types.Context) -> CaptureFacts | None:
    """What is known of the scene's capture by now."""
    return facts.capture(context.scene)[0]


def root(context: bpy.types.Context) -> bpy.types.Object | None:
    """The empty of the panel's capture in the scene, if it was imported."""
    return panel_root(context.scene)


def job(context: bpy.types.Context) -> Job | None:
    """The scene's training."""
    return training.job_of(context.scene)


def open_preferences(layout: bpy.types.UILayout) -> None:
    """A button that leads to the add-on's preferences."""
    operator = layout.operator("preferences.addon_show", text="Preferences", icon="PREFERENCES")
    operator.module = preferences.ROOT
