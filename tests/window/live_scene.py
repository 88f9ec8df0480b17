"""Runs inside a Blender with a window: shows splats, takes screenshots, records the results.

`blender --factory-startup --enable-event-simulate -P tests/window/live_scene.py -- FOLDER
PACKAGES...`; PACKAGES are folders with the packages missing in Blender's Python. Writes
FOLDER/seen.json and pictures of the screen.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
FOLDER, *PACKAGES = map(Path, sys.argv[sys.argv.index("--") + 1 :])
sys.path[:0] = [str(ROOT), *map(str, PACKAGES)]

import addon_utils  # noqa: E402 - the path comes first
import bpy  # noqa: E402
from mathutils import Quaternion  # noqa: E402

addon_utils.enable("addon", default_set=True, persistent=True)

from addon.live import draw_handler, level  # noqa: E402
from addon.live.card import Card, Shot  # noqa: E402
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
    send,
    space,
    write_results,
)

COLOR = (0.8, 0.4, 0.2)
DARK = (5, 4, 3)
seen: dict = {"log": []}


def screenshot(name: str) -> None:
    """Save the screen as a file; return the rectangle of the view."""
    save_screenshot(FOLDER / f"{name}.png")


def named(context: bpy.types.Context) -> list[str]:
    """The objects that are drawn live."""
    found = draw_handler.shown(context, context.evaluated_depsgraph_get())
    return sorted(source.ob.name for source in found)


def look() -> list[str]:
    """The same for the view of the window."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area(), region=region()):
        return named(bpy.context)


@contextmanager
def counted_pictures() -> Iterator[list[Shot]]:
    """Number of splat pictures drawn meanwhile."""
    drawn, draw = [], Card.draw

    def counted(self: Card, *given: Any) -> None:
        drawn.append(given[3])
        draw(self, *given)

    Card.draw = counted
    yield drawn
    Card.draw = draw


def moving(view: bpy.types.RegionView3D, name: str) -> Iterator[object]:
    """A picture of a view that keeps moving."""
    still, level.STILL = level.STILL, 1e9
    view.view_rotation = Quaternion((0, 0, 1), 0.01)
    yield 1.0
    seen.setdefault("moving", []).append(draw_handler.view_of(region()).level.moving)
    screenshot(name)
    level.STILL = still
    view.view_rotation = Quaternion((1, 0, 0, 0))
    yield 0.5
    yield at_rest


def lines(scene: bpy.types.Scene, view: bpy.types.RegionView3D) -> Iterator[object]:
    """An edge in front of the wall and behind it."""
    mesh = bpy.data.meshes.new("edge")
    mesh.from_pydata([(-0.2, 0, 0), (0.2, 0, 0)], [(0, 1)], [])
    edge = bpy.data.objects.new("edge", mesh)
    scene.collection.objects.link(edge)
    for name, z in (("line_before", 0.5), ("line_behind", -0.5)):
        edge.location.z = z
        yield 0.5
        yield at_rest
        screenshot(name)
        yield from moving(view, f"{name}_moving")
    edge.show_in_front = True
    yield 0.5
    yield at_rest
    screenshot("line_in_front")
    yield from moving(view, "line_in_front_moving")
    bpy.data.objects.remove(edge)
    yield 0.5


def clipped() -> Iterator[object]:
    """A view that clips around its middle, then in front of the wall, then not.

    By the keys of a user, because Blender does not redraw a view for a script. Without overlays,
    which would cause new depths.
    """
    space().overlay.show_overlays = False
    for key, value, place in (
        ("B", "PRESS", -50),
        ("LEFTMOUSE", "PRESS", -50),
        ("MOUSEMOVE", "NOTHING", 50),
        ("LEFTMOUSE", "RELEASE", 50),
    ):
        send("MOUSEMOVE", "NOTHING", place, place)
        send(key, value, place, place, alt=key == "B")
        yield 0.2
    yield at_rest
    screenshot("clipped")
    send("B", alt=True)
    yield 0.2
    yield at_rest
    screenshot("unclipped")
    space().overlay.show_overlays = True
    space().clip_end = 3.0  # the wall is 4 away
    yield 0.5
    yield at_rest
    screenshot("beyond_the_end")
    space().clip_end = 1000.0
    yield 0.5


