"""The render engine. Oracle, unless stated otherwise: gscore.render of the same splats and
camera."""

import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest

from addon import compat
from addon.cameras import captures
from addon.cameras.render_camera import render_camera
from addon.compat import matrix_to_numpy
from addon.core import Cancelled, transform_splats, write_splats
from addon.registration import classes_of
from addon.render import engine, panels, picture
from addon.render.scene import sources
from addon.render.viewport_copies import Copies
from addon.splats import objects
from tests.addon import splat_scenes as lab
from tests.addon.calls import import_capture
from tests.light_changes import encode

ROOT = Path(__file__).parents[3]
SIZE = (90, 70)
LEVEL = 1 / 255


@pytest.mark.parametrize("light", [0.0, 0.2])
def test_png_shows_the_values_of_gscore(scene, tmp_path, light):
    """Colours are those of blending over the world's colour, to one level of 8 bit."""
    camera = lab.prepare(scene, light=light)
    splats = lab.blob()
    lab.add(scene, splats)
    got = lab.render_file(tmp_path / "a.png")
    want = lab.truth(camera, splats, SIZE, background=(float(encode(light)),) * 3).rgb
    assert np.abs(got[..., :3] - np.clip(want, 0, 1)).max() <= 1.01 * LEVEL
    assert np.std(want) > 0.05


def test_same_picture_as_the_command_line(scene, tmp_path):
    """Oracle: `gscore render` from the capture's own camera, pixel by pixel."""
    capture = import_capture(bpy.context.scene, ROOT / "examples" / "studio", photos=False)
    splats = _around(_means(capture.points))
    write_splats(tmp_path / "a.ply", splats)
    objects.create(splats, "s", collection=capture.collection, parent=capture.root)
    camera = capture.cameras[5]
    lab.prepare(scene)
    captures.use_camera(scene, camera)
    got = lab.render_file(tmp_path / "blender.png")
    command = [sys.executable, "-m", "gscore", "render", str(tmp_path / "a.ply"), "--quiet"]
    command += ["-s", str(ROOT / "examples" / "studio"), "-r", "1", "--view", camera["gs_image"]]
    command += ["--near", str(camera.data.clip_start / capture.root.scale[0])]
    subprocess.run([*command, "-o", str(tmp_path / "cli.png")], check=True, cwd=ROOT)
    want = lab.read_image(tmp_path / "cli.png")
    assert got.shape == want.shape
    assert np.abs(got - want).max() <= 1.01 * LEVEL
    assert want[..., :3].std() > 0.1


def _means(points: bpy.types.Object) -> np.ndarray:
    values = np.empty(3 * len(points.data.vertices), np.float32)
    points.data.attributes["position"].data.foreach_get("vector", values)
    return values.reshape(-1, 3)


def _around(cloud: np.ndarray):
    """A splat at every point of a cloud."""
    rng = np.random.default_rng(0)
    splats = lab.blob(len(cloud))
    spread = float(np.median(np.abs(cloud - np.median(cloud, axis=0))))
    scales = (np.log(spread / 15) + rng.uniform(-1, 1, (len(cloud), 3))).astype(np.float32)
    fields = {n: getattr(splats, n) for n in ("quats", "opacities", "sh0", "shN")}
    return type(splats)(means=cloud, scales=scales, **fields)


