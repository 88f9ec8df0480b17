"""Redraw scene, inside a Blender with a window, for redraws.py: orbits splats and measures.

`blender -P tools/measure/redraw_scene.py -- FOLDER PACKAGES...`; FOLDER/splats.ply is shown as
FOLDER/asked.json says. Leaves FOLDER/seen.json: rows of numbers, or a problem.
"""

import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
FOLDER, *PACKAGES = map(Path, sys.argv[sys.argv.index("--") + 1 :])
sys.path[:0] = [str(ROOT), *map(str, PACKAGES)]

import addon_utils  # noqa: E402 - the path comes first
import bpy  # noqa: E402
import numpy as np  # noqa: E402
from mathutils import Quaternion  # noqa: E402

addon_utils.enable("addon", default_set=True, persistent=True)

from addon.core import read_splats  # noqa: E402
from addon.live import card, depths, handler, uploads, view_picture  # noqa: E402
from addon.live.program import QUADS  # noqa: E402
from addon.splats import objects  # noqa: E402
from tools.window import desk  # noqa: E402

ASKED = json.loads((FOLDER / "asked.json").read_text())
seen: dict[str, Any] = {"rows": []}
STILL_REDRAWS = 20
"""Of a view at rest."""
FIRST = Quaternion((1, 0, 0), 1.2)
"""From where the view begins: from the side, and a little from above."""


@dataclass
class Redraw:
    """What the add-on did in one redraw of the view."""

    began: float
    """Seconds of `time.perf_counter`."""
    total_ms: float = 0.0
    """Of Blender's main thread."""
    card_ms: float = 0.0
    """Of these, in draw calls, in waits and for the card's memory: where the processor stands in
    for a card, its work."""
    drawn: int = 0
    """Splats."""
    calls: int = 0
    """Draw calls."""
    uploaded: int = 0
    """Bytes."""


class Meter:
    """Listens to the add-on's drawing, from now on."""

    def __init__(self) -> None:
        self.redraws: list[Redraw] = []
        draw, texture, wait = handler.draw, uploads.texture, view_picture._wait
        read = depths._read_depths
        init, reserve = card.Card.__init__, uploads.Texels.__init__

        def timed(context: bpy.types.Context) -> None:
            now = Redraw(began=time.perf_counter())
            self.redraws.append(now)
            draw(context)
            now.total_ms = (time.perf_counter() - now.began) * 1000

        def counted(values: np.ndarray) -> Any:
            if self.redraws:
                self.redraws[-1].uploaded += values.nbytes
            return texture(values)

        def made(this: card.Card) -> None:
            init(this)
            this._quads, this._screen = (_Batch(b, self) for b in (this._quads, this._screen))

        handler.draw, card.Card.__init__ = timed, made
        uploads.texture = card.texture = counted
        # The room for an atlas, which the processor empties where it stands in for a card.
        uploads.Texels.__init__ = lambda this, values: self.time(reserve, this, values)
        view_picture._wait = lambda target: self.time(wait, target)
        depths._read_depths = lambda *given: self.time(
            read, *given
        )  # waits for all that Blender draws

    def time(self, act: Callable, *given: Any, **named: Any) -> Any:
        """Do something whose time is the card's."""
        began = time.perf_counter()
        found = act(*given, **named)
        self.redraws[-1].card_ms += (time.perf_counter() - began) * 1000
        return found


class _Batch:
    """A batch whose draw calls are counted and timed."""

    def __init__(self, batch: Any, meter: Meter) -> None:
        self._batch, self._meter = batch, meter

    def draw(self, *given: Any) -> None:
        """Over the view."""
        self._meter.time(self._batch.draw, *given)
        self._meter.redraws[-1].calls += 1

    def draw_instanced(self, shader: Any, *, instance_count: int) -> None:
        """Splats."""
        self._meter.time(self._batch.draw_instanced, shader, instance_count=instance_count)
        now = self._meter.redraws[-1]
        now.calls += 1
        now.drawn += instance_count * QUADS


