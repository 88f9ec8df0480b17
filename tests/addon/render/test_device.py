"""Pictures by a render server, whose device is the CPU. Oracle, unless stated otherwise: the same
pictures with the preference Device at CPU, bit by bit."""

import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest

from addon import compat, preferences
from addon.core import Cancelled, write_splats
from addon.interface.option_labels import panel_text
from addon.render import device, engine, picture, viewport
from addon.render.model import SplatCache
from addon.render.pass_renderer import PassRenderer
from addon.render.viewport import ViewRenderer
from gscore.raster import render_process
from gscore.raster.render_client import RenderServerError
from tests.addon import splat_scenes as lab
from tests.addon.render.test_viewport import request_for, wait
from tests.addon.vulkan_device import passed_device
from tests.raster.render_clients import WAITING

CARD = "cpu"
"""The UUID of a card in the preferences: for the render server it is the device CPU."""
BREAKING = """
import os, sys; sys.path[:0] = sys.argv[1].split(os.pathsep)
import gscore.raster.render_server as s
answer = s.RenderServer.answer
def answer_or_die(self, message, cancel):
    if message["do"] == "draw":
        os.kill(os.getpid(), 9)
    return answer(self, message, cancel)
s.RenderServer.answer = answer_or_die
s.main(sys.argv[2:])
"""
"""Program of a server that is killed in each picture."""
FIRST = "Card failed: The render server ended with signal 9. The CPU draws instead."
SECOND = (
    "Card failed: The render server ended with signal 9. After two failures the CPU draws for the "
    "rest of this session; choose the device again in the preferences to try it again."
)


@pytest.fixture
def prefs() -> Iterator[preferences.Preferences]:
    """The preferences with a found card, which is not chosen; restored afterwards."""
    found = preferences.get()
    found.found_devices = json.dumps([[CARD, "Card"]])
    found.device = preferences.CPU
    yield found
    found.device, found.found_devices = preferences.CPU, ""
    device.CHOICE.forget()


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], list[dict]]:
    """Renders the scene with a device; returns the passes and mattes of each view layer and eye."""
    made: list[dict] = []
    completed = PassRenderer.completed

    def recorded(self: PassRenderer, shot: Any, *args: Any) -> dict[str, np.ndarray]:
        passes = completed(self, shot, *args)
        made.append({**passes, **{str(key): values for key, values in shot.covered.items()}})
        return passes

    monkeypatch.setattr(PassRenderer, "completed", recorded)

    def render(chosen: str) -> list[dict]:
        preferences.get().device = chosen
        made.clear()
        bpy.ops.render.render()
        return list(made)

    return render


def assert_same(ones: list[dict], others: list[dict]) -> None:
    """Fail unless all passes have the same bits."""
    assert ones and len(ones) == len(others)
    for one, other in zip(ones, others, strict=True):
        assert one.keys() == other.keys()
        for name, values in one.items():
            assert values.tobytes() == other[name].tobytes(), name
            assert values.std() > 0, name


def client_of() -> Any:
    """The client of the chosen device."""
    chosen = device.CHOICE.device()
    assert chosen is not None
    return chosen._client


def test_all_passes(scene, prefs, rendered):
    """Depth, mattes, held-out splats and meshes, a transparent film, anti-aliasing, a border."""
    lab.prepare(scene)
    for i in range(2):
        lab.add(scene, lab.blob(seed=i), f"s{i}").location.x = i - 0.5
    hole = lab.add(scene, lab.blob(100, seed=7, size=0.3), "hole")
    hole.is_holdout = True
    mesh = bpy.data.objects.new("mesh", bpy.data.meshes.new("mesh"))
    mesh.data.from_pydata([(0, 0, 0.1), (1, 0, 0.1), (0, 1, 0.2)], [], [(0, 1, 2)])
    mesh.is_holdout = True
    scene.collection.objects.link(mesh)
    layer = scene.view_layers[0]
    layer.use_pass_z = layer.use_pass_cryptomatte_object = True
    scene.render.film_transparent, scene.gscore_render.antialias = True, "ON"
    render = scene.render
    render.use_border, render.border_min_x, render.border_max_y = True, 0.2, 0.9
    bpy.context.view_layer.update()
    assert_same(rendered(CARD), rendered("CPU"))
    prefs.device = CARD
    assert device.CHOICE.device() is not None and client_of().started == 0, (
        "a new client: CPU came between"
    )


