"""Picture scene, inside a Blender with a window: draws the sidebar's panels for docs/.

`blender --factory-startup --enable-event-simulate -P tools/window/pictures_scene.py -- FOLDER
PACKAGES...`; PACKAGES are folders with packages that Blender's Python lacks. FOLDER/python contains
the path of the Python that trains. With a video FOLDER/walk.mp4, the script takes the pictures of
the tour from it to a render, else the other pictures, of the capture FOLDER/studio. Writes
FOLDER/seen.json and screenshots, from which
`tools/build/blender_pictures.py` makes the pictures of pages.
"""

import shutil
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDER, *PACKAGES = map(Path, sys.argv[sys.argv.index("--") + 1 :])
sys.path[:0] = [str(ROOT), *map(str, PACKAGES)]

import addon_utils  # noqa: E402 - the path comes first
import bmesh  # noqa: E402
import bpy  # noqa: E402
from mathutils import Matrix, Quaternion, Vector  # noqa: E402

from addon import panels  # noqa: E402
from addon.registration import classes_of  # noqa: E402

IS_TOUR = (FOLDER / "walk.mp4").exists()
OPEN = {"progress"} if IS_TOUR else {"result", "filters", "region", "sequence", "guides"}
"""Open panels."""
NAMES = ("cameras", "edit", "progress", "render", "result", "train")
PANELS = (import_module(f"{panels.__name__}.{name}") for name in NAMES)
for panel in (panel for module in PANELS for panel in classes_of(module)):
    name = getattr(panel, "bl_idname", "").removeprefix("GSCORE_PT_")
    if name in OPEN:
        panel.bl_options = set()
    elif name in {"capture", "cameras", "train", "progress", "result", "render"}:
        panel.bl_options = {"DEFAULT_CLOSED"}

addon_utils.enable("addon", default_set=True, persistent=True)

from addon.process import poll_timer  # noqa: E402
from addon.sfm import find_cameras  # noqa: E402
from addon.trainer_python import setup  # noqa: E402
from addon.training.run_state import RunState  # noqa: E402
from addon.training.start_training import job_of  # noqa: E402
from tools.window.window_script import (  # noqa: E402
    ScriptRunner,
    area,
    at_rest,
    region,
    save_screenshot,
    send,
    space,
    write_results,
)

ScriptRunner.LONGEST = 200.0
WIDER = 60
"""Pixels by which the sidebar is widened, so that labels are not cut."""
CREAM = 0.85, 0.8, 0.7
"""Color of the blouse."""
GUIDES = {"surface": (0.1, 0.25, 0.6, 1.0), "free": (0.9, 0.4, 0.05, 0.5)}
"""Viewport colors of guide meshes by their role."""
CAPTURE, CAMERAS, TRAIN = 0, 1, 3
"""Rows of panels in the sidebar when all are closed."""
seen: dict = {"log": []}
python = (FOLDER / "python").read_text().strip()
bpy.context.preferences.addons["addon"].preferences.python_path = python


def press(name: str, **given: object) -> None:
    """Call an operator, `room.name`, in the context of the 3D view."""
    room, operator = name.split(".")
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area(), region=region()):
        getattr(getattr(bpy.ops, room), operator)("EXEC_DEFAULT", True, **given)


def choose(ob: bpy.types.Object) -> None:
    """Select an object and make it active."""
    for other in bpy.context.view_layer.objects:
        other.select_set(other == ob)
    bpy.context.view_layer.objects.active = ob


def sidebar() -> bpy.types.Region:
    """The region of the sidebar."""
    return next(r for r in area().regions if r.type == "UI")


def open_sidebar() -> Iterator[object]:
    """Open the add-on's tab and widen it."""
    press("screen.screen_full_area")
    yield 1.0
    space().show_region_ui = True
    yield 1.0
    sidebar().active_panel_category = "Train Splats"
    yield 0.5
    window, edge = bpy.context.window_manager.windows[0], sidebar().x
    y = sidebar().y + sidebar().height // 3
    for kind, value, x in (
        ("MOUSEMOVE", "NOTHING", edge + 1),
        ("LEFTMOUSE", "PRESS", edge + 1),
        ("MOUSEMOVE", "NOTHING", edge - WIDER // 2),
        ("MOUSEMOVE", "NOTHING", edge - WIDER),
        ("LEFTMOUSE", "RELEASE", edge - WIDER),
        ("MOUSEMOVE", "NOTHING", area().x + area().width // 3),
    ):
        window.event_simulate(kind, value, x=x, y=y)
        yield 0.2


def empty_file() -> Iterator[object]:
    """A saved file without objects, with the add-on's tab open."""
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "figure.blend"))
    for ob in list(bpy.data.objects):
        bpy.data.objects.remove(ob)
    yield from open_sidebar()


