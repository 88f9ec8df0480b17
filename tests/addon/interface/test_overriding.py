"""Oracle: Blender's context; whether Blender still runs."""

from collections.abc import Callable
from pathlib import Path

import bpy

from addon.interface.windows import in_a_window

ROOT = Path(__file__).parents[3]
PUSHES_BESIDE_THREADS = """
import sys, threading
import bpy
sys.path.insert(0, {root!r})
import addon_utils
addon_utils.enable("addon", default_set=True)
from addon.interface.windows import push_undo
ended = threading.Event()
def work():
    while not ended.is_set():
        [str(i).encode().decode() for i in range(50)]
threads = [threading.Thread(target=work) for _ in range(3)]
for thread in threads:
    thread.start()
for i in range(150):
    push_undo("Step")
ended.set()
for thread in threads:
    thread.join()
addon_utils.disable("addon")
print("pushed")
sys.stdout.flush()
import os
os._exit(0)  # bpy 4.2 crashes at the end of Python in any case
"""


def test_there_is_a_window() -> None:
    """Inside the override, and outside if there was one."""
    with in_a_window() as window:
        assert window and bpy.context.window is not None


def test_steps_are_pushed_while_threads_run(run_blender: Callable[..., str]) -> None:
    """Blender 4.5 crashed in most runs where the window was overridden for it."""
    assert "pushed" in run_blender(PUSHES_BESIDE_THREADS.format(root=str(ROOT)), timeout=100)
