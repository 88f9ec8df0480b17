"""Runs inside a Blender with a window: splats behind and in front of a photo of their camera.

`blender --factory-startup -P tests/window/photo_scene.py -- FOLDER PACKAGES...`, as
`live_scene.py`.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDER, *PACKAGES = map(Path, sys.argv[sys.argv.index("--") + 1 :])
sys.path[:0] = [str(ROOT), *map(str, PACKAGES)]

import addon_utils  # noqa: E402 - the path comes first
import bpy  # noqa: E402
from mathutils import Matrix  # noqa: E402

addon_utils.enable("addon", default_set=True, persistent=True)

from tests.addon import splat_scenes as lab  # noqa: E402
from tools.window.window_script import (  # noqa: E402
    ScriptRunner,
    area,
    at_rest,
    clear,
    region,
    save_screenshot,
    space,
    write_results,
)

CAPTURE = ROOT / "examples" / "studio"
COLOR = (0.8, 0.4, 0.2)
seen: dict = {"log": []}


def shots(name: str, wall: bpy.types.Object) -> Iterator[object]:
    """The screen with the photo behind the splats, in front of them, and half; and the photo
    alone."""
    slot = bpy.context.scene.camera.data.background_images[0]
    kinds = {"back": ("BACK", 1.0), "front": ("FRONT", 1.0), "half": ("FRONT", 0.5)}
    kinds["alone"] = "FRONT", 1.0
    for kind, (depth, opacity) in kinds.items():
        slot.display_depth, slot.alpha = depth, opacity
        wall.hide_set(kind == "alone")
        area().tag_redraw()
        yield 2.0
        file = FOLDER / f"{name}_{kind}.png"
        save_screenshot(file)
    wall.hide_set(False)


def without_live(wall: bpy.types.Object) -> Iterator[object]:
    """The photo behind the splats in the engine's own picture: without live drawing, and with a
    holdout, live or not; then from another place."""
    scene = bpy.context.scene
    slot = scene.camera.data.background_images[0]
    slot.display_depth, slot.alpha = "BACK", 1.0
    scene.gscore_render.live = False
    area().tag_redraw()
    yield at_rest
    yield 1.0
    save_screenshot(FOLDER / "still_back.png")
    hole = lab.add(scene, lab.wall(0.0, COLOR, half=0.1), "hole")
    hole.matrix_world = scene.camera.matrix_world @ Matrix.Translation((0, 0, -2.5))
    hole.is_holdout = True
    hole.select_set(False)
    for live in (False, True):
        scene.gscore_render.live = live
        yield 0.5
        yield at_rest
        yield 1.0
        save_screenshot(FOLDER / f"held_{'live' if live else 'still'}.png")
    bpy.data.objects.remove(hole)
    scene.gscore_render.live = False
    space().region_3d.view_perspective = "PERSP"
    for name, shows in (("elsewhere", True), ("elsewhere_bare", False)):
        scene.camera.data.show_background_images = shows
        area().tag_redraw()
        yield 0.5
        yield at_rest
        yield 1.0
        save_screenshot(FOLDER / f"{name}.png")
    scene.camera.data.show_background_images = True
    space().region_3d.view_perspective = "CAMERA"
    scene.gscore_render.live = True
    yield 0.5


def lost() -> Iterator[object]:
    """The screen with a missing photo in front of the splats."""
    slot = bpy.context.scene.camera.data.background_images[0]
    slot.image = slot.image.copy()
    slot.image.filepath = str(FOLDER / "nowhere.jpg")
    slot.image.reload()
    slot.display_depth, slot.alpha = "FRONT", 1.0
    area().tag_redraw()
    yield 2.0
    save_screenshot(FOLDER / "lost.png")


def sequence() -> Iterator[object]:
    """The screen with a sequence of pictures in front of the splats."""
    slot = bpy.context.scene.camera.data.background_images[0]
    photo = slot.image
    slot.image = photo.copy()
    slot.image.source = "SEQUENCE"
    area().tag_redraw()
    yield 2.0
    save_screenshot(FOLDER / "sequence.png")
    slot.image = photo


def story() -> Iterator[object]:
    """Import a capture, put a wall in front of one of its cameras, view the scene through that."""
    scene = bpy.context.scene
    clear()
    scene.gscore.capture_path = str(CAPTURE)
    bpy.ops.gscore.import_cameras(directory=str(CAPTURE), photos=True)
    yield 0.5
    camera = next(ob for ob in scene.objects if ob.type == "CAMERA")
    scene.camera = camera
    for ob in scene.objects:  # lines of others would be visible
        ob.hide_set(ob is not camera)
    bpy.context.view_layer.update()
    wall = lab.add(scene, lab.wall(0.0, COLOR, half=0.3), "wall")
    wall.matrix_world = camera.matrix_world @ Matrix.Translation((0, 0, -3))
    wall.select_set(False)
    space().region_3d.view_perspective = "CAMERA"
    space().overlay.show_extras = False
    yield 0.5
    yield at_rest
    found = region()
    seen["middle"] = [found.x + found.width // 2, found.y + found.height // 2]
    yield from shots("solid", wall)
    space().shading.type, scene.render.engine = "RENDERED", "GSCORE_SPLATS"
    yield 1.0
    yield from shots("rendered", wall)
    yield from without_live(wall)
    space().shading.type = "SOLID"
    yield from sequence()
    yield from lost()


ScriptRunner(story(), write_results(FOLDER, seen))
