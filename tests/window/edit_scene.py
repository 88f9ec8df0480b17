"""Runs inside a Blender with a window: selects splats in Edit Mode, takes screenshots.

`blender --factory-startup -P tests/window/edit_scene.py -- FOLDER PACKAGES...`; PACKAGES are
folders with the packages missing in Blender's Python. Writes FOLDER/seen.json and pictures of the
screen.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDER, *PACKAGES = map(Path, sys.argv[sys.argv.index("--") + 1 :])
sys.path[:0] = [str(ROOT), *map(str, PACKAGES)]

import addon_utils  # noqa: E402 - the path comes first
import bmesh  # noqa: E402
import bpy  # noqa: E402
from bpy_extras.view3d_utils import location_3d_to_region_2d  # noqa: E402
from mathutils import Vector  # noqa: E402

addon_utils.enable("addon", default_set=True, persistent=True)

from addon.render import viewport_copies  # noqa: E402
from tests.addon import splat_scenes as lab  # noqa: E402
from tools.window.window_script import (  # noqa: E402
    ScriptRunner,
    area,
    at_rest,
    clear,
    look_down,
    region,
    save_screenshot,
    space,
    write_results,
)

COLOR = (0.1, 0.3, 0.9)
POINT = 0.002
"""Radius of the balls, smaller than the vertices that Blender draws."""
seen: dict = {"log": []}


def screenshot(name: str) -> None:
    """Save the screen as a file."""
    save_screenshot(FOLDER / f"{name}.png")


def choose(ob: bpy.types.Object, *, upper: bool, lower: bool) -> None:
    """Select the upper and the lower half, in Edit Mode as a user does."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area(), region=region()):
        bpy.ops.object.mode_set(mode="OBJECT")
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.mesh.select_all(action="DESELECT")
        editor = bmesh.from_edit_mesh(ob.data)
        for vertex in editor.verts:
            vertex.select_set(upper if vertex.co.y > 0.01 else lower)
        bmesh.update_edit_mesh(ob.data)


def invert() -> None:
    """Select the others, without leaving Edit Mode."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area(), region=region()):
        bpy.ops.mesh.select_all(action="INVERT")


def part(sign: int) -> list[int]:
    """Left, right, bottom and top of the inside of the upper or lower half, on the screen."""
    view, shown = space().region_3d, region()
    corners = [Vector((x, sign * y, 0)) for x, y in ((-0.8, 0.2), (0.8, 0.8))]
    flat = [location_3d_to_region_2d(shown, view, corner) for corner in corners]
    xs, ys = (sorted(int(p[k]) for p in flat) for k in (0, 1))
    return [shown.x + xs[0], shown.x + xs[1], shown.y + ys[0], shown.y + ys[1]]


def drawn_around(ob: bpy.types.Object) -> Iterator[object]:
    """The splats selected by Blender's own box and lasso, with X-Ray and without.

    The box is that of `part(1)`; the lasso goes around its left half, with a corner cut off.
    """
    window, shown = bpy.context.window_manager.windows[0], region()
    left, right, bottom, top = (v - (shown.x, shown.y)[k // 2] for k, v in enumerate(part(1)))
    middle = (left + right) // 2
    lasso = [(left, bottom), (middle, bottom), (middle, top), (left, (bottom + top) // 2)]
    path = [{"name": "", "loc": corner, "time": 0.0} for corner in lasso]
    flat = [location_3d_to_region_2d(shown, space().region_3d, v.co) for v in ob.data.vertices]
    seen["flat"] = [list(place) for place in flat]
    seen["box"], seen["lasso"] = [left, right, bottom, top], lasso
    seen["drawn"] = {}
    with bpy.context.temp_override(window=window, area=area(), region=shown):
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.mesh.select_mode(type="VERT")
    for xray in (False, True):
        space().shading.show_xray = xray
        area().tag_redraw()
        yield 1.0  # Blender selects by its drawn pixels
        for name in ("box", "lasso"):
            with bpy.context.temp_override(window=window, area=area(), region=shown):
                bpy.ops.mesh.select_all(action="DESELECT")
                if name == "box":
                    sides = {"xmin": left, "xmax": right, "ymin": bottom, "ymax": top}
                    bpy.ops.view3d.select_box(**sides, wait_for_input=False, mode="SET")
                else:
                    bpy.ops.view3d.select_lasso(path=path, mode="SET")
            yield 1.0
            editor = bmesh.from_edit_mesh(ob.data)
            chosen = [v.index for v in editor.verts if v.select]
            seen["drawn"][f"{name}_{'xray' if xray else 'plain'}"] = chosen
        screenshot(f"lasso_{'xray' if xray else 'plain'}")
    space().shading.show_xray = False


def story() -> Iterator[object]:
    """The events; a yield returns control to Blender (`ScriptRunner`)."""
    clear()
    look_down()
    wall = lab.add(bpy.context.scene, lab.wall(0.0, COLOR), "wall")
    yield at_rest
    bpy.context.view_layer.objects.active = wall
    wall.select_set(True)
    wall.gscore.point_size = POINT
    wall.gscore.display = "POINTS"
    yield 1.0
    seen["upper"], seen["lower"] = part(1), part(-1)
    choose(wall, upper=False, lower=False)
    yield 1.5
    seen["none"] = wall.data.count_selected_items()[0]
    screenshot("points_none")
    choose(wall, upper=True, lower=False)
    yield 1.5
    screenshot("points_upper")
    wall.gscore.display = "SPLATS"
    yield 3.0
    screenshot("splats_upper")
    bpy.ops.object.mode_set(mode="OBJECT")
    yield from drawn_around(wall)
    viewport_copies.EDITED_AT_ONCE = 1000  # fewer than in the wall
    choose(wall, upper=True, lower=False)
    yield 1.5
    invert()
    yield 2.0
    screenshot("splats_lower")


ScriptRunner(story(), write_results(FOLDER, seen))
