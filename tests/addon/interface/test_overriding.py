"""Oracle: what Blender says of its context; whether it is still there."""

from collections.abc import Callable
from pathlib import Path

import bpy

from addon.interface.overriding import acting_in

ROOT = Path(__file__).parents[3]
PUSHES_BESIDE_THREADS = """
import sys, threading
import bpy
sys.path.insert(0, {root!r})
import addon_utils
addon_utils.enable("addon", default_set=True)
from addon.interface import undo
ended = threading.Event()
def work():
    while not ended.is_set():
        [str(i).encode().decode() for i in range(50)]
threads = [threading.Thread(target=work) for _ in range(3)]
for thread in threads:
    thread.start()
for i in range(150):
    undo.push("Step")
ended.set()
for thread in threads:
    thread.join()
addon_utils.disable("addon")
print("pushed")
sys.stdout.flush()
import os
os._exit(0)  # bpy 4.2 crashes at the end of Python whatever was done
"""


def test_another_scene_is_acted_on(scene: bpy.types.Scene) -> None:
    """Inside, the context has the scene that was asked for; outside, the one it had."""
    other = bpy.data.scenes.new("Other")
    shown = bpy.context.scene
    with acting_in(other) as window:
        assert window and bpy.context.scene == other
        assert bpy.context.view_layer == other.view_layers[0]
    assert bpy.context.scene == shown


def test_nothing_is_overridden_that_is_so_already(scene: bpy.types.Scene) -> None:
    """The scene of the window, with or without its name."""
    for wanted in (None, bpy.context.scene):
        with acting_in(wanted) as window:
            assert window and bpy.context.window is not None


def test_steps_are_pushed_while_threads_run(run_blender: Callable[..., str]) -> None:
    """Blender 4.5 crashed in most runs where the window was overridden for it."""
    assert "pushed" in run_blender(PUSHES_BESIDE_THREADS.format(root=str(ROOT)), timeout=100)
