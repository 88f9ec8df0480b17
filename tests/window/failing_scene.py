"""Runs inside a Blender with a window: a graphics card that fails and refuses; takes screenshots.

`blender --factory-startup -P tests/window/failing_scene.py -- FOLDER PACKAGES...`, as
`live_scene.py`.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
FOLDER, *PACKAGES = map(Path, sys.argv[sys.argv.index("--") + 1 :])
sys.path[:0] = [str(ROOT), *map(str, PACKAGES)]

import addon_utils  # noqa: E402 - the path comes first
import bpy  # noqa: E402

addon_utils.enable("addon", default_set=True, persistent=True)

from addon.live import draw_handler  # noqa: E402
from addon.live.card import Card  # noqa: E402
from addon.nodes import display  # noqa: E402
from tests.addon import splat_scenes as lab  # noqa: E402
from tools.window.window_script import (  # noqa: E402
    ScriptRunner,
    area,
    at_rest,
    clear,
    look_down,
    region,
    save_screenshot,
    space,
    write_results,
)

COLOR = (0.8, 0.4, 0.2)
seen: dict = {"log": [], "problems": {}, "calls": {}}


def shot(name: str) -> None:
    """Save the screen as a file; return the text of the panel."""
    save_screenshot(FOLDER / f"{name}.png")
    seen["problems"][name] = draw_handler.problem_of(region())


class Failing:
    """A method that raises a driver's error a given number of times, and counts calls."""

    def __init__(self, owner: Any, name: str, times: float) -> None:
        """Replace the real method."""
        self.owner, self.name, self.times, self.calls = owner, name, times, 0
        self.real = getattr(owner, name)
        setattr(owner, name, lambda *given, **named: self(*given, **named))

    def __call__(self, *given: Any, **named: Any) -> Any:
        """Fail, or call the real method."""
        self.calls += 1
        if self.calls <= self.times:
            raise Exception("a driver's word")
        return self.real(*given, **named)

    def end(self, name: str) -> None:
        """Restore the real method."""
        setattr(self.owner, self.name, self.real)
        seen["calls"][name] = self.calls


def spoiled(name: str, wall: bpy.types.Object) -> Iterator[object]:
    """Make a splat invalid, then restore it; no other change meanwhile."""
    before = tuple(wall.data.attributes["scale"].data[7].vector)
    for vector, end in (((float("nan"),) * 3, "spoiled"), (before, "mended")):
        wall.data.attributes["scale"].data[7].vector = vector
        wall.data.update()
        yield 3.0
        shot(f"{name}_{end}")


def story() -> Iterator[object]:
    """The events; a yield returns control to Blender (`ScriptRunner`)."""
    scene = bpy.context.scene
    clear()
    look_down()
    wall = lab.add(scene, lab.wall(0.0, COLOR), "wall")
    lab.add(scene, lab.blob(2000, center=(0.5, 0.3, 0.3)), "blob")
    mesh = bpy.data.meshes.new("plate")
    corners = [(-0.2, -0.2, 0.5), (0.2, -0.2, 0.5), (0.2, 0.2, 0.5), (-0.2, 0.2, 0.5)]
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    scene.collection.objects.link(bpy.data.objects.new("plate", mesh))
    for ob in scene.objects:
        ob.select_set(False)
    yield 0.5
    yield at_rest
    yield 1.0
    found = region()
    seen["middle"] = [found.x + found.width // 2, found.y + found.height // 2]
    shot("live")
    yield from spoiled("live", wall)
    before = draw_handler.view_of(region())
    failing = Failing(Card, "show", 1)
    area().tag_redraw()
    yield 0.15
    shot("failed_once")
    yield lambda: draw_handler.view_of(region()) not in (None, before)
    yield at_rest
    failing.end("once")
    yield 0.5
    shot("again")
    draw_handler._PAUSE = 0.2
    failing = Failing(Card, "show", 1e9)
    area().tag_redraw()
    yield lambda: draw_handler.SESSION.problem
    yield 1.0
    failing.end("for_good")
    shot("points")
    addon_utils.disable("addon")
    addon_utils.enable("addon", persistent=True)
    failing = Failing(Card, "step", 1e9)
    area().tag_redraw()
    yield lambda: draw_handler.SESSION.problem
    yield 1.0
    failing.end("refused")
    shot("refused")
    space().overlay.show_text = True
    seen["corner"] = [region().x, region().y]
    area().tag_redraw()
    yield 0.5
    shot("said")
    modifier = display.modifier_of(wall)
    seen["vertices"] = [len(ob.data.vertices) for ob in scene.objects if ob.type == "MESH"]
    seen["modifier"] = modifier is not None


ScriptRunner(story(), write_results(FOLDER, seen))
