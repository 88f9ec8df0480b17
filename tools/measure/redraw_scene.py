"""Redraw scene, inside a Blender with a window, for redraws.py: orbits splats and measures.

`blender -P tools/measure/redraw_scene.py -- FOLDER PACKAGES...` shows FOLDER/splats.ply with the
options of FOLDER/asked.json, and writes FOLDER/seen.json: rows of numbers, or a problem.
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
from addon.live import card, depths, draw_handler, texture_upload  # noqa: E402
from addon.live.program import QUADS  # noqa: E402
from addon.splats import objects  # noqa: E402
from tools.window import window_script  # noqa: E402

REQUEST = json.loads((FOLDER / "asked.json").read_text())
seen: dict[str, Any] = {"rows": []}
STILL_REDRAWS = 20
"""Number of redraws of a view at rest."""
FIRST = Quaternion((1, 0, 0), 1.2)
"""Initial view: from the side and slightly above."""


@dataclass
class Redraw:
    """Work of the add-on in one redraw of the view."""

    began: float
    """Start, seconds of `time.perf_counter`."""
    total_ms: float = 0.0
    """Time of Blender's main thread."""
    card_ms: float = 0.0
    """Share of it in draw calls, waits and memory transfers; with software rendering, the GPU
    work."""
    drawn: int = 0
    """Number of splats."""
    calls: int = 0
    """Number of draw calls."""
    uploaded: int = 0
    """Uploaded bytes."""


class Meter:
    """Measures the add-on's drawing, from its creation on."""

    def __init__(self) -> None:
        self.redraws: list[Redraw] = []
        draw, texture, wait = draw_handler.draw, texture_upload.texture, card._wait
        read = depths._read_depths
        step, reserve = card.Card.step, texture_upload.Texels.__init__

        def timed(context: bpy.types.Context) -> None:
            now = Redraw(began=time.perf_counter())
            self.redraws.append(now)
            draw(context)
            now.total_ms = (time.perf_counter() - now.began) * 1000

        def counted(values: np.ndarray) -> Any:
            if self.redraws:
                self.redraws[-1].uploaded += values.nbytes
            return texture(values)

        def stepped(this: card.Card) -> bool:
            was, ready = this.ready, step(this)
            if ready and not was:
                this._quads, this._screen = (_Batch(b, self) for b in (this._quads, this._screen))
            return ready

        draw_handler.draw, card.Card.step = timed, stepped
        texture_upload.texture = card.texture = counted
        # Allocation of an atlas, which software rendering clears on the CPU.
        texture_upload.Texels.__init__ = lambda this, values: self.time(reserve, this, values)
        card._wait = lambda target: self.time(wait, target)
        depths._read_depths = lambda *given: self.time(
            read, *given
        )  # waits for all drawing of Blender

    def time(self, act: Callable, *given: Any, **named: Any) -> Any:
        """Call a function and add its time to the GPU's."""
        began = time.perf_counter()
        found = act(*given, **named)
        self.redraws[-1].card_ms += (time.perf_counter() - began) * 1000
        return found


class _Batch:
    """A batch whose draw calls are counted and timed."""

    def __init__(self, batch: Any, meter: Meter) -> None:
        self._batch, self._meter = batch, meter

    def draw(self, *given: Any) -> None:
        """Draw over the view."""
        self._meter.time(self._batch.draw, *given)
        self._meter.redraws[-1].calls += 1

    def draw_instanced(self, shader: Any, *, instance_count: int) -> None:
        """Draw splats."""
        self._meter.time(self._batch.draw_instanced, shader, instance_count=instance_count)
        now = self._meter.redraws[-1]
        now.calls += 1
        now.drawn += instance_count * QUADS


