"""Runs inside a Blender with a window: an artist's work on a capture, from photos to a file.

`blender --factory-startup -P tests/window/tour_scene.py -- FOLDER PACKAGES...`; PACKAGES are
folders with the packages missing in Blender's Python. FOLDER/first and FOLDER/second are captures,
FOLDER/venv is named by a file `python`: the Python that trains. Writes FOLDER/seen.json and
pictures of the screen, one after each station.
"""

import sys
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDER, *PACKAGES = map(Path, sys.argv[sys.argv.index("--") + 1 :])
sys.path[:0] = [str(ROOT), *map(str, PACKAGES)]

import addon_utils  # noqa: E402 - the path comes first
import bmesh  # noqa: E402
import bpy  # noqa: E402
import numpy as np  # noqa: E402

addon_utils.enable("addon", default_set=True, persistent=True)

from addon.cameras.objects import root_of  # noqa: E402
from addon.error_maps.measure_errors import job_of as errors_of  # noqa: E402
from addon.process import poll_timer  # noqa: E402
from addon.region_training.train_region import job_of as region_of  # noqa: E402
from addon.training.start_training import job_of as training_of  # noqa: E402
from tools.window.window_script import (  # noqa: E402
    ScriptRunner,
    area,
    at_rest,
    region,
    save_screenshot,
    space,
    write_results,
)

ScriptRunner.LONGEST = 60.0
STEPS = 1_000
seen: dict = {"log": [], "longest_beat": {}}
station = "start"


def _timed() -> float | None:
    """Blender's timer, with the longest beat of each station kept, milliseconds of this thread."""
    begin = time.thread_time()
    again = _tick()
    spent = 1000 * (time.thread_time() - begin)
    seen["longest_beat"][station] = max(spent, seen["longest_beat"].get(station, 0.0))
    return again


_tick, poll_timer.poll = poll_timer.poll, _timed


def press(name: str, **given: object) -> None:
    """Press a button, with the view under the mouse; an undo step, as for a user."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area(), region=region()):
        getattr(bpy.ops.gscore, name)("EXEC_DEFAULT", True, **given)


def key(name: str, **given: object) -> None:
    """Call an operator of Blender's, `room.name`, with the view under the mouse."""
    room, operator = name.split(".")
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area(), region=region()):
        getattr(getattr(bpy.ops, room), operator)("EXEC_DEFAULT", True, **given)


def arrive(name: str) -> None:
    """Keep a picture of the screen, and begin the next station."""
    global station
    save_screenshot(FOLDER / f"{name}.png")
    station = name


def scene_settings() -> bpy.types.PropertyGroup:
    """The add-on's settings."""
    return bpy.context.scene.gscore


def result() -> bpy.types.Object:
    """The splats of the training."""
    return scene_settings().result


def choose(ob: bpy.types.Object) -> None:
    """Click on an object."""
    for other in bpy.context.view_layer.objects:
        other.select_set(other == ob)
    bpy.context.view_layer.objects.active = ob


def count_of(ob: bpy.types.Object) -> int:
    """The number of splats of an object; in Edit Mode its mesh does not have it."""
    mesh = ob.data
    return len(bmesh.from_edit_mesh(mesh).verts if mesh.is_editmode else mesh.vertices)


def rows(ob: bpy.types.Object, name: str = "position") -> np.ndarray:
    """Float values of an attribute of the splats."""
    values = ob.data.attributes[name].data
    flat = np.empty(3 * len(values), np.float32)
    values.foreach_get("vector", flat)
    return flat.reshape(-1, 3)


def over(job_of: object, *of: object) -> object:
    """True if a job has ended and its result is in the scene."""

    def ended() -> bool:
        job = job_of(*of)
        return job is not None and job.ended and not job.awaits_import

    return ended


def trained() -> bool:
    """True if the scene's training has ended, and its splats are there."""
    job = training_of(bpy.context.scene)
    return job is not None and job.state.ended and not any(f.waits() for f in poll_timer.POLLERS)


def to_train(capture: Path) -> None:
    """Choose a capture and the small effort spent on it."""
    settings = scene_settings()
    settings.capture_path = str(capture)
    settings.preset = "preview"
    settings.iterations, settings.max_splats = STEPS, 20_000
    settings.use_masks = False


def begin() -> Iterator[object]:
    """Cameras, and splats that arrive during the training."""
    python = (FOLDER / "python").read_text().strip()
    preferences = bpy.context.preferences.addons["addon"].preferences
    preferences.python_path = python
    preferences.live_seconds = 2.0  # the default is about as long as this training
    space().show_region_ui = True
    yield 1.0
    next(r for r in area().regions if r.type == "UI").active_panel_category = "Train Splats"
    to_train(FOLDER / "first")
    press("import_cameras", directory=str(FOLDER / "first"))
    yield 3.0
    seen["cameras"] = sum(ob.type == "CAMERA" for ob in bpy.data.objects) - 1
    arrive("cameras")
    press("train")
    yield lambda: result() is not None
    seen["came_while_training"] = not trained()
    yield 2.0
    arrive("training")
    yield trained
    press("show_splats")
    yield at_rest
    seen["trained"] = len(result().data.vertices)
    arrive("trained")


