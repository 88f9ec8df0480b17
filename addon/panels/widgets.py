"""Shared widgets of the sidebar's panels."""

from typing import ClassVar

import bpy

from .. import preferences
from ..cameras.lookup import panel_root
from ..capture.inspection import ShownFacts
from ..interface.base_operator import Condition, letters, wrapped
from ..interface.option_labels import error_text
from ..interface.sidebar import TAB
from ..splats.objects import has_splats
from ..trainer_python import setup
from ..training import facts, start_training
from ..training.training_job import Job
from ..training.verb_job import FAILED, VerbJob

_WARNINGS_SHOWN = 3


class TabPanel:
    """Base of panels in the tab "Train Splats" of the 3D view's sidebar."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = TAB
    needs = Condition(lambda context: True)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """True if `needs` holds."""
        return cls.needs.holds(context)


class SplatsPanel(TabPanel):
    """Base of closed panels on the active splat object, or the one that the active object crops."""

    bl_options: ClassVar = {"DEFAULT_CLOSED"}
    needs = Condition(has_splats)


def sentence(layout: bpy.types.UILayout, text: str, *, icon: str = "NONE") -> None:
    """Draw a sentence, wrapped to the width of the drawn region.

    Args:
        layout: Parent of the lines.
        text: The sentence.
        icon: Icon of the first line.
    """
    wrapped(layout, text, icon=icon, width=letters())


def rows(layout: bpy.types.UILayout, pairs: list[tuple[str, str]]) -> None:
    """Draw labels with their values in two columns."""
    column = layout.column(align=True)
    for label, value in pairs:
        split = column.split(factor=0.36)
        split.label(text=label)
        split.label(text=value)


def limit(layout: bpy.types.UILayout, owner: bpy.types.PropertyGroup, name: str) -> None:
    """Draw a limit, marked "(off)" at 0."""
    label = owner.bl_rna.properties[name].name
    layout.prop(owner, name, text=label if getattr(owner, name) else f"{label} (off)")


def found(context: bpy.types.Context) -> ShownFacts | None:
    """The loaded facts of the scene's capture."""
    return facts.capture(context.scene)[0]


def root(context: bpy.types.Context) -> bpy.types.Object | None:
    """The empty of the panel's capture in the scene, if it was imported."""
    return panel_root(context.scene)


def job(context: bpy.types.Context) -> Job | None:
    """The scene's training."""
    return start_training.job_of(context.scene)


def python_problem() -> str:
    """Sentence why the preferences have no Python that trains; empty if they have one."""
    try:
        setup.trainer_python(preferences.get())
    except ValueError as error:
        return error_text(error)
    return ""


def has_python(layout: bpy.types.UILayout) -> bool:
    """True if the preferences have a Python that trains; else draw the problem and a button to the
    preferences."""
    if problem := python_problem():
        sentence(layout, problem, icon="ERROR")
        operator = layout.operator("preferences.addon_show", text="Preferences", icon="PREFERENCES")
        operator.module = preferences.ROOT
        return False
    return True


def draw_verb(
    layout: bpy.types.UILayout,
    job: VerbJob,
    text: str,
    stop: str,
    *,
    icon: str = "SNAP_FACE",
) -> None:
    """Draw a job: its bar, or its end with warnings.

    Args:
        layout: Parent.
        job: The job.
        text: Text of the bar.
        stop: Operator that cancels it.
        icon: Icon of that button.
    """
    if not job.ended:
        row = layout.row(align=True)
        row.progress(factor=job.share, text=text)
        row.operator(stop, text="", icon=icon)
    elif job.awaits_import:
        layout.label(text="Importing the result...", icon="TIME")
    if job.sentence:
        end = "ERROR" if job.status == FAILED else "CHECKMARK"
        sentence(layout, job.sentence, icon=end)
    for warning in job.warnings[-_WARNINGS_SHOWN:]:
        sentence(layout, warning, icon="ERROR")
