"""Mouse and keys while splats are painted. Oracles: the same strokes by the plain function, and
Blender's undo. Fakes replace the views and events of a window."""

import re
import time
from collections.abc import Iterator
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from addon import attributes
from addon.cameras.camera_math import project
from addon.cameras.render_camera import render_camera
from addon.paint import modal, paint_target, session
from addon.paint.session import Answer, Session
from addon.panels.edit import PaintPanel
from addon.process.incremental_tasks import run_blocking
from addon.splats import objects
from tests.addon import splat_scenes as lab
from tests.addon.drawn import drawn

WIDTH, HEIGHT = 300, 200
WAY = [(120, 60), (190, 110), (160, 160)]
COMMON = {"does", "radius", "front_only", "only_selected"}
"""Settings of every brush."""


class Desk:
    """A session with fakes of Blender's arguments."""

    def __init__(self) -> None:
        self.session = Session()
        self.over_view = True
        self.pushed: list[str] = []

    @property
    def brush(self) -> bpy.types.PropertyGroup:
        """The brush of the session."""
        return bpy.context.window_manager.gscore_paint

    def spot(self, window: object, x: int, y: int) -> session.Spot | None:
        """Position in the only view, which is the scene camera's."""
        return StandIn(Region(), x, y) if self.over_view else None

    def send(self, key: str, value: str = "PRESS", at: tuple[int, int] = WAY[0], **held) -> Answer:
        """An event."""
        keys = dict.fromkeys(("ctrl", "shift", "alt", "oskey"), False) | held
        event = SimpleNamespace(type=key, value=value, mouse_x=at[0], mouse_y=at[1], **keys)
        return self.session.take(bpy.context, event)

    def paint(self, **held) -> None:
        """A stroke along WAY."""
        assert self.send("LEFTMOUSE", at=WAY[0], **held) is Answer.TAKEN
        for at in WAY[1:]:
            assert self.send("MOUSEMOVE", at=at, **held) is Answer.TAKEN
        assert self.send("LEFTMOUSE", "RELEASE", at=WAY[-1], **held) is Answer.TAKEN


class Region:
    """A region of one view."""

    height = HEIGHT

    def as_pointer(self) -> int:
        """Never 0."""
        return 17


class StandIn(session.Spot):
    """A fake mouse position in it."""

    @property
    def view(self) -> object:
        """The view of the scene's camera."""
        return render_camera(bpy.context.scene.camera, bpy.context.scene)


@pytest.fixture
def ob(scene: bpy.types.Scene) -> bpy.types.Object:
    """Active splats in front of a camera."""
    lab.prepare(scene, (WIDTH, HEIGHT))
    made = lab.add(scene, lab.blob(600, size=1.4))
    bpy.context.view_layer.objects.active = made
    made.data.vertices.foreach_set("select", np.zeros(600, bool))
    bpy.context.view_layer.update()
    return made


