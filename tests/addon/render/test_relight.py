"""Lights of the scene on splats. Oracle, unless stated otherwise: Cycles' picture of a plane in
place of the splats."""

from functools import partial

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from addon import attributes, compat
from addon.core import POINT, SUN, Lamp, transform_splats
from addon.panels.result import LightPanel
from addon.render import compositor, lamps, relight
from addon.render.model import SplatCache
from addon.render.proxy import attach
from addon.render.scene import place, sources
from addon.render.shadow_maps import Casters, shadow_map
from addon.triangles import Triangles
from tests.addon import splat_scenes as lab
from tests.addon.drawn import drawn
from tests.light_changes import decode

SIZE = (40, 40)
COLOR = (0.5, 0.6, 0.3)


def lamp(scene: bpy.types.Scene, kind: str) -> bpy.types.Object:
    """A colored lamp above the right side, which shines obliquely down."""
    data = bpy.data.lights.new(kind, kind)
    made = bpy.data.objects.new(kind, data)
    scene.collection.objects.link(made)
    made.location, made.rotation_euler = (0.5, 0.2, 1.5), (0.1, -0.3, 0.2)
    data.color = (1.0, 0.8, 0.6)
    data.energy = 3.0 if kind == "SUN" else 60.0
    if kind == "SPOT":
        data.spot_size, data.spot_blend = 0.9, 0.4
    if kind == "AREA":
        data.shape, data.size, data.size_y = "RECTANGLE", 0.6, 0.3
    if kind in {"POINT", "SPOT"}:
        data.shadow_soft_size = 0.02
    return made


def know_light(ob: bpy.types.Object, normal=(0, 0, 1), captured: float = 1.0) -> None:
    """Store normal and captured light of all splats."""
    for name, values in ((attributes.NORMAL, normal), (attributes.CAPTURED, 3 * [captured])):
        attributes.declare(ob.data, name, "FLOAT_VECTOR")
        rows = np.tile(np.float32(values), (len(ob.data.vertices), 1))
        attributes.fill(ob.data, name, "FLOAT_VECTOR", rows.ravel())


@pytest.fixture
def lit(scene):
    """A wall of splats at z = 0 that is relit, in a black world."""
    lab.prepare(scene, SIZE)
    ob = lab.add(scene, lab.wall(0.0, COLOR, half=2.5, along=101))
    know_light(ob)
    ob.gscore.light = 1.0
    return scene


def grid(z: float, along: int = 150) -> bpy.types.Object:
    """A mesh of the wall, fine by default."""
    bpy.ops.mesh.primitive_grid_add(
        x_subdivisions=along, y_subdivisions=along, size=5, location=(0, 0, z)
    )
    return bpy.context.object


def by_cycles(scene: bpy.types.Scene, folder) -> np.ndarray:
    """The picture of a plane with the splats' color as albedo."""
    bpy.ops.mesh.primitive_plane_add(size=5)
    albedo = bpy.data.materials.new("albedo")
    compat.use_nodes(albedo)
    albedo.node_tree.nodes.clear()
    shader = albedo.node_tree.nodes.new("ShaderNodeBsdfDiffuse")
    linear = decode(COLOR)
    shader.inputs["Color"].default_value = (*linear, 1)
    out = albedo.node_tree.nodes.new("ShaderNodeOutputMaterial")
    albedo.node_tree.links.new(shader.outputs[0], out.inputs["Surface"])
    bpy.context.object.data.materials.append(albedo)
    for ob in scene.objects:
        if ob.get("gs_kind") == "splats":
            ob.hide_render = True
    scene.render.engine, scene.cycles.samples = "CYCLES", 64
    scene.cycles.use_denoising = False
    return lab.render_exr(folder, "cycles")[..., :3]


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_meshes_hide_the_world(lit, tmp_path, share):
    """A cube and a ball that stand, and a ball that hangs, without lamps: the share of the light of
    relit splats, and of those with the captured look, that they leave."""
    lit.render.resolution_x = lit.render.resolution_y = 80
    (ob,) = (ob for ob in lit.objects if ob.get("gs_kind") == "splats")
    ob.gscore.light = share
    attach(lit, ob, proxy := grid(-0.01))
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(-0.5, 0.1, 0.25))
    meshes = [bpy.context.object]
    for radius, middle in ((0.2, (0, -0.6, 0.2)), (0.3, (0.5, 0, 0.7))):
        bpy.ops.mesh.primitive_uv_sphere_add(radius=radius, location=middle)
        meshes.append(bpy.context.object)
    tree = compat.world_nodes(lit.world)
    tree.nodes["Background"].inputs[0].default_value = (0.7, 0.6, 0.5, 1)
    got = lab.render_exr(tmp_path, "got")[..., :3]
    for mesh in meshes:
        mesh.visible_shadow = False
    bare = lab.render_exr(tmp_path, "bare")[..., :3]
    for mesh in meshes:
        mesh.visible_shadow, mesh.visible_camera = True, False
    proxy.driver_remove("hide_render")
    proxy.hide_render, lit.cycles.max_bounces = True, 0
    wanted = by_cycles(lit, tmp_path) / (decode(COLOR) * [0.7, 0.6, 0.5])
    error = np.abs(got / bare - wanted)[4:-4, 4:-4]
    assert (wanted < 0.7).mean() > 0.04
    assert error.mean() < 0.03
    assert np.percentile(error, 95) < 0.1


