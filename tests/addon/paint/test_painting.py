"""Strokes on splat objects. Oracles: Blender's own projection of each splat
(`world_to_camera_view`) and the brush's formula in numpy; Blender's undo."""

from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector

from addon import attributes, stored_paths
from addon.attributes import BASE
from addon.cameras.camera_math import project
from addon.cameras.render_camera import render_camera
from addon.core import join_splats
from addon.paint import paint_target
from addon.paint.brush import COLOR, OPACITY, SELECT, Brush
from addon.process.incremental_tasks import run_blocking
from addon.render.viewport import view_camera
from addon.splats import objects, replay
from tests.addon import splat_scenes as lab
from tests.addon.paint.test_brush import falloff, from_way

SIZE = (300, 200)
WAY = [(120.0, 60.0), (190.0, 110.0), (160.0, 160.0)]
"""Pixels from the lower left."""
RED = (1.0, 0.25, 0.0)
FIELDS = ("means", "quats", "scales", "opacities", "sh0", "shN")


@pytest.fixture
def ob(scene: bpy.types.Scene) -> bpy.types.Object:
    """Active splats, rotated and moved, with a camera at their side."""
    camera = lab.prepare(scene, SIZE)
    camera.location, camera.rotation_euler = (1, -3, 2.5), (0.9, 0.1, 0.3)
    made = lab.add(scene, lab.blob(900, size=1.4))
    made.rotation_euler, made.location, made.scale = (0.4, 1, 2), (0.1, 0, 0.2), (0.8, 0.8, 0.8)
    activate(made)
    return made


def activate(ob: bpy.types.Object) -> None:
    """Make an object active, with the scene updated and none of its vertices selected."""
    bpy.context.view_layer.objects.active = ob
    ob.data.vertices.foreach_set("select", np.zeros(len(ob.data.vertices), bool))
    bpy.context.view_layer.update()


def stroke(points: list[tuple[float, ...]]) -> list[dict]:
    """Points in the form of the operator."""
    return [{"name": "", "place": (*point, 0.0)[:3]} for point in points]


def base_of(ob: bpy.types.Object) -> np.ndarray:
    """[N, 4] of `radiance:base`."""
    return attributes.column(ob.data, BASE)


def shares(ob: bpy.types.Object, radius: float, hardness: float) -> np.ndarray:
    """Brush weights of the splats along WAY, [N], by Blender's projection."""
    scene, way, found = bpy.context.scene, [np.array(p) for p in WAY], []
    for vertex in ob.data.vertices:
        x, y, z = world_to_camera_view(scene, scene.camera, ob.matrix_world @ vertex.co)
        seen = z > 0 and 0 <= x < 1 and 0 <= y < 1
        distance = from_way(np.array([x * SIZE[0], y * SIZE[1]]), way) if seen else np.inf
        found.append(falloff(distance, radius, hardness))
    return np.array(found)


@pytest.mark.parametrize("does", [COLOR, SELECT])
def test_edits_during_a_stroke_are_kept(ob: bpy.types.Object, does: str) -> None:
    """Oracle: splats out of the stroke's reach have the values of another edit."""
    chosen = np.arange(900) % 2 == 0

    brush = Brush(does=does, radius=0.3, hardness=1.0, strength=1.0, color=RED)
    made = run_blocking(paint_target.begin_stroke(ob, brush, None))
    made.to(np.array(ob.matrix_world.translation))
    wanted = np.full((900, 4), 0.25, np.float32)
    attributes.fill(ob.data, BASE, "FLOAT_COLOR", wanted.reshape(-1))
    attributes.select(ob.data, chosen)
    reached = np.zeros(900, bool)
    reached[made._rows[made._stroke.share > 0]] = True
    assert 10 < reached.sum() < 800
    assert run_blocking(made.finish()) == reached.sum()
    if does == COLOR:
        np.testing.assert_array_equal(base_of(ob)[~reached], wanted[~reached])
        assert not (base_of(ob)[reached, 0] == 0.25).any()
    else:
        np.testing.assert_array_equal(attributes.selected(ob.data), chosen | reached)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_color_through_a_camera(ob: bpy.types.Object, kind: str) -> None:
    """Oracle: the splats by Blender's projection, their weights by the formula; SH, opacity and all
    else to the bit."""
    bpy.context.scene.camera.data.type = kind
    bpy.context.scene.camera.data.ortho_scale = 3.0
    before, share = objects.read(ob), shares(ob, 30, 0.3)
    assert 50 < (share > 0).sum() < 800
    how = {"radius": 30, "hardness": 0.3, "strength": 0.8, "color": RED, "front_only": False}
    assert bpy.ops.gscore.paint_stroke(stroke=stroke(WAY), **how) == {"FINISHED"}
    after = objects.read(ob)
    target = (np.array(RED) - 0.5) / lab.SH_C0
    want = before.sh0[:, 0] + 0.8 * share[:, None] * (target - before.sh0[:, 0])
    np.testing.assert_allclose(after.sh0[:, 0], want, atol=2e-3)
    np.testing.assert_array_equal(after.sh0[share == 0], before.sh0[share == 0])
    for field in ("means", "quats", "scales", "opacities", "shN"):
        np.testing.assert_array_equal(getattr(after, field), getattr(before, field))


