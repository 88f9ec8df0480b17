"""Operators on data that Blender does not save: linked objects and meshes, library overrides.

Oracle of all: the file after saving and loading. Changes that an operator reports are in it;
refused ones are not, and the refusal is one sentence of the add-on.
"""

import shutil
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from addon import attributes
from tests.addon import splat_scenes as lab
from tests.addon.captures import ODD_CAMERAS, write_capture

CASES = ("linked", "mesh", "override", "both", "system", "scene")
"""A linked object; a local object with a linked mesh; an override that may be edited, the same with
its mesh; one that only follows its library; all of it in a linked scene."""
CALLS: dict[str, dict[str, Any]] = {
    "select_by_color": {"picked": True},
    "select_by_opacity": {},
    "select_by_size": {},
    "select_in_crop": {},
    "select_flood": {},
    "select_floaters": {},
    "select_splats": {},
    "grade_splats": {"saturation": 0.3},
    "separate_splats": {},
    "erase_splats": {},
    "replay_edits": {},
    "restore_splats": {},
    "heal_splats": {},
    "clone_splats": {},
    "remove_healing": {},
    "join_splats": {},
    "decimate_splats": {"count": 20},
    "apply_filters": {},
    "reset_filters": {},
    "add_crop_box": {},
    "apply_splat_transform": {},
    "make_scale_even": {},
    "mend_splats": {},
    "reset_display": {},
    "take_native_splats": {},
    "import_splats": {"filepath": "a.ply"},
    "import_result": {},
    "import_sequence": {"directory": "frames"},
    "play_again": {},
    "keep_frame": {},
    "look_at_frames_again": {},
    "import_camera_path": {"filepath": "path.json", "world": "BLENDER"},
    "import_cameras": {"directory": "capture"},
    "use_camera": {"index": 2},
    "step_camera": {},
    "choose_camera": {},
    "choose_capture": {"path": "capture"},
    "relink_capture": {"directory": "capture"},
    "align_capture": {"up": "X"},
    "flip_up": {},
    "set_extent": {"extent": 70.0},
    "reset_alignment": {},
    "color_cameras": {},
    "use_engine": {},
    "use_photo_colors": {},
    "see_through_splats": {},
    "make_size_even": {},
    "set_up_compositing": {},
    "remove_compositing": {},
    "world_from_splats": {"width": 64},
    "match_sun": {},
    "use_as_proxy": {},
    "remove_proxy": {},
    "update_proxy": {},
    "relight_splats": {},
    "show_splats": {},
    "select_result": {},
    "compare_photo": {},
    "compare_worst_photo": {},
    "color_by_error": {"show": False},
    "add_guides": {},
    "show_error_map": {},
    "remove_errors": {},
    "choose_video": {"filepath": "a.ply"},
    "fit_training": {},
    "follow_training": {},
    "paint_mask": {},
    "paint_splats": {},
    "paint_stroke": {
        "stroke": [{"name": "", "place": (0.0, 0.0, 0.0)}],
        "way": "PLACES",
        "radius": 1e3,
    },
}
"""Arguments of operators; file names are relative to the test's folder."""
_OF_OVERRIDES = (
    "reset_filters",
    "add_crop_box",
    "make_scale_even",
    "reset_display",
    "align_capture",
)
_OF_SCENES = ("use_engine", "use_photo_colors", "show_splats", "use_camera", "import_cameras")
IMPORTS = ("splats", "sequence", "camera_path")
DONE = {
    *((name, case) for name in _OF_OVERRIDES for case in ("override", "both")),
    *((name, case) for name in _OF_SCENES for case in CASES if case != "scene"),
    *((name, "mesh") for name in ("reset_filters", "add_crop_box")),
    ("set_up_compositing", "override"),
    *((f"import_{what}", case) for what in IMPORTS for case in CASES if case != "scene"),
}
"""Operators that must work: an override keeps settings, and the scene is the user's own."""
NOT_IN_THE_SCENE = {
    *("export_splats", "export_cameras", "export_camera_path"),
    *("train", "resume_training", "find_cameras", "predict_depth", "check_depth"),
    *("pause_training", "continue_training", "stop_training", "discard_training"),
    *("update_splats", "cancel_search", "cancel_depth", "show_depth_sheet"),
    *("show_report", "show_test_view", "check_trainer", "make_environment", "cancel_setup"),
    *("train_sequence", "stop_sequence", "train_region", "stop_region", "train_healed"),
    *("measure_errors", "stop_errors", "find_devices", "make_mesh", "stop_mesh"),
    *("refit_splats", "stop_refit"),
    *("save_mask", "discard_mask", "mask_brush"),
    *("straighten_photos", "stop_straightening", "remove_straight_photos", "open_manual"),
}
"""Operators that write files, or start, control and show background processes."""