@pytest.mark.parametrize("kind", ["SUN", "POINT", "SPOT", "AREA"])
def test_lamps(lit, tmp_path, kind):
    """Of all kinds: color, strength, distance, angle, cone and size."""
    lamp(lit, kind)
    got = lab.render_exr(tmp_path, "ours")[..., :3]
    wanted = by_cycles(lit, tmp_path)
    assert wanted.max() > 0.1
    error = np.abs(got - wanted) / wanted.max()
    assert error.mean() < 0.015
    assert np.percentile(error, 95) < 0.04


@pytest.mark.parametrize("kind", ["SUN", "POINT", "room"])
def test_shadows_of_meshes(lit, tmp_path, kind):
    """A cube over the wall: where its shadow is, and none of a cube without shadows; in a room, in
    which the lamp is among the meshes; the wall's own proxy casts none on it."""
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0.1, 0, 0.5))
    cube = bpy.context.object
    made = lamp(lit, "POINT" if kind == "room" else kind)
    made.location = (0.5, 0.2, 1.9)
    if kind == "room":
        bpy.ops.mesh.primitive_cube_add(size=9, location=(0, 0, 4.4))
        bpy.context.object.visible_camera = False
        lit.cycles.max_bounces = 0
    (ob,) = (ob for ob in lit.objects if ob.get("gs_kind") == "splats")
    proxy = grid(-0.01)
    attach(lit, ob, proxy)
    got = lab.render_exr(tmp_path, "ours")[..., :3]
    cube.visible_shadow = False
    without = lab.render_exr(tmp_path, "without")[..., :3]
    cube.visible_shadow, cube.visible_camera = True, False
    lit.cycles.max_bounces, proxy.hide_render = 0, True
    proxy.driver_remove("hide_render")
    proxy.hide_render = True
    wanted = by_cycles(lit, tmp_path)
    shadow = wanted.mean(2) < 0.5 * without.mean(2)
    ours = got.mean(2) < 0.5 * without.mean(2)
    assert shadow.sum() > 20
    assert (shadow & ours).sum() / (shadow | ours).sum() > 0.7
    clear = ~(shadow | ours)
    assert np.abs(got - without)[clear].mean() < 0.01 * without.max()


@pytest.mark.parametrize(("kind", "size"), [("SUN", "angle"), ("POINT", "shadow_soft_size")])
def test_shadows_begin_where_meshes_stand(lit, tmp_path, kind, size):
    """A small cube on the wall, which has a coarse proxy: the distance that proxies may be off is
    none of other meshes. The maps of soft shadows have its far side, those of hard ones do not."""
    lit.render.resolution_x = lit.render.resolution_y = 80
    made = lamp(lit, kind)
    made.location = (1.5, 0.2, 1.5)
    (ob,) = (ob for ob in lit.objects if ob.get("gs_kind") == "splats")
    proxy = grid(-0.01, 12)
    attach(lit, ob, proxy)
    bare = lab.render_exr(tmp_path, "bare")[..., :3].mean(2)
    bpy.ops.mesh.primitive_cube_add(size=0.3, location=(0.1, 0, 0.15))
    cube = bpy.context.object
    found = {}
    for soft in (False, True):
        setattr(made.data, size, 0.05 * soft)
        found[soft] = lab.render_exr(tmp_path, f"soft{soft}")[..., :3].mean(2) < 0.5 * bare
        of_cube, of_proxy = sorted(relight._known.values(), key=lambda one: one.slack)
        assert (of_cube.backs is not None) == soft and of_proxy.backs is None
    proxy.driver_remove("hide_render")
    proxy.hide_render, cube.visible_camera, lit.cycles.max_bounces = True, False, 0
    wanted = by_cycles(lit, tmp_path).mean(2) < 0.5 * bare
    assert wanted.sum() > 40
    for ours in found.values():
        assert (wanted & ours).sum() / (wanted | ours).sum() > 0.75


@pytest.mark.parametrize("kind", ["SUN", "POINT", "AREA"])
def test_soft_shadows(lit, tmp_path, kind):
    """Where Cycles' shadow of a cube is neither dark nor bright, ours is as dark; that of a lamp
    without a size is not."""
    lit.render.resolution_x = lit.render.resolution_y = 120
    made = lamp(lit, kind)
    made.location = (0.5, 0.2, 3)

    def resize(share: float) -> None:
        if kind == "SUN":
            made.data.angle = share * np.radians(20)
        elif kind == "POINT":
            made.data.shadow_soft_size = share * 0.3
        else:
            made.data.size = made.data.size_y = share * 0.6

    resize(1)
    bare = lab.render_exr(tmp_path, "bare")[..., :3].mean(2)
    bpy.ops.mesh.primitive_cube_add(size=0.8, location=(0.1, 0, 0.9))
    cube = bpy.context.object
    ours = lab.render_exr(tmp_path, "soft")[..., :3].mean(2) / bare
    resize(1e-3)
    hard = lab.render_exr(tmp_path, "hard")[..., :3].mean(2) / bare
    resize(1)
    cube.visible_camera = False
    lit.cycles.max_bounces = 0
    wanted = by_cycles(lit, tmp_path).mean(2) / bare
    blurred = (wanted > 0.05) & (wanted < 0.93)
    assert blurred.sum() > 500
    errors = [np.abs(one - wanted)[blurred].mean() for one in (ours, hard)]
    assert errors[0] < 0.13
    assert errors[1] > 0.2


