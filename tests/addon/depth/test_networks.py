"""Oracle: the catalogue's own entries, a scripted gscore, and Blender's switch for going online."""

import json
from collections.abc import Callable
from pathlib import Path

import bpy
import pytest

from addon import preferences
from addon.core import depth_networks
from addon.depth import networks, predict_depth
from addon.panels.depth import DepthPanel
from addon.training import lookups
from addon.training.lookups import networks_here
from tests.addon.drawn import drawn
from tests.addon.fake_trainer import fake_python

SMALL = depth_networks()[0]
DONE = {"event": "depth", "views": 1, "accepted": 0, "predicted": 1, "kept": 0, "folder": "f"}
DONE |= {"params": "p", "sheet": "s", "table": [], "why": ""}
Play = Callable[..., Path]


@pytest.fixture
def play(studio: bpy.types.Scene, tmp_path: Path) -> Play:
    """Use the studio as capture and the small network, and replace gscore by a fake that plays a
    script; return the file of its arguments."""
    prefs = preferences.get()
    prefs.depth_model = ""
    prefs.depth_network = SMALL.name

    def choose(*script: dict, here: tuple[str, ...] = ()) -> Path:
        rows = [{"name": n.name, "file": "x" if n.name in here else None} for n in depth_networks()]
        lists = fake_python(tmp_path / "lists", [{"raw": json.dumps({"models": rows}) + "\n"}])
        prefs.python_path = str(lists)
        lookups.networks.wait(str(lists))
        answer = lookups.networks.get(str(lists))
        assert answer == (frozenset(here), "")
        fake_python(tmp_path / "lists", list(script))  # from now on it predicts
        return tmp_path / "lists" / "script.args"

    return choose


@pytest.fixture
def online(monkeypatch: pytest.MonkeyPatch) -> Callable[[bool], None]:
    """Sets Blender's online access."""
    return lambda may: monkeypatch.setattr(networks, "may_go_online", lambda: may)


def test_a_network_that_is_here_needs_no_question(play: Play, online) -> None:
    """Oracle: the command line."""
    online(False)
    called = play({"say": DONE}, here=(SMALL.name,))
    shown = drawn(DepthPanel)
    assert "(Predict Again)" in shown and "Download" not in shown
    assert bpy.ops.gscore.predict_depth(wait=True) == {"FINISHED"}
    words = json.loads(called.read_text())
    assert words[words.index("--model") + 1] == SMALL.name and "--download" not in words


def test_one_that_is_not_here_is_fetched_on_a_click_alone(play: Play, online) -> None:
    """Oracle: size and licence of the catalogue in the panel and in the dialog; the call."""
    online(True)
    called = play({"say": DONE})
    shown = drawn(DepthPanel)
    assert "To download: 99 MB, licence Apache-2.0" in shown
    assert "(Download and Predict)" in shown and "(Predict Again)" not in shown
    asked = " ".join(networks.confirm_lines(SMALL))
    assert all(word in asked for word in ("99 MB", "Apache-2.0", SMALL.page, "SHA-256"))
    with pytest.raises(RuntimeError, match="press Download and Predict"):
        bpy.ops.gscore.predict_depth(wait=True)
    assert bpy.ops.gscore.predict_depth(download=True, wait=True) == {"FINISHED"}
    assert "--download" in json.loads(called.read_text())


def test_no_download_while_blender_is_offline(play: Play, online) -> None:
    """Oracle: no process is started, and the message names the switch."""
    online(False)
    called = play({"say": DONE})
    called.unlink()
    shown = drawn(DepthPanel)
    assert "Preferences > System > Network" in shown and "(Download and Predict)" not in shown
    with pytest.raises(RuntimeError, match="does not allow add-ons to go online"):
        bpy.ops.gscore.predict_depth(download=True, wait=True)
    assert not called.exists() and predict_depth.job_of(bpy.context.scene) is None


def test_the_switch_is_blenders() -> None:
    """Oracle: bpy.app."""
    assert networks.may_go_online() == bpy.app.online_access


def test_a_file_of_ones_own_is_taken(play: Play, tmp_path: Path) -> None:
    """Oracle: the preferences and the command line."""
    called = play({"say": DONE})
    (tmp_path / "own.onnx").write_bytes(b"x")
    preferences.get().depth_model = str(tmp_path / "own.onnx")
    assert networks.chosen() is None
    assert "<depth_model>" in drawn(DepthPanel)
    assert bpy.ops.gscore.predict_depth(wait=True) == {"FINISHED"}
    assert str(tmp_path / "own.onnx") in called.read_text()


def test_a_python_without_an_answer(tmp_path: Path) -> None:
    """Oracle: an error that names the Python."""
    for python in (tmp_path / "none", fake_python(tmp_path / "p", [{"raw": "no list\n"}])):
        with pytest.raises(ValueError, match="cannot list depth networks"):
            networks_here(str(python))
