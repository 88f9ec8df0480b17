"""Runs inside a Blender with a window: Rendered shading of the engine, of a part of a view, of an
edited mesh, and through a camera that blurs.

`blender --factory-startup -P tests/window/rendered_scene.py -- FOLDER PACKAGES...`; PACKAGES are
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
import bpy  # noqa: E402
import numpy as np  # noqa: E402
from mathutils import Quaternion  # noqa: E402

addon_utils.enable("addon", default_set=True, persistent=True)

from addon.live import draw_handler, level  # noqa: E402
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

COLOR = (0.8, 0.4, 0.2)
REGION = (-110, 40, -60, 90)
"""Left, right, bottom and top of a part, pixels from the middle of the view."""
seen: dict = {"log": [], "region": REGION}


def screenshot(name: str) -> None:
    """Save the screen as a file."""
    save_screenshot(FOLDER / f"{name}.png")


def exact() -> bool:
    """True if the view shows the engine's finished picture."""
    return region().as_pointer() in draw_handler.viewport.EXACT


def live() -> bool:
    """True if the view has drawn splats live, for which Blender compiles programs first."""
    return draw_handler.view_of(region()) is not None


def called(operator: object, **given: object) -> None:
    """Call an operator in the view of the window."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area(), region=region()):
        operator(**given)


def limited() -> None:
    """Have the view draw the part, as Ctrl-B does."""
    left, right, bottom, top = REGION
    x, y = region().width // 2, region().height // 2
    called(
        bpy.ops.view3d.render_border,
        xmin=x + left,
        xmax=x + right,
        ymin=y + bottom,
        ymax=y + top,
    )


def regions(scene: bpy.types.Scene) -> Iterator[object]:
    """A part of the view, at rest, on the move, in another engine; and of the camera's frame."""
    view = space().region_3d
    limited()
    yield 0.5
    yield exact
    yield 0.5
    screenshot("region")
    still, level.STILL = level.STILL, 1e9
    for step in range(100):  # each redraw of a moving view compiles one program
        if live():
            break
        view.view_rotation = Quaternion((0, 0, 1), 0.01 + step / 1e4)
        yield 0.1
    view.view_rotation = Quaternion((0, 0, 1), 0.01)
    yield 1.0
    seen["moving"] = draw_handler.view_of(region()).level.moving
    screenshot("region_moving")
    level.STILL = still
    view.view_rotation = Quaternion((1, 0, 0, 0))
    space().shading.type = "MATERIAL"
    yield 0.5
    yield at_rest
    yield 0.5
    screenshot("region_material")
    space().shading.type = "SOLID"
    yield 0.5
    yield at_rest
    screenshot("region_solid")
    space().shading.type = "RENDERED"
    called(bpy.ops.view3d.clear_render_border)
    yield 0.5
    yield exact
    yield 0.5
    screenshot("everything")
    view.view_perspective = "CAMERA"
    yield 0.5
    limited()
    seen["scenes_own"] = scene.render.use_border
    yield 0.5
    yield exact
    yield 0.5
    screenshot("region_of_camera")
    scene.render.use_border = False
    view.view_perspective = "PERSP"


def edited(wall: bpy.types.Object) -> Iterator[object]:
    """The wall in Edit Mode: its left is hidden, its right selected; then in Object Mode."""
    x = np.empty(3 * len(wall.data.vertices), np.float32)
    wall.data.vertices.foreach_get("co", x)
    wall.data.vertices.foreach_set("hide", x[::3] < -0.4)
    wall.data.vertices.foreach_set("select", x[::3] > 0.4)
    wall.data.update()
    bpy.context.view_layer.objects.active = wall
    wall.select_set(True)
    called(bpy.ops.object.mode_set, mode="EDIT")
    yield 1.0
    yield exact
    yield 0.5
    screenshot("edited")
    space().overlay.show_overlays = False
    yield 0.5
    yield exact
    yield 0.5
    screenshot("edited_without_overlays")
    space().overlay.show_overlays = True
    called(bpy.ops.object.mode_set, mode="OBJECT")
    yield 0.5
    yield exact
    yield 0.5
    screenshot("not_edited")


def through_a_lens(scene: bpy.types.Scene) -> Iterator[object]:
    """Texts of a view through a camera that blurs, and of one through another."""
    space().overlay.show_text = True
    space().region_3d.view_perspective = "CAMERA"
    for name, blurs in (("sharp", False), ("lens", True)):
        scene.camera.data.dof.use_dof = blurs
        yield 0.5
        yield exact
        yield 1.0
        screenshot(name)
    space().region_3d.view_perspective = "PERSP"
    yield 0.5
    yield exact
    yield 1.0
    screenshot("no_camera")


def story() -> Iterator[object]:
    """The events; a yield returns control to Blender (`ScriptRunner`)."""
    scene = bpy.context.scene
    clear()
    look_down()
    lab.prepare(scene, (400, 300))
    wall = lab.add(scene, lab.wall(0.0, COLOR), "wall")
    space().shading.type = "RENDERED"
    yield 0.5
    yield exact
    shown = region()
    seen["middle"] = [shown.x + shown.width // 2, shown.y + shown.height // 2]
    seen["view"] = [shown.x, shown.y, shown.width, shown.height]
    yield from regions(scene)
    yield from edited(wall)
    yield from through_a_lens(scene)


ScriptRunner(story(), write_results(FOLDER, seen))
