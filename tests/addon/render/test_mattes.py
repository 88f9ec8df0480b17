"""Mattes of objects. Oracle: the alpha of renders in which all other objects are held out."""

import json
import re
import struct
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from addon import compat
from addon.core import Splats
from addon.render import panels, pass_renderer, passes
from tests.addon import splat_scenes as lab
from tests.addon.drawn import Layout
from tests.addon.render import test_blur as blur
from tests.addon.render import test_mesh_holdout as meshes
from tests.addon.render.test_panorama import panoramic

LEVEL = 1 / 255
SIZE = (90, 70)


def several(scene: bpy.types.Scene, count: int = 4) -> list[bpy.types.Object]:
    """Overlapping objects with names and indices."""
    made = []
    for i in range(count):
        place = (0.35 * np.cos(2 * i), 0.35 * np.sin(2 * i), 0.2 * i)
        ob = lab.add(scene, lab.blob(120, center=place, seed=i), f"Blob {i}ä")
        ob.pass_index = 7 + i
        made.append(ob)
    scene.view_layers[0].use_pass_cryptomatte_object = True
    return made


def matte(scene: bpy.types.Scene, folder, name: str, kind: str = "CryptoObject") -> np.ndarray:
    """Matte of the compositor's own Cryptomatte node, [H, W]."""
    tree = compat.make_compositor_tree(scene)
    node = tree.nodes.new("CompositorNodeCryptomatteV2")
    node.scene, node.layer_name, node.matte_id = scene, f"ViewLayer.{kind}", name
    tree.links.new(node.outputs["Matte"], compat.compositor_result(tree))
    scene.render.use_compositing = True
    picked = lab.render_exr(folder, "matte")[..., 0]
    tree.nodes.remove(node)
    scene.render.use_compositing = False
    return picked


def alone(scene: bpy.types.Scene, folder, ob: bpy.types.Object) -> np.ndarray:
    """Alpha of an object with the others as holdouts, [H, W]."""
    others = [o for o in scene.objects if o.type == "MESH" and o != ob and not o.is_holdout]
    film_before, scene.render.film_transparent = scene.render.film_transparent, True
    for other in others:
        other.is_holdout = True
    alpha = lab.render_exr(folder, "alone")[..., 3]
    for other in others:
        other.is_holdout = False
    scene.render.film_transparent = film_before
    return alpha


def fisheye(scene: bpy.types.Scene) -> None:
    """A fisheye camera."""
    panoramic(scene, "equidistant")


def open_lens(scene: bpy.types.Scene) -> None:
    """Depth of field."""
    blur.open_lens(scene, 0.4, 2.5, 4)


def motion(scene: bpy.types.Scene) -> None:
    """One of the objects moves."""
    lab.moving(bpy.data.objects["Blob 1ä"], 0.5)
    scene.frame_set(5)
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
    scene.gscore_render.blur_samples = 4


def held(scene: bpy.types.Scene) -> None:
    """One of the objects cuts a hole."""
    bpy.data.objects["Blob 3ä"].is_holdout = True


def held_mesh(scene: bpy.types.Scene) -> None:
    """A plane hides half of everything."""
    meshes.plane(scene, z=0.4, right=0.1).is_holdout = True


def orthographic(scene: bpy.types.Scene) -> None:
    """Parallel rays."""
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 3.0


def border(scene: bpy.types.Scene) -> None:
    """A part of the picture, which keeps its size."""
    scene.render.use_border = True
    scene.render.border_min_x, scene.render.border_max_x = 0.31, 0.83
    scene.render.border_min_y, scene.render.border_max_y = 0.22, 0.77


def cropped(scene: bpy.types.Scene) -> None:
    """A part of the picture alone."""
    border(scene)
    scene.render.use_crop_to_border = True


WAYS = (fisheye, open_lens, motion, held, held_mesh, orthographic, border, cropped)


@pytest.mark.parametrize("transparent", [True, False])
def test_mattes_of_several_objects(scene, tmp_path, transparent):
    """Within 1/255 of the oracle; their sum is the alpha of the picture."""
    lab.prepare(scene, SIZE, light=0.4)
    scene.render.film_transparent = transparent
    made, total = several(scene), np.zeros(SIZE[::-1], np.float32)
    for ob in made:
        got, wanted = matte(scene, tmp_path, ob.name), alone(scene, tmp_path, ob)
        assert wanted.max() > 0.8 and np.abs(got - wanted).max() < LEVEL
        total += got
    scene.render.film_transparent = True
    assert np.abs(total - lab.render_exr(tmp_path, "all")[..., 3]).max() < LEVEL


@pytest.mark.parametrize("way", WAYS)
def test_mattes_in_every_kind_of_picture(scene, tmp_path, way):
    """The same with each of them; the second object is the one that moves."""
    lab.prepare(scene, SIZE)
    several(scene)
    way(scene)
    ob = bpy.data.objects["Blob 1ä"]
    got, wanted = matte(scene, tmp_path, ob.name), alone(scene, tmp_path, ob)
    assert wanted.max() > 0.3 and np.abs(got - wanted).max() < LEVEL