@pytest.mark.parametrize("kind", ["SUN", "POINT"])
def test_shadows_beside_a_wide_ground(lit, tmp_path, kind):
    """Oracle: the picture without the ground, with a tower far up that casts no shadow here."""
    lamp(lit, kind)
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0.1, 0, 0.5))
    wanted = lab.render_exr(tmp_path, "before")[..., 0]
    dark = wanted < 0.1 * wanted.max()
    assert dark.sum() > 20
    bpy.ops.mesh.primitive_plane_add(size=400, location=(0, 0, -0.5))
    bpy.ops.mesh.primitive_cube_add(size=20, location=(0, 60, 90))
    found = lab.render_exr(tmp_path, "after")[..., 0] < 0.1 * wanted.max()
    assert (dark & found).sum() / (dark | found).sum() > 0.8
    assert len(relight._known) == 1  # maps of earlier pictures are freed


def test_maps_of_lamps_with_the_same_numbers():
    """A sun along an axis and a point at the same numbers. Oracle: the sum of the light of each.
    The shadows alone, which need the light without them, free no maps."""
    square = np.array([[-1.0, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
    mesh = Triangles(square, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    casters = Casters(mesh_key=b"square", meshes=((mesh, np.eye(4)),))
    common = {"strength": (1.0, 1.0, 1.0), "source": (0.0, 0.0, -1.0)}
    sun = Lamp(kind=SUN, axis=(0.0, 0.0, -1.0), **common)
    point = Lamp(kind=POINT, place=(0.0, 0.0, -1.0), **common)
    rng = np.random.default_rng(1)
    places = rng.uniform(-2, 2, (500, 3)).astype(np.float32)
    normals = rng.normal(size=(500, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found = []
    for some in ((sun,), (point,), (sun, point)):
        relight.forget_maps()
        light = relight.SceneLight(lamps=some, casters=casters)
        found.append(light.white_of(places, normals, np.eye(4)))
    np.testing.assert_allclose(found[2], found[0] + found[1], atol=1e-5)
    maps = dict(relight._known)
    assert len(maps) == 2
    how = relight.Relighting(share=1.0, light=light, matrix=np.eye(4))
    shadows = relight.shade(places, normals, np.ones_like(places), how)
    assert (shadows < 0.1).any() and (shadows > 0.9).any() and shadows.max() <= 1
    assert relight._known == maps


@pytest.mark.parametrize("kind", [SUN, POINT])
def test_splats_below_a_proxy_are_lit(kind):
    """A proxy of a ground with a cube on it, below which the ground goes on. Oracle: what stands on
    the ground shadows it, and what is just below the surface; the surface itself does so deeper."""
    cube = np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (0.0, 2)])
    corners = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (1, 5, 7, 3)]
    ground = 6 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    quads = np.array([*corners, (8, 9, 10, 11)], np.int32)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    mesh = Triangles(np.concatenate([cube, ground]), np.ascontiguousarray(triangles))
    casters = Casters(proxy_key=b"cube", proxies=((mesh, np.eye(4)),))
    slack = casters.slack
    axis = np.array([1.0, 0, -1]) / np.sqrt(2)
    place = tuple((-1000 * axis).tolist())
    strength = 3 * ((1.0 if kind == SUN else 1e6),)
    lamp = Lamp(kind=kind, strength=strength, axis=tuple(axis), place=place, source=place)
    relight.forget_maps()
    light = relight.SceneLight(lamps=(lamp,), casters=casters)
    below = -2 * slack
    places = [[-4, 0, 0], [-4, 0, below], [1.8, 0, 0], [1.8, 0, below], [-4, 0, -6 * slack]]
    normals = np.tile(np.float32([0, 0, 1]), (len(places), 1))
    found = light.white_of(np.float32(places), normals, np.eye(4))[:, 0]
    np.testing.assert_allclose(found[:2], np.sqrt(0.5), rtol=0.02)
    np.testing.assert_array_equal(found[2:], 0)


def test_playback_moves_shadows(lit):
    """Of a mesh that changes by shape keys."""
    lamp(lit, "SUN")
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0.1, 0, 0.5))
    cube = bpy.context.object
    cube.shape_key_add(name="small")
    large = cube.shape_key_add(name="large")
    for point in large.data:
        point.co *= 3
    for frame in (1, 10):
        large.value = float(frame == 10)
        large.keyframe_insert("value", frame=frame)
    keys = []
    for frame in (1, 10, 1):
        lit.frame_set(frame)
        keys.append(lamps.scene_light(bpy.context.evaluated_depsgraph_get()).casters.key)
    assert keys[0] != keys[1]
    assert keys[0] == keys[2]


def test_lamps_move_over_known_meshes(lit):
    """Only another mesh is measured anew."""
    sun = lamp(lit, "SUN")
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0.1, 0, 0.5))

    def casters() -> Casters:
        return lamps.scene_light(bpy.context.evaluated_depsgraph_get()).casters

    first, cube = casters(), bpy.context.object
    sun.rotation_euler = (0, 0, 0)
    assert casters() is first
    cube.location = (0.2, 0, 0.5)
    assert casters().ball[0].tolist() == pytest.approx([0.2, 0, 0.5])