@pytest.fixture
def desk(ob: bpy.types.Object, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    """A running session."""
    made = Desk()
    for name in ("does", "radius", "strength", "hardness", "color", "opacity", "front_only"):
        made.brush.property_unset(name)
    monkeypatch.setattr(session, "spot_of", made.spot)
    for module in (modal, session):
        monkeypatch.setattr(module, "push_undo", made.pushed.append)
    yield made
    made.session.close()


def base_of(ob: bpy.types.Object) -> np.ndarray:
    """[N, 4] of `radiance:base`."""
    return attributes.column(ob.data, attributes.BASE)


def by_function(ob: bpy.types.Object, brush: bpy.types.PropertyGroup, **how) -> np.ndarray:
    """[N, 4] after the same stroke by the plain function, on another object."""
    other = lab.add(bpy.context.scene, objects.read(ob), "other")
    bpy.context.view_layer.update()
    view = render_camera(bpy.context.scene.camera, bpy.context.scene)
    way = [np.array([x, HEIGHT - y], np.float64) for x, y in WAY]
    wanted = brush.brush(inverted=how.get("inverted", False))
    run_blocking(paint_target.paint(other, way, wanted, view, front_only=brush.front_only))
    return base_of(other)


def test_a_drag_is_a_stroke_and_an_undo_step(ob: bpy.types.Object, desk: Desk) -> None:
    """Oracle: the plain function; one step a stroke, none where nothing was reached."""
    want = by_function(ob, desk.brush)
    desk.paint()
    np.testing.assert_array_equal(base_of(ob), want)
    assert desk.pushed == ["Paint Splats"]
    desk.brush.radius = 1
    desk.send("LEFTMOUSE", at=(1, 1))
    desk.send("LEFTMOUSE", "RELEASE", at=(1, 1))
    assert desk.pushed == ["Paint Splats"]


def test_ctrl_paints_the_opposite(ob: bpy.types.Object, desk: Desk) -> None:
    """Oracle: the plain function, inverted; after deselecting nothing is selected along the
    path."""
    desk.brush.does = "OPACITY"
    want = by_function(ob, desk.brush, inverted=True)
    desk.paint(ctrl=True)
    np.testing.assert_array_equal(base_of(ob), want)
    assert (want[:, 3] == 1).sum() > 20
    desk.brush.does = "SELECT"
    desk.paint()
    assert attributes.selected(ob.data).sum() > 20
    desk.paint(ctrl=True)
    assert not attributes.selected(ob.data).any()


def test_escape_drops_the_stroke_then_ends(ob: bpy.types.Object, desk: Desk) -> None:
    """Oracle: the unchanged attribute, no undo step; then the answer."""
    before = base_of(ob)
    desk.send("LEFTMOUSE")
    desk.send("MOUSEMOVE", at=WAY[1])
    assert (base_of(ob) != before).any()
    assert desk.send("ESC") is Answer.TAKEN
    np.testing.assert_array_equal(base_of(ob), before)
    assert desk.pushed == []
    assert desk.send("ESC") is Answer.ENDED


@pytest.mark.parametrize("key", ["RET", "NUMPAD_ENTER", "ESC"])
def test_keys_that_end(desk: Desk, key: str) -> None:
    """Oracle: the answer; also after the button Stop Painting."""
    assert desk.send(key, "RELEASE") is not Answer.ENDED
    assert desk.send(key) is Answer.ENDED
    desk.session.ended = True
    assert desk.send("MOUSEMOVE") is Answer.ENDED


def test_unrelated_events_pass_through(desk: Desk) -> None:
    """Oracle: navigation, panels, clocks and whatever happens outside of views pass; keys that
    would change the scene do not."""
    for key in ("MIDDLEMOUSE", "WHEELUPMOUSE", "TRACKPADPAN", "NUMPAD_1", "NDOF_MOTION", "HOME"):
        assert desk.send(key) is Answer.PASSED, key
    for key in ("N", "T", "TIMER", "WINDOW_DEACTIVATE", "LEFT_CTRL", "MOUSEMOVE"):
        assert desk.send(key) is Answer.PASSED, key
    assert desk.send("LEFTMOUSE", alt=True) is Answer.PASSED
    for key in ("X", "DEL", "G", "TAB", "A", "LEFT_ARROW", "RIGHTMOUSE", "D"):
        assert desk.send(key) is Answer.TAKEN, key
    assert desk.send("D", alt=True) is Answer.TAKEN
    for key in ("NUMPAD_1", "NUMPAD_7", "WHEELUPMOUSE"):
        assert desk.send(key, ctrl=True) is Answer.PASSED, key
    for key in ("NUMPAD_0", "NUMPAD_PLUS"):  # the camera of the scene, the selection
        assert desk.send(key, ctrl=True) is Answer.TAKEN, key
    desk.over_view = False
    for key in ("LEFTMOUSE", "ESC", "X"):
        assert desk.send(key) is Answer.PASSED, key


def test_clocks_go_on_while_something_is_drawn(ob: bpy.types.Object, desk: Desk) -> None:
    """Oracle: timer events pass during a stroke and while a radius is chosen; mouse moves do
    not."""
    for begin, end in (("LEFTMOUSE", "RELEASE"), ("F", "PRESS")):
        desk.send(begin)
        for key in ("TIMER", "TIMER_REPORT", "TIMER0", "WINDOW_DEACTIVATE", "NONE"):
            assert desk.send(key) is Answer.PASSED, key
        for key in ("INBETWEEN_MOUSEMOVE", "MOUSEMOVE", "X"):
            assert desk.send(key) is Answer.TAKEN, key
        desk.send("LEFTMOUSE", end)
    assert desk.send("INBETWEEN_MOUSEMOVE") is Answer.PASSED


def test_views_are_drawn_where_the_circle_changes(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the number of redraw requests."""
    drawn_: list[int] = []
    monkeypatch.setattr(session, "redraw_views", lambda: drawn_.append(1))
    desk.send("MOUSEMOVE", at=WAY[0])
    for key in ("TIMER", "LEFT_CTRL", "MOUSEMOVE"):
        desk.send(key, at=WAY[0])
    assert len(drawn_) == 1
    desk.send("MOUSEMOVE", at=WAY[1])
    desk.send("RIGHT_BRACKET", at=WAY[1])
    assert len(drawn_) == 3
    desk.over_view = False
    for _ in range(3):
        desk.send("MOUSEMOVE", at=WAY[1])
    assert len(drawn_) == 4


def test_painting_goes_on_where_its_workspace_is_deleted(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the status text is updated, and painting ends, without an error."""
    if bpy.app.version[:2] == (5, 0):
        pytest.skip("bpy 5.0 crashes where a workspace is copied without a window")
    running = modal.Running()
    workspace = bpy.context.workspace.copy()
    if workspace is None:
        pytest.skip("this Blender copies no workspace without a window")
    running.begin(SimpleNamespace(workspace=workspace, window_manager=bpy.context.window_manager))
    bpy.data.batch_remove([workspace])
    running.update_status(bpy.context)
    running.end()
    assert running.session is None


def test_radius_by_keys(desk: Desk) -> None:
    """Oracle: the mouse's distance in pixels; Esc restores the earlier radius, and a click keeps
    it."""
    desk.brush.radius = 50
    desk.send("F", at=(100, 100))
    desk.send("MOUSEMOVE", at=(130, 90))
    assert desk.brush.radius == 80 and "Radius 80 px" in desk.session.sentence(desk.brush)
    assert desk.session.cursor.radius == 80
    desk.send("ESC", at=(130, 90))
    assert desk.brush.radius == 50
    desk.send("F", at=(100, 100))
    desk.send("MOUSEMOVE", at=(0, 90))
    assert desk.brush.radius == 1
    desk.send("MOUSEMOVE", at=(110, 90))
    desk.send("LEFTMOUSE", at=(110, 90))
    assert desk.brush.radius == 60
    desk.send("RIGHT_BRACKET")
    assert desk.brush.radius == pytest.approx(66)
    desk.send("LEFT_BRACKET")
    assert desk.brush.radius == pytest.approx(60)
    assert "Color, 60 px" in desk.session.sentence(desk.brush)


@pytest.mark.parametrize("how", [{"key": "S"}, {"key": "LEFTMOUSE", "shift": True}])
def test_picking_a_color(scene: bpy.types.Scene, desk: Desk, how: dict) -> None:
    """Oracle: the colour of a wall that fills the view; nothing is painted."""
    wall = lab.add(scene, lab.wall(0.0, (0.9, 0.4, 0.2)))
    bpy.context.view_layer.objects.active = wall
    bpy.context.view_layer.update()
    before = base_of(wall)
    key = how.pop("key")
    desk.send(key, at=(150, 100), **how)
    np.testing.assert_allclose(desk.brush.color, (0.9, 0.4, 0.2), atol=0.02)
    np.testing.assert_array_equal(base_of(wall), before)
    wall.location.x = 50
    bpy.context.view_layer.update()
    with pytest.raises(ValueError, match="no splats of"):
        desk.send("S", at=(150, 100))


def test_clones(scene: bpy.types.Scene, desk: Desk) -> None:
    """Ctrl click moves the 3D cursor onto the surface; a stroke is one undo step that adds splats,
    Esc before its end none, and Ctrl adds none either."""
    wall = lab.add(scene, lab.wall(0.2, (0.9, 0.4, 0.2)))
    bpy.context.view_layer.objects.active = wall
    bpy.context.view_layer.update()
    desk.brush.does = "CLONE"
    desk.send("LEFTMOUSE", at=(90, 130), ctrl=True)
    source = np.array(scene.cursor.location)
    assert source[2] == pytest.approx(0.2, abs=0.01)
    view = render_camera(scene.camera, scene)
    at, _ = project(source[None], view.K, view.viewmat)
    np.testing.assert_allclose(at[0], (90, HEIGHT - 130), atol=0.01)
    assert desk.pushed == []
    before = len(wall.data.vertices)
    desk.send("LEFTMOUSE")
    desk.send("MOUSEMOVE", at=WAY[1])
    np.testing.assert_allclose(
        desk.session.cursor.to_source, np.subtract((90, 130), WAY[0]), atol=0.01
    )
    desk.send("ESC")
    desk.send("LEFTMOUSE", "RELEASE")
    assert len(wall.data.vertices) == before and desk.pushed == []
    desk.paint()
    assert len(wall.data.vertices) > before + 20
    assert desk.pushed == ["Paint Splats"]
    assert desk.session.cursor.to_source is None


@pytest.mark.parametrize("dropped", [False, True])
def test_clones_in_steps(
    scene: bpy.types.Scene, desk: Desk, monkeypatch: pytest.MonkeyPatch, dropped: bool
) -> None:
    """As in a window, where work at both ends of a stroke takes several timer events: the stroke
    goes on meanwhile, and Esc before the copies are there drops them."""
    wall = lab.add(scene, lab.wall(0.2, (0.9, 0.4, 0.2)))
    bpy.context.view_layer.objects.active = wall
    bpy.context.view_layer.update()
    before, step = len(wall.data.vertices), Session._step_search
    monkeypatch.setattr(Session, "_step_search", lambda own, **_: step(own))
    desk.brush.does, scene.cursor.location = "CLONE", (0.3, 0.2, 0.2)
    desk.send("LEFTMOUSE", at=WAY[0])
    for at in WAY[1:]:
        desk.send("MOUSEMOVE", at=at)
    desk.send("LEFTMOUSE", "RELEASE", at=WAY[-1])
    assert desk.session.painting and len(wall.data.vertices) == before
    until = time.monotonic() + 60
    while desk.session.painting and time.monotonic() < until:
        if dropped and desk.session._stroke is None and desk.session._search.way == []:
            assert desk.send("ESC") is Answer.TAKEN
        assert desk.send("TIMER", "NOTHING") is Answer.PASSED
        time.sleep(0.01)
    assert not desk.session.painting
    assert (len(wall.data.vertices) > before + 20) != dropped
    assert desk.pushed == ([] if dropped else ["Paint Splats"])


def test_the_tool_waits_for_a_click(
    ob: bpy.types.Object, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A color that takes several steps to find, as in a window: the tool ends after it."""
    monkeypatch.setattr(modal.RUNNING, "session", desk.session)
    monkeypatch.setattr(modal.Running, "update_status", lambda *_: None)
    monkeypatch.setattr(modal.Running, "end", lambda *_: None)
    step = Session._step_search
    monkeypatch.setattr(Session, "_step_search", lambda *_, **__: None)
    tool = SimpleNamespace(once=True, _edit_again=lambda _: None)
    keys = dict.fromkeys(("ctrl", "alt", "oskey"), False)
    event = SimpleNamespace(
        type="LEFTMOUSE", value="PRESS", mouse_x=150, mouse_y=100, shift=True, **keys
    )
    assert modal.PaintSplats.modal(tool, bpy.context, event) == {"RUNNING_MODAL"}
    monkeypatch.setattr(Session, "_step_search", lambda own, **_: step(own, wait=True))
    event.type = "TIMER"
    assert modal.PaintSplats.modal(tool, bpy.context, event) == {"FINISHED"}


def test_undo_passes_and_what_it_brings_is_shown(
    ob: bpy.types.Object, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the next event passes the mesh's values to the live display."""
    shown = []
    monkeypatch.setattr(paint_target, "show_as_kept", shown.append)
    assert desk.send("Z") is Answer.TAKEN
    assert desk.send("Z", ctrl=True) is Answer.PASSED
    assert shown == []
    desk.send("MOUSEMOVE")
    desk.send("MOUSEMOVE")
    assert shown == [ob]


def test_unpaintable_objects_are_refused(ob: bpy.types.Object, desk: Desk) -> None:
    """Oracle: an error for each, after which painting continues."""
    ob.hide_set(True)
    with pytest.raises(ValueError, match="is hidden"):
        desk.send("LEFTMOUSE")
    ob.hide_set(False)
    bpy.context.view_layer.objects.active = bpy.context.scene.camera
    with pytest.raises(ValueError, match="Select a splat object"):
        desk.send("LEFTMOUSE")
    bpy.context.view_layer.objects.active = ob
    bpy.ops.object.mode_set(mode="EDIT")  # as undo may do
    desk.paint()
    assert ob.mode == "OBJECT" and desk.pushed == ["Paint Splats"]


def test_closing_takes_back_what_was_begun(ob: bpy.types.Object, desk: Desk) -> None:
    """Oracle: the attribute; drawing has stopped. A removed object is no error."""
    before = base_of(ob)
    desk.send("LEFTMOUSE")
    desk.session.close()
    np.testing.assert_array_equal(base_of(ob), before)
    assert desk.session.cursor._handle is None
    desk.session.close()
    again = Session()
    desk.session = again
    desk.send("LEFTMOUSE")
    bpy.data.meshes.remove(ob.data)
    again.close()


def test_the_live_display_follows_without_the_mesh(
    ob: bpy.types.Object, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the data passed to it; the mesh is written only at the end of the stroke."""
    monkeypatch.setattr("addon.splats.live_display.SESSION.there", True)
    ob.gscore.display = "SPLATS"
    reported: list[np.ndarray] = []
    monkeypatch.setattr(
        paint_target.viewport_copies.SHARED,
        "repaint",
        lambda uid, base: reported.append(base.copy()),
    )
    before, want = base_of(ob), by_function(ob, desk.brush)
    reported.clear()
    desk.send("LEFTMOUSE", at=WAY[0])
    for at in WAY[1:]:
        desk.send("MOUSEMOVE", at=at)
    np.testing.assert_array_equal(base_of(ob), before)
    np.testing.assert_array_equal(reported[-1], want)
    assert len(reported) == 3 and (reported[0] != reported[1]).any()
    desk.send("LEFTMOUSE", "RELEASE", at=WAY[-1])
    np.testing.assert_array_equal(base_of(ob), want)


def test_where_the_mouse_is() -> None:
    """Oracle: rectangles by hand: regions over a view's main region hide it."""

    def part(kind: str, x: int, y: int, width: int, height: int) -> SimpleNamespace:
        return SimpleNamespace(type=kind, x=x, y=y, width=width, height=height)

    main, side = part("WINDOW", 100, 50, 400, 300), part("UI", 400, 50, 100, 300)
    gone = part("TOOLS", 100, 50, 1, 300)
    view = SimpleNamespace(type="VIEW_3D", regions=[main, side, gone])
    other = SimpleNamespace(type="OUTLINER", regions=[part("WINDOW", 500, 50, 100, 300)])
    window = SimpleNamespace(screen=SimpleNamespace(areas=[other, view]))
    found = session.spot_of(window, 100, 50)
    assert (found.region, found.x, found.y) == (main, 0.5, 0.5)
    assert session.spot_of(window, 399, 349).point == pytest.approx([299.5, 0.5])
    for x, y in ((400, 100), (550, 100), (99, 100), (200, 350)):
        assert session.spot_of(window, x, y) is None


def test_the_panel_shows_what_the_brush_needs(ob: bpy.types.Object, desk: Desk) -> None:
    """Oracle: the settings that have an effect."""
    wanted = {
        "COLOR": {"color", "strength", "hardness"},
        "OPACITY": {"opacity", "strength", "hardness"},
        "SELECT": set(),
        "CLONE": {"strength", "hardness"},
    }
    for does, own in wanted.items():
        desk.brush.does = does
        shown = drawn(PaintPanel)
        assert "(Paint Splats)" in shown
        assert set(re.findall(r"<(\w+)>", shown)) == own | COMMON
