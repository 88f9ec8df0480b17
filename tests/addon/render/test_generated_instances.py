"""Instances of holdout objects hide splats. Oracle: the picture with the same instances realised,
by Blender's own node, or as separate objects."""

from collections.abc import Callable

import bpy
import numpy as np
import pytest

from addon import compat
from addon.equality import same
from addon.render import (
    compositing_scene,
    compositor,
    holdout_meshes,
    instances,
    unsupported_settings,
)
from addon.render.engine import SplatsRenderEngine
from addon.render.holdout_meshes import HoldoutMeshes
from addon.triangles import Triangles
from tests.addon import splat_scenes as lab

SIZE = 90, 70
SHAPES = ("object", "collection", "primitive", "nested")


def link(collection: bpy.types.Collection, name: str, data: bpy.types.ID | None):
    """Link a new object."""
    ob = bpy.data.objects.new(name, data)
    collection.objects.link(ob)
    return ob


def quad(name: str, half: float) -> bpy.types.Mesh:
    """A square across the z axis, with one corner cut off."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(
        [(-half, -half, 0), (half, -half, 0), (half, half / 2, 0), (-half, half, 0)],
        [],
        [(0, 1, 2, 3)],
    )
    return mesh


def points(name: str = "corners") -> bpy.types.Mesh:
    """Three corners without a face."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(-0.5, 0.1, 0), (0.4, 0.4, 0.3), (0.3, -0.5, 0.6)], [], [])
    return mesh


def on_points(shown: bpy.types.ID | None, *, realized: bool = False) -> bpy.types.NodeTree:
    """Nodes that instance an object, a collection or a cube on points."""
    tree = bpy.data.node_groups.new("On Points", "GeometryNodeTree")
    tree.is_modifier = True
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    given, result = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    put = tree.nodes.new("GeometryNodeInstanceOnPoints")
    put.inputs["Rotation"].default_value = (0.2, 0.3, 0.4)
    put.inputs["Scale"].default_value = (0.9, 1.1, 1.0)
    if shown is None:
        source = tree.nodes.new("GeometryNodeMeshCube")
        source.inputs["Size"].default_value = (0.3, 0.2, 0.1)
    elif isinstance(shown, bpy.types.Object):
        source = tree.nodes.new("GeometryNodeObjectInfo")
        source.inputs["Object"].default_value = shown
        source.inputs["As Instance"].default_value = True
    else:
        source = tree.nodes.new("GeometryNodeCollectionInfo")
        source.inputs["Collection"].default_value = shown
    geometry = next(s for s in source.outputs if s.type == "GEOMETRY")
    tree.links.new(given.outputs[0], put.inputs["Points"])
    tree.links.new(geometry, put.inputs["Instance"])
    last = put
    if realized:
        last = tree.nodes.new("GeometryNodeRealizeInstances")
        tree.links.new(put.outputs[0], last.inputs[0])
    tree.links.new(last.outputs[0], result.inputs[0])
    return tree


def a_collection() -> bpy.types.Collection:
    """Two meshes and a text, one of them hidden, with an instance offset."""
    group = bpy.data.collections.new("shown")
    link(group, "near", quad("near", 0.15)).location = 0.1, 0, 0.3
    link(group, "hidden", quad("hidden", 2.0)).hide_render = True
    bpy.data.objects["hidden"].hide_viewport = True
    text = bpy.data.curves.new("text", "FONT")
    text.body, text.size = "H", 0.5
    link(group, "text", text).location = -0.2, 0, 0
    group.instance_offset = 0.1, -0.1, 0.2
    return group


def owner(scene: bpy.types.Scene, shape: str) -> tuple[bpy.types.Object, Callable[[], None]]:
    """An object in front of the splats whose nodes make instances, and the node that realises
    them."""
    shown = None
    if shape in ("object", "nested"):
        shown = link(scene.collection, "shown", quad("shown", 0.2))
        shown.location = 90, 0, 0  # itself out of view
    elif shape == "collection":
        shown = a_collection()
    if shape == "nested":
        small = link(scene.collection, "small", quad("small", 0.08))
        small.location = 90, 0, 0
        shown.data = points("inner")
        shown.modifiers.new("nodes", "NODES").node_group = on_points(small)
    ob = link(scene.collection, "owner", points())
    ob.location, ob.rotation_euler, ob.scale = (0, 0, 1), (0.1, 0, 0.5), (1, 1.2, 1)
    ob.is_holdout = True
    modifier = ob.modifiers.new("nodes", "NODES")
    modifier.node_group = on_points(shown)

    def realize() -> None:
        if shape == "collection":  # hidden objects would be realised too
            shown.objects.unlink(bpy.data.objects["hidden"])
        modifier.node_group = on_points(shown, realized=True)

    return ob, realize