def test_world(lit, tmp_path):
    """An even world, and an environment texture whose upper half is bright and blue."""
    lit.render.film_transparent = True
    tree = compat.world_nodes(lit.world)
    tree.nodes["Background"].inputs[0].default_value = (0.3, 0.5, 0.7, 1)
    got = lab.render_exr(tmp_path, "ours")[16:24, 16:24, :3].mean((0, 1))
    linear = decode(COLOR)
    np.testing.assert_allclose(got, linear * [0.3, 0.5, 0.7], rtol=0.02)
    image = bpy.data.images.new("sky", 64, 32, float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"
    pixels = np.zeros((32, 64, 4), np.float32)
    pixels[16:, :32] = (0.2, 0.4, 1.5, 1)
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = image
    tree.links.new(node.outputs[0], tree.nodes["Background"].inputs[0])
    got = lab.render_exr(tmp_path, "textured")[16:24, 16:24, :3].mean((0, 1))
    wanted = by_cycles(lit, tmp_path)[16:24, 16:24].mean((0, 1))
    np.testing.assert_allclose(got, wanted, rtol=0.05)


def test_pictures_of_worlds(lit, tmp_path):
    """An sRGB picture of bytes, and the same image after another file was loaded into it."""
    lit.render.film_transparent = True
    image = bpy.data.images.new("sky", 600, 300)
    pixels = np.ones((300, 600, 4), np.float32)
    pixels[150:, :, :3] = (0.3, 0.5, 0.7)
    pixels[:150, :, :3] = 0.1
    image.pixels.foreach_set(pixels.ravel())
    for name, gain in (("dark.png", 0.5), ("light.png", 1.0)):
        image.pixels.foreach_set((pixels * gain).ravel())
        image.filepath_raw, image.file_format = str(tmp_path / name), "PNG"
        image.save()
    image = bpy.data.images.load(str(tmp_path / "dark.png"))
    tree = compat.world_nodes(lit.world)
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = image
    tree.links.new(node.outputs[0], tree.nodes["Background"].inputs[0])
    lab.render_exr(tmp_path, "dark")
    image.filepath = str(tmp_path / "light.png")
    image.reload()
    got = lab.render_exr(tmp_path, "light")[16:24, 16:24, :3].mean((0, 1))
    wanted = by_cycles(lit, tmp_path)[16:24, 16:24].mean((0, 1))
    np.testing.assert_allclose(got, wanted, rtol=0.05)


def test_off_is_the_captured_look(lit, tmp_path):
    """Oracle: the same bits as without attributes, whatever the lamps; and half way between."""
    lamp(lit, "SUN")
    (ob,) = (ob for ob in lit.objects if ob.get("gs_kind") == "splats")
    on = lab.render_exr(tmp_path, "on")
    ob.gscore.light = 0.0
    off = lab.render_exr(tmp_path, "off")
    ob.gscore.light = 0.5
    half = lab.render_exr(tmp_path, "half")
    for name in (attributes.NORMAL, attributes.CAPTURED):
        ob.data.attributes.remove(ob.data.attributes[name])
    np.testing.assert_array_equal(lab.render_exr(tmp_path, "plain"), off)
    assert np.abs(on - off).max() > 0.05
    np.testing.assert_allclose(half, (on + off) / 2, atol=2e-3)


def test_objects_are_lit_where_they_stand(lit, tmp_path):
    """A turned, scaled copy far away, and moved lamps, without another estimate."""
    (ob,) = (ob for ob in lit.objects if ob.get("gs_kind") == "splats")
    sun = lamp(lit, "SUN")
    sun.rotation_euler = (0, 0, 0)
    straight = lab.render_exr(tmp_path, "straight")[20, 20, :3]
    sun.rotation_euler = (0, np.radians(60), 0)
    np.testing.assert_allclose(lab.render_exr(tmp_path, "low")[20, 20, :3], straight / 2, rtol=0.01)
    ob.rotation_euler, ob.scale = (0, np.radians(60), 0), (2, 2, 2)
    np.testing.assert_allclose(lab.render_exr(tmp_path, "turned")[20, 20, :3], straight, rtol=0.03)


def test_normals_turn_with_the_splats(lit, tmp_path):
    """Applied and joined transforms: the picture of the object that was turned."""
    (ob,) = (ob for ob in lit.objects if ob.get("gs_kind") == "splats")
    lamp(lit, "SUN")
    ob.rotation_euler, ob.scale = (0.3, 0.5, 0), (1.5,) * 3
    wanted = lab.render_exr(tmp_path, "turned")
    bpy.context.view_layer.objects.active = ob
    ob.select_set(True)
    assert bpy.ops.gscore.apply_splat_transform() == {"FINISHED"}
    np.testing.assert_allclose(lab.render_exr(tmp_path, "applied"), wanted, atol=2e-3)
    other = lab.add(lit, lab.wall(0.0, COLOR), "receiver")
    know_light(other)
    other.rotation_euler, other.location = (0, -0.4, 0), (50, 0, 0)
    bpy.context.view_layer.update()
    bpy.context.view_layer.objects.active = other
    other.gscore.light = 1.0
    for one in (ob, other):
        one.select_set(True)
    assert bpy.ops.gscore.join_splats() == {"FINISHED"}
    np.testing.assert_allclose(lab.render_exr(tmp_path, "joined"), wanted, atol=2e-3)


MIRROR = np.diag([-1.0, 1, 1, 1])


def tilted(scene: bpy.types.Scene, by: str) -> tuple[bpy.types.Object, bpy.types.Object]:
    """A tilted wall of splats and its proxy, a little above it, with a cube that stands there; both
    mirrored `by` the object's scale, or by their data."""
    turn = np.array(Matrix.Rotation(0.5, 4, "Y") @ Matrix.Translation((0.2, 0.1, 0)))
    splats = transform_splats(lab.wall(0.0, COLOR, half=2.5, along=101), turn)
    mesh = grid(0.1)
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0.5, -0.3, 0.25))
    mesh.select_set(True)
    bpy.context.view_layer.objects.active = mesh
    bpy.ops.object.join()
    mesh.data.transform(Matrix(turn @ np.array(mesh.matrix_world)))
    mesh.matrix_world = Matrix()
    if by == "data":
        splats = transform_splats(splats, MIRROR)
        mesh.data.transform(Matrix(MIRROR))
        mesh.data.flip_normals()
    ob = lab.add(scene, splats)
    attach(scene, ob, mesh)
    if by == "scale":
        ob.scale.x = -1
    bpy.context.view_layer.objects.active = ob
    bpy.context.view_layer.update()
    return ob, mesh