def alone() -> None:
    """Maximise the 3D view."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(
        window=window, area=window_script.area(), region=window_script.region()
    ):
        bpy.ops.screen.screen_full_area(use_hide_panels=True)


def add_splats() -> None:
    """Add the splats of the file, a cube among them if requested, and set the view around them."""
    splats = read_splats(FOLDER / "splats.ply")
    objects.create(splats, "splats", collection=bpy.context.scene.collection)
    middle = np.median(splats.means, axis=0)
    view = window_script.space().region_3d
    view.view_perspective, view.view_location, view.view_rotation = "PERSP", middle, FIRST
    away = float(np.median(np.linalg.norm(splats.means - middle, axis=1)))
    view.view_distance = 3.0 * away
    if REQUEST["mesh"]:
        bpy.ops.mesh.primitive_cube_add(size=0.3 * away, location=middle)


def turn(steps: int) -> Iterator[object]:
    """Orbit once, with one redraw per step."""
    for k in range(steps):
        window_script.space().region_3d.view_rotation = (
            Quaternion((0, 0, 1), 2 * np.pi * (k + 1) / steps) @ FIRST
        )
        window_script.area().tag_redraw()
        yield 0.0


def drag(steps: int) -> Iterator[object]:
    """Drag a filter's limit, with one redraw per step and histograms in the view."""
    bpy.context.window_manager.gscore_histograms = window_script.space().show_gizmo = True
    ob = bpy.data.objects["splats"]
    for k in range(steps):
        ob.gscore.opacity_min = 0.5 * (k + 1) / steps
        window_script.area().tag_redraw()
        yield 0.0
    bpy.context.window_manager.gscore_histograms = window_script.space().show_gizmo = False


def redraw() -> Iterator[object]:
    """Redraw the same view repeatedly."""
    for _ in range(STILL_REDRAWS):
        window_script.area().tag_redraw()
        yield 0.0


def is_exact() -> bool:
    """Whether the view shows the engine's picture."""
    return window_script.region().as_pointer() in draw_handler.viewport.EXACT


def story() -> Iterator[object]:
    """Measure without splats, then with each shading: turning, and at rest."""
    window_script.clear()
    meter = Meter()
    alone()
    window_script.space().region_3d.view_rotation = FIRST
    yield 0.5
    yield from measured("no splats", meter, lambda: True)
    add_splats()
    yield 0.5
    yield from measured("Solid", meter, window_script.at_rest)
    meter.redraws.clear()
    yield from drag(REQUEST["steps"])
    note("Solid, filter dragged", meter)
    bpy.data.objects["splats"].gscore.opacity_min = 0.0
    yield window_script.at_rest
    bpy.context.scene.render.engine = "GSCORE_SPLATS"
    bpy.context.scene.view_settings.view_transform = "Standard"  # others are not drawn live
    window_script.space().shading.type = "RENDERED"
    yield 0.5
    yield from measured("Rendered", meter, is_exact)


def measured(what: str, meter: Meter, at_rest: Callable[[], bool]) -> Iterator[object]:
    """Record the first picture, turning, coming to rest, and redraws at rest."""
    meter.redraws.clear()
    yield at_rest
    if any(r.calls for r in meter.redraws):
        note(f"{what}, first", meter, summed=True)
    meter.redraws.clear()
    yield from turn(REQUEST["steps"])
    note(f"{what}, turning", meter)
    meter.redraws.clear()
    yield at_rest
    if any(r.calls for r in meter.redraws):
        note(f"{what}, coming to rest", meter, summed=True)
    meter.redraws.clear()
    yield from redraw()
    note(f"{what}, at rest", meter)


def note(what: str, meter: Meter, *, summed: bool = False) -> None:
    """Store a measurement; `summed`: all redraws together are one picture."""
    redraws = [asdict(r) for r in meter.redraws]
    seen["rows"].append({"what": what, "redraws": redraws, "summed": summed})


def end(problem: str) -> None:
    """Write the results and quit Blender."""
    shown = window_script.region()
    seen.update(problem=problem, blender=bpy.app.version_string, size=[shown.width, shown.height])
    (FOLDER / "seen.json").write_text(json.dumps(seen))
    bpy.ops.wm.quit_blender()


window_script.ScriptRunner(story(), end)