def test_opacity_and_its_opposite(ob: bpy.types.Object) -> None:
    """Oracle: the formula; 0 erases."""
    before, share = base_of(ob), shares(ob, 40, 1.0)
    how = {"radius": 40, "hardness": 1.0, "does": OPACITY, "front_only": False}
    bpy.ops.gscore.paint_stroke(stroke=stroke(WAY), opacity=0.0, **how)
    erased = base_of(ob)
    assert (erased[share == 1, 3] == 0).all() and (share == 1).sum() > 50
    np.testing.assert_array_equal(erased[share == 0], before[share == 0])
    np.testing.assert_array_equal(erased[:, :3], before[:, :3])
    bpy.ops.gscore.paint_stroke(stroke=stroke(WAY), opacity=0.2, inverted=True, **how)
    assert (base_of(ob)[share == 1, 3] == np.float32(0.8)).all()
    objects.read(ob)  # which refuses what is no opacity


def test_selecting(ob: bpy.types.Object) -> None:
    """Oracle: the splats under the brush; the attributes stay to the bit."""
    before, under = objects.read(ob), shares(ob, 25, 0.5) > 0
    how = {"radius": 25, "does": "SELECT", "front_only": False}
    bpy.ops.gscore.paint_stroke(stroke=stroke(WAY), **how)
    np.testing.assert_array_equal(attributes.selected(ob.data), under)
    bpy.ops.gscore.paint_stroke(stroke=stroke(WAY[:1]), inverted=True, **how)
    left = attributes.selected(ob.data)
    assert 0 < left.sum() < under.sum() and not (left & ~under).any()
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(objects.read(ob), field), getattr(before, field))


def test_hidden_splats_are_not_painted(ob: bpy.types.Object) -> None:
    """Oracle: hidden in Edit Mode, filtered out, not selected: each unchanged, to the bit."""
    under = shares(ob, 60, 1.0) > 0
    hidden = np.arange(len(under)) % 3 == 0
    ob.data.vertices.foreach_set("hide", hidden)
    chosen = np.arange(len(under)) % 2 == 0
    ob.data.vertices.foreach_set("select", chosen)
    before = base_of(ob)
    ob.gscore.opacity_min = 0.5
    faint = before[:, 3] < 0.5
    how = {"stroke": stroke(WAY), "radius": 60, "hardness": 1.0, "front_only": False, "color": RED}
    bpy.ops.gscore.paint_stroke(only_selected=True, **how)
    reached = (base_of(ob) != before).any(axis=1)
    np.testing.assert_array_equal(reached, under & ~hidden & ~faint & chosen)
    assert 10 < reached.sum() < under.sum() / 3
    ob.data.vertices.foreach_set("select", np.zeros(len(under), bool))
    with pytest.raises(RuntimeError, match="turn Only Selected off"):
        bpy.ops.gscore.paint_stroke(only_selected=True, **how)