@pytest.mark.parametrize("kind", ["relit", "photos", "captured"])
def test_mirrored_splats(scene, tmp_path, kind):
    """Oracle: the picture of splats and proxy that are mirrored in their data, under a lamp, a
    world and a mesh: relit with the normals of the proxy, those of which the light of the photos is
    the scene's too, and with the captured look and no normals."""
    lab.prepare(scene, SIZE, light=0.2)
    lamp(scene, "SUN").data.energy = 5
    found = []
    for by in ("data", "scale"):
        ob, mesh = tilted(scene, by)
        if kind != "captured":
            how = "SCENE" if kind == "photos" else "SURFACES"
            assert bpy.ops.gscore.relight_splats(captured=how) == {"FINISHED"}
        bare = lab.render_exr(tmp_path, f"bare {by}")[..., :3]
        bpy.ops.mesh.primitive_cube_add(size=0.4, location=(-0.4, 0.5, 0.9))
        cube = bpy.context.object
        cube.visible_camera = False
        found.append(lab.render_exr(tmp_path, by)[..., :3])
        assert (found[-1] < 0.7 * bare).all(-1).sum() > 20
        for one in (cube, mesh, ob):
            bpy.data.objects.remove(one)
    np.testing.assert_allclose(found[1], found[0], atol=5e-3)


@pytest.mark.parametrize("kind", [SUN, POINT])
def test_mirrored_meshes_cast_the_same_shadows(kind):
    """Oracle: casters whose vertices are mirrored and whose triangles are turned round."""
    corners = np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    quads = np.array(sides, np.int32)
    triangles = np.ascontiguousarray(np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))
    turned = Triangles(corners * [-1, 1, 1], np.ascontiguousarray(triangles[:, ::-1]))
    axis = np.array([0.6, 0, -0.8])
    for name in ("proxies", "meshes"):
        maps = []
        for mesh, matrix in ((Triangles(corners, triangles), MIRROR), (turned, np.eye(4))):
            casters = Casters(**{name: ((mesh, matrix),)})
            sun = axis if kind == SUN else None
            maps.append(shadow_map(casters, -6 * axis, sun, soft=True))
        np.testing.assert_allclose(maps[0].depths, maps[1].depths, atol=1e-5)


def test_the_captured_light_is_found(scene):
    """Oracle: the light of a ball of one color, by the cosine of its normals, up to scale, and
    grey; normals face the cameras, without them away from the middle."""
    index = np.arange(3000) + 0.5
    up, turn = 1 - index / 1500, np.pi * (1 + 5**0.5) * index
    level = np.sqrt(1 - up**2)
    normals = np.stack([level * np.cos(turn), level * np.sin(turn), up], 1).astype(np.float32)
    light = 0.5 + 0.4 * normals @ np.float32([0, 0, 1])
    colors = np.repeat(light[:, None], 3, axis=1) * [1, 0.5, 0.2]
    found = relight.captured_light(colors, normals, np.ones(3000))
    np.testing.assert_array_equal(found, found[:, :1].repeat(3, axis=1))
    ratio = found[:, 0] / light
    np.testing.assert_allclose(ratio, ratio.mean(), rtol=0.06)
    brightness = (colors / found) @ [0.2126, 0.7152, 0.0722]
    np.testing.assert_allclose(np.median(brightness), 0.8, rtol=0.03)
    assert (relight.facing(normals, np.zeros((0, 3))) * normals).sum(1).min() > 0.5
    inside = relight.facing(normals, np.zeros((1, 3)))
    assert (inside * normals).sum(1).max() < 0


