"""Runs inside a Blender with a window: paints a mask where no image editor is open.

`blender --factory-startup -P tests/window/mask_scene.py -- FOLDER PACKAGES...`; PACKAGES are
folders with the packages missing in Blender's Python. Writes FOLDER/seen.json.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDER, *PACKAGES = map(Path, sys.argv[sys.argv.index("--") + 1 :])
sys.path[:0] = [str(ROOT), *map(str, PACKAGES)]

import addon_utils  # noqa: E402 - the path comes first
import bpy  # noqa: E402

addon_utils.enable("addon", default_set=True, persistent=True)

from addon.interface.sidebar import TAB  # noqa: E402
from tools.window.window_script import ScriptRunner, clear, write_results  # noqa: E402

CAPTURE = ROOT / "examples" / "studio"
seen: dict = {"log": []}


def editor() -> bpy.types.Area | None:
    """The image editor, in any window."""
    windows = bpy.context.window_manager.windows
    areas = (area for window in windows for area in window.screen.areas)
    return next((area for area in areas if area.type == "IMAGE_EDITOR"), None)


def sidebar() -> bpy.types.Region:
    """Its sidebar."""
    return next(region for region in editor().regions if region.type == "UI")


def story() -> Iterator[object]:
    """Import, paint, record the editor once it is at rest."""
    clear()
    bpy.context.scene.gscore.capture_path = str(CAPTURE)
    bpy.ops.gscore.import_cameras(directory=str(CAPTURE), photos=False)
    yield 0.5
    seen["painting"] = list(bpy.ops.gscore.paint_mask())
    can_tell = "active_panel_category" in sidebar().bl_rna.properties
    may_set = can_tell and not sidebar().bl_rna.properties["active_panel_category"].is_readonly
    if may_set:
        yield lambda: sidebar().active_panel_category == TAB
    yield 3.0
    area, space = editor(), editor().spaces.active
    seen["mode"], seen["open"] = space.ui_mode, space.show_region_ui
    seen["shelf"] = getattr(space, "show_region_asset_shelf", False)
    width = space.image.size[0] * space.zoom_percentage / 100
    seen["free"] = area.width - 2 * sidebar().width - width
    seen["height"] = area.height - space.image.size[1] * space.zoom_percentage / 100


ScriptRunner(story(), write_results(FOLDER, seen))