def dark(scene: bpy.types.Scene) -> Iterator[object]:
    """A wall of a few levels of 8 bit in front of the other, at rest and redrawn repeatedly."""
    wall = lab.add(scene, lab.wall(0.8, tuple(level / 255 for level in DARK)), "dark")
    yield 0.5
    yield at_rest
    for _ in range(5):
        area().tag_redraw()
        yield 0.2
    screenshot("dark")
    bpy.data.objects.remove(wall)
    yield 0.5


def with_gizmo(ob: bpy.types.Object) -> Iterator[object]:
    """The move gizmo of a selected object over splats, in each shading, and the view without it."""
    window = bpy.context.window_manager.windows[0]
    bpy.context.view_layer.objects.active = ob
    ob.select_set(True)
    colors = bpy.context.preferences.themes[0].user_interface
    seen["axes"] = [list(getattr(colors, f"axis_{axis}")) for axis in "xy"]
    with bpy.context.temp_override(window=window, area=area(), region=region()):
        bpy.ops.wm.tool_set_by_id(name="builtin.move")
    for shading in ("SOLID", "MATERIAL", "RENDERED"):
        space().shading.type = shading
        for shows in (False, True):
            space().show_gizmo = shows
            yield 0.5
            yield at_rest
            yield 1.0
            screenshot(f"gizmo_{shading.lower()}_{'on' if shows else 'off'}")
    space().show_gizmo = False
    space().shading.type = "SOLID"
    ob.select_set(False)


def through_camera(scene: bpy.types.Scene) -> Iterator[object]:
    """The view through a camera with a frame that fills it, and the picture of F12."""
    shown, view = region(), space().region_3d
    seen["view"] = [shown.x, shown.y, shown.width, shown.height]
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    camera.location = (0.3, -0.2, 4)
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = shown.width, shown.height
    scene.render.resolution_percentage = 100
    view.view_perspective, view.view_camera_offset = "CAMERA", (0, 0)
    view.view_camera_zoom = 50 * (2 - 2**0.5)  # the frame fills the view at this zoom
    space().overlay.show_overlays = False
    for transform in ("Standard", "Raw"):
        scene.view_settings.view_transform = transform
        yield 0.5
        yield lambda: region().as_pointer() in draw_handler.viewport.EXACT
        yield 1.0
        screenshot(f"camera_{transform}")
        lab.render_file(FOLDER / f"f12_{transform}.png")
    scene.view_settings.view_transform = "Standard"
    view.view_perspective = "PERSP"


def off_and_on() -> Iterator[object]:
    """The add-on disabled and enabled again, as in the preferences."""
    space().shading.type = "SOLID"
    look_down()
    yield 0.5
    yield at_rest
    yield 1.0
    screenshot("before_off")
    addon_utils.disable("addon", default_set=True)
    area().tag_redraw()
    yield 1.0
    screenshot("off")
    addon_utils.enable("addon", default_set=True, persistent=True)
    area().tag_redraw()
    yield 0.5
    yield at_rest
    yield 1.0
    screenshot("on_again")
    wall = bpy.data.objects["wall"]
    seen["display_again"] = wall.gscore.display
    wall.gscore.display = "POINTS"
    yield 1.0
    seen["shown_again"] = look()