def test_a_device_of_this_machine(scene, prefs, rendered, monkeypatch, tmp_path):
    """Oracle: the CPU's passes; one value in a thousand may differ where rounding decides whether a
    splat is visible."""
    uuid, _ = passed_device(sys.executable, tmp_path, monkeypatch)
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    scene.view_layers[0].use_pass_z = True
    prefs.found_devices = json.dumps([[uuid, "Card"]])
    (found,), (wanted,) = rendered(uuid), rendered("CPU")
    for name, values in wanted.items():
        differs = np.abs(found[name] - values) > 1e-4 * np.maximum(np.abs(values), 1)
        assert differs.mean() < 1e-3 and values.std() > 0, name
    prefs.device = uuid
    assert not client_of().started and found["Depth"].tobytes() != wanted["Depth"].tobytes()


def test_animations_keep_the_server(scene, prefs, rendered):
    """Oracle also: the number of servers, and of sent arrays."""
    lab.prepare(scene)
    ob = lab.add(scene, lab.blob())
    lab.moving(ob, 0.1)
    preferences.get().device = CARD
    frames = []
    for frame in (0, 1, 2):
        scene.frame_set(frame)
        frames += rendered(CARD)
    assert client_of().started == 1 and client_of().sent == 6
    for frame, one in zip((0, 1, 2), frames, strict=True):
        scene.frame_set(frame)
        assert_same([one], rendered("CPU"))


def test_sequences_and_a_picture_of_4k(scene, prefs, rendered, tmp_path):
    """Oracle also: each frame of a sequence has other splats, which are sent once."""
    lab.prepare(scene)
    for number in range(3):
        write_splats(tmp_path / f"frame_{number:04d}.ply", lab.blob(100 + number, seed=number))
    bpy.ops.gscore.import_sequence(directory=str(tmp_path), up="Z")
    frames = []
    for frame in (1, 2, 3):
        scene.frame_set(frame)
        frames += rendered(CARD)
        assert client_of().sent == 6 * frame
    for frame, one in zip((1, 2, 3), frames, strict=True):
        scene.frame_set(frame)
        assert_same([one], rendered("CPU"))
    scene.render.resolution_x, scene.render.resolution_y = 3840, 2160
    scene.render.resolution_percentage = 100
    assert_same(rendered(CARD), rendered("CPU"))


def test_panoramas_stereo_and_blur(scene, prefs, rendered):
    """Oracle: as above."""
    camera = lab.prepare(scene, (48, 24))
    ob = lab.add(scene, lab.blob())
    scene.view_layers[0].use_pass_z = True
    camera.location, camera.data.type = (0.1, 0.2, 1.0), "PANO"
    compat.panorama_settings(camera.data).panorama_type = "EQUIRECTANGULAR"
    assert_same(rendered(CARD), rendered("CPU"))
    camera.location, camera.data.type = (0, 0, 4), "PERSP"
    scene.render.use_multiview = True
    assert_same(rendered(CARD), rendered("CPU"))
    scene.render.use_multiview = False
    scene.view_layers[0].use_pass_z = False
    lab.moving(ob, 0.5)
    scene.render.use_motion_blur, scene.gscore_render.blur_samples = True, 3
    assert_same(rendered(CARD), rendered("CPU"))


def test_a_killed_server_ends_in_the_picture_of_the_cpu(scene, prefs, rendered, monkeypatch, capfd):
    """Oracle also: the reports: a sentence for the first and the second failure, none later."""
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    want = rendered("CPU")
    monkeypatch.setattr(render_process, "_CODE", BREAKING)
    for sentences in ([FIRST], [SECOND], [], []):
        capfd.readouterr()
        assert_same(rendered(CARD), want)
        output = "".join(capfd.readouterr())
        assert [s for s in (FIRST, SECOND) if s in output] == sentences
        assert output.count("failed") == len(sentences)
    assert client_of().started == 2
    prefs.device = preferences.CPU
    assert device.CHOICE.device() is None
    prefs.device = CARD
    assert not device.CHOICE.device().is_off