def test_film_transparent(scene, tmp_path):
    """Premultiplied linear light in the EXR, straight alpha of the splats' colours in the PNG."""
    camera = lab.prepare(scene, light=0.5)
    scene.render.film_transparent = True
    splats = lab.blob()
    lab.add(scene, splats)
    want = lab.truth(camera, splats, SIZE)
    exr = lab.render_exr(tmp_path)
    # Blender's matrices and the positions of splats in the two pictures are float32.
    np.testing.assert_allclose(exr[..., 3], want.alpha, atol=5e-6)
    assert 0.02 < (want.alpha > 0.5).mean() < 0.9
    seen = want.alpha > 0.05
    straight = want.rgb[seen] / want.alpha[seen][:, None]
    np.testing.assert_allclose(
        encode(exr[seen][:, :3] / exr[seen][:, 3:]), straight, atol=2e-5, rtol=1e-4
    )
    png = lab.render_file(tmp_path / "b.png", mode="RGBA")
    assert np.abs(png[..., 3] - want.alpha).max() <= 0.51 * LEVEL + 1e-6
    solid = want.alpha > 0.9
    wanted = np.clip(want.rgb / np.maximum(want.alpha, 1e-9)[..., None], 0, 1)
    assert np.abs(png[..., :3] - wanted)[solid].max() <= 1.1 * LEVEL


def test_depth_pass(scene, tmp_path):
    """Oracle: a wall of splats at a known distance; 1e10 outside of it."""
    lab.prepare(scene)
    lab.add(scene, lab.wall(1.0, (0.9, 0.2, 0.1), half=0.5))
    scene.view_layers[0].use_pass_z = True
    depth = lab.render_pass(scene, tmp_path, "Depth")
    assert depth[35, 45] == pytest.approx(3.0, abs=1e-5)
    assert depth[2, 2] == pytest.approx(1e10)
    near = depth[depth < 1e9]
    assert near.size > 100 and np.abs(near - 3).max() < 0.01


@pytest.mark.parametrize("crop", [False, True])
def test_border(scene, tmp_path, crop):
    """Oracle: the same window of the whole picture, bit by bit; nothing outside."""
    lab.prepare(scene, light=0.1)
    lab.add(scene, lab.blob())
    whole = lab.render_exr(tmp_path, "whole")
    render = scene.render
    render.use_border, render.use_crop_to_border = True, crop
    render.border_min_x, render.border_max_x = 0.33, 0.81
    render.border_min_y, render.border_max_y = 0.2, 0.75
    part = lab.render_exr(tmp_path, "part")
    left, right = int(0.33 * 90), int(0.81 * 90)
    top, bottom = 70 - int(0.75 * 70), 70 - int(0.2 * 70)
    window = whole[top:bottom, left:right]
    if crop:
        np.testing.assert_array_equal(part, window)
    else:
        np.testing.assert_array_equal(part[top:bottom, left:right], window)
        assert not part[:top].any() and not part[:, right:].any()
    assert window.std() > 0.05


@pytest.mark.parametrize(
    "border",
    [(0.0, 1.0, 0.0, 1.0), (0.97, 1.0, 0.98, 1.0), (0.0, 0.03, 0.0, 0.03), (0.1, 0.6, 0.5, 1)],
)
def test_any_border_fits_blenders_own(scene, tmp_path, border):
    """Oracle: the same pixels of the whole picture, wherever the border is."""
    lab.prepare(scene, light=0.1)
    lab.add(scene, lab.blob(size=0.6))
    whole = lab.render_exr(tmp_path, "whole")
    render = scene.render
    render.use_border = render.use_crop_to_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = border
    part = lab.render_exr(tmp_path, "part")
    left, bottom = int(np.float32(border[0]) * 90), int(np.float32(border[2]) * 70)
    height, width = part.shape[:2]
    window = whole[70 - bottom - height : 70 - bottom, left : left + width]
    np.testing.assert_array_equal(part, window)