def alone() -> None:
    """The 3D view fills the window."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=desk.area(), region=desk.region()):
        bpy.ops.screen.screen_full_area(use_hide_panels=True)


def add_splats() -> None:
    """Those of the file, a cube among them if one is asked for, and a view that turns around most
    of them."""
    splats = read_splats(FOLDER / "splats.ply")
    objects.create(splats, "splats", collection=bpy.context.scene.collection)
    middle = np.median(splats.means, axis=0)
    view = desk.space().region_3d
    view.view_perspective, view.view_location, view.view_rotation = "PERSP", middle, FIRST
    away = float(np.median(np.linalg.norm(splats.means - middle, axis=1)))
    view.view_distance = 3.0 * away
    if ASKED["mesh"]:
        bpy.ops.mesh.primitive_cube_add(size=0.3 * away, location=middle)


def turn(steps: int) -> Iterator[object]:
    """Once around, a redraw a step."""
    for k in range(steps):
        desk.space().region_3d.view_rotation = (
            Quaternion((0, 0, 1), 2 * np.pi * (k + 1) / steps) @ FIRST
        )
        desk.area().tag_redraw()
        yield 0.0


def drag(steps: int) -> Iterator[object]:
    """A filter's limit, a redraw a step, with the histograms in the view."""
    bpy.context.window_manager.gscore_histograms = desk.space().show_gizmo = True
    ob = bpy.data.objects["splats"]
    for k in range(steps):
        ob.gscore.opacity_min = 0.5 * (k + 1) / steps
        desk.area().tag_redraw()
        yield 0.0
    bpy.context.window_manager.gscore_histograms = desk.space().show_gizmo = False


def redraw() -> Iterator[object]:
    """Again and again the same."""
    for _ in range(STILL_REDRAWS):
        desk.area().tag_redraw()
        yield 0.0


def is_exact() -> bool:
    """Whether the view shows the engine's picture."""
    return desk.region().as_pointer() in handler.viewport.EXACT


def story() -> Iterator[object]:
    """Without splats, then with each shading: turning, and at rest."""
    desk.clear()
    meter = Meter()
    alone()
    desk.space().region_3d.view_rotation = FIRST
    yield 0.5
    yield from measured("no splats", meter, lambda: True)
    add_splats()
    yield 0.5
    yield from measured("Solid", meter, desk.at_rest)
    meter.redraws.clear()
    yield from drag(ASKED["steps"])
    note("Solid, filter dragged", meter)
    bpy.data.objects["splats"].gscore.opacity_min = 0.0
    yield desk.at_rest
    bpy.context.scene.render.engine = "GSCORE_SPLATS"
    bpy.context.scene.view_settings.view_transform = "Standard"  # others are not drawn live
    desk.space().shading.type = "RENDERED"
    yield 0.5
    yield from measured("Rendered", meter, is_exact)


def measured(what: str, meter: Meter, at_rest: Callable[[], bool]) -> Iterator[object]:
    """Notes what the first picture takes, turning, coming to rest, and then standing still."""
    meter.redraws.clear()
    yield at_rest
    if any(r.calls for r in meter.redraws):
        note(f"{what}, first", meter, summed=True)
    meter.redraws.clear()
    yield from turn(ASKED["steps"])
    note(f"{what}, turning", meter)
    meter.redraws.clear()
    yield at_rest
    if any(r.calls for r in meter.redraws):
        note(f"{what}, coming to rest", meter, summed=True)
    meter.redraws.clear()
    yield from redraw()
    note(f"{what}, at rest", meter)


def note(what: str, meter: Meter, *, summed: bool = False) -> None:
    """Keep what was measured; `summed`: all redraws together make one picture."""
    redraws = [asdict(r) for r in meter.redraws]
    seen["rows"].append({"what": what, "redraws": redraws, "summed": summed})


def end(problem: str) -> None:
    """Leave all of it, and the program."""
    shown = desk.region()
    seen.update(problem=problem, blender=bpy.app.version_string, size=[shown.width, shown.height])
    (FOLDER / "seen.json").write_text(json.dumps(seen))
    bpy.ops.wm.quit_blender()


desk.Teller(story(), end)