def look_at_figure() -> None:
    """Set the view to the front and slightly above, with the figure filling its height."""
    view = space().region_3d
    view.view_perspective = "PERSP"
    view.view_distance = 3.5
    view.view_location = (0, 0, 0.8)
    view.view_rotation = Quaternion((0.79, 0.59, 0.06, 0.12)).normalized()


def state() -> RunState:
    """State of the training."""
    job = job_of(bpy.context.scene)
    assert job is not None
    return job.state


def trained() -> bool:
    """Whether the training has ended and its splats are loaded."""
    return state().ended and not any(f.waits() for f in poll_timer.POLLERS)


def toggled(row: int) -> Iterator[object]:
    """Click on a panel header in the sidebar, which opens or closes the panel.

    Args:
        row: Number of closed panels above it.
    """
    window, shown = bpy.context.window_manager.windows[0], sidebar()
    place = {"x": shown.x + 60, "y": shown.y + shown.height - 14 - 28 * row}  # header height 28
    window.event_simulate("MOUSEMOVE", "NOTHING", **place)
    yield 0.2
    for value in ("PRESS", "RELEASE"):
        window.event_simulate("LEFTMOUSE", value, **place)
        yield 0.3
    place["x"] = area().x + area().width // 3
    window.event_simulate("MOUSEMOVE", "NOTHING", **place)
    yield 0.5


def searched() -> bool:
    """Whether the camera poses are estimated and their capture is imported."""
    ends = not any(f.waits() for f in poll_timer.POLLERS)
    return ends and any("gs_viewmat" in ob for ob in bpy.data.objects)


def tour() -> Iterator[object]:
    """Take the ten pictures from a video to a render, and frames of the training."""
    scene, settings = bpy.context.scene, bpy.context.scene.gscore
    bpy.context.preferences.addons["addon"].preferences.live_seconds = 1.0
    yield from empty_file()
    yield from toggled(CAPTURE)
    press("gscore.choose_video", filepath=str(FOLDER / "walk.mp4"))
    yield 4.0
    save_screenshot(FOLDER / "tour-01.png")
    press("gscore.find_cameras")
    yield lambda: find_cameras.job_of(scene).share > 0.5
    yield 1.0
    save_screenshot(FOLDER / "tour-02.png")
    yield searched
    yield 3.0
    yield from toggled(CAPTURE)
    yield from toggled(CAMERAS)
    save_screenshot(FOLDER / "tour-03.png")
    yield from toggled(CAMERAS)
    yield from toggled(TRAIN)
    settings.preset = "preview"
    yield 4.0
    save_screenshot(FOLDER / "tour-04.png")
    yield from toggled(TRAIN)
    photo_camera = next(ob for ob in bpy.data.objects if "gs_viewmat" in ob)
    space().region_3d.view_matrix = photo_camera.matrix_world.inverted()  # inside the room
    press("gscore.train")
    shown, number = 0, 0
    while not trained():
        yield 0.2
        if settings.result is not None and state().step > shown:
            shown, number = state().step, number + 1
            save_screenshot(FOLDER / f"growing-{number:03}.png")
            if state().share > 0.5 and not (FOLDER / "tour-05.png").exists():
                save_screenshot(FOLDER / "tour-05.png")
    press("gscore.show_splats")
    yield at_rest
    yield 1.0
    save_screenshot(FOLDER / "tour-06.png")
    yield from finished(settings.result)