def test_all_operators_are_looked_at() -> None:
    """Oracle: Blender's own list."""
    assert set(dir(bpy.ops.gscore)) == CALLS.keys() | NOT_IN_THE_SCENE


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file with a collection that holds a capture and splats below it, and a splat PLY."""
    folder = tmp_path_factory.mktemp("library")
    some = {1: ODD_CAMERAS[1]}
    write_capture(folder / "capture", np.random.default_rng(0), cameras=some, images=4, photos=True)
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.gscore.import_cameras(directory=str(folder / "capture"))
    root = bpy.context.object
    ob = lab.add(bpy.context.scene, lab.blob(60), "tree")
    collection = bpy.data.collections.new("kit")
    for one in (*root.children_recursive, root, ob):
        for holder in one.users_collection:
            holder.objects.unlink(one)
        collection.objects.link(one)
    bpy.context.scene.collection.children.link(collection)
    bpy.context.scene.name = "kept"
    ob.parent, ob.scale = root, (1, 1, 3)
    ob.data.vertices.foreach_set("select", np.arange(60) < 20)
    ob.gscore.opacity_min = 0.5
    plain = lab.add(bpy.context.scene, lab.blob(30), "plain")
    bpy.context.view_layer.update()
    bpy.ops.object.select_all(action="DESELECT")
    plain.select_set(True)
    bpy.ops.gscore.export_splats(filepath=str(folder / "a.ply"))
    bpy.data.objects.remove(plain)
    (folder / "frames").mkdir()
    for number in (1, 2):
        shutil.copy(folder / "a.ply", folder / "frames" / f"{number}.ply")
    bpy.context.scene.camera = next(o for o in bpy.data.objects if o.type == "CAMERA")
    bpy.ops.gscore.export_camera_path(filepath=str(folder / "path.json"), world="BLENDER")
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "library.blend"))
    return folder


def bring(library: Path, case: str, *, beside: bool = False) -> bpy.types.Object:
    """The splats of the library in a new file, active, optionally with other selected ones."""
    bpy.ops.wm.read_homefile(use_empty=True)
    file = str(library / "library.blend")
    with bpy.data.libraries.load(file, link=True) as (_, wanted):
        wanted.collections, wanted.scenes = ["kit"], ["kept"] if case == "scene" else []
    (kit,) = wanted.collections
    if case == "scene":
        bpy.context.window.scene = wanted.scenes[0]
    scene, layer = bpy.context.scene, bpy.context.view_layer
    if case != "scene":
        scene.collection.children.link(kit)
    if case in ("override", "both", "system"):
        linked = kit
        kit = kit.override_hierarchy_create(scene, layer, do_fully_editable=case != "system")
        if scene.collection.children.get(linked.name, linked.library.filepath) == linked:
            scene.collection.children.unlink(
                linked
            )  # versions of Blender differ in whether it stays
    ob = next(o for o in kit.objects if o.name.startswith("tree"))
    if case == "both":
        ob.data.override_create(remap_local_usages=True)
    if case == "scene":
        layer.objects.active = ob
        return ob
    if case == "mesh":
        mesh = ob.data
        ob = ob.copy()
        ob.data, ob.name = mesh, "local tree"
        scene.collection.objects.link(ob)
    other = lab.add(scene, lab.blob(30), "own") if beside else None
    layer.update()
    for one in scene.objects:
        one.select_set(one in (ob, other))
    layer.objects.active = ob
    scene.camera = next(o for o in scene.objects if o.type == "CAMERA")
    scene.gscore.result = ob
    return ob


def state() -> dict[str, Any]:
    """Content of the file that operators may change."""
    found: dict[str, Any] = {}
    for ob in bpy.data.objects:
        if ob.library is None or ob.users_scene:
            found[f"object {ob.name} {ob.library and ob.library.name}"] = _object(ob)
    for scene in bpy.data.scenes:
        found[f"scene {scene.name}"] = (
            *(scene.render.engine, scene.camera and scene.camera.name),
            *(scene.render.resolution_x, scene.view_settings.view_transform),
            sorted(o.name for o in scene.objects),
        )
    return found


def _object(ob: bpy.types.Object) -> list[Any]:
    own = ob.gscore
    made: list[Any] = [[round(v, 4) for row in ob.matrix_basis for v in row]]
    made += [own.display, own.opacity_min, own.crop_object and own.crop_object.name]
    made += [ob.hide_viewport, ob.hide_render, ob.get("gs_colored"), ob.parent and ob.parent.name]
    for modifier in ob.modifiers:
        made.append((modifier.name, modifier.show_render, _inputs(modifier)))
    if ob.type == "CAMERA":
        made += [ob.data.show_background_images, round(ob.data.clip_end, 3)]
    if ob.type == "MESH" and attributes.BASE in ob.data.attributes:
        made += [len(ob.data.vertices), attributes.column(ob.data, attributes.BASE).tobytes()]
        flags = np.empty(len(ob.data.vertices), bool)
        ob.data.vertices.foreach_get("select", flags)
        made.append(flags.tobytes())
    return made


def _inputs(modifier: bpy.types.NodesModifier) -> list[Any]:
    found = []
    for item in modifier.node_group.interface.items_tree if modifier.node_group else ():
        if item.item_type == "SOCKET" and item.in_out == "INPUT" and item.name != "Geometry":
            if hasattr(modifier, "properties"):
                value = getattr(modifier.properties.inputs, item.identifier).value
            else:
                value = modifier.get(item.identifier)
            found.append((item.name, getattr(value, "name", value)))
    return found


def call(name: str, library: Path) -> str:
    """Run an operator; return its error, if any."""
    given = dict(CALLS[name])
    for key in given.keys() & {"filepath", "directory"}:
        given[key] = str(library / given[key])
    if name == "choose_camera":
        given["image"] = "sub/v001.png"
    try:
        getattr(bpy.ops.gscore, name)(**given)
    except RuntimeError as error:
        return str(error).strip()
    return ""


def reopened(folder: Path) -> dict[str, Any]:
    """The state after saving and loading."""
    if bpy.context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.update()
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "saved.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(folder / "saved.blend"))
    return state()


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", CALLS)
def test_kept_or_refused(name: str, case: str, library: Path, tmp_path: Path) -> None:
    """Oracle: the saved file; a message says what to do if nothing was done."""
    bring(library, case, beside=name == "join_splats")
    before = state()
    problem = call(name, library)
    assert not problem or (name, case) not in DONE, problem
    if bpy.context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    after = state()
    if problem:
        assert "Traceback" not in problem and problem.count("\n") == 0, problem
        assert after == before, problem
    else:
        assert reopened(tmp_path) == after


SETTINGS: dict[str, Any] = {
    "display": "ELLIPSOIDS",
    "colour_by": "OPACITY",
    "point_size": 0.5,
    "ellipsoid_size": 2.5,
    "opacity_min": 0.25,
    "size_min": 0.125,
    "size_max": 0.75,
    "crop_shape": "SPHERE",
    "crop_invert": True,
    "light": 0.5,
    "apply_filters_to_render": False,
}


def test_an_override_keeps_its_display(library: Path, tmp_path: Path) -> None:
    """Oracle: all settings of a splat object, and its modifier, in the saved file."""
    ob = bring(library, "override")
    own = set(ob.gscore.bl_rna.properties.keys())
    assert own - {"rna_type", "name", "crop_object"} == SETTINGS.keys()
    for name, value in SETTINGS.items():
        setattr(ob.gscore, name, value)
    ob.gscore.crop_object = next(o for o in bpy.data.objects if o.type == "CAMERA")
    before = state()
    assert reopened(tmp_path) == before
    (ob,) = (o for o in bpy.data.objects if o.name == "tree" and o.library is None)
    assert {name: getattr(ob.gscore, name) for name in SETTINGS} == SETTINGS
    assert ob.gscore.crop_object.type == "CAMERA"


@pytest.mark.parametrize("case", ["linked", "system", "scene"])
def test_settings_of_others_raise_nothing(case: str, library: Path) -> None:
    """Oracle: no exception; Blender's own fields are disabled there, but scripts may write."""
    ob = bring(library, case)
    for name, value in SETTINGS.items():
        setattr(ob.gscore, name, value)
    photos = bpy.context.scene.gscore_photos
    photos.shown, photos.opacity = False, 0.5


