"""Operators of the trainer's Python, find, check and install, and its preferences section."""

from pathlib import Path
from typing import ClassVar

import bpy
from bpy.props import StringProperty

from .. import preferences
from ..interface.base_operator import BaseOperator, Condition, ConfirmMixin, Waiting, wrapped
from ..preferences import SECTIONS, Preferences
from ..process import poll_timer
from . import installer
from .setup import CURRENT, contents


class CheckTrainer(Waiting, bpy.types.Operator):
    """Check whether the chosen Python can train; if none is chosen, search for one"""

    bl_idname = "gscore.check_trainer"
    bl_label = "Check"
    bl_options: ClassVar = set()

    def run(self, context: bpy.types.Context) -> str:
        """Check."""
        prefs = preferences.get()
        if not self.wait:
            CURRENT.start_check(prefs)
            poll_timer.ensure()
            return ""
        verdict = CURRENT.check(prefs)
        if not verdict.good:
            raise ValueError(verdict.sentence)
        return verdict.sentence


class MakeEnvironment(ConfirmMixin, Waiting, bpy.types.Operator):
    """Make a private Python environment for training: downloads torch and its dependencies"""

    bl_idname = "gscore.make_environment"
    bl_label = "Make Environment"
    bl_options: ClassVar = set()

    wheel: StringProperty(
        name="Wheel",
        description="gscore to install; empty: the one in the extension",
        options={"HIDDEN", "SKIP_SAVE"},
    )
    confirm = "Download and Install"

    def confirm_lines(self, context: bpy.types.Context) -> list[str]:
        """List the packages to install."""
        wheel = Path(self.wheel) if self.wheel else None
        return contents(preferences.get(), wheel=wheel)

    def run(self, context: bpy.types.Context) -> None:
        """Start."""
        wheel = Path(self.wheel) if self.wheel else None
        if self.wait:
            CURRENT.make(preferences.get(), wheel=wheel)
        else:
            CURRENT.start_make(preferences.get(), wheel=wheel)
        poll_timer.ensure()


class CancelSetup(BaseOperator, bpy.types.Operator):
    """Cancel the check or the installation; an earlier environment is kept"""

    bl_idname = "gscore.cancel_setup"
    bl_label = "Cancel"
    needs = Condition(lambda context: CURRENT.busy())

    def run(self, context: bpy.types.Context) -> None:
        """Cancel it."""
        CURRENT.cancel()


def draw_trainer(layout: bpy.types.UILayout, prefs: Preferences) -> None:
    """Draw the trainer's Python: choice, check, installation, and their results."""
    box = layout.box()
    row = box.row(align=True)
    row.prop(prefs, "python_path", placeholder="The add-on's own environment, or one found") if (
        "placeholder" in row.bl_rna.functions["prop"].parameters
    ) else row.prop(prefs, "python_path")
    row.operator("gscore.check_trainer", text="Check" if prefs.python_path else "Find")
    row = box.row()
    row.operator("gscore.make_environment", icon="IMPORT")
    row.prop(prefs, "torch_source", text="")
    if not bpy.app.online_access:
        wrapped(box, installer.OFFLINE, icon="INTERNET_OFFLINE")
    for line in CURRENT.progress():
        row = box.row()
        row.label(text=line, icon="TIME")
        row.operator("gscore.cancel_setup", text="", icon="X")
    if CURRENT.make_problem:
        wrapped(box, CURRENT.make_problem, icon="ERROR")
    if CURRENT.verdict is not None:
        wrapped(
            box, CURRENT.verdict.sentence, icon="CHECKMARK" if CURRENT.verdict.good else "ERROR"
        )


APPENDED = ((SECTIONS, draw_trainer),)