@pytest.mark.parametrize(("percentage", "aspect"), [(50, 1.0), (37, 1.0), (100, 1.5)])
def test_percentage_and_pixel_aspect(scene, tmp_path, percentage, aspect):
    """Sizes are Blender's; wider pixels show the same view with fewer columns each."""
    camera = lab.prepare(scene, size=(120, 80))
    scene.render.resolution_percentage = percentage
    scene.render.pixel_aspect_x = aspect
    splats = lab.blob()
    lab.add(scene, splats)
    got = lab.render_exr(tmp_path)
    width, height = 120 * percentage // 100, 80 * percentage // 100
    assert got.shape[:2] == (height, width)
    focal = camera.data.lens / camera.data.sensor_width * width
    K = np.array([[focal, 0, width / 2], [0, focal * aspect, height / 2], [0, 0, 1.0]])
    viewmat = np.diag([1.0, -1.0, -1.0, 1.0])
    viewmat[2, 3] = 4.0
    want = lab.render(splats, K, viewmat, width, height, near=camera.data.clip_start)
    np.testing.assert_allclose(encode(got[..., :3]), want.rgb, atol=1e-4)


def test_shift_moves_the_picture(scene, tmp_path):
    """Oracle: a shift of whole pixels moves what a wider frame already shows."""
    camera = lab.prepare(scene, size=(100, 80))
    lab.add(scene, lab.blob(size=0.3))
    plain = lab.render_exr(tmp_path, "plain")
    camera.data.shift_x, camera.data.shift_y = 0.1, -0.05
    moved = lab.render_exr(tmp_path, "moved")
    np.testing.assert_allclose(moved[:75, :90], plain[5:, 10:], atol=2e-3)
    assert moved[:75, :90, :3].std() > 0.05


def test_orthographic(scene, tmp_path):
    """Oracle: gscore.render with parallel rays, 70 pixels to 2 units at that size."""
    camera = lab.prepare(scene, size=(70, 70))
    camera.data.type, camera.data.ortho_scale = "ORTHO", 2.0
    splats = lab.blob()
    lab.add(scene, splats)
    got = lab.render_exr(tmp_path)
    K = np.array([[35.0, 0, 35], [0, 35.0, 35], [0, 0, 1]])
    viewmat = np.diag([1.0, -1.0, -1.0, 1.0])
    viewmat[2, 3] = 4.0
    want = lab.render(splats, K, viewmat, 70, 70, near=0.1, orthographic=True)
    np.testing.assert_allclose(encode(got[..., :3]), want.rgb, atol=1e-4)
    assert want.alpha.mean() > 0.1


def test_several_objects_with_their_transforms(scene, tmp_path):
    """Oracle: all splats transformed to the world by gscore and drawn as one model."""
    camera = lab.prepare(scene)
    parts = [lab.blob(300, seed=1), lab.blob(200, seed=2), lab.wall(0, (0.1, 0.8, 0.3), half=0.2)]
    placements = [
        ((0.3, 0.1, 0.2), (0.4, -0.2, 1.0), 1.3),
        ((-0.4, 0.0, 0.5), (0.0, 0.7, 0.0), 0.6),
        ((0.1, -0.3, 1.0), (0.2, 0.1, 0.3), -1.0),
    ]
    world = []
    for i, (splats, (place, turn, scale)) in enumerate(zip(parts, placements, strict=True)):
        ob = lab.add(scene, splats, f"part {i}")
        ob.location, ob.rotation_euler, ob.scale = place, turn, (scale,) * 3
        bpy.context.view_layer.update()
        world.append(transform_splats(splats, matrix_to_numpy(ob.matrix_world)))
    got = lab.render_exr(tmp_path)
    from addon.render.model import _concatenated

    want = lab.truth(camera, _concatenated(world), SIZE)
    np.testing.assert_allclose(encode(got[..., :3]), want.rgb, atol=3e-4)
    assert want.alpha.mean() > 0.1


def _hide(ob: bpy.types.Object, how: str, scene: bpy.types.Scene) -> None:
    group = bpy.data.collections.new("group")
    scene.collection.children.link(group)
    scene.collection.objects.unlink(ob)
    group.objects.link(ob)
    if how == "object":
        ob.hide_render = True
    elif how == "collection":
        group.hide_render = True
    elif how == "excluded":
        scene.view_layers[0].layer_collection.children["group"].exclude = True
    elif how == "viewport":
        ob.hide_viewport = True


