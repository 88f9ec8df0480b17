"""The viewport's pictures without a window. Oracles are named in the tests."""

import threading
import time
from dataclasses import replace

import bpy
import numpy as np
import pytest

from addon.cameras.render_camera import render_camera
from addon.compat import TEXTURES_ARE_ENCODED, matrix_to_numpy
from addon.core import CancelFlag, Cancelled, Splats, render
from addon.equality import same
from addon.render import mesh_copies, picture, viewport, viewport_copies
from addon.render.color import EXPONENT, over_view
from addon.render.mesh_copies import HIDDEN, SELECTED
from addon.render.model import SplatCache
from addon.render.scene import Placed, sources
from addon.render.selections import Tinted, marks_of
from addon.splats import filters
from addon.splats.point_attributes import zeroed
from tests.addon import splat_scenes as lab
from tests.light_changes import decode, encode


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_view_camera_is_the_camera_of_the_matrices(scene, kind):
    """Oracle: `render_camera` of a Blender camera with the same matrices."""
    ob = lab.prepare(scene, (120, 70))
    ob.rotation_euler, ob.data.type = (0.3, -0.2, 0.9), kind
    ob.data.shift_x, ob.data.shift_y, ob.data.ortho_scale = 0.1, -0.07, 3.0
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    view = np.linalg.inv(matrix_to_numpy(ob.matrix_world))
    window = matrix_to_numpy(ob.calc_matrix_camera(depsgraph, x=120, y=70))
    got = viewport.view_camera(view, window, 120, 70, perspective=kind == "PERSP")
    want = render_camera(ob, scene, depsgraph=depsgraph)
    np.testing.assert_allclose(got.K, want.K, atol=1e-3)
    assert got.orthographic == want.orthographic
    if kind == "PERSP":
        np.testing.assert_allclose(got.viewmat, want.viewmat, atol=1e-6)
        assert got.near == pytest.approx(want.near, rel=1e-3)
    else:  # moved along its axis, which changes only z
        np.testing.assert_allclose(got.viewmat[:2], want.viewmat[:2], atol=1e-6)
        moved = got.viewmat[2, 3] - want.viewmat[2, 3]
        assert got.near - moved == pytest.approx(want.near, abs=1e-3)


def request_for(scene, splats, size=(96, 64), **options):
    """A request for a picture from the scene's camera."""
    ob = lab.add(scene, splats)
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    made, complete = viewport_copies.Copies(), False
    while not complete:
        placed, complete = made.copied(sources(depsgraph))
    return viewport.Request(
        placed=placed,
        holdout_meshes=(),
        camera=render_camera(
            scene.camera, scene, depsgraph=depsgraph, width=size[0], height=size[1]
        ),
        options=picture.Options(**options),
        transparent=False,
        to_scene=np.eye(3),
    ), ob


def wait(renderer, seconds=60.0):
    """Wait until the renderer has finished its request."""
    until = time.monotonic() + seconds
    while renderer.busy and time.monotonic() < until:
        time.sleep(0.01)
    assert not renderer.busy


def test_painter_ends_with_the_full_picture(scene):
    """Oracle: gscore.render, whatever smaller pictures came before."""
    lab.prepare(scene, (96, 64))
    splats = lab.blob()
    request, _ = request_for(scene, splats)
    renderer = viewport.ViewRenderer(SplatCache())
    renderer._factor = 4
    renderer.submit(request)
    wait(renderer)
    camera = request.camera
    want = render(splats, camera.K, camera.viewmat, 96, 64, near=camera.near)
    np.testing.assert_allclose(encode(renderer.pixels[::-1, :, :3]), want.rgb, atol=1e-4)
    assert renderer.fresh and not renderer.problem
    renderer.fresh = False
    renderer.submit(request)  # an equal request: nothing to do
    assert not renderer.busy
    renderer.close()


def test_pictures_appear_while_the_view_turns(scene):
    """Oracle: the number of pictures. Requests come faster than pictures are drawn, as during an
    orbit."""
    lab.prepare(scene, (96, 64))
    request, _ = request_for(scene, lab.veil(2000), size=(1200, 900))
    renderer, shown = viewport.ViewRenderer(SplatCache()), set()
    until = time.monotonic() + 60
    while time.monotonic() < until and len(shown) < 4:
        turned = request.camera.viewmat.copy()
        turned[0, 3] += 1e-3 * (time.monotonic() % 1)
        renderer.submit(replace(request, camera=replace(request.camera, viewmat=turned)))
        shown.add(id(renderer.pixels) if renderer.fresh else None)
        renderer.fresh = False
        time.sleep(0.02)
    renderer.close()
    assert len(shown - {None}) >= 3