def test_a_success_forgives_a_failure(scene, prefs, rendered, monkeypatch):
    """Oracle: the device is used after failures with successes between them."""
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    prefs.device = CARD
    client, code = client_of(), render_process._CODE
    for program in (BREAKING, code, BREAKING, code):
        client.close()
        while client.pid is not None:
            time.sleep(0.01)
        monkeypatch.setattr(render_process, "_CODE", program)
        rendered(CARD)
    chosen = device.CHOICE.device()
    assert chosen is not None and not chosen.is_off and not chosen.problem
    assert chosen.sentences == [FIRST, FIRST]


def test_automatic_without_a_card_gives_the_reason_once(scene, prefs, rendered, monkeypatch, capfd):
    """Oracle also: one report; one process at most looks for cards, where there may be one."""
    monkeypatch.setattr(preferences, "no_automatic_card", lambda: "")
    none = "def none(*_): raise s.NoDeviceError('The CPU draws. There is no card.')\n"
    code = BREAKING.replace("s.main(", f"{none}s.open_device = none\ns.main(")
    monkeypatch.setattr(render_process, "_CODE", code)
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    want = rendered("CPU")
    for count in (1, 0):
        capfd.readouterr()
        assert_same(rendered("AUTO"), want)
        output = "".join(capfd.readouterr())
        assert output.count("The CPU draws. There is no card.") == count
        assert "failed" not in output
        chosen = device.CHOICE.device()
        assert chosen is not None and bool(chosen.problem) == bool(count), "in the view"
    assert client_of().started == 1
    monkeypatch.setattr(preferences, "no_automatic_card", lambda: "There is no graphics card.")
    assert device.CHOICE.device() is None


def test_the_viewport_is_drawn_by_the_device(scene, prefs, monkeypatch):
    """Oracle also: the sentence where it fails, with the CPU's picture."""
    lab.prepare(scene, (96, 64))
    request, _ = request_for(scene, lab.blob())

    def pixels(chosen: Any) -> np.ndarray:
        renderer = ViewRenderer(SplatCache())
        options = replace(request.options, device=chosen)
        renderer.submit(replace(request, options=options))
        wait(renderer)
        renderer.close()
        assert not renderer.problem
        return renderer.pixels

    prefs.device = CARD
    want = pixels(None)
    assert np.array_equal(pixels(device.CHOICE.device()), want)
    assert client_of().sent == 6
    device.CHOICE.forget()
    monkeypatch.setattr(render_process, "_CODE", BREAKING)
    assert np.array_equal(pixels(device.CHOICE.device()), want)
    assert device.CHOICE.device().problem == FIRST


def test_cancel_reaches_the_server(scene, prefs, monkeypatch):
    """Oracle: Cancelled; the same server draws the next picture."""
    monkeypatch.setattr(render_process, "_CODE", WAITING)
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    depsgraph = bpy.context.evaluated_depsgraph_get()
    model = lab.model_of(depsgraph)
    prefs.device = CARD
    options = picture.Options(device=device.CHOICE.device())
    small, _ = request_for(scene, lab.blob(10), size=(20, 20))
    picture.draw(model, small.camera, options)
    client = client_of()
    pid, looks = client.pid, iter(range(1000))
    with pytest.raises(Cancelled):
        endless = replace(small.camera, width=77)
        picture.draw(model, endless, options, stop=lambda: next(looks) > 3)
    picture.draw(model, small.camera, options)
    assert client.pid == pid and client.started == 1