def finished(ob: bpy.types.Object) -> Iterator[object]:
    """The last four of the ten: filters, an edit, a comparison and a render."""
    choose(ob)
    window = bpy.context.window_manager
    space().shading.type = "SOLID"
    ob.gscore.opacity_min, ob.gscore.size_max = 0.1, 0.1
    window.gscore_histograms = True
    yield at_rest
    yield 1.0
    save_screenshot(FOLDER / "tour-07.png")
    window.gscore_histograms = False
    press("gscore.reset_filters")
    press("gscore.select_by_color", picked=True, color=CREAM, tolerance=0.2)
    yield lambda: bpy.context.mode == "EDIT_MESH"
    bpy.ops.object.mode_set(mode="OBJECT")
    press("gscore.grade_splats", gain=(1.3, 0.4, 0.4), only_selected=True)
    yield 3.0
    yield at_rest
    save_screenshot(FOLDER / "tour-08.png")
    press("gscore.use_camera", index=0, look_through=False)
    press("gscore.compare_photo")
    yield lambda: "GS Comparison" in bpy.data.images
    yield 4.0
    save_screenshot(FOLDER / "tour-09.png")
    with bpy.context.temp_override(window=window.windows[0]):
        bpy.ops.render.render("INVOKE_DEFAULT", use_viewport=True)
    yield 2.0
    yield lambda: not bpy.app.is_job_running("RENDER")
    yield 4.0
    save_screenshot(FOLDER / "tour-10.png")


def guides() -> Iterator[object]:
    """Picture of a floor and a hull around the figure as guide meshes, which are removed again."""
    points = next(ob for ob in bpy.data.objects if ob.get("gs_kind") == "points")
    figure = [p for v in points.data.vertices if (p := points.matrix_world @ v.co).z > 0.1]
    figure = [p for p in figure if p.xy.length < 0.5]
    floor = [Vector((x, y, 0)) for x in (-2, 2) for y in (-2, 2)]
    made = [_hull(role, spots) for role, spots in (("surface", floor), ("free", figure))]
    space().shading.color_type = "OBJECT"
    space().region_3d.view_distance = 7.0
    yield from toggled(TRAIN)
    yield 4.0  # for the forecast
    save_screenshot(FOLDER / "part_guides.png")
    yield from toggled(TRAIN)
    for ob in made:
        bpy.data.objects.remove(ob)
    scene = bpy.context.scene.gscore
    scene.guide_surface = scene.guide_free = None
    space().shading.color_type = "VERTEX"
    look_at_figure()


def _hull(role: str, spots: list[Vector]) -> bpy.types.Object:
    """Make the convex hull of some points a guide mesh."""
    shape, mesh = bmesh.new(), bpy.data.meshes.new(role)
    verts = [shape.verts.new(spot) for spot in spots]
    bmesh.ops.convex_hull(shape, input=verts)
    bmesh.ops.delete(shape, geom=[v for v in shape.verts if not v.link_faces], context="VERTS")
    shape.to_mesh(mesh)
    ob = bpy.data.objects.new(role, mesh)
    bpy.context.scene.collection.objects.link(ob)
    ob.color = GUIDES[role]
    choose(ob)
    press("gscore.add_guides", role=role)
    ob.select_set(False)
    return ob


def region_and_filters(ob: bpy.types.Object) -> Iterator[object]:
    """Pictures of a crop box, histograms with limits, region training, and view histograms."""
    press("gscore.add_crop_box")
    box = bpy.context.object
    box.location.z, box.scale = 1.2, [0.6 * v for v in box.scale]
    ob.gscore.opacity_min, ob.gscore.size_max = 0.25, 0.02
    yield at_rest
    yield 1.0
    save_screenshot(FOLDER / "region.png")
    bpy.data.objects.remove(box)
    choose(ob)
    ob.gscore.opacity_min, ob.gscore.size_max = 0.6, 0.025
    bpy.context.window_manager.gscore_histograms = True
    yield at_rest
    yield 1.0
    save_screenshot(FOLDER / "handles.png")
    bpy.context.window_manager.gscore_histograms = False
    press("gscore.reset_filters")


def displays(ob: bpy.types.Object) -> Iterator[object]:
    """Soft Splats and Ellipsoids."""
    space().shading.type = "MATERIAL"
    space().overlay.show_overlays = space().show_gizmo = False
    for display in ("SOFT", "ELLIPSOIDS"):
        ob.gscore.display = display
        ob.gscore.opacity_min = 0.3 if display == "ELLIPSOIDS" else 0.0
        area().tag_redraw()
        yield 60.0  # for its shaders; until then everything is white
        space().shading.type = "SOLID"  # else white would remain in the accumulated mean
        yield 1.0
        space().shading.type = "MATERIAL"
        yield 60.0
        save_screenshot(FOLDER / f"part_{display.lower()}.png")
    ob.gscore.display, ob.gscore.opacity_min = "SPLATS", 0.0
    space().shading.type = "SOLID"
    space().overlay.show_overlays = space().show_gizmo = True