def alike(got: np.ndarray, wanted: np.ndarray) -> None:
    """Compare pictures; Blender's float32 positions may change one of a pixel's 16 samples."""
    off = np.abs(got - wanted).max(-1)
    assert off.max() < 0.1 and (off > 1e-5).sum() <= 3


@pytest.fixture
def held(scene: bpy.types.Scene) -> bpy.types.Scene:
    """A scene of splats, on an empty background."""
    lab.prepare(scene)
    scene.render.film_transparent = True
    lab.add(scene, lab.wall(0.0, (0.8, 0.4, 0.2), half=2.0))
    return scene


@pytest.fixture(params=["as it comes", "walked"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both ways to read instances; before 4.5 there is one."""
    if request.param == "walked":
        monkeypatch.setattr(instances, "needs_walk", instances.may_grow)


@pytest.mark.parametrize("shape", SHAPES)
def test_instances_of_nodes_hide_what_is_behind_them(held, tmp_path, way, shape):
    """Oracle: the picture with Realize Instances, and that without the object."""
    ob, realize = owner(held, shape)
    got = lab.render_exr(tmp_path, "got")
    realize()
    wanted = lab.render_exr(tmp_path, "wanted")
    ob.is_holdout = False
    free = lab.render_exr(tmp_path, "free")
    alike(got, wanted)
    assert 60 < (np.abs(got - free).max(-1) > 0.5).sum() < 3000


@pytest.mark.parametrize("how", ["instance", "collection", "turned off", "not seen"])
def test_instancer_itself_is_included(held, tmp_path, way, how):
    """Oracle: realised, in a holdout or instanced collection; nothing of disabled objects."""
    ob, realize = owner(held, "object")
    if how in ("instance", "collection"):
        group = bpy.data.collections.new("cut")
        held.collection.objects.unlink(ob)
        group.objects.link(ob)
        ob.is_holdout = False
        if how == "collection":
            held.collection.children.link(group)
            bpy.context.view_layer.layer_collection.children["cut"].holdout = True
        else:
            shower = link(held.collection, "shower", None)
            shower.instance_type, shower.instance_collection = "COLLECTION", group
            shower.location, shower.is_holdout = (0.3, -0.2, 0.1), True
    elif how == "turned off":
        ob.modifiers[0].show_render = False
    else:
        ob.visible_camera = False
    got = lab.render_exr(tmp_path, "got")
    hidden = got[..., 3] < 0.5
    if how in ("turned off", "not seen"):
        assert not hidden[10:60, 10:80].any()
        return
    realize()
    alike(got, lab.render_exr(tmp_path, "wanted"))
    assert hidden[10:60, 10:80].sum() > 60


def test_instances_on_corners_and_of_particles(held, tmp_path):
    """Oracle: a separate object at each corner; twenty particles of one mesh."""
    ob = link(held.collection, "owner", points())
    ob.is_holdout, ob.location = True, (0, 0, 1)
    shown = link(held.collection, "shown", quad("shown", 0.2))
    shown.parent, ob.instance_type = ob, "VERTS"
    got = lab.render_exr(tmp_path, "got")
    ob.instance_type = "NONE"
    shown.hide_render = True
    for vertex in ob.data.vertices:
        one = link(held.collection, "one", shown.data)
        one.location, one.is_holdout = vertex.co + ob.location, True
    alike(got, lab.render_exr(tmp_path, "wanted"))
    for one in [o for o in held.objects if o.name.startswith("one")]:
        bpy.data.objects.remove(one)
    free = lab.render_exr(tmp_path, "free")
    assert (np.abs(got - free).max(-1) > 0.5).sum() > 100
    ob.data = quad("emitter", 1.0)
    ob.modifiers.new("grass", "PARTICLE_SYSTEM")
    settings = ob.particle_systems[0].settings
    settings.type, settings.count = "HAIR", 20
    settings.render_type, settings.instance_object = "OBJECT", shown
    ob.show_instancer_for_render = True
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    of_emitter, of_hairs = HoldoutMeshes().of(depsgraph)
    assert len(of_emitter.matrices) == 1 and len(of_hairs.matrices) == 20
    assert len(of_hairs.triangles.vertices) == len(shown.data.vertices)


def grow_hair(ob: bpy.types.Object, shown: bpy.types.Object, count: int) -> None:
    """Instance an object many times as hair of another one."""
    ob.modifiers.new("grass", "PARTICLE_SYSTEM")
    settings = ob.particle_systems[0].settings
    settings.type, settings.count = "HAIR", count
    settings.render_type, settings.instance_object = "OBJECT", shown


def counts() -> dict[tuple[int, float], int]:
    """Number of holdout meshes, by their number of corners and largest coordinate."""
    bpy.context.view_layer.update()
    found = HoldoutMeshes().of(bpy.context.evaluated_depsgraph_get())
    keys = [(len(m.triangles.vertices), round(float(m.triangles.vertices.max()), 2)) for m in found]
    assert len(keys) == len(set(keys))
    return {key: len(mesh.matrices) for key, mesh in zip(keys, found, strict=True)}


@pytest.mark.parametrize("nested", [False, True])
def test_instances_of_an_instanced_object_are_holdouts(held, nested):
    """Oracle: the emitter once and each of its hairs; nothing else in the collection."""
    group = bpy.data.collections.new("cut")
    link(group, "before", quad("before", 0.31))
    shown = link(held.collection, "shown", quad("shown", 0.2))
    emitter = link(group, "emitter", quad("emitter", 1.0))
    emitter.is_holdout = True
    link(group, "hidden", quad("hidden", 0.32)).hide_viewport = True
    link(group, "after", quad("after", 0.33))
    other = link(group, "other", quad("other", 0.9))
    grow_hair(emitter, shown, 20)
    grow_hair(other, shown, 7)
    shower = link(held.collection, "shower", None)
    shower.instance_type, shower.instance_collection = "COLLECTION", group
    if nested:
        outer = bpy.data.collections.new("outer")
        link(outer, "first", quad("first", 0.34))
        held.collection.objects.unlink(shower)
        outer.objects.link(shower)
        above = link(held.collection, "above", None)
        above.instance_type, above.instance_collection = "COLLECTION", outer
    assert counts() == {(4, 1.0): 1, (4, 0.2): 20}


@pytest.mark.parametrize("render", [False, True])
@pytest.mark.parametrize("how", ["faces", "hair", "nodes", "in a collection", "in a set"])
def test_instances_hide_without_their_instancer(held, tmp_path, monkeypatch, way, how, render):
    """Oracle: the holdouts with Show Instancer, without the faces of the instancer."""
    scene = held
    if how == "in a set":
        scene = held.background_set = bpy.data.scenes.new("set")
    shown = link(scene.collection, "shown", quad("shown", 0.2))
    ob = link(scene.collection, "owner", quad("owner", 1.0))
    ob.is_holdout = True
    if how in ("faces", "in a set"):
        shown.parent, ob.instance_type = ob, "FACES"
    elif how == "nodes":
        tree = on_points(shown)
        ob.modifiers.new("nodes", "NODES").node_group = tree
        join, (made,) = tree.nodes.new("GeometryNodeJoinGeometry"), tree.nodes[1].inputs[0].links
        for socket in (tree.nodes[0].outputs[0], made.from_socket):
            tree.links.new(socket, join.inputs[0])
        tree.links.new(join.outputs[0], tree.nodes[1].inputs[0])
    else:
        grow_hair(ob, shown, 20)
    off = [ob]
    if how == "in a collection":
        group = bpy.data.collections.new("cut")
        held.collection.objects.unlink(ob)
        group.objects.link(ob)
        shower = link(held.collection, "shower", None)
        shower.instance_type, shower.instance_collection = "COLLECTION", group
        off.append(shower)

    def hiding() -> dict[tuple[int, float], int]:
        if not render:
            return counts()
        found = {}

        def of(self: HoldoutMeshes, depsgraph: bpy.types.Depsgraph):
            for mesh in kept(self, depsgraph):
                corners = mesh.triangles.vertices
                found[len(corners), round(float(corners.max()), 2)] = len(mesh.matrices)
            return ()

        kept = HoldoutMeshes.of
        with monkeypatch.context() as patch:
            patch.setattr(HoldoutMeshes, "of", of)
            lab.render_exr(tmp_path, "seen")
        return found

    with_it = hiding()
    for one in off:
        one.show_instancer_for_render = one.show_instancer_for_viewport = False
    without = hiding()
    assert with_it.pop((4, 1.0)) == 1 and with_it
    assert without == with_it
    for one in off:
        one.hide_render = True
        one.hide_viewport = True
    assert hiding() == {}


def test_viewports_follow_what_nodes_make(held, way):
    """Oracle: reading the depsgraph without a cache, at the same time."""
    ob, _ = owner(held, "object")
    shared = HoldoutMeshes()

    def handler(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
        shared.forget_changed(depsgraph)

    bpy.app.handlers.depsgraph_update_post.append(handler)
    try:
        bpy.context.view_layer.update()
        before = shared.of(bpy.context.evaluated_depsgraph_get())
        again = shared.of(bpy.context.evaluated_depsgraph_get())
        assert same(before, again)
        assert before[0].triangles is again[0].triangles  # nothing is copied again
        for change in (
            lambda: setattr(ob.location, "x", 0.2),
            lambda: bpy.data.meshes["shown"].transform(np.diag([2.0, 1, 1, 1])),
            lambda: setattr(ob.data.vertices[0].co, "x", 0.3),
        ):
            change()
            ob.data.update()
            bpy.data.meshes["shown"].update()
            bpy.context.view_layer.update()
            after = shared.of(bpy.context.evaluated_depsgraph_get())
            assert same(after, HoldoutMeshes().of(bpy.context.evaluated_depsgraph_get()))
            assert not same(before, after)
            before = after
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(handler)


@pytest.mark.parametrize("shape", ["object", "collection"])
def test_composites_have_them(held, tmp_path, shape):
    """Oracle: the same composite with realised instances."""
    held.render.engine = "CYCLES"
    held.cycles.samples, held.cycles.use_denoising = 1, False
    ob, realize = owner(held, shape)
    bpy.context.view_layer.update()
    ob.is_holdout = False
    compositor.set_up(held)
    ob.is_holdout = True
    assert unsupported_settings.NOT_TAKEN_OVER.format("owner") in "".join(
        unsupported_settings.without_effect(
            unsupported_settings.Shown(
                scene=held[compositing_scene.SPLAT_SCENE],
                layer=held[compositing_scene.SPLAT_SCENE].view_layers[0],
                camera=held.camera,
            )
        )
    )
    compositor.set_up(held)
    got = lab.render_exr(tmp_path, "got")
    realize()
    compositor.set_up(held)
    wanted = lab.render_exr(tmp_path, "wanted")
    alike(got, wanted)
    assert (got[10:60, 10:80, 3] < 0.5).sum() > 60


def test_too_many_triangles_are_refused(held, tmp_path, monkeypatch):
    """Oracle: an error with both numbers, and no picture."""
    owner(held, "object")
    monkeypatch.setattr(holdout_meshes, "MOST_TRIANGLES", 5)
    with pytest.raises(RuntimeError, match="have 6 triangles with all instances; the limit is"):
        lab.render_exr(tmp_path, "none")


def test_instancers_are_not_reported_as_faceless(held):
    """Oracle: the message about objects without faces, for curves without and with nodes."""
    hair = link(held.collection, "hair", bpy.data.hair_curves.new("hair"))
    hair.is_holdout = True
    bpy.context.view_layer.update()
    shown = unsupported_settings.Shown(scene=held, layer=held.view_layers[0], camera=held.camera)
    sentence = "Holdout of hair hides no splats"
    assert sentence in "".join(unsupported_settings.without_effect(shown))
    hair.modifiers.new("nodes", "NODES").node_group = on_points(None)
    assert sentence not in "".join(unsupported_settings.without_effect(shown))


def test_points_that_become_faces_hide(held, way):
    """Oracle: a point cloud, which has no faces itself, whose nodes make a cube."""
    tree = on_points(None)
    cube = next(n for n in tree.nodes if n.bl_idname == "GeometryNodeMeshCube")
    result = next(n for n in tree.nodes if n.bl_idname == "NodeGroupOutput")
    tree.links.new(cube.outputs[0], result.inputs[0])
    cloud = link(held.collection, "cloud", bpy.data.hair_curves.new("cloud"))
    cloud.is_holdout = True
    cloud.modifiers.new("nodes", "NODES").node_group = tree
    bpy.context.view_layer.update()
    found = HoldoutMeshes().of(bpy.context.evaluated_depsgraph_get())
    assert [len(m.triangles.triangles) * len(m.matrices) for m in found] == [12]
    assert compat.matrix_to_numpy(cloud.matrix_world).tolist() == found[0].matrices[0].tolist()


def test_a_viewport_that_begins_remembers_nothing(monkeypatch):
    """Oracle: changes made while no viewport was drawn, which were not reported."""
    shared = HoldoutMeshes()
    shared._known[1] = Triangles(np.zeros((3, 3)), np.zeros((1, 3), np.int32))
    monkeypatch.setattr(holdout_meshes, "SHARED", shared)

    class Engine:
        _view = None

    engine = Engine()
    SplatsRenderEngine._viewport(engine)
    assert not shared._known
    shared._known[1] = Triangles(np.zeros((3, 3)), np.zeros((1, 3), np.int32))
    SplatsRenderEngine._viewport(engine)
    assert shared._known