def test_the_status_says_what_takes_long(scene, prefs, monkeypatch):
    """Oracle: the texts that the engine shows in a render, and in the view's corner."""
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    prefs.device = CARD
    shown = []

    class Engine:
        _device = device.CHOICE.device()

        def update_stats(self, stats: str, info: str) -> None:
            shown.append(info)

        def test_break(self) -> bool:
            return False

    assert not engine.SplatsRenderEngine._stops(Engine())
    client_of().status = "Testing Card once"
    assert not engine.SplatsRenderEngine._stops(Engine())
    assert shown == ["Testing Card once"]


def test_views_are_redrawn_when_the_status_changes(monkeypatch):
    """Oracle: the number of redraws by the timer; it ends with the picture."""
    polls, redraws = [], []
    app = SimpleNamespace(timers=SimpleNamespace(register=lambda poll, **_: polls.append(poll)))
    monkeypatch.setattr(viewport, "bpy", SimpleNamespace(app=app))
    monkeypatch.setattr(viewport, "redraw_views", lambda: redraws.append(1))
    renderer, card = SimpleNamespace(fresh=False, busy=True), SimpleNamespace(status="")
    viewport.redraw_when_ready(renderer, card)
    (poll,) = polls
    for status, count in (("", 0), ("Testing", 1), ("Testing", 1), ("", 2)):
        card.status = status
        assert poll() and len(redraws) == count
    renderer.busy = False
    assert poll() is None and len(redraws) == 2


def test_cards_are_items_of_the_preference(prefs):
    """Oracle: the list of found cards; a stored choice keeps its card when others come and go."""
    prefs.found_devices = json.dumps([["aa", "One"], ["bb", "Two"]])
    prefs.device = "bb"
    prefs.found_devices = json.dumps([["cc", "Three"], ["bb", "Two"], ["aa", "One"]])
    assert prefs.device == "bb" and preferences.device_name("bb") == "Two"
    with pytest.raises(TypeError):
        prefs.device = "dd"
    for broken in ("{", "3", "[[1]]", "[1]", "null"):
        prefs.found_devices = broken
        assert prefs.device == "", "no card, no item"
        assert device.CHOICE.device() is None, "the CPU"
    assert preferences.device_name("AUTO") == "The graphics card"


def test_find_devices(prefs, monkeypatch):
    """Oracle: the cards that another process lists; those that cannot be used are named."""
    usable = {"uuid": "aa", "name": "One", "reason": ""}
    other = {"uuid": "bb", "name": "Two", "reason": "It lacks Vulkan 1.2."}
    found = [usable, other], ["There is a card without a driver."]
    monkeypatch.setattr(device.core, "find_devices", lambda folder: found, raising=False)
    assert bpy.ops.gscore.find_devices() == {"FINISHED"}
    assert json.loads(prefs.found_devices) == [["aa", "One"]]


def test_a_failed_search_is_an_error(prefs, monkeypatch):
    """Oracle: the message of the operator."""

    def fail(folder: str) -> None:
        raise RenderServerError("The render server ended with code 3.")

    monkeypatch.setattr(device.core, "find_devices", fail, raising=False)
    message = lab.error_of(bpy.ops.gscore.find_devices)
    assert "The render server ended with code 3." in message


def test_messages_name_the_preference():
    """Oracle: the label in the preferences."""
    assert panel_text("use `--device cpu`") == 'use "Device: CPU"'


def test_the_cpu_starts_and_imports_nothing(run_blender, tmp_path):
    """Oracle: the modules and processes of a fresh Blender after a render."""
    script = f"""
import sys
sys.path.insert(0, {str(engine.__file__.rpartition("/addon/")[0])!r})
import bpy, addon_utils
started = []
sys.addaudithook(lambda name, args: started.append(args) if name == "subprocess.Popen" else None)
addon_utils.enable("addon", default_set=True)
from tests.addon import splat_scenes as lab
lab.prepare(bpy.context.scene)
lab.add(bpy.context.scene, lab.blob())
bpy.ops.render.render()
print("loaded", [n for n in sys.modules if "render_client" in n or "gscore.raster.gpu" in n])
print("started", started)
addon_utils.disable("addon", default_set=True)
"""
    output = run_blender(script)
    assert "loaded ['gscore.raster.gpu', 'gscore.raster.gpu.absence']" in output
    assert "started []" in output