def test_holdouts_have_no_matte(scene, tmp_path):
    """Oracle: nothing."""
    lab.prepare(scene, SIZE)
    several(scene)
    held(scene)
    assert matte(scene, tmp_path, "Blob 3ä").max() == 0


def test_more_levels_than_objects_and_fewer(scene, tmp_path):
    """Oracle: with two levels, the two largest coverages; with eight, all."""
    lab.prepare(scene, SIZE)
    made = several(scene)
    layer = scene.view_layers[0]
    parts = {}
    for levels in (8, 2):
        layer.pass_cryptomatte_depth = levels
        parts[levels] = np.stack([matte(scene, tmp_path, ob.name) for ob in made])
    order = np.argsort(-parts[8], axis=0, kind="stable")
    wanted = parts[8].copy()
    np.put_along_axis(wanted, order[2:], 0, axis=0)
    np.testing.assert_array_equal(parts[2], wanted)
    assert (parts[8] > 0.01).all(0).any()


def test_assets_are_the_uppermost_parents(scene, tmp_path):
    """Oracle: the mattes of the objects below one empty, added."""
    lab.prepare(scene, SIZE)
    made = several(scene)
    upper, lower = (bpy.data.objects.new(name, None) for name in ("Upper", "Lower"))
    for empty in (upper, lower):
        scene.collection.objects.link(empty)
    lower.parent, made[0].parent, made[2].parent = upper, lower, upper
    scene.view_layers[0].use_pass_cryptomatte_asset = True
    got = matte(scene, tmp_path, "Upper", "CryptoAsset")
    wanted = sum(matte(scene, tmp_path, made[i].name) for i in (0, 2))
    np.testing.assert_allclose(got, wanted, atol=1e-6)
    own = matte(scene, tmp_path, made[1].name, "CryptoAsset")
    np.testing.assert_array_equal(own, matte(scene, tmp_path, made[1].name))


def test_instances_of_collections_share_a_matte(scene, tmp_path):
    """Oracle: the alpha of both, the only objects of the picture."""
    lab.prepare(scene, SIZE)
    scene.render.film_transparent = True
    lab.add(scene, lab.blob(100, size=0.3), "one")
    group = bpy.data.collections.new("group")
    group.objects.link(bpy.data.objects["one"])
    empty = bpy.data.objects.new("again", None)
    scene.collection.objects.link(empty)
    empty.instance_type, empty.instance_collection = "COLLECTION", group
    empty.location = (0.8, 0.2, 0)
    scene.view_layers[0].use_pass_cryptomatte_object = True
    wanted = lab.render_exr(tmp_path, "alpha")[..., 3]
    np.testing.assert_allclose(matte(scene, tmp_path, "one"), wanted, atol=1e-6)
    assert wanted[:, :45].max() > 0.5 and wanted[:, 60:].max() > 0.5


def test_index_is_that_of_what_adds_most(scene, tmp_path):
    """Oracle: the mattes; nothing where their sum is below the threshold."""
    lab.prepare(scene, SIZE)
    made = several(scene)
    layer = scene.view_layers[0]
    layer.use_pass_object_index = True
    parts = np.stack([matte(scene, tmp_path, ob.name) for ob in made])
    for threshold in (0.5, 0.1):
        layer.pass_alpha_threshold = threshold
        got = lab.render_pass(scene, tmp_path, compat.index_pass_name())
        sure = np.abs(parts.sum(0) - threshold) > 1e-5
        wanted = np.where(parts.sum(0) >= threshold, 7 + parts.argmax(0), 0)
        np.testing.assert_array_equal(got[sure], wanted[sure])
        assert set(np.unique(got)) == {0, 7, 8, 9, 10}


def test_the_index_pass_is_called_as_by_cycles(scene):
    """Oracle: the name that Cycles registers."""
    names = []
    layer = scene.view_layers[0]
    layer.use_pass_object_index = True
    from cycles.engine import list_render_passes  # only available with Blender's add-ons

    names = [one[0] for one in list_render_passes(scene, layer)]
    assert compat.index_pass_name() in names


def test_ids_are_those_of_the_specification():
    """Oracle: the test vectors of MurmurHash3_x86_32, and normal floats."""
    assert passes.name_hash("") == 0
    assert passes.name_hash("test") == 0xBA6BD213
    assert passes.name_hash("Hello, world!") == 0xC0363E43
    assert passes.name_hash("The quick brown fox jumps over the lazy dog") == 0x2E4FF723
    names = [str(i) for i in range(20000)]
    ids = np.array([passes.id_of(name) for name in names])
    assert np.isfinite(ids).all() and (np.abs(ids) >= np.finfo(np.float32).tiny).all()
    (bits,) = struct.unpack("<I", passes.id_of("test").tobytes())
    assert bits == 0xBA6BD213  # its exponent is normal, so that nothing changes