def test_a_new_request_stops_the_old_one(scene):
    """Oracle: how the old picture ends, which would take many seconds."""
    begun, ends = threading.Event(), []

    class Large(viewport.Request):
        def render(self, *arguments):
            begun.set()
            try:
                return super().render(*arguments)
            except Cancelled as error:
                ends.append(error)
                raise

    lab.prepare(scene, (96, 64))
    quick, _ = request_for(scene, lab.veil())
    slow = Large(**vars(quick) | {"camera": replace(quick.camera, width=3000, height=3000)})
    renderer = viewport.ViewRenderer(SplatCache())
    renderer.submit(slow)
    assert begun.wait(60)
    renderer.submit(quick)
    wait(renderer)
    assert len(ends) == 1 and renderer.pixels.shape == (64, 96, 4)
    renderer.close()


def test_problems_are_sentences(scene):
    """Oracle: the message of the final render."""
    lab.prepare(scene, (96, 64))
    request, ob = request_for(scene, lab.blob())
    placed = [type(p)(**{**vars(p), "matrix": np.diag([1.0, 2, 1, 1])}) for p in request.placed]
    renderer = viewport.ViewRenderer(SplatCache())
    renderer.submit(type(request)(**{**vars(request), "placed": placed}))
    wait(renderer)
    assert ob.name in renderer.problem and "unevenly" in renderer.problem
    assert renderer.pixels is None
    renderer.close()


def test_copying_is_spread_over_redraws(scene, monkeypatch):
    """Oracle: no redraw copies more than one attribute after its time limit; all are copied in the
    end."""
    lab.prepare(scene)
    lab.add(scene, lab.blob(2000))
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    monkeypatch.setattr(viewport_copies, "COPY_BUDGET", 0.0)
    made, redraws = viewport_copies.Copies(), 0
    shown = sources(depsgraph)
    while not (found := made.copied(shown))[1]:
        assert not found[0] and made.under_way(shown)
        assert not made.under_way([])  # another view, which shows none of them
        redraws += 1
        assert redraws < 100
    placed = found[0]
    assert not made.under_way(shown)
    assert redraws == 12  # position, scale, rotation, base and 8 of SH
    assert len(SplatCache().model(placed).splats) == 2000


def test_a_copy_waits_for_memory(scene, monkeypatch):
    """Oracle: a copy of the same mesh without the thread; a waiting step copies nothing."""
    ob, may_end = lab.add(scene, lab.blob(2000)), threading.Event()

    def slow(*given):
        assert may_end.wait(60)
        return zeroed(*given)

    monkeypatch.setattr(mesh_copies, "zeroed", slow)
    freezer = mesh_copies.Freezer(ahead=0)
    assert freezer.step(ob.data, ob.name) is None and freezer.waits
    assert freezer.step(ob.data, ob.name) is None and not freezer._copy.columns
    may_end.set()
    while (copy := freezer.step(ob.data, ob.name)) is None:
        time.sleep(0.001)
    assert copy.fingerprint == mesh_copies.freeze(ob.data, ob.name).fingerprint
    assert not freezer.waits


@pytest.mark.parametrize("filtered", [False, True])
def test_selection_reaches_the_renderer(scene: bpy.types.Scene, filtered: bool) -> None:
    """Oracle: vertices selected and hidden by Blender's own operators. In Edit Mode a selection
    does not change geometry: splats are not copied again, but the selection is."""
    ob = lab.add(scene, lab.blob(200))
    bpy.context.view_layer.objects.active = ob
    ob.gscore.opacity_min = 0.6 if filtered else 0.0
    keep = filters.visible_mask(ob)
    some = np.arange(200) % 3 == 0
    made = viewport_copies.Copies()
    seen: list[bool] = []

    def copied() -> Placed:
        found, complete = [], False
        while not complete:
            found, complete = made.copied(sources(bpy.context.evaluated_depsgraph_get()))
        return found[0]

    def look() -> np.ndarray | None:
        placed = copied()
        seen.append(placed.frozen.columns["position"] is before)
        return marks_of(placed, Tinted.ALL)

    def changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
        made.forget_changed(depsgraph)

    bpy.app.handlers.depsgraph_update_post.append(changed)
    try:
        ob.data.vertices.foreach_set("select", some)
        ob.data.update()
        bpy.context.view_layer.update()
        before = None
        assert (look() == some[keep]).all()  # stored, in Object Mode
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.context.scene.tool_settings.mesh_select_mode = (True, False, False)
        bpy.context.view_layer.update()
        look()
        before = copied().frozen.columns["position"]
        bpy.app.handlers.depsgraph_update_post.remove(changed)
        bpy.context.view_layer.update()  # changed by reading in Edit Mode
        bpy.app.handlers.depsgraph_update_post.append(changed)
        for action, wanted in (("INVERT", ~some), ("SELECT", some | True)):
            bpy.ops.mesh.select_all(action=action)
            bpy.context.view_layer.update()
            assert (look() == wanted[keep]).all() and seen[-1]
        bpy.ops.mesh.select_all(action="DESELECT")
        bpy.context.view_layer.update()
        assert look() is None and seen[-1]
        bpy.ops.mesh.select_all(action="SELECT")
        bpy.ops.mesh.hide()
        bpy.context.view_layer.update()
        assert (look() == HIDDEN).all()
        bpy.ops.object.mode_set(mode="OBJECT")
        bpy.context.view_layer.update()
        assert look() is None  # as for meshes: points hidden in Edit Mode are visible outside of it
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(changed)