def photo(ob: bpy.types.Object) -> Iterator[object]:
    """Picture of a photo with splats next to the figure in it."""
    scene = bpy.context.scene
    press("gscore.use_camera", index=0, look_through=True)
    for other in scene.objects:
        other.hide_set(other not in (ob, scene.camera))
    slot = scene.camera.data.background_images[0]
    scene.camera.data.show_background_images = True
    slot.show_background_image, slot.display_depth, slot.alpha = True, "BACK", 1.0
    place = ob.matrix_world.copy()
    ob.matrix_world = (
        Matrix.Translation(scene.camera.matrix_world.to_3x3() @ Vector((0.35, 0, 0))) @ place
    )
    scene.render.engine, scene.view_settings.view_transform = "GSCORE_SPLATS", "Standard"
    space().shading.type = "RENDERED"
    space().show_region_ui = space().show_gizmo = False
    ob.select_set(False)
    yield 1.0
    yield at_rest
    yield 1.0
    save_screenshot(FOLDER / "part_photo.png")
    space().show_region_ui = space().show_gizmo = True
    ob.matrix_world = place
    space().shading.type = "SOLID"
    space().region_3d.view_perspective = "PERSP"
    look_at_figure()


def sequence() -> Iterator[object]:
    """The settings of a sequence."""
    frames = FOLDER / "frames"
    frames.mkdir()
    for number in range(1, 25):
        shutil.copy(FOLDER / "studio_splats" / "point_cloud.ply", frames / f"{number:04}.ply")
    press("gscore.import_sequence", directory=str(frames))
    ob = bpy.context.object
    ob.name = "dance"
    bpy.context.scene.frame_set(7)
    yield 1.0
    yield at_rest
    save_screenshot(FOLDER / "part_sequence.png")
    bpy.data.objects.remove(ob)


def torn(ob: bpy.types.Object) -> Iterator[object]:
    """Picture of the warning on splats after Apply."""
    choose(ob)
    ob.rotation_euler = (0.0, 0.0, 1.2)
    press("object.transform_apply", location=False, rotation=True, scale=False)
    yield 1.0
    yield at_rest
    save_screenshot(FOLDER / "part_torn.png")


def question() -> Iterator[object]:
    """Picture of the dialog of Make Environment."""
    bpy.context.preferences.system.use_online_access = True
    setup.private_folder = lambda: Path("/home/me/gscore/trainer")
    window = bpy.context.window_manager.windows[0]
    send("MOUSEMOVE", "NOTHING", 0, 200)  # where it opens
    yield 0.5
    with bpy.context.temp_override(window=window, area=area(), region=region()):
        bpy.ops.gscore.make_environment(
            "INVOKE_DEFAULT", wheel="gscore-0.1.0-py3-none-manylinux_2_28_x86_64.whl"
        )
    yield 1.0
    save_screenshot(FOLDER / "part_question.png")


def result() -> Iterator[object]:
    """Pictures of work with the splats of a training."""
    settings = bpy.context.scene.gscore
    yield from empty_file()
    settings.capture_path, settings.output_path = "//studio", "//studio_splats"
    settings.preset = "preview"
    press("gscore.import_cameras", directory=str(FOLDER / "studio"))
    yield 3.0
    look_at_figure()
    yield from guides()
    press("gscore.train")
    yield trained
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / "figure.blend"), load_ui=False)
    yield 2.0
    ob = bpy.context.scene.gscore.result
    choose(ob)
    for other in bpy.context.scene.objects:
        other.hide_set(other != ob)
    look_at_figure()
    yield at_rest
    for part in (region_and_filters, displays, photo):
        yield from part(ob)
    for other in bpy.context.scene.objects:
        other.hide_set(other != ob)
    ob.hide_set(True)
    yield from sequence()
    ob.hide_set(False)
    yield from torn(ob)
    yield from question()


ScriptRunner(tour() if IS_TOUR else result(), write_results(FOLDER, seen))