def test_the_button(scene, tmp_path):
    """Oracle: the lamps of the estimate give the captured look again; a brighter sun brightens; the
    attributes stay through edits and files."""
    lab.prepare(scene, SIZE)
    ob = lab.add(scene, lab.wall(0.0, COLOR, half=2.5, along=101))
    sun = lamp(scene, "SUN")
    before = lab.render_exr(tmp_path, "before")
    bpy.context.view_layer.objects.active = ob
    ob.select_set(True)
    assert bpy.ops.gscore.relight_splats(captured="SCENE") == {"FINISHED"}
    assert ob.gscore.light == 1.0
    np.testing.assert_allclose(lab.render_exr(tmp_path, "same"), before, atol=2e-3)
    sun.data.energy *= 2
    brighter = lab.render_exr(tmp_path, "brighter")[..., :3]
    np.testing.assert_allclose(brighter, 2 * before[..., :3], rtol=0.02, atol=2e-3)
    assert bpy.ops.gscore.relight_splats() == {"FINISHED"}
    path = str(tmp_path / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    wanted = lab.render_exr(tmp_path, "wanted")
    bpy.ops.wm.open_mainfile(filepath=path)
    np.testing.assert_array_equal(lab.render_exr(tmp_path, "loaded"), wanted)


def test_undo_of_the_button(scene, tmp_path):
    """Oracle: the picture before, to the bit; then the button again, with another lamp. Redo brings
    the first estimate back."""
    lab.prepare(scene, SIZE)
    ob = lab.add(scene, lab.wall(0.0, COLOR, half=2.5, along=101), "wall")
    lamp(scene, "SUN")
    bpy.context.view_layer.objects.active = ob
    bpy.ops.ed.undo_push(message="start")
    before = lab.render_exr(tmp_path, "before")
    assert bpy.ops.gscore.relight_splats(captured="SCENE") == {"FINISHED"}
    first = attributes.column(ob.data, attributes.CAPTURED)
    bpy.ops.ed.undo_push(message="relit")
    bpy.ops.ed.undo()
    ob = bpy.data.objects["wall"]
    names = set(ob.data.attributes.keys())
    assert not names & {attributes.NORMAL, attributes.CAPTURED} and ob.gscore.light == 0
    np.testing.assert_array_equal(lab.render_exr(tmp_path, "undone"), before)
    bpy.ops.ed.redo()
    ob = bpy.data.objects["wall"]
    np.testing.assert_array_equal(attributes.column(ob.data, attributes.CAPTURED), first)
    bpy.ops.ed.undo()
    bpy.data.lights["SUN"].energy *= 2
    bpy.context.view_layer.objects.active = bpy.data.objects["wall"]
    assert bpy.ops.gscore.relight_splats(captured="SCENE") == {"FINISHED"}
    again = attributes.column(bpy.data.objects["wall"].data, attributes.CAPTURED)
    np.testing.assert_allclose(again, 2 * first, rtol=1e-5)


@pytest.mark.parametrize("display", ["POINTS", "ELLIPSOIDS", "SOFT"])
def test_node_displays(scene, tmp_path, display):
    """A sun brightens the display in Cycles as it does the engine's picture; with the slider at 0
    it does nothing. The object is turned, so that its normals are not the world's."""
    lab.prepare(scene, (24, 24))
    ob = lab.add(scene, lab.wall(0.0, COLOR, half=2.5, along=41))
    know_light(ob, normal=(1, 0, 0))
    ob.matrix_world = Matrix.Rotation(np.radians(-90), 4, "Y")
    ob.data.attributes["position"].data.foreach_set(
        "vector", (lab.wall(0.0, COLOR, half=2.5, along=41).means[:, [2, 1, 0]]).ravel()
    )
    for name, order in ((attributes.SCALE, [2, 1, 0]),):
        rows = attributes.column(ob.data, name)[:, order]
        attributes.fill(ob.data, name, "FLOAT_VECTOR", np.ascontiguousarray(rows).ravel())
    ob.data.update()
    sun = lamp(scene, "SUN")
    middle = (slice(8, 16), slice(8, 16), slice(0, 3))
    pictures = {}
    for engine in ("GSCORE_SPLATS", "CYCLES"):
        for light in (0.0, 1.0):
            ob.gscore.light = light
            found = lab.render_exr(tmp_path, f"{engine}{light}")
            pictures[engine, light] = found[middle].mean((0, 1))
        ob.gscore.display, ob.gscore.point_size = display, 0.15
        scene.render.engine, scene.cycles.samples = "CYCLES", 64
        scene.cycles.use_denoising, scene.cycles.transparent_max_bounces = False, 64
    gains = {one: pictures[one, 1.0] / pictures[one, 0.0] for one in ("GSCORE_SPLATS", "CYCLES")}
    np.testing.assert_allclose(gains["CYCLES"], gains["GSCORE_SPLATS"], rtol=0.06)
    ob.gscore.light = 0.0
    before = lab.render_exr(tmp_path, "off")
    sun.hide_render = True
    np.testing.assert_array_equal(lab.render_exr(tmp_path, "dark"), before)


def test_new_meshes_shadow_the_captured_look(scene, tmp_path):
    """A cube that is there already when the light of the photos is that of the scene: the captured
    look, but in its shadow."""
    lab.prepare(scene, SIZE)
    ob = lab.add(scene, lab.wall(0.0, COLOR, half=2.5, along=101))
    lamp(scene, "SUN")
    before = lab.render_exr(tmp_path, "before")[..., 0]
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0.1, 0, 0.5))
    bpy.context.view_layer.objects.active = ob
    assert bpy.ops.gscore.relight_splats(captured="SCENE") == {"FINISHED"}
    after = lab.render_exr(tmp_path, "after")[..., 0]
    dark = after < 0.1 * before
    assert 20 < dark.sum() < 200
    rest = after > 0.9 * before
    assert (dark | rest).mean() > 0.9
    np.testing.assert_allclose(after[rest], before[rest], atol=2e-3, rtol=0.1)