def look() -> Iterator[object]:
    """Every shading, turned, hidden and shown again."""
    view = space().region_3d
    for shading in ("SOLID", "MATERIAL", "RENDERED"):
        space().shading.type = shading
        for _ in range(8):
            view.view_rotation = turned(0.1) @ view.view_rotation
            yield 0.1
        yield at_rest
        arrive(f"look_{shading.lower()}")
    space().shading.type = "SOLID"
    result().hide_set(True)
    yield 1.0
    arrive("hidden")
    result().hide_set(False)
    yield at_rest


def turned(angle: float) -> object:
    """A turn about the vertical."""
    from mathutils import Quaternion

    return Quaternion((0, 0, 1), angle)


def edit() -> Iterator[object]:
    """Select, grade, delete; undo and redo; crop, thin out, write."""
    choose(result())
    count = count_of(result())
    press("select_by_opacity", low=0.9, high=1.0)
    yield 1.0
    arrive("selected")
    press("grade_splats", gain=(1.4, 0.8, 0.8))
    yield at_rest
    arrive("graded")
    key("object.mode_set", mode="EDIT")
    key("mesh.delete", type="VERT")
    key("object.mode_set", mode="OBJECT")
    yield at_rest
    less = count_of(result())
    for _ in range(2):  # Edit Mode was left after it
        key("ed.undo")
        yield at_rest
    back = count_of(result())
    for _ in range(2):
        key("ed.redo")
        yield at_rest
    seen["deleted"] = [count, less, back, count_of(result())]
    press("add_crop_box")
    box = bpy.context.object
    box.scale *= 0.5
    choose(result())
    yield at_rest
    arrive("cropped")
    press("export_splats", filepath=str(FOLDER / "cropped.ply"))
    yield 2.0
    press("import_splats", filepath=str(FOLDER / "cropped.ply"))
    yield 2.0
    again = bpy.context.object
    seen["cropped"] = len(again.data.vertices)
    press("decimate_splats", count=seen["cropped"] // 2)
    yield at_rest
    seen["decimated"] = len(bpy.context.object.data.vertices)
    bpy.data.objects.remove(bpy.context.object)
    yield 1.0


def measure_errors() -> Iterator[object]:
    """Errors on cameras and splats, the worst photo, a mask."""
    choose(result())
    press("measure_errors")
    yield over(errors_of, result())
    yield at_rest
    arrive("errors")
    seen["maps"] = sum("rror" in ob.name for ob in bpy.data.objects)
    press("remove_errors")
    choose(result())
    press("compare_worst_photo")
    yield 3.0
    seen["windows"] = len(bpy.context.window_manager.windows)
    arrive("compared")
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[1]):
        bpy.ops.wm.window_close()


def steer() -> Iterator[object]:
    """Train the splats in the crop box again; all others are frozen."""
    choose(result())
    before = rows(result()).copy()
    bpy.context.scene.gscore_steer.region_steps = 100
    press("train_region")
    yield over(region_of, bpy.context.scene)
    yield at_rest
    after = {row.tobytes() for row in rows(result())}
    seen["still"] = float(np.mean([row.tobytes() in after for row in before]))
    arrive("region")


def render() -> Iterator[object]:
    """F12 by the engine, and next to a mesh of EEVEE or Cycles."""
    scene = bpy.context.scene
    scene.render.resolution_percentage = 50
    press("use_camera", index=0, look_through=True)
    yield at_rest
    scene.render.filepath = str(FOLDER / "render.png")
    key("render.render", write_still=True)
    key("mesh.primitive_cube_add", size=0.3)
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.device = 4, "CPU"
    scene.cycles.use_denoising = False  # Debian 13 builds it without
    press("set_up_compositing")
    scene.render.filepath = str(FOLDER / "composite.png")
    key("render.render", write_still=True)
    yield 1.0
    press("remove_compositing")
    arrive("composited")


def second() -> Iterator[object]:
    """Another capture in the same file: the first one keeps what it has."""
    first, splats = result().name, len(result().data.vertices)
    folder = scene_settings().output_path
    to_train(FOLDER / "second")
    press("import_cameras", directory=str(FOLDER / "second"))
    yield 1.0
    press("train")
    yield lambda: result() is not None and trained()
    yield at_rest
    seen["roots"] = len({root_of(o) for o in bpy.data.objects if o.type == "CAMERA"} - {None})
    seen["second"] = [result().name != first, scene_settings().output_path != folder]
    arrive("second")
    scene_settings().capture_path = str(FOLDER / "first")
    yield 1.0
    seen["first_back"] = [
        result().name == first,
        len(result().data.vertices) == splats,
        scene_settings().output_path == folder,
    ]


def reopen() -> Iterator[object]:
    """Save, begin another file, and open the first again."""
    names = {ob.name: len(ob.data.vertices) for ob in bpy.data.objects if ob.type == "MESH"}
    key("wm.save_as_mainfile", filepath=str(FOLDER / "tour.blend"))
    key("wm.read_homefile", app_template="")
    yield 1.0
    key("wm.open_mainfile", filepath=str(FOLDER / "tour.blend"))
    yield 2.0
    yield at_rest
    there = {ob.name: len(ob.data.vertices) for ob in bpy.data.objects if ob.type == "MESH"}
    seen["reopened"] = there == names
    arrive("reopened")


def story() -> Iterator[object]:
    """The events; a yield returns control to Blender (`ScriptRunner`)."""
    for part in (begin, look, edit, measure_errors, steer, render, second, reopen):
        yield from part()
        seen.setdefault("parts", []).append(part.__name__)


ScriptRunner(story(), write_results(FOLDER, seen))