@pytest.mark.parametrize("case", ["linked", "mesh", "override", "both", "system"])
def test_suggested_remedy_works(case: str, library: Path) -> None:
    """Oracle: the refused operator, after Blender's own Make Local."""
    bring(library, case)
    problem = call("grade_splats", library)
    assert "Object > Relations > Make Local > Selected Objects and Data" in problem
    bpy.ops.object.make_local(type="ALL" if case == "linked" else "SELECT_OBDATA")
    assert call("grade_splats", library) == ""
    assert call("separate_splats", library) == ""


def test_a_follower_is_made_editable(library: Path) -> None:
    """Oracle: the refused operator, after the remedy of the message."""
    ob = bring(library, "system")
    assert "Library Override > Make > Selected" in call("reset_filters", library)
    ob.override_library.is_system_override = False  # which is what the Outliner does
    assert call("reset_filters", library) == ""
    assert ob.gscore.opacity_min == 0.0


@pytest.mark.parametrize("case", CASES[:-1])
def test_join_takes_only_what_goes(case: str, library: Path, tmp_path: Path) -> None:
    """Oracle: the saved file: both objects, or one with the splats of both."""
    ob = bring(library, case, beside=True)
    if case in ("override", "system"):
        ob.scale = (1, 1, 1)
    bpy.context.view_layer.objects.active = bpy.data.objects["own"]
    before = state()
    problem = call("join_splats", library)
    after = state()
    assert not problem or after == before
    assert "Traceback" not in problem and reopened(tmp_path) == after


def test_a_collection_that_takes_nothing(library: Path) -> None:
    """Oracle: new objects go to the scene's collection if the object's cannot take them."""
    bring(library, "override")
    assert call("add_crop_box", library) == ""
    (box,) = (o for o in bpy.data.objects if o.name == "Crop")
    assert list(box.users_collection) == [bpy.context.scene.collection]
