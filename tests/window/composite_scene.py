"""Runs inside a Blender with a window: composites with EEVEE in which a mesh is held out, by F12.

`blender --factory-startup -P tests/window/composite_scene.py -- FOLDER PACKAGES...`, as
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

addon_utils.enable("addon", default_set=True, persistent=True)

from tests.addon import splat_scenes as lab  # noqa: E402
from tests.addon.mesh_scenes import paint_world, plane  # noqa: E402
from tools.window.window_script import ScriptRunner, clear, write_results  # noqa: E402

SIZE, WORLD = (120, 90), (0.3, 0.5, 0.9)
seen: dict = {"log": []}


def story() -> Iterator[object]:
    """The events; a yield returns control to Blender (`ScriptRunner`)."""
    scene = bpy.context.scene
    clear()
    lab.prepare(scene, SIZE)
    scene.render.engine = "BLENDER_EEVEE" if bpy.app.version >= (5, 0) else "BLENDER_EEVEE_NEXT"
    scene.eevee.taa_render_samples = 32
    paint_world(scene, *WORLD)
    hole = plane(scene, 0.5, (1, 1, 1), -9.0, 0.2, "hole")
    hole.is_holdout, hole.rotation_euler.z = True, 0.3
    plane(scene, 1.5, (0, 1, 0), -0.6, -0.4, "before")
    plane(scene, -1.0, (0, 0, 1), 0.6, 1.2, "behind")
    splats = []
    for z, half, x in ((2.0, 0.08, -0.25), (-2.0, 0.5, 0.4)):
        splats.append(lab.add(scene, lab.wall(z, (0.9, 0.1, 0.1), half=half)))
        splats[-1].location.x, splats[-1].hide_render = x, True
    yield 1.0
    seen["plain"] = lab.render_exr(FOLDER, "plain").tolist()
    bpy.ops.gscore.set_up_compositing()
    yield 0.5
    seen["meshes"] = lab.render_exr(FOLDER, "meshes").tolist()
    for ob in splats:
        ob.hide_render = False
    yield 0.5
    seen["all"] = lab.render_exr(FOLDER, "all").tolist()
    lab.render_file(FOLDER / "all.png", mode="RGBA")
    bpy.ops.gscore.remove_compositing()
    for ob in splats:
        ob.hide_render = True
    yield 0.5
    seen["after"] = lab.render_exr(FOLDER, "after").tolist()


ScriptRunner(story(), write_results(FOLDER, seen))