def test_composites_have_the_light_of_the_main_scene(lit, tmp_path):
    """Oracle: the engine's picture, with a lamp that moves and a world that changes after the
    set-up."""
    sun = lamp(lit, "SUN")
    lit.render.engine, lit.cycles.samples = "CYCLES", 1
    compositor.set_up(lit)
    sun.rotation_euler = (0, 0.9, 0)
    compat.world_nodes(lit.world).nodes["Background"].inputs[0].default_value = (0.2, 0.1, 0.3, 1)
    middle = (slice(8, 32), slice(8, 32), slice(0, 3))
    got = lab.render_exr(tmp_path, "composite")[middle]
    lit.render.engine = "GSCORE_SPLATS"
    bpy.context.view_layer.update()
    wanted = lab.render_exr(tmp_path, "engine")[middle]
    assert wanted.max() > 0.1
    np.testing.assert_allclose(got, wanted, atol=5e-3)


def test_shadows_in_composites(lit, tmp_path):
    """Of parts of a proxy on others: the engine's picture; of a held-out cube: once, as of one that
    is not; a lamp in a collection that is excluded is dark."""
    (ob,) = (ob for ob in lit.objects if ob.get("gs_kind") == "splats")
    lamp(lit, "SUN").data.angle = 0
    aside = bpy.data.collections.new("aside")
    lit.collection.children.link(aside)
    excluded = bpy.data.objects.new("excluded", bpy.data.lights.new("excluded", "SUN"))
    aside.objects.link(excluded)
    bpy.context.view_layer.layer_collection.children["aside"].exclude = True
    compat.world_nodes(lit.world).nodes["Background"].inputs[0].default_value = (0.2, 0.2, 0.2, 1)
    proxy = grid(-0.01)
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(-0.9, 0.3, 0.6))
    proxy.select_set(True)
    bpy.context.view_layer.objects.active = proxy
    bpy.ops.object.join()
    attach(lit, ob, proxy)
    wanted = lab.render_exr(tmp_path, "engine")[..., 0]
    assert (wanted < 0.5 * np.median(wanted)).sum() > 20
    lit.render.engine, lit.cycles.samples = "CYCLES", 16
    compositor.set_up(lit)
    got = lab.render_exr(tmp_path, "composite")[..., 0]
    assert np.median(np.abs(got - wanted)) < 0.005
    assert (np.abs(got - wanted) > 0.05).mean() < 0.01
    bpy.ops.mesh.primitive_cube_add(size=0.4, location=(0.4, -0.3, 0.5))
    cube = bpy.context.object
    found = []
    for cube.is_holdout in (False, True):
        compositor.set_up(lit)
        found.append(lab.render_exr(tmp_path, f"cube{cube.is_holdout}")[..., 0])
    dark = (found[0] < 0.8 * got) & (found[1] > 0)
    assert dark.sum() > 20
    assert np.median(np.abs(found[1] - found[0])[dark]) < 0.02


def test_bad_matrices_and_meshes(lit, tmp_path):
    """Lamps of scale 0 and meshes with places that are no numbers change nothing; splats of scale
    0, or of several scales, get a sentence."""
    (ob,) = (ob for ob in lit.objects if ob.get("gs_kind") == "splats")
    lamp(lit, "POINT")
    wanted = lab.render_exr(tmp_path, "before")
    lamp(lit, "SUN").scale = (0, 0, 0)
    mesh = bpy.data.meshes.new("broken")
    mesh.from_pydata([(0, 0, 1), (1, 0, float("nan")), (0, 1, 1)], [], [(0, 1, 2)])
    lit.collection.objects.link(bpy.data.objects.new("broken", mesh))
    np.testing.assert_array_equal(lab.render_exr(tmp_path, "after"), wanted)
    bpy.context.view_layer.objects.active = ob
    for scale, words in (((0, 0, 0), "scale of 0"), ((1, 2, 1), "unevenly")):
        ob.scale = scale
        bpy.context.view_layer.update()
        for captured in ("SURFACES", "SCENE"):
            press = partial(bpy.ops.gscore.relight_splats, captured=captured)
            assert words in lab.error_of(press)