@pytest.mark.parametrize("how", ["object", "collection", "excluded", "viewport"])
def test_hidden_objects(scene, tmp_path, how):
    """Oracle: objects hidden in renders are not drawn, those hidden in the viewport are."""
    camera = lab.prepare(scene)
    shown, hidden = lab.blob(seed=1), lab.wall(2.0, (1, 0, 0))
    lab.add(scene, shown)
    _hide(lab.add(scene, hidden, "hidden"), how, scene)
    got = encode(lab.render_exr(tmp_path)[..., :3])
    alone = lab.truth(camera, shown, SIZE).rgb
    assert (np.abs(got - alone).max() < 1e-4) == (how != "viewport")


def test_collection_instances(scene, tmp_path):
    """Oracle: the object itself, moved by the instance's matrix and the collection's offset."""
    camera = lab.prepare(scene)
    splats = lab.blob()
    library = bpy.data.collections.new("library")
    library.instance_offset = (0.0, 0.5, 0.0)
    objects.create(splats, "inside", collection=library)
    empty = bpy.data.objects.new("instance", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", library
    empty.location, empty.scale = (0.3, 0.2, 0.1), (0.7,) * 3
    scene.collection.objects.link(empty)
    got = lab.render_exr(tmp_path)
    matrix = np.diag([0.7, 0.7, 0.7, 1.0])
    matrix[:3, 3] = np.array([0.3, 0.2, 0.1]) - 0.7 * np.array([0, 0.5, 0])
    want = lab.truth(camera, transform_splats(splats, matrix), SIZE)
    np.testing.assert_allclose(encode(got[..., :3]), want.rgb, atol=3e-4)


def test_filters_reach_the_render_if_wanted(scene, tmp_path):
    """Oracle: only the splats above the limit."""
    camera = lab.prepare(scene)
    splats = lab.blob()
    ob = lab.add(scene, splats)
    ob.gscore.opacity_min, ob.gscore.apply_filters_to_render = 0.8, True
    kept = splats.subset(1 / (1 + np.exp(-splats.opacities.astype(np.float64))) >= 0.8)
    for wanted, apply in ((kept, True), (splats, False)):
        ob.gscore.apply_filters_to_render = apply
        got = encode(lab.render_exr(tmp_path)[..., :3])
        np.testing.assert_allclose(got, lab.truth(camera, wanted, SIZE).rgb, atol=1e-4)
    assert 50 < len(kept) < 350


def test_animation_decodes_once(scene, tmp_path):
    """Oracle: the cache's own count, and the last frame rendered alone in an empty cache."""
    camera = lab.prepare(scene)
    lab.add(scene, lab.blob(seed=1))
    other = lab.add(scene, lab.blob(100, seed=2), "other")
    camera.keyframe_insert("location", frame=1)
    camera.location.x = 1.0
    camera.keyframe_insert("location", frame=4)
    scene.frame_start, scene.frame_end = 1, 4
    engine.final_cache.clear()
    decoded, merged = engine.final_cache.decoded, engine.final_cache.merged
    scene.render.filepath = str(tmp_path / "f")
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGBA", "32"
    bpy.ops.render.render(animation=True)
    assert engine.final_cache.decoded - decoded == 2
    assert engine.final_cache.merged - merged == 1
    last = lab.read_image(tmp_path / "f0004.exr")
    assert np.abs(last - lab.read_image(tmp_path / "f0001.exr")).max() > 0.1
    engine.final_cache.clear()
    scene.frame_set(4)
    np.testing.assert_array_equal(lab.render_exr(tmp_path), last)
    # An object that moves relative to the other is merged again, but not decoded.
    decoded, merged = engine.final_cache.decoded, engine.final_cache.merged
    other.location.y = 0.3
    lab.render_exr(tmp_path)
    assert (engine.final_cache.decoded - decoded, engine.final_cache.merged - merged) == (0, 1)


def test_edits_show_without_any_update_call(scene, tmp_path):
    """Oracle: the colour: a script paints a wall red and renders again."""
    lab.prepare(scene)
    ob = lab.add(scene, lab.wall(1.0, (0.1, 0.1, 0.9)))
    before = lab.render_exr(tmp_path)[35, 45]
    red = lab.wall(1.0, (0.9, 0.1, 0.1))
    base = np.concatenate([red.sh0[:, 0], np.ones((len(red), 1), np.float32)], axis=1)
    ob.data.attributes["radiance:base"].data.foreach_set("color", base.astype(np.float32).ravel())
    after = lab.render_exr(tmp_path)[35, 45]
    assert before[2] > before[0] and after[0] > after[2]


def test_splats_in_edit_mode(scene, tmp_path):
    """Oracle: the picture after Edit Mode was left; also of an object that shares the mesh."""
    lab.prepare(scene)
    ob = lab.add(scene, lab.blob())
    other = bpy.data.objects.new("other", ob.data)
    other["gs_kind"], other.location = "splats", (0.5, 0.2, 0)
    scene.collection.objects.link(other)
    before = lab.render_exr(tmp_path)
    ob.data.vertices.foreach_set("select", np.arange(len(ob.data.vertices)) % 2 == 0)
    bpy.context.view_layer.objects.active = ob
    bpy.ops.object.mode_set(mode="EDIT")
    np.testing.assert_array_equal(lab.render_exr(tmp_path), before)
    bpy.ops.mesh.delete(type="VERT")
    edited = lab.render_exr(tmp_path)
    assert ob.mode == "EDIT"
    depsgraph = bpy.context.evaluated_depsgraph_get()
    shown, complete = Copies().copied(sources(depsgraph))
    assert complete
    bpy.ops.object.mode_set(mode="OBJECT")
    assert [len(p.frozen.vertices) for p in shown] == [len(ob.data.vertices)] * 2 == [200, 200]
    np.testing.assert_array_equal(lab.render_exr(tmp_path), edited)
    assert np.abs(edited - before).max() > 0.1


def test_view_layers(scene, tmp_path):
    """Oracle: each layer's own objects, identified by colour in a multilayer result."""
    lab.prepare(scene)
    left = bpy.data.collections.new("left")
    right = bpy.data.collections.new("right")
    for group, color in ((left, (1, 0, 0)), (right, (0, 1, 0))):
        scene.collection.children.link(group)
        objects.create(lab.wall(1.0, color), group.name, collection=group)
    second = scene.view_layers.new("second")
    scene.view_layers[0].layer_collection.children["right"].exclude = True
    second.layer_collection.children["left"].exclude = True
    from addon import compat

    tree = compat.make_compositor_tree(scene)
    layers = next(n for n in tree.nodes if n.type == "R_LAYERS")
    tree.links.new(layers.outputs["Image"], compat.compositor_result(tree))
    for name, channel in ((scene.view_layers[0].name, 0), ("second", 1)):
        layers.layer = name
        pixel = lab.render_exr(tmp_path, name)[35, 45, :3]
        assert pixel.argmax() == channel and pixel[channel] > 0.9


def no_camera(scene):
    scene.camera = None


def no_splats(scene):
    bpy.data.objects["splats"].hide_render = True


def panorama(scene):
    scene.camera.data.type = "PANO"
    compat.panorama_settings(scene.camera.data).panorama_type = "MIRRORBALL"


def stretched(scene):
    bpy.data.objects["splats"].scale = (1, 2, 1)


def no_attribute(scene):
    attributes = bpy.data.objects["splats"].data.attributes
    attributes.remove(attributes["scale"])


def many_cameras(scene):
    scene.render.use_multiview, scene.render.views_format = True, "MULTIVIEW"


def two_minds(scene):
    lab.add(scene, lab.blob(seed=3), "mip")["gs_antialias"] = True


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (no_camera, "no camera"),
        (no_splats, "no splats to render"),
        (panorama, "Camera is mirrorball; panoramas"),
        (stretched, "splats cannot be rendered.*unevenly"),
        (no_attribute, "scale"),
        (many_cameras, "Multi-View is not supported"),
        (two_minds, "Anti-Aliasing"),
    ],
)
def test_refusals_are_sentences(scene, tmp_path, spoil, words):
    """Oracle: the message names the problem; nothing is written; the next render works."""
    import re

    lab.prepare(scene)
    lab.add(scene, lab.blob())
    spoil(scene)
    scene.render.filepath = str(tmp_path / "no.png")
    message = lab.error_of(lambda: bpy.ops.render.render(write_still=True))
    assert re.search(words, message), message
    assert not list(tmp_path.iterdir())


