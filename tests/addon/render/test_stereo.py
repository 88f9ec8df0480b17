"""Stereo pictures. Oracles: Cycles' own of a mesh at the same position, and single pictures."""

from pathlib import Path

import bpy
import numpy as np
import pytest

from addon import compat
from addon.render import compositor, pass_renderer
from tests.addon import splat_scenes as lab
from tests.addon.render import test_blur as blur
from tests.addon.render.test_panorama import panoramic

SIZE = (120, 80)


@pytest.fixture
def pair(scene: bpy.types.Scene) -> bpy.types.Scene:
    """A scene with a stereo camera with a large eye distance."""
    camera = lab.prepare(scene, SIZE)
    camera.rotation_euler.z = 0.4
    scene.render.film_transparent = True
    scene.render.use_multiview, scene.render.views_format = True, "STEREO_3D"
    camera.data.stereo.interocular_distance = 0.5
    camera.data.stereo.convergence_distance = 3.0
    bpy.context.view_layer.update()
    return scene


def eyes(scene: bpy.types.Scene, folder: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
    """F12 as scene-linear pictures of the left and the right eye, saved side by side."""
    scene.render.image_settings.views_format = "STEREO_3D"
    scene.render.image_settings.stereo_3d_format.display_mode = "SIDEBYSIDE"
    both = lab.render_exr(folder, name)
    assert both.shape == (SIZE[1], 2 * SIZE[0], 4)
    return both[:, : SIZE[0]], both[:, SIZE[0] :]


@pytest.mark.parametrize("mode", ["OFFAXIS", "PARALLEL", "TOE"])
@pytest.mark.parametrize("pivot", ["LEFT", "CENTER", "RIGHT"])
def test_both_eyes_see_as_those_of_cycles(pair, tmp_path, mode, pivot):
    """A small square in Cycles is at the position of a splat, in the pictures of both eyes."""
    stereo = pair.camera.data.stereo
    stereo.convergence_mode, stereo.pivot = mode, pivot
    pair.camera.data.shift_x = 0.07
    place = (0.2, -0.1, 1.5)
    splat = lab.add(pair, blur.point(place))
    mesh = bpy.data.meshes.new("square")
    x, y, z = place
    ends = (-0.02, 0.02)
    mesh.from_pydata([(x + a, y + b, z) for a in ends for b in ends], [], [(0, 1, 3, 2)])
    square = bpy.data.objects.new("square", mesh)
    pair.collection.objects.link(square)
    square.hide_render = True
    ours = [blur.spot(one)[0] for one in eyes(pair, tmp_path, "ours")]
    square.hide_render, splat.hide_render = False, True
    pair.render.engine = "CYCLES"
    pair.cycles.samples, pair.cycles.use_denoising = 64, False
    theirs = [blur.spot(one)[0] for one in eyes(pair, tmp_path, "theirs")]
    np.testing.assert_allclose(ours, theirs, atol=0.15)
    assert abs(ours[0][0] - ours[1][0]) > 3


def test_everything_is_of_its_eye(pair, tmp_path):
    """Oracle: pictures by a camera at the eye's position, for parallel eyes: picture, depth, and
    mattes, with depth of field."""
    stereo = pair.camera.data.stereo
    stereo.convergence_mode, stereo.pivot = "PARALLEL", "CENTER"
    lab.add(pair, lab.blob(200), "one").pass_index = 3
    lab.add(pair, lab.wall(-0.5, (0.2, 0.6, 0.9), half=0.5), "two").pass_index = 5
    layer = pair.view_layers[0]
    layer.use_pass_z = layer.use_pass_object_index = layer.use_pass_cryptomatte_object = True
    blur.open_lens(pair, 0.2, 4.0, 4)
    tree = compat.make_compositor_tree(pair)
    layers = next(n for n in tree.nodes if n.type == "R_LAYERS")
    node = tree.nodes.new("CompositorNodeCryptomatteV2")
    node.scene, node.layer_name, node.matte_id = pair, "ViewLayer.CryptoObject", "one"
    sockets = [layers.outputs[n] for n in ("Image", "Depth", compat.index_pass_name())]
    pair.render.use_compositing = True
    right = np.array(pair.camera.matrix_world.to_3x3().col[0])
    middle = np.array(pair.camera.location)
    for socket in [*sockets, node.outputs["Matte"]]:
        tree.links.new(socket, compat.compositor_result(tree))
        pair.render.use_multiview = True
        pair.camera.location = middle
        got = eyes(pair, tmp_path, "pair")
        pair.render.use_multiview = False
        for picture, side in zip(got, (-0.25, 0.25), strict=True):
            pair.camera.location = middle + side * right
            wanted = lab.render_exr(tmp_path, "alone")
            np.testing.assert_allclose(picture, wanted, rtol=1e-4, atol=2e-4)
        assert np.abs(got[0] - got[1]).max() > 0.1


def test_an_eye_alone(pair, tmp_path, monkeypatch):
    """Oracle: half of the drawings."""
    lab.add(pair, lab.blob(200))
    drawings, drawn = [], pass_renderer.picture.draw

    def draw(*args, **options):
        drawings.append(args)
        return drawn(*args, **options)

    monkeypatch.setattr(pass_renderer.picture, "draw", draw)
    counts = []
    for use in (True, False):
        pair.render.stereo_views["right"].use = use
        drawings.clear()
        bpy.ops.render.render()
        counts.append(len(drawings))
    assert counts == [2, 1]


def test_without_eyes_there_is_a_picture(pair, tmp_path, capfd):
    """Views may be removed or renamed. Oracle: the picture without stereo, of the engine and of a
    composite."""
    lab.add(pair, lab.blob(200))
    pair.render.use_multiview = False
    wanted = lab.render_exr(tmp_path, "plain")
    views = pair.render.views
    views.remove(views["left"])
    views[0].name = "else"
    pair.render.use_multiview = True
    np.testing.assert_array_equal(lab.render_exr(tmp_path, "none"), wanted)
    pair.render.engine = "CYCLES"
    pair.cycles.samples = 1
    compositor.set_up(pair)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(lab.render_exr(tmp_path, "composite"), wanted, atol=1e-3)
    assert "Traceback" not in capfd.readouterr().err


def test_composites_have_two_eyes(pair, tmp_path):
    """Oracle: the pictures of the engine itself."""
    lab.add(pair, lab.blob(200))
    wanted = eyes(pair, tmp_path, "engine")
    pair.render.engine = "CYCLES"
    pair.cycles.samples = 1
    compositor.set_up(pair)
    for got, want in zip(eyes(pair, tmp_path, "composite"), wanted, strict=True):
        np.testing.assert_allclose(got, want, atol=1e-3)


def test_panoramas_have_one_eye(pair):
    """Oracle: the message."""
    lab.add(pair, lab.blob(20))
    panoramic(pair, "equidistant")
    assert "Panoramas are not supported in stereo" in lab.error_of(bpy.ops.render.render)