def test_many_lamps_and_none(lit, tmp_path):
    """Hundreds of lamps add up, with shadows of the first; without any the panel says why the
    splats are black."""
    (ob,) = (ob for ob in lit.objects if ob.get("gs_kind") == "splats")
    bpy.context.view_layer.objects.active = ob
    assert "no lamp" in drawn(LightPanel)
    tree = compat.world_nodes(lit.world)
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = bpy.data.images.new("sky", 8, 4, float_buffer=True)
    node.image.pixels.foreach_set(np.ones(128, np.float32))
    assert "no lamp" not in drawn(LightPanel)
    tree.nodes.remove(node)
    assert lab.render_exr(tmp_path, "none")[..., :3].max() < 1e-3
    bpy.ops.mesh.primitive_cube_add(size=0.2, location=(0.5, 0.5, 0.5))
    bpy.context.view_layer.objects.active = ob
    data = bpy.data.lights.new("many", "SUN")
    data.energy = 0.01
    for number in range(200):
        one = bpy.data.objects.new("many", data)
        one.rotation_euler.z = number / 100
        one.rotation_euler.x = 1e-4 * number
        lit.collection.objects.link(one)
    assert "no lamp" not in drawn(LightPanel)
    got = lab.render_exr(tmp_path, "many")[12, 12, :3]
    linear = decode(COLOR)
    np.testing.assert_allclose(got, linear * 2 / np.pi, rtol=0.02)


@pytest.mark.parametrize("kind", ["captured", "estimated"])
def test_meshes_shadow_splats_with_the_captured_look(lit, tmp_path, kind):
    """Of splats with a proxy: their picture times the light that Cycles renders on a plane with the
    cube over that without, in linear light; the same bits without a mesh, and without a proxy. The
    splats' shortest axes face away from the lamp, if no normals were estimated."""
    (ob,) = (ob for ob in lit.objects if ob.get("gs_kind") == "splats")
    ob.gscore.light = 0.0
    if kind == "captured":
        for name in (attributes.NORMAL, attributes.CAPTURED):
            ob.data.attributes.remove(ob.data.attributes[name])
        ob.rotation_euler = (0, np.pi, 0)
    lamp(lit, "SUN").data.energy = 3.0
    world = compat.world_nodes(lit.world).nodes["Background"]
    world.inputs[0].default_value = (0.3, 0.3, 0.3, 1)
    plain = lab.render_exr(tmp_path, "plain")
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0.1, 0, 0.5))
    cube = bpy.context.object
    np.testing.assert_array_equal(lab.render_exr(tmp_path, "no_proxy"), plain)
    proxy = grid(-0.01)
    attach(lit, ob, proxy)
    got = lab.render_exr(tmp_path, "got")
    cube.hide_render = True
    np.testing.assert_array_equal(lab.render_exr(tmp_path, "no_mesh"), plain)
    proxy.driver_remove("hide_render")
    proxy.hide_render = True
    lit.cycles.max_bounces = 0
    without = by_cycles(lit, tmp_path)
    cube.hide_render, cube.visible_camera = False, False
    ratio = (lab.render_exr(tmp_path, "with")[..., :3] / without).mean(-1)
    ours = (got[..., :3] / plain[..., :3]).mean(-1)
    shadow = ratio < 0.5
    assert shadow.sum() > 20
    assert (shadow & (ours < 0.5)).sum() / (shadow | (ours < 0.5)).sum() > 0.7
    np.testing.assert_allclose(np.median(ours[shadow]), np.median(ratio[shadow]), atol=0.12)
    assert ours[~shadow & (ours > 0.5)].mean() > 0.97


def test_shadows_of_meshes_in_viewports(lit):
    """The splats of a viewport, exact and live, under and beside the cube; its own map alone is
    drawn again when it moves; another file frees both."""
    (ob,) = (ob for ob in lit.objects if ob.get("gs_kind") == "splats")
    ob.gscore.light = 0.0
    sun = lamp(lit, "SUN")
    sun.rotation_euler = (0, 0, 0)
    attach(lit, ob, grid(-0.01))
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0.5, 0, 0.6))
    cube = bpy.context.object

    def drawn_now() -> tuple[np.ndarray, np.ndarray, tuple, dict]:
        """Colors, distances from the cube's middle, key, and maps."""
        bpy.context.view_layer.update()
        placed = [place(one) for one in sources(bpy.context.evaluated_depsgraph_get())]
        cache = SplatCache()
        (own,), exact = cache.parts(placed), cache.model(placed).splats
        np.testing.assert_array_equal(own.sh0, exact.sh0)
        color = own.sh0[:, 0].mean(1) * lab.SH_C0 + 0.5
        away = np.abs(own.means[:, :2] - cube.location[:2]).max(1)
        return color, away, placed[0].part, dict(relight._known)

    color, away, before, maps = drawn_now()
    bright = np.median(color[away > 0.4])
    assert (color[away < 0.2] < 0.1 * bright).all()
    np.testing.assert_allclose(color[away > 0.3], np.mean(COLOR), atol=1e-3)
    cube.location.x = -0.5
    color, away, after, moved = drawn_now()
    assert (color[away < 0.2] < 0.1 * bright).all() and (color[away > 0.3] > 0.9 * bright).all()
    assert before != after
    kept = [one for one in moved if one in maps]
    assert len(moved) == 2 and len(kept) == 1 and moved[kept[0]] is maps[kept[0]]
    lamps.HANDLERS["load_post"]()
    assert not relight._known
