"""Runs inside a Blender with a window: Soft Splats in EEVEE, by F12.

`blender --factory-startup -P tests/window/soft_scene.py -- FOLDER PACKAGES...`, as `live_scene.py`.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDER, *PACKAGES = map(Path, sys.argv[sys.argv.index("--") + 1 :])
sys.path[:0] = [str(ROOT), *map(str, PACKAGES)]

import addon_utils  # noqa: E402 - the path comes first
import bpy  # noqa: E402
from bpy_extras.object_utils import world_to_camera_view  # noqa: E402
from mathutils import Vector  # noqa: E402

addon_utils.enable("addon", default_set=True, persistent=True)

from tests.addon import splat_scenes as lab  # noqa: E402
from tools.window.window_script import ScriptRunner, clear, write_results  # noqa: E402

SIZE = 200, 200
seen: dict = {"log": []}


def story() -> Iterator[object]:
    """The events; a yield returns control to Blender (`ScriptRunner`)."""
    scene, splats = bpy.context.scene, lab.beads(15)
    clear()
    camera = lab.prepare(scene, SIZE)
    camera.location = (1.5, -2, 5)
    camera.rotation_euler = Vector((-1.5, 2, -5)).to_track_quat("-Z", "Y").to_euler()
    ob = lab.add(scene, splats, "beads")
    ob.gscore.display = "SOFT"
    bpy.context.view_layer.update()
    exact = lab.truth(camera, splats, SIZE)
    places = [world_to_camera_view(scene, camera, v.co) for v in ob.data.vertices]
    seen["places"] = [[int(u * SIZE[0]), int((1 - v) * SIZE[1])] for u, v, _ in places]
    seen["wanted"] = [exact.rgb[y, x].tolist() for x, y in seen["places"]]
    scene.render.engine = "BLENDER_EEVEE" if bpy.app.version >= (5, 0) else "BLENDER_EEVEE_NEXT"
    scene.eevee.taa_render_samples = 32
    scene.render.filter_size = 0.01
    yield 1.0
    lab.render_file(FOLDER / "f12.png")


ScriptRunner(story(), write_results(FOLDER, seen))
