"""Passes of the splats' values, as Blender writes them to a multilayer EXR. Oracle: numpy in
float64 on the pictures' own weights, by brute force."""

import struct
import zlib
from pathlib import Path

import bpy
import numpy as np
import pytest

from addon import attributes, compat
from addon.core import quat_to_rotmat
from addon.render import passes
from addon.render.proxy import attach
from tests.addon import splat_scenes as lab
from tests.addon.render import test_blur as blur
from tests.addon.render.test_panorama import panoramic
from tests.addon.render.test_relight import grid, know_light, lamp
from tests.light_changes import decode

SIZE = (60, 44)


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """Channels [H, W] of an EXR of scan lines by name, without compression or with ZIPS or ZIP (the
    file layout of OpenEXR; Blender drops channels of images that it cannot show)."""
    data, at = path.read_bytes(), 8
    assert data[:4] == b"\x76\x2f\x31\x01"

    def text() -> str:
        nonlocal at
        end = data.index(b"\0", at)
        found, at = data[at:end].decode(), end + 1
        return found

    head = {}
    while name := text():
        text()
        (size,) = struct.unpack_from("<i", data, at)
        head[name], at = data[at + 4 : at + 4 + size], at + 4 + size
    channels, inside = [], head["channels"]
    while inside[0]:
        name, inside = inside.split(b"\0", 1)
        channels.append((name.decode(), {1: "<f2", 2: "<f4"}[struct.unpack_from("<i", inside)[0]]))
        inside = inside[16:]
    left, top, right, bottom = struct.unpack("<4i", head["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    lines = {0: 1, 2: 1, 3: 16}[head["compression"][0]]
    row = sum(width * np.dtype(kind).itemsize for _, kind in channels)
    found = {name: np.empty((height, width), kind) for name, kind in channels}
    for place in struct.unpack_from(f"<{-(-height // lines)}q", data, at):
        y, size = struct.unpack_from("<ii", data, place)
        block, count = data[place + 8 : place + 8 + size], min(lines, top + height - y)
        if size < count * row:
            sums = np.frombuffer(zlib.decompress(block), np.uint8).astype(np.int64)
            sums[1:] -= 128
            halves = np.cumsum(sums).astype(np.uint8)
            raw = np.empty_like(halves)
            raw[::2], raw[1::2] = np.split(halves, [-(-len(halves) // 2)])
            block = raw.tobytes()
        begin = 0
        for line in range(y - top, y - top + count):
            for name, kind in channels:
                found[name][line] = np.frombuffer(block, kind, width, begin)
                begin += found[name][line].nbytes
    return found


def render_passes(scene: bpy.types.Scene, folder: Path, depth: str = "32") -> dict[str, np.ndarray]:
    """Passes [H, W] or [H, W, C] of a multilayer EXR by name."""
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", depth
    settings.exr_codec = "ZIP"
    if hasattr(settings, "use_exr_interleave"):
        settings.use_exr_interleave = True  # one part with all channels, as before 5.0
    scene.render.filepath = str(folder / "passes.exr")
    bpy.ops.render.render(write_still=True)
    found: dict[str, dict[str, np.ndarray]] = {}
    for name, values in read_exr(folder / "passes.exr").items():
        layer, made, channel = name.rsplit(".", 2)
        assert layer == scene.view_layers[0].name
        found.setdefault(made, {})[channel] = values
    order = "RGBXYZWA"
    return {
        made: np.stack([parts[c] for c in sorted(parts, key=order.index)], -1).squeeze()
        for made, parts in found.items()
    }


def weights(scene: bpy.types.Scene) -> tuple[np.ndarray, np.ndarray]:
    """By brute force in float64: the weight of each splat of the scene at each pixel [N, H, W],
    the objects' one after the other, and the row of the splat at which transmittance falls to 0.5
    [H, W], or -1."""
    model = lab.model_of(scene.view_layers[0].depsgraph)
    splats, camera = model.splats, scene.camera
    focal = camera.data.lens / camera.data.sensor_width * max(SIZE)
    pose = np.array([tuple(row) for row in camera.matrix_world], np.float64)
    to_camera = np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(pose) @ model.matrix
    means = splats.means @ to_camera[:3, :3].T + to_camera[:3, 3]
    axes = quat_to_rotmat(splats.quats.astype(np.float64)) * np.exp(splats.scales[:, None])
    px, py, z = *(focal * means[:, :2] / means[:, 2:]).T, means[:, 2]
    zero = np.zeros_like(z)
    jacobian = np.array([[focal / z, zero, -px / z], [zero, focal / z, -py / z]]).transpose(2, 0, 1)
    spread = jacobian @ to_camera[:3, :3] @ axes
    conics = np.linalg.inv(spread @ spread.transpose(0, 2, 1) + 0.3 * np.eye(2))
    y, x = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    light, half = np.ones(SIZE[::-1]), np.full(SIZE[::-1], -1)
    out = np.zeros((len(splats), *SIZE[::-1]))
    for row in np.argsort(z, kind="stable"):
        d = np.stack([x - px[row] - SIZE[0] / 2, y - py[row] - SIZE[1] / 2], -1)
        power = np.einsum("hwi,ij,hwj->hw", d, conics[row], d) / 2
        alpha = np.minimum(np.exp(-power) / (1 + np.exp(-splats.opacities[row])), 0.99)
        weight = light * np.where(alpha >= 1 / 255, alpha, 0)
        blended = light - weight > 1e-4  # else it would complete the pixel
        out[row], after = np.where(blended, weight, 0), np.where(blended, light - weight, 0)
        half[blended & (light > 0.5) & (after <= 0.5)] = row
        light = after
    return out, half


@pytest.fixture
def two(scene):
    """Two overlapping objects with filters, one of them turned, and all passes."""
    lab.prepare(scene, SIZE)
    for i in range(2):
        ob = lab.add(scene, lab.blob(150, seed=i, center=(0.3 * i, 0, 0.2 * i)), f"blob {i}")
        ob.pass_index = 4 + 3 * i
        know_light(ob, captured=0.5 + 0.25 * i)
    ob.rotation_euler = (0.3, 0.2, 0.1)
    ob.gscore.opacity_min = 0.45
    layer = scene.view_layers[0]
    layer.use_pass_z = layer.use_pass_object_index = layer.use_pass_diffuse_color = True
    layer.use_pass_shadow = True
    layer.pass_alpha_threshold = 0.5
    scene.gscore_render.splat_index = True
    layer.update()
    return scene


def test_indices_are_exact(two, tmp_path):
    """Object and splat, also in a file of half floats; of filtered splats the number before the
    filters."""
    found = render_passes(two, tmp_path, "16")
    share, half = weights(two)
    (_, count) = lab.model_of(two.view_layers[0].depsgraph).owners[0]
    obs = [bpy.data.objects[f"blob {i}"] for i in range(2)]
    base = np.empty(4 * 150, np.float32)
    obs[1].data.attributes[attributes.BASE].data.foreach_get("color", base)
    kept = np.flatnonzero(base[3::4] >= 0.45)
    assert count == 150 and len(share) - count == len(kept) < 140
    number = np.append(np.concatenate([np.arange(150), kept]), -1)[half]
    assert (number >= 0).mean() > 0.1
    np.testing.assert_array_equal(found["Splat Index"], number)
    parts = np.stack([share[:count].sum(0), share[count:].sum(0)])
    index = np.where(parts.sum(0) >= 0.5, np.array([4, 7])[parts.argmax(0)], 0)
    np.testing.assert_array_equal(found[compat.index_pass_name()], index)
    assert {4, 7} == set(np.unique(index)) - {0}
    assert found["Depth"].dtype == np.float32 and found["Combined"].dtype == np.float16


def test_albedo_is_the_color_without_the_captured_light(two, tmp_path):
    """Linear, as long as the pixel is covered; black where it is not known, whose object is named;
    left out with no estimate at all."""
    share, _ = weights(two)
    colors, light = [], np.repeat([0.5, 0.75], [150, len(share) - 150])
    splats = lab.model_of(two.view_layers[0].depsgraph).splats
    srgb = np.maximum(splats.sh0[:, 0] * lab.SH_C0 + 0.5, 0).astype(np.float64)
    colors = decode(srgb)
    albedo = colors / light[:, None]
    name = compat.albedo_pass_name()
    found = render_passes(two, tmp_path)[name]
    wanted = np.einsum("nhw,nc->hwc", share, albedo)
    assert wanted.max() > 0.5
    np.testing.assert_allclose(found, wanted, atol=2e-4)
    first = bpy.data.objects["blob 0"]
    first.data.attributes.remove(first.data.attributes[attributes.NORMAL])
    first.data.attributes.remove(first.data.attributes[attributes.CAPTURED])
    albedo[:150] = 0
    wanted = np.einsum("nhw,nc->hwc", share, albedo)
    np.testing.assert_allclose(render_passes(two, tmp_path)[name], wanted, atol=2e-4)
    assert "for blob 0: press Relight Splats" in sentences(two)
    second = bpy.data.objects["blob 1"].data
    second.attributes.remove(second.attributes[attributes.NORMAL])
    second.attributes.remove(second.attributes[attributes.CAPTURED])
    assert name not in render_passes(two, tmp_path)
    assert "for blob 0, blob 1: press Relight Splats" in sentences(two)


def sentences(scene: bpy.types.Scene) -> str:
    """Warnings of a render."""
    from addon.render import unsupported_settings as settings

    layer = scene.view_layers[0]
    shown = settings.Shown(scene=scene, layer=layer, camera=scene.camera)
    return " ".join(settings.without_effect(shown))


@pytest.mark.parametrize("kind", ["PERSP", "PANO", "blur", "region", "captured"])
def test_shadow_times_unshadowed_is_the_picture(scene, tmp_path, kind):
    """Of a wall of one color under a lamp and a cube; 1 where nothing is in between, and beside the
    splats; by every kind of picture, and of splats that are not relit."""
    lab.prepare(scene, SIZE)
    wall = lab.add(scene, lab.wall(0.0, (0.5, 0.6, 0.3), half=1.2, along=61))
    if kind != "captured":
        know_light(wall)
        wall.gscore.light = 1.0
    lamp(scene, "SUN")
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0.1, 0, 0.5))
    cube = bpy.context.object
    attach(scene, wall, grid(-0.01))
    scene.view_layers[0].use_pass_shadow = True
    if kind == "PANO":
        panoramic(scene, "equidistant")
    if kind == "blur":
        blur.open_lens(scene, 0.4, 4.0, 2)
    scene.render.use_border = kind == "region"
    scene.render.border_max_x = 0.6
    with_cube = render_passes(scene, tmp_path)
    cube.hide_render = True
    without = render_passes(scene, tmp_path)["Combined"][..., :3]
    shadow, got = with_cube["Shadow"], with_cube["Combined"][..., :3]
    part = slice(None, None if kind != "region" else SIZE[0] * 6 // 10)
    shadow, got, without = (one[:, part] for one in (shadow, got, without))
    dark = shadow.mean(-1) < 0.1
    assert 20 < dark.sum() < 0.5 * dark.size and (shadow > 0.999).all(-1).mean() > 0.3
    level = shadow.max(-1) - shadow.min(-1)
    assert level.max() < 1e-3  # of one lamp
    even = (shadow < 0.01).all(-1) | (shadow > 0.99).all(-1)  # edges mix in sRGB
    np.testing.assert_allclose((shadow * without)[even], got[even], atol=0.02)
    np.testing.assert_array_equal(shadow[without.max(-1) == 0], 1)


def test_numbers_in_a_panorama_and_with_depth_of_field(two, tmp_path):
    """Whole numbers of splats that are there, of the sharp picture; none of held-out splats."""
    sharp = render_passes(two, tmp_path)["Splat Index"]
    blur.open_lens(two, 0.4, 2.5, 3)
    np.testing.assert_array_equal(render_passes(two, tmp_path)["Splat Index"], sharp)
    two.camera.data.dof.use_dof = False
    panoramic(two, "equidistant")
    found = render_passes(two, tmp_path)["Splat Index"]
    assert (found == np.round(found)).all() and found.min() == -1 and found.max() < 150
    assert 0.02 < (found >= 0).mean() < 0.9
    for i in range(2):
        bpy.data.objects[f"blob {i}"].is_holdout = True
    assert (render_passes(two, tmp_path)["Splat Index"] == -1).all()


def test_other_passes_keep_their_bits(two, tmp_path):
    """The picture does not depend on them."""
    every = render_passes(two, tmp_path)
    layer = two.view_layers[0]
    layer.use_pass_diffuse_color = layer.use_pass_shadow = False
    two.gscore_render.splat_index = False
    fewer = render_passes(two, tmp_path)
    assert set(every) - set(fewer) == {compat.albedo_pass_name(), "Shadow", "Splat Index"}
    for name, picture in fewer.items():
        np.testing.assert_array_equal(picture, every[name])


def test_the_compositor_has_a_socket_of_the_switch(scene):
    """Of the index of splats, at once, as of Blender's own switches."""
    lab.prepare(scene, SIZE)
    tree = compat.make_compositor_tree(scene)
    (layers,) = (node for node in tree.nodes if node.type == "R_LAYERS")
    scene.gscore_render.splat_index = True
    assert "Splat Index" in [one.name for one in layers.outputs if one.enabled]
    scene.gscore_render.splat_index = False
    assert "Splat Index" not in [one.name for one in layers.outputs if one.enabled]


def test_albedo_of_nested_instances(scene):
    """Splats in a collection that an instanced collection instances count; hidden ones do not."""
    lab.prepare(scene, SIZE)
    ob = lab.add(scene, lab.blob(20))
    know_light(ob)
    scene.collection.objects.unlink(ob)
    inside = ob
    for level in range(2):
        collection = bpy.data.collections.new(f"level {level}")
        collection.objects.link(inside)
        inside = bpy.data.objects.new(f"instance {level}", None)
        inside.instance_type, inside.instance_collection = "COLLECTION", collection
    scene.collection.objects.link(inside)
    layer = scene.view_layers[0]
    layer.use_pass_diffuse_color = True
    layer.update()
    assert passes.requested_passes(scene, layer, None).albedo
    ob.hide_render = True
    assert not passes.requested_passes(scene, layer, None).albedo