def story() -> Iterator[object]:
    """The events; a yield returns control to Blender (`ScriptRunner`)."""
    scene = bpy.context.scene
    clear()
    view = look_down()
    wall = lab.add(scene, lab.wall(0.0, COLOR), "wall")
    seen["display"] = wall.gscore.display
    yield at_rest
    yield 1.0
    # One attribute per redraw, as for a million splats.
    budget, viewport_copies.COPY_BUDGET = viewport_copies.COPY_BUDGET, 0.0
    viewport_copies.SHARED.clear()
    area().tag_redraw()
    yield 3.0  # without any user action
    found = draw_handler.sources(bpy.context.evaluated_depsgraph_get())
    seen["by_itself"] = viewport_copies.SHARED.copied(found)[1]
    viewport_copies.COPY_BUDGET = budget
    yield 1.0
    shown = region()
    seen["middle"] = [shown.x + shown.width // 2, shown.y + shown.height // 2]
    screenshot("wall")
    wall.scale.y = 2.0
    yield 0.5
    seen["uneven"] = draw_handler.problem_of(region())
    screenshot("uneven")
    wall.scale.y = 1.0
    yield 0.5
    yield at_rest
    mesh = bpy.data.meshes.new("plate")
    mesh.from_pydata(
        [(-0.2, -0.2, 0.5), (0.2, -0.2, 0.5), (0.2, 0.2, 0.5), (-0.2, 0.2, 0.5)], [], [(0, 1, 2, 3)]
    )
    plate = bpy.data.objects.new("plate", mesh)
    scene.collection.objects.link(plate)
    yield 1.0
    screenshot("plate_before")
    yield at_rest
    with counted_pictures() as pictures:
        for _ in range(5):
            area().tag_redraw()
            yield 0.2
        seen["with_mesh"] = {"again": len(pictures)}
        plate.location.z = 0.2
        yield 0.5
        seen["with_mesh"]["moved"] = len(pictures)
    plate.location.z = -1.0
    yield 1.0
    screenshot("plate_behind")
    plate.location.z = 0.0
    yield from moving(view, "plate_before_moving")
    plate.location.z = -1.0
    yield from moving(view, "plate_behind_moving")
    plate.hide_set(True)
    yield from lines(scene, view)
    yield from clipped()
    plate.hide_set(False)
    other = lab.add(scene, lab.blob(), "blob")
    yield at_rest
    seen["both"] = look()
    other.hide_set(True)
    yield 0.3
    seen["hidden"] = look()
    other.hide_set(False)
    other.gscore.display = "POINTS"
    yield 0.3
    seen["as_points"] = look()
    other.gscore.display = "SPLATS"
    window = bpy.context.window_manager.windows[0]
    for ob in scene.objects:
        ob.select_set(ob == other)
    with bpy.context.temp_override(window=window, area=area(), region=region()):
        bpy.ops.view3d.localview()
    yield 0.5
    seen["local"] = look()
    with bpy.context.temp_override(window=window, area=area(), region=region()):
        bpy.ops.view3d.localview()
    space().overlay.show_overlays = False
    plate.hide_set(True)
    yield from dark(scene)
    view.view_rotation = Quaternion((0, 0, 1), 0.3)
    yield 0.3
    yield at_rest
    yield 1.0  # in which Blender smooths its own picture
    screenshot("both")
    with counted_pictures() as pictures:
        area().tag_redraw()
        yield 0.3
        seen["pictures"] = {"again": len(pictures)}
        view.view_rotation = Quaternion((0, 0, 1), 0.4)
        yield 0.3
        seen["pictures"]["turned"] = len(pictures)
        view.view_rotation = Quaternion((0, 0, 1), 0.3)
        yield 0.3
        yield at_rest
    yield 1.0
    screenshot("both_again")
    scene.render.engine = "GSCORE_SPLATS"
    scene.view_settings.view_transform = "Standard"
    space().shading.type = "RENDERED"
    yield lambda: region().as_pointer() in draw_handler.viewport.EXACT
    yield 1.0
    screenshot("exact")
    yield from through_camera(scene)
    look_down()
    yield from with_gizmo(wall)
    yield from off_and_on()


def _end(problem: str) -> None:
    found = draw_handler.view_of(region())
    seen["seconds"] = None if found is None else found.seconds
    write_results(FOLDER, seen)(problem)


ScriptRunner(story(), _end)
