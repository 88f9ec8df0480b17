"""Add-on preferences: the Python environment for trainings, and settings of this computer."""

import json
import zlib
from collections.abc import Callable

import bpy
from bpy.props import EnumProperty, FloatProperty, IntProperty, StringProperty

from .core import depth_networks, no_automatic_card
from .paths import ROOT

FILE = "FILE"
"""Value of `depth_network` for a file of the user."""
CPU, AUTO = "CPU", "AUTO"
"""Values of `device` besides the UUIDs of graphics cards."""
_Item = tuple[str, str, str, int]
_items: list[_Item] = []
"""Items of `device`: Blender does not keep their texts."""

SECTIONS: list[Callable[[bpy.types.UILayout, "Preferences"], None]] = []
"""Drawing functions of other modules, above the rest."""
PYTHON_CHOSEN: list[Callable[["Preferences"], None]] = []
"""Callbacks after a change of the Python path."""


def _file_chosen(prefs: "Preferences", context: bpy.types.Context) -> None:
    if prefs.depth_model.strip():
        prefs.depth_network = FILE


def _python_chosen(prefs: "Preferences", context: bpy.types.Context) -> None:
    for callback in PYTHON_CHOSEN:
        callback(prefs)


def _devices(prefs: "Preferences", context: bpy.types.Context | None) -> list[_Item]:
    """Items of `device`; a card has the same number in every session."""
    _items[:] = [
        (CPU, "CPU", "All cores of the processor", 0),
        (AUTO, "Automatic", "A graphics card, for trainings if it is faster, else the CPU", 1),
    ]
    for uuid, name in _found(prefs):
        number = 2 + zlib.crc32(uuid.encode()) % (1 << 30)
        _items.append((uuid, name, "Graphics card, by Vulkan", number))
    return _items


def _found(prefs: "Preferences") -> list[list[str]]:
    """UUID and name of the graphics cards that were found."""
    try:
        return [[str(uuid), str(name)] for uuid, name in json.loads(prefs.found_devices or "[]")]
    except (ValueError, TypeError):
        return []


def device_name(value: str) -> str:
    """Name of a value of `device`, as the subject of a sentence."""
    return dict(_found(get())).get(value, "The graphics card")


def uses_card() -> bool:
    """Whether something else than the CPU may be used: where `AUTO` finds no card, nothing is
    loaded or started for it."""
    value = get().device or AUTO
    return value != CPU and not (value == AUTO and no_automatic_card())


class Preferences(bpy.types.AddonPreferences):
    """Preferences of the add-on; Blender stores them for the user, not in files."""

    bl_idname = ROOT

    python_path: StringProperty(
        name="Python",
        description="Python with gscore and torch, or the folder of its environment; empty: the "
        "add-on's own environment, or one found by Find",
        subtype="FILE_PATH",
        update=_python_chosen,
    )
    found_python: StringProperty(
        name="Found",
        description="Python found by Find",
        options={"HIDDEN"},
    )
    torch_source: EnumProperty(
        name="Torch",
        description="Build of torch that Make Environment downloads",
        items=(
            ("CPU", "CPU Only", "Small; on Linux from the PyTorch package index"),
            ("USUAL", "Default Build", "From PyPI; on Linux it includes gigabytes of CUDA"),
        ),
        default="CPU",
    )
    device: EnumProperty(
        name="Device",
        description="What trains splats, and what draws renders and Rendered shading of the engine "
        "Gaussian Splats",
        items=_devices,
        default=1,
    )
    gpu_share: FloatProperty(
        name="Share of the Card",
        description="Share of the time of the graphics card that a training may use; the rest is "
        "for the viewport. It does not change the splats",
        default=0.8,
        min=0.1,
        max=1.0,
        subtype="FACTOR",
    )
    found_devices: StringProperty(
        name="Found Devices",
        description="Graphics cards found by Find Graphics Cards",
        options={"HIDDEN"},
    )
    threads: IntProperty(
        name="Threads",
        description="CPU threads for training; 0: all. Fewer keep Blender more responsive",
        default=0,
        min=0,
        soft_max=64,
    )
    preview_seconds: FloatProperty(
        name="Test View Every",
        description="Training time between two pictures of a test view, in seconds; 0: no pictures",
        default=10.0,
        min=0.0,
        soft_max=300.0,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
    )
    live_seconds: FloatProperty(
        name="Live Splats Every",
        description="Time between two updates of the splats in the viewport, in seconds",
        default=10.0,
        min=1.0,
        soft_max=300.0,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
    )
    live_most: IntProperty(
        name="Maximum Live Splats",
        description="Maximum number of splats shown while training, sampled evenly to keep Blender "
        "responsive; the result always has all splats",
        default=100_000,
        min=1000,
        soft_max=500_000,
    )
    sequence_memory: IntProperty(
        name="Memory for Frames (MB)",
        description="Memory for preloaded frames of splat sequences, in megabytes; 100,000 splats "
        "in full color take 24 MB",
        default=1000,
        min=50,
        soft_max=16_000,
    )
    lpips_path: StringProperty(
        name="LPIPS Network",
        description="ONNX file of the network that measures LPIPS; empty: LPIPS is not measured",
        subtype="FILE_PATH",
    )
    depth_network: EnumProperty(
        name="Depth Network",
        description="Network that predicts depth maps; a missing one is downloaded only by a "
        "button that says so",
        items=[
            *((n.name, n.name, f"{n.bytes / 1e6:.0f} MB, {n.licence}") for n in depth_networks()),
            (FILE, "ONNX File", "Your own file; docs/depth.md lists sources"),
        ],
    )
    depth_model: StringProperty(
        name="Depth Network File",
        description="ONNX file of the network that predicts depth maps, such as MiDaS or Depth "
        "Anything",
        subtype="FILE_PATH",
        update=_file_chosen,
    )
    output_folder: StringProperty(
        name="Default Output Folder",
        description="Folder for results of scenes without an output folder; empty: next to the "
        ".blend file, or next to the capture",
        subtype="DIR_PATH",
    )

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the preferences."""
        for section in SECTIONS:
            section(self.layout, self)
        column = self.layout.column()
        column.use_property_split = True
        for name in ("threads", "live_seconds", "live_most", "preview_seconds", "sequence_memory"):
            column.prop(self, name)
        column.prop(self, "lpips_path")
        column.prop(self, "depth_network")
        if self.depth_network == FILE:
            column.prop(self, "depth_model")
        column.prop(self, "output_folder")


def get() -> Preferences:
    """The preferences; added if a script has registered the add-on without enabling it."""
    addons = bpy.context.preferences.addons
    entry = addons.get(ROOT)
    if entry is None:
        entry = addons.new()
        entry.module = ROOT
    return entry.preferences
