"""Preferences section of the trainer's Python."""

import bpy

from ..interface.base_operator import wrapped
from ..preferences import SECTIONS, Preferences
from . import installer
from .setup import CURRENT


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