def test_a_file_tells_its_names(scene, tmp_path):
    """Oracle: the manifest by its key in a saved multilayer file, of two view layers."""
    lab.prepare(scene, SIZE)
    made = several(scene)
    scene.view_layers[0].name = "Front"
    back = scene.view_layers.new("Back")
    back.use_pass_cryptomatte_object = True
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.filepath = str(tmp_path / "all.exr")
    bpy.ops.render.render(write_still=True)
    content = (tmp_path / "all.exr").read_bytes()
    for layer in ("Front", "Back"):
        key = f"cryptomatte/{passes.name_hash(f'{layer}.CryptoObject'):08x}"[:19]
        manifest = re.search(key.encode() + rb"/manifest\0string\0....(\{[^}]*\})", content, re.S)
        assert manifest is not None
        listed = json.loads(manifest.group(1).decode())
        assert listed == {ob.name: f"{passes.name_hash(ob.name):08x}" for ob in made}
        assert f"{layer}.CryptoObject00".encode() in content


def test_unrequested_mattes_are_not_drawn(scene, tmp_path, monkeypatch):
    """Oracle: the number of drawings; one more per three objects if mattes are requested."""
    drawings, drawn_before = [], pass_renderer.picture.draw

    def draw(*args, **options):
        drawings.append(args)
        return drawn_before(*args, **options)

    lab.prepare(scene, SIZE)
    several(scene, 4)
    monkeypatch.setattr(pass_renderer.picture, "draw", draw)
    counts = []
    for wanted in (False, True):
        scene.view_layers[0].use_pass_cryptomatte_object = wanted
        lab.render_exr(tmp_path)
        counts.append(len(drawings))
    assert counts == [1, 1 + 1 + 2]


def offered() -> str:
    """Text of the panel of passes."""
    layout = Layout()
    panels.VIEWLAYER_PT_gscore_passes.draw(SimpleNamespace(layout=layout), bpy.context)
    return layout.text


def test_the_panel_offers_them(scene):
    """Oracle: the names of Blender's switches, and a message about missing passes."""
    lab.prepare(scene)
    before = offered()
    assert "<use_pass_cryptomatte_object>" in before and "no materials" in before
    assert "<pass_cryptomatte_depth>" not in before and "<pass_alpha_threshold>" not in before
    scene.view_layers[0].use_pass_cryptomatte_asset = True
    scene.view_layers[0].use_pass_object_index = True
    after = offered()
    assert "<pass_cryptomatte_depth>" in after and "<pass_alpha_threshold>" in after


def test_a_composite_has_the_mattes_of_its_splats(scene, tmp_path):
    """Oracle: the matte of the splats alone, by the engine itself."""
    lab.prepare(scene, SIZE)
    made = several(scene)
    wanted = matte(scene, tmp_path, made[0].name)
    scene.render.engine = "CYCLES"
    bpy.ops.gscore.set_up_compositing()
    other = bpy.data.scenes[f"{scene.name} Splats"]
    assert other.view_layers[0].use_pass_cryptomatte_object
    scene.view_layers[0].use_pass_object_index = True
    bpy.context.view_layer.update()
    assert other.view_layers[0].use_pass_object_index
    tree = compat.compositor_tree(scene)
    names = [o.name for o in tree.nodes["GS Splats"].outputs if o.enabled]
    assert compat.index_pass_name() in names
    tree = compat.make_compositor_tree(scene)
    node = tree.nodes.new("CompositorNodeCryptomatteV2")
    node.scene = other
    node.layer_name, node.matte_id = "ViewLayer.CryptoObject", made[0].name
    tree.links.new(node.outputs["Matte"], compat.compositor_result(tree))
    scene.cycles.samples = 1
    np.testing.assert_allclose(lab.render_exr(tmp_path)[..., 0], wanted, atol=1e-6)


def faint() -> Splats:
    """A nearly transparent object."""
    splats = lab.blob(40)
    splats.opacities[:] = -3
    return splats


def test_faint_objects_have_a_matte_and_no_index(scene, tmp_path):
    """Oracle: their alpha, and zero below the threshold."""
    lab.prepare(scene, SIZE)
    scene.render.film_transparent = True
    lab.add(scene, faint(), "faint").pass_index = 3
    layer = scene.view_layers[0]
    layer.use_pass_cryptomatte_object = layer.use_pass_object_index = True
    wanted = lab.render_exr(tmp_path, "alpha")[..., 3]
    np.testing.assert_allclose(matte(scene, tmp_path, "faint"), wanted, atol=1e-6)
    assert 0.02 < wanted.max() < 0.5
    assert lab.render_pass(scene, tmp_path, compat.index_pass_name()).max() == 0