def test_around_places(ob: bpy.types.Object) -> None:
    """Oracle: distances of the vertices from the path in Blender's world."""
    way = [np.array(p) for p in ((0, 0, 0), (0.4, 0.1, 0.3))]
    before = base_of(ob)
    far = [from_way(np.array(ob.matrix_world @ v.co), way) for v in ob.data.vertices]
    share = np.array([falloff(d, 0.25, 0.5) for d in far])
    target = (np.array(RED) - 0.5) / lab.SH_C0
    bpy.ops.gscore.paint_stroke(
        stroke=stroke([tuple(p) for p in way]), way="PLACES", radius=0.25, color=RED
    )
    want = before[:, :3] + share[:, None] * (target - before[:, :3])
    np.testing.assert_allclose(base_of(ob)[:, :3], want, atol=1e-4)
    assert 20 < (share > 0).sum() < 800


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_only_the_front(scene: bpy.types.Scene, kind: str, scale: float) -> None:
    """Oracle: two walls, one behind the other; faint splats in front of both hide nothing."""
    camera = lab.prepare(scene, SIZE)
    camera.data.type, camera.data.ortho_scale, camera.location.z = kind, 2.2 * scale, 4 * scale
    veil = lab.wall(0.5, (0, 0, 1))
    veil.opacities[:] = -5
    walls = [lab.wall(0.0, (0.2, 0.2, 0.2)), lab.wall(-0.6, (0.2, 0.2, 0.2)), veil]
    ob = lab.add(scene, join_splats(walls))
    ob.scale = (scale,) * 3
    activate(ob)
    which = np.repeat([0, 1, 2], 41 * 41)
    before = base_of(ob)
    how = {"stroke": stroke([(90, 100), (210, 100)]), "radius": 35, "color": RED, "hardness": 1.0}
    bpy.ops.gscore.paint_stroke(front_only=True, **how)
    reached = (base_of(ob) != before).any(axis=1)
    assert reached[which == 0].sum() > 100 and not reached[which == 1].any()
    assert reached[which == 2].sum() > 100
    bpy.ops.gscore.paint_stroke(front_only=False, **how)
    assert (base_of(ob) != before).any(axis=1)[which == 1].sum() > 100


@pytest.mark.parametrize("perspective", [True, False])
def test_only_the_front_of_a_view(scene: bpy.types.Scene, perspective: bool) -> None:
    """Oracle: as above, in a 3D view; an orthographic one also shows a thousand units behind it."""
    ob = lab.add(scene, join_splats([lab.wall(0.0, (0, 0, 0)), lab.wall(-0.6, (0, 0, 0))]))
    activate(ob)
    view, window = np.eye(4), np.diag([0.8, 1.2, -1e-3, 1.0])
    view[2, 3] = -4
    if perspective:
        window = np.array([[2.0, 0, 0, 0], [0, 3, 0, 0], [0, 0, -1.002, -0.2002], [0, 0, -1, 0]])
    camera = view_camera(view, window, *SIZE, perspective=perspective)
    before, middle = base_of(ob), np.array([150.0, 100])
    run_blocking(
        paint_target.paint(ob, [middle], Brush(radius=40, color=RED), camera, front_only=True)
    )
    reached = (base_of(ob) != before).any(axis=1)
    assert reached[: 41 * 41].sum() > 30 and not reached[41 * 41 :].any()


def test_undo_and_edit_mode(ob: bpy.types.Object) -> None:
    """Oracle: the attribute before; the mode in which it was painted."""
    before, name = base_of(ob), ob.name
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.gscore.paint_stroke(stroke=stroke(WAY), color=RED)
    assert ob.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    assert (base_of(ob) != before).any()
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    np.testing.assert_array_equal(base_of(bpy.data.objects[name]), before)


def test_refusals(ob: bpy.types.Object) -> None:
    """Oracle: error messages, and the attribute to the bit."""
    before = base_of(ob)
    with pytest.raises(RuntimeError, match="stroke has no points"):
        bpy.ops.gscore.paint_stroke()
    with pytest.raises(RuntimeError, match="has no object nobody"):
        bpy.ops.gscore.paint_stroke(stroke=stroke(WAY), camera="nobody")
    with pytest.raises(RuntimeError, match="is not a camera"):
        bpy.ops.gscore.paint_stroke(stroke=stroke(WAY), camera=ob.name)
    bpy.context.scene.camera = None
    with pytest.raises(RuntimeError, match="has no camera to paint through"):
        bpy.ops.gscore.paint_stroke(stroke=stroke(WAY))
    with pytest.raises(RuntimeError, match="needs a 3D view"):
        bpy.ops.gscore.paint_splats()
    with pytest.raises(ValueError, match="Front Only needs a view"):
        run_blocking(paint_target.paint(ob, [np.zeros(3)], Brush(radius=1), None, front_only=True))
    np.testing.assert_array_equal(base_of(ob), before)