def test_missing_library_is_named(run_blender):
    """Oracle: a fresh Blender whose gscore searches for its library in an empty folder."""
    script = f"""
import atexit, os, sys
os.environ["GSCORE_LIBRARY"] = "/nowhere/libgscore.so"
sys.path[:0] = [{str(ROOT)!r}, {str(ROOT / "tests" / "addon")!r}]
import bpy, addon
addon.register(); atexit.register(addon.unregister)
import splat_scenes as lab
bpy.ops.wm.read_homefile(use_empty=True)
lab.prepare(bpy.context.scene); lab.add(bpy.context.scene, lab.blob())
print("SAID", lab.error_of(lambda: bpy.ops.render.render()))
sys.stdout.flush()
os._exit(0)  # bpy 4.2 crashes at exit once a property had a callback
"""
    assert "native library is missing" in run_blender(script)


def test_antialias_follows_the_objects(scene, tmp_path):
    """Oracle: gscore.render with and without compensation."""
    camera = lab.prepare(scene)
    splats = lab.blob()
    ob = lab.add(scene, splats)
    pictures = [lab.truth(camera, splats, SIZE, antialias=on).rgb for on in (False, True)]
    assert np.abs(pictures[0] - pictures[1]).max() > 0.01
    for mark, request, want in ((False, "AUTO", 0), (True, "AUTO", 1), (True, "OFF", 0)):
        ob["gs_antialias"], scene.gscore_render.antialias = mark, request
        got = encode(lab.render_exr(tmp_path)[..., :3])
        np.testing.assert_allclose(got, pictures[want], atol=1e-4)