def test_hidden_and_selected_splats_in_edit_mode(scene: bpy.types.Scene) -> None:
    """Oracle: gscore.render of the visible splats, with selected ones in the mixed color; in Object
    Mode the whole picture. A second object, selected too, is not edited."""
    lab.prepare(scene, (96, 64))
    request, _ = request_for(scene, lab.blob())
    splats, marks = request.placed[0].frozen.read(), np.zeros(len(lab.blob()), np.uint8)
    marks[::3], marks[1::3] = SELECTED, HIDDEN
    edited = replace(
        request.placed[0], frozen=request.placed[0].frozen.remarked(marks), edited=True
    )
    other = np.eye(4)
    other[0, 3] = 0.5
    beside = replace(edited, matrix=other, uid=-1, edited=False)
    asked = replace(request, placed=[edited, beside], tinted=Tinted.EDITED)

    def shot(request: viewport.Request) -> np.ndarray:
        model = SplatCache().model(request.placed)
        found = request.render(model, request.camera, lambda: False, CancelFlag())
        return encode(found[::-1, :, :3])

    def truth(*parts: Splats) -> np.ndarray:
        whole = {n: np.concatenate([getattr(p, n) for p in parts]) for n in vars(parts[0])}
        camera = request.camera
        return render(Splats(**whole), camera.K, camera.viewmat, 96, 64, near=camera.near).rgb

    sh0, shN = splats.sh0.copy(), splats.shN.copy()
    sh0[::3] = 0.35 * sh0[::3] + 0.65 * (np.float32([1.0, 0.5, 0.05]) - 0.5) / 0.28209479
    shN[::3] *= 0.35
    moved = replace(splats, means=splats.means + np.float32([0.5, 0, 0]))
    there, tinted = marks != HIDDEN, replace(splats, sh0=sh0, shN=shN)
    np.testing.assert_allclose(shot(asked), truth(tinted.subset(there), moved), atol=1e-4)
    plain = replace(asked, tinted=Tinted.NONE)
    np.testing.assert_allclose(shot(plain), truth(splats.subset(there), moved), atol=1e-4)
    left = replace(asked, placed=[replace(edited, edited=False), beside])
    np.testing.assert_allclose(shot(left), truth(splats, moved), atol=1e-4)
    assert not any(same(asked, one) for one in (plain, left))


def test_hidden_holdout_splats_cut_no_hole(scene: bpy.types.Scene) -> None:
    """Oracle: the picture of holdout splats without the hidden ones; a selection of holdouts, which
    have no color, changes nothing."""
    lab.prepare(scene, (96, 64))
    request, _ = request_for(scene, lab.blob(500))
    own = request.placed[0]
    marks = np.full(500, SELECTED, np.uint8)
    marks[:250] = HIDDEN
    cut = replace(own, frozen=own.frozen.remarked(marks), edited=True, holdout=True)
    behind = np.eye(4)
    behind[2, 3] = -0.2
    seen = replace(own, matrix=behind, uid=-1)
    asked = replace(request, placed=[cut, seen], tinted=Tinted.EDITED)
    model = SplatCache().model(asked.placed)
    got = asked.render(model, asked.camera, lambda: False, CancelFlag())
    fewer = lab.add(scene, own.frozen.read().subset(marks == SELECTED))
    bpy.context.view_layer.update()
    frozen_fewer = mesh_copies.freeze(fewer.data, "fewer")
    wanted = replace(asked, placed=[replace(cut, frozen=frozen_fewer, edited=False), seen])
    model = SplatCache().model(wanted.placed)
    want = wanted.render(model, asked.camera, lambda: False, CancelFlag())
    np.testing.assert_allclose(got, want, atol=1e-5)
    whole = replace(asked, placed=[replace(cut, edited=False), seen])
    model = SplatCache().model(whole.placed)
    every = whole.render(model, asked.camera, lambda: False, CancelFlag())
    assert (every[..., 3] < want[..., 3] - 0.1).mean() > 0.02


def test_overlay_has_the_views_colours() -> None:
    """Oracle: Blender's processing of overlays, by IEC 61966-2-1 and its exponent."""
    rgb = np.float32([[[0.4, 0.2, 0.1], [0.0, 0.0, 0.0]]])
    alpha = np.float32([[0.5, 0.0]])
    held = over_view(rgb, alpha)
    light = decode(held) if TEXTURES_ARE_ENCODED else held
    behind = 0.3**EXPONENT
    mixed = (light[..., :3] + behind * (1 - alpha[..., None])) ** (1 / EXPONENT)
    want = (0.5 * np.array([0.8, 0.4, 0.2]) ** EXPONENT + 0.5 * behind) ** (1 / EXPONENT)
    np.testing.assert_allclose(mixed[0, 0], want, atol=1e-5)
    np.testing.assert_allclose(mixed[0, 1], 0.3, atol=1e-5)