def test_an_uneven_scale_says_what_to_do(ob: bpy.types.Object) -> None:
    """Oracle: the message names the object; without Front Only, which renders a picture, it
    works."""
    ob.scale = (1, 2, 1)
    with pytest.raises(RuntimeError, match=f"{ob.name} cannot be transformed"):
        bpy.ops.gscore.paint_stroke(stroke=stroke(WAY))
    before = base_of(ob)
    bpy.ops.gscore.paint_stroke(stroke=stroke(WAY), front_only=False)
    assert (base_of(ob) != before).any()


def test_no_splats_and_none_in_reach(scene: bpy.types.Scene) -> None:
    """Oracle: the report; nothing raises."""
    lab.prepare(scene, SIZE)
    ob = lab.add(scene, attributes.NO_SPLATS)
    activate(ob)
    assert bpy.ops.gscore.paint_stroke(stroke=stroke(WAY)) == {"FINISHED"}
    other = lab.add(scene, lab.blob(20, center=(0, 0, 90)))
    activate(other)
    before = base_of(other)
    assert bpy.ops.gscore.paint_stroke(stroke=stroke(WAY)) == {"FINISHED"}
    np.testing.assert_array_equal(base_of(other), before)


def test_a_dropped_stroke_leaves_nothing(ob: bpy.types.Object) -> None:
    """Oracle: the attribute; displays other than the live one had been written to."""
    before = base_of(ob)
    view = render_camera(bpy.context.scene.camera, bpy.context.scene)
    made = run_blocking(
        paint_target.begin_stroke(ob, Brush(radius=40, does=COLOR, color=RED), view)
    )
    for point in WAY:
        made.to(np.array(point))
        made.show()
    assert (base_of(ob) != before).any()
    made.cancel()
    np.testing.assert_array_equal(base_of(ob), before)


def test_splats_that_were_replaced_meanwhile(ob: bpy.types.Object) -> None:
    """Oracle: the message, and the unchanged new splats."""
    view = render_camera(bpy.context.scene.camera, bpy.context.scene)
    made = run_blocking(paint_target.begin_stroke(ob, Brush(radius=400, color=RED), view))
    made.to(np.array(WAY[0]))
    objects.refresh(ob, lab.blob(30))
    with pytest.raises(ValueError, match="were replaced during the stroke"):
        run_blocking(made.finish())
    np.testing.assert_array_equal(objects.read(ob).sh0, lab.blob(30).sh0)


def cursor_at(ob: bpy.types.Object, place: tuple[float, float, float]) -> None:
    """Move the source of clones to a place in an object's space."""
    bpy.context.scene.cursor.location = ob.matrix_world @ Vector(place)


def floor(scene: bpy.types.Scene) -> bpy.types.Object:
    """An active wall, white where x is below 0, with a camera before it; moved and turned."""
    splats = lab.wall(0.0, (0.6, 0.5, 0.4), along=41)
    splats.sh0[splats.means[:, 0] < 0] = (1.0 - 0.5) / lab.SH_C0
    camera = lab.prepare(scene, (200, 200))
    ob = lab.add(scene, splats, "floor")
    ob.rotation_euler, ob.location = (0.3, 0.1, 0.5), (1, 2, 0)
    bpy.context.view_layer.update()
    camera.matrix_world = ob.matrix_world @ Matrix.Translation((0, 0, 3))
    activate(ob)
    return ob


