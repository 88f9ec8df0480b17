"""The add-on's preferences: the Python that trains, and this computer's habits."""

import bpy
from bpy.props import EnumProperty, FloatProperty, IntProperty, StringProperty

from .interface.questions import wrapped
from .paths import ROOT
from .python import setup


class Preferences(bpy.types.AddonPreferences):
    """Kept by Blender for the user, not in files."""

    bl_idname = ROOT

    python_path: StringProperty(
        name="Python",
        description="Python that has gscore and torch, or the folder of its environment; empty: "
        "the add-on's own environment, or one that is found",
        subtype="FILE_PATH",
    )
    found_python: StringProperty(
        name="Found",
        description="Python that Find has found",
        options={"HIDDEN"},
    )
    torch_source: EnumProperty(
        name="Torch",
        description="Which torch Make Environment downloads",
        items=(
            ("CPU", "For the CPU", "The small one; on Linux from the registry of torch's makers"),
            ("USUAL", "The Usual One", "From the usual registry; on Linux with gigabytes of CUDA"),
        ),
        default="CPU",
    )
    threads: IntProperty(
        name="Threads",
        description="CPU threads for training; 0: all. Fewer leave more for Blender",
        default=0,
        min=0,
        soft_max=64,
    )
    preview_seconds: FloatProperty(
        name="Test View Every",
        description="Training time between two pictures of a test view, seconds; 0: none",
        default=10.0,
        min=0.0,
        soft_max=300.0,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
    )
    live_seconds: FloatProperty(
        name="Live Splats Every",
        description="Time between two updates of the splats in the viewport, seconds",
        default=10.0,
        min=1.0,
        soft_max=300.0,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
    )
    live_most: IntProperty(
        name="Live Splats at Most",
        description="Splats shown while training, evenly chosen, so that Blender never waits; the "
        "result always has all",
        default=100_000,
        min=1000,
        soft_max=500_000,
    )
    lpips_path: StringProperty(
        name="LPIPS Network",
        description="ONNX file of the network that measures LPIPS; empty: LPIPS is not measured",
        subtype="FILE_PATH",
    )
    depth_model: StringProperty(
        name="Depth Network",
        description="ONNX file of the network that predicts depth maps, such as MiDaS or Depth "
        "Anything; nothing is downloaded, docs/depth.md says where they are",
        subtype="FILE_PATH",
    )
    output_folder: StringProperty(
        name="Default Output Folder",
        description="Where results go if the scene names no folder; empty: beside the .blend file, "
        "or beside the capture",
        subtype="DIR_PATH",
    )

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the preferences."""
        draw_trainer(self.layout, self)
        column = self.layout.column()
        column.use_property_split = True
        for name in ("threads", "live_seconds", "live_most", "preview_seconds"):
            column.prop(self, name)
        column.prop(self, "lpips_path")
        column.prop(self, "depth_model")
        column.prop(self, "output_folder")


def draw_trainer(layout: bpy.types.UILayout, prefs: Preferences) -> None:
    """The Python that trains: choose, check, make, and what came of it."""
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
        wrapped(box, setup.installer.OFFLINE, icon="INTERNET_OFFLINE")
    for line in setup.progress():
        row = box.row()
        row.label(text=line, icon="TIME")
        row.operator("gscore.cancel_setup", text="", icon="X")
    if setup.make_problem:
        wrapped(box, setup.make_problem, icon="ERROR")
    if setup.verdict is not None:
        wrapped(box, setup.verdict.sentence, icon="CHECKMARK" if setup.verdict.good else "ERROR")


def get() -> Preferences:
    """The preferences, also where a script has registered the add-on without enabling it."""
    addons = bpy.context.preferences.addons
    entry = addons.get(ROOT)
    if entry is None:
        entry = addons.new()
        entry.module = ROOT
    return entry.preferences


def register() -> None:
    """Register the preferences."""
    bpy.utils.register_class(Preferences)


def unregister() -> None:
    """Take them back and end what was started from them."""
    setup.shut_down()
    bpy.utils.unregister_class(Preferences)