def test_stopping(scene):
    """Oracle: the error, for a picture that takes many seconds; the next one is whole."""
    camera = lab.prepare(scene)
    lab.add(scene, lab.veil())
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    model = lab.model_of(depsgraph)
    part, whole = (
        render_camera(camera, scene, depsgraph=depsgraph, width=side, height=side)
        for side in (300, 3000)
    )
    looks = iter((False, True))
    with pytest.raises(Cancelled):
        picture.draw(model, whole, picture.Options(), stop=lambda: next(looks, True))
    assert picture.draw(model, part, picture.Options()).alpha.mean() > 0.5


@pytest.mark.parametrize(
    "panel", ["RENDER_PT_format", "RENDER_PT_output", "RENDER_PT_stereoscopy", "DATA_PT_lens"]
)
def test_blenders_panels_are_shown(panel, switch):
    """Oracle: the panels' own lists of engines, with the add-on and without it."""
    engines = getattr(bpy.types, panel).COMPAT_ENGINES
    assert engine.NAME in engines
    switch(False)
    assert engine.NAME not in engines
    switch(True)
    assert engine.NAME in engines


def test_panels_of_its_own_are_shown_again(switch):
    """Oracle: the lists of engines of the add-on's panels, after it was enabled again."""
    own = classes_of(panels)
    assert len(own) == 4
    switch(False)
    switch(True)
    assert [kind.COMPAT_ENGINES for kind in own] == [{engine.NAME}] * 4