@pytest.mark.parametrize("front_only", [False, True])
def test_clones_lie_beside_their_sources(scene: bpy.types.Scene, front_only: bool) -> None:
    """Oracle: each copy is a white splat shifted along the wall, to around the stroke; opacities by
    the formula; all others to the bit, and the selection too; undo, and the record for replay."""
    ob = floor(scene)
    before, chosen = objects.read(ob), np.zeros(len(ob.data.vertices), bool)
    chosen[::7] = True
    attributes.select(ob.data, chosen)
    cursor_at(ob, (-0.5, 0, 0))
    bpy.ops.ed.undo_push(message="start")
    way = [(140.0, 100.0, 0.0), (140.0, 120.0, 0.0)]
    how = {"does": "CLONE", "radius": 15, "hardness": 0.5, "strength": 0.8}
    given = {"stroke": stroke(way), "front_only": front_only, **how}
    assert bpy.ops.gscore.paint_stroke(**given) == {"FINISHED"}
    ob = bpy.data.objects["floor"]
    now, count = objects.read(ob), len(before)
    assert len(now) > count + 20
    for name in ("means", "quats", "scales", "opacities", "sh0", "shN"):
        np.testing.assert_array_equal(getattr(now, name)[:count], getattr(before, name))
    copies = now.subset(slice(count, None))
    view = render_camera(scene.camera, scene)
    world = np.array(ob.matrix_world)
    at, _ = project(copies.means @ world[:3, :3].T + world[:3, 3], view.K, view.viewmat)
    path = [np.array([x, 200 - y]) for x, y, _ in way]
    share = 0.8 * np.array([falloff(from_way(point, path), 15, 0.5) for point in at])
    assert share.min() > 0
    alpha = 1 / (1 + np.exp(-copies.opacities))
    np.testing.assert_allclose(alpha, share / (1 + np.exp(-before.opacities[0])), atol=0.01)
    np.testing.assert_array_equal(copies.sh0, before.sh0[:1].repeat(len(copies), 0))
    shift = copies.means[:, None] - before.means
    shift = shift[np.abs(shift[..., 1:]).max(2) < 1e-4].reshape(len(copies), -1, 3)[:, 0]
    assert np.ptp(shift[:, 1:]) < 1e-3
    np.testing.assert_array_equal(attributes.selected(ob.data)[:count], chosen)
    assert not attributes.selected(ob.data)[count:].any()
    assert ["cloned" in one for one in replay.edits_of(ob)] == [True]
    bpy.ops.ed.undo_push(message="cloned")
    bpy.ops.ed.undo()
    assert len(bpy.data.objects["floor"].data.vertices) == count


def test_cloned_again_on_new_splats(scene: bpy.types.Scene) -> None:
    """Those of the next training get the copies with the opacity of the stroke's middle."""
    ob = floor(scene)
    stored_paths.write(ob, stored_paths.SOURCE, Path("/captures/floor"))
    cursor_at(ob, (-0.5, 0, 0))
    given = {"stroke": stroke([(140, 100, 0)]), "does": "CLONE", "radius": 15, "strength": 0.4}
    assert bpy.ops.gscore.paint_stroke(**given) == {"FINISHED"}
    before = lab.wall(0.0, (0.6, 0.5, 0.4), along=41)
    new = lab.add(scene, before, "new")
    stored_paths.write(new, stored_paths.SOURCE, Path("/captures/floor"))
    activate(new)
    assert bpy.ops.gscore.replay_edits() == {"FINISHED"}
    copies = objects.read(new).subset(slice(len(before), None))
    assert len(copies) >= len(ob.data.vertices) - len(before) > 10
    alpha = 1 / (1 + np.exp(-copies.opacities))
    np.testing.assert_allclose(alpha, 0.4 / (1 + np.exp(-before.opacities[0])), rtol=1e-4)


@pytest.mark.parametrize(
    "case", ["away", "out of view", "protected", "outside", "faint", "scale", "edges"]
)
def test_strokes_that_copy_nothing(scene: bpy.types.Scene, case: str) -> None:
    """Oracle: the message, without one if the brush is too faint; nothing is added."""
    ob = floor(scene)
    cursor_at(ob, (5 if case == "away" else 0.5, 0, 0))
    given = {"stroke": stroke([(100, 100, 0)]), "does": "CLONE", "radius": 15}
    wanted = "Ctrl click"
    if case == "out of view":
        scene.camera.location += Vector((0, 0, 90))
        scene.camera.rotation_euler = (np.pi / 2, 0, 0)
    elif case == "protected":
        attributes.select(ob.data, objects.read(ob).means[:, 0] < 0)
        given["only_selected"] = True
    elif case == "outside":
        given["stroke"], wanted = stroke([(-5, 100, 0), (100, 100, 0)]), "outside the picture"
    elif case == "faint":
        given["strength"] = 0.0
    elif case == "scale":
        ob.scale, given["way"], wanted = (0, 0, 0), "PLACES", "scale of 0"
    elif case == "edges":
        ob.data.edges.add(1)
        ob.data.update()
        wanted = "edges or faces"
    bpy.context.view_layer.update()
    if case == "faint":
        assert bpy.ops.gscore.paint_stroke(**given) == {"FINISHED"}
    else:
        assert wanted in lab.error_of(lambda: bpy.ops.gscore.paint_stroke(**given))
    assert len(ob.data.vertices) == 41 * 41
    assert attributes.HEALED not in ob.data.attributes
