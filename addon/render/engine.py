"""Render engine "Gaussian Splats": F12, animations, and the viewport's Rendered shading."""

import traceback
from contextlib import closing
from typing import Any
from weakref import WeakSet, finalize

import bpy
import numpy as np

from ..compat import matrix_to_numpy, rec709_to_scene
from ..core import Cancelled, GsError
from ..interface.option_labels import error_words
from ..timeline import frame_sync
from ..timeline.frame_at import gap_sentence
from ..timeline.settings import plays
from . import copies, holdout_meshes, holdout_passes, picture, unsupported_settings
from .compositing_scene import main_scene
from .model import SplatCache
from .pass_renderer import MESHES, SHARE, Film
from .passes import RequestedPasses, requested_passes
from .regions import border_corner, border_window, camera_of, drawn_window
from .renders_only import renders_only
from .samples import Mean
from .scene import Identity, Placed, sources
from .selections import tinted_in
from .shutter_lens import Stage
from .stereo import eye_of, refusal, views_of
from .viewport import (
    EXACT,
    OVER,
    STAND_INS,
    Request,
    ViewPainter,
    Viewport,
    redraw_when_ready,
    view_camera,
)
from .world import background_of, world_light, world_of

NAME = "GSCORE_SPLATS"
"""The engine in `scene.render.engine`."""
ENGINE_BEFORE = "gs_engine_before"
"""Custom property of a scene: the engine that it had before this one was chosen for it."""
final_cache = SplatCache()
"""Decoded splats of the last picture: the frames of an animation share it."""
_painters: WeakSet[ViewPainter] = WeakSet()
"""Of all viewports in Rendered shading."""


class SplatsRenderEngine(bpy.types.RenderEngine):
    """Draws splat objects, as the trainer and `gscore render` see them, and nothing else."""

    bl_idname = NAME
    bl_label = "Gaussian Splats"
    bl_use_preview = False
    bl_use_postprocess = True  # compositor and sequencer
    bl_use_shading_nodes_custom = False
    bl_use_eevee_viewport = True  # Material Preview
    bl_use_stereo_viewport = False

    def update_render_passes(
        self, scene: bpy.types.Scene | None = None, renderlayer: Any = None
    ) -> None:
        """Tell the compositor which passes there will be."""
        for one in requested_passes(scene, renderlayer).registered():
            self.register_pass(scene, renderlayer, *one)

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Draw one view layer of one frame. In the program this is not the main thread."""
        # An exception would leave a black picture and the word FINISHED.
        try:
            self._render(depsgraph)
        except Cancelled:
            pass
        except (GsError, ValueError) as error:
            self._refuse(error_words(error))
        except MemoryError:
            self._refuse("Not enough memory to render the splats: close programs or delete some.")
        except Exception as error:
            traceback.print_exc()
            self._refuse(f"Rendering splats failed: {error!r}. Details are in the console.")

    def view_update(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Something in the scene has changed."""
        copies.SHARED.forget_changed(depsgraph)
        holdout_meshes.SHARED.forget_changed(depsgraph)

    def view_draw(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Show the last picture that is ready, and ask for the one of now.

        Where splats are drawn live, they are until the picture of now is ready. Before a photo that
        Blender would lay over the picture, whoever draws live lays the picture over that.
        """
        view, region = self._viewport(), context.region
        pointer = region.as_pointer()
        EXACT.discard(pointer)
        OVER.pop(pointer, None)
        try:
            found = sources(depsgraph)
            placed, complete = copies.SHARED.copied(found)
        except ValueError as error:
            self.update_stats("", error_words(error))
            return
        live = next((one for one in STAND_INS if one.stands_in(context)), None)
        held = holdout_meshes.SHARED.of(depsgraph)
        holds = bool(held) or any(one.holdout for one in placed)
        stays = live is not None and not holds and live.stays(context)
        over = not stays and any(one.lays_over(context) for one in STAND_INS)
        request = self._request(context, depsgraph, placed, held, over=over)
        said = ""
        if not complete:
            said = "Reading splats"
            if copies.SHARED.under_way(found):
                self.tag_redraw()
        elif not placed:
            view.painter.pixels = None
            said = "There are no splats to show"
        elif live is None or not (stays or live.moves(context)):
            said = self._ask(view, request)
        self.update_stats("", said or renders_only(depsgraph, camera_of(context)))
        view.painter.fresh = False
        if complete and not stays and view.painter.shows(request):
            EXACT.add(pointer)
        made = view.painter.made
        is_meant = isinstance(made, Request) and made.over_view == over
        pixels, window = view.painter.pixels if is_meant else None, view.window
        waits = live is not None and pointer not in EXACT
        if over and pixels is not None and not waits:
            OVER[pointer] = view
        if over or waits:
            pixels, window = self._empty(depsgraph), request.options.window
        if pixels is not None:
            self.bind_display_space_shader(depsgraph.scene)
            view.draw(pixels, region.width, region.height, window)
            self.unbind_display_space_shader()

    _view: Viewport | None = None

    def _viewport(self) -> Viewport:
        # Not in __init__, whose arguments differ between versions of Blender.
        if self._view is None:
            self._view = Viewport(final_cache)
            holdout_meshes.SHARED.clear()  # nobody told of changes while none was drawn
            _painters.add(self._view.painter)
            # Not in __del__ either: by then the instance's attributes are out of reach.
            finalize(self, self._view.painter.close)
        return self._view

    def _request(
        self,
        context: bpy.types.Context,
        depsgraph: bpy.types.Depsgraph,
        placed: list[Placed],
        held: tuple[holdout_meshes.HoldoutMesh, ...],
        *,
        over: bool,
    ) -> Request:
        scene = depsgraph.scene
        region, rv3d = context.region, context.region_data
        matrices = [matrix_to_numpy(m) for m in (rv3d.view_matrix, rv3d.window_matrix)]
        size = region.width, region.height
        transparent = scene.render.film_transparent or over
        light = np.zeros(3) if transparent else _light(depsgraph)
        return Request(
            placed=placed,
            held=held,
            camera=view_camera(*matrices, *size, perspective=rv3d.is_perspective),
            options=picture.Options(
                background=background_of(light),
                antialias=scene.gscore_render.antialias,
                window=drawn_window(context, matrices[1], *size),
            ),
            transparent=transparent,
            to_scene=rec709_to_scene(),
            over_view=over,
            tinted=tinted_in(context.space_data, own=True),
        )

    def _ask(self, view: Viewport, request: Request) -> str:
        """Have a picture drawn; why there is none, or an empty string."""
        painter = view.painter
        painter.ask(request)
        if painter.busy:
            redraw_when_ready(painter)
        return painter.problem

    def _empty(self, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
        """[1, 1, 4] of a picture without splats."""
        if depsgraph.scene.render.film_transparent:
            return np.zeros((1, 1, 4), np.float32)
        return np.array([[[*_light(depsgraph), 1]]], np.float32)

    def _refuse(self, message: str) -> None:
        """Stop with a sentence: on the render window, and as the operator's error."""
        self.error_set(message)
        self.report({"ERROR"}, message)

    def _render(self, depsgraph: bpy.types.Depsgraph) -> None:
        camera = self._camera(depsgraph.scene)
        scene, layer = depsgraph.scene, depsgraph.view_layer_eval
        self._warn(unsupported_settings.Shown(scene=scene, layer=layer, camera=camera))
        for view in views_of(scene.render):
            self._render_view(depsgraph, camera, view)

    def _render_view(
        self, depsgraph: bpy.types.Depsgraph, camera: bpy.types.Object, view: str
    ) -> None:
        """Draw the picture of an eye, or the only one."""
        scene, layer = depsgraph.scene, depsgraph.view_layer_eval
        size = self.resolution_x, self.resolution_y
        self.update_stats("", "Reading splats")
        eye = eye_of(self, view)
        stage = Stage(depsgraph, camera, size, final_cache, self.frame_set, eye)
        still = stage.view()
        asked = requested_passes(scene, layer)
        film = self._film(depsgraph, depths=asked.depth)
        self.update_progress(0.1)
        self.update_stats("", f"Drawing {len(still.model.splats):,} splats")
        if stage.blurs:
            count = scene.gscore_render.blur_samples
            passes, covered, held = self._mean(film, stage, asked, count)
            if asked.depth:  # of the frame itself, through the lens's middle: means are of no use
                passes["Depth"] = film.shoot(still, self.test_break)["Depth"]
        else:
            passes = film.shoot(still, self.test_break)
            covered = film.coverage(still, self.test_break) if asked.mattes else {}
            held = holdout_passes.blocked(film, still, self.test_break) if asked.held else {}
        if asked.held:
            held |= holdout_passes.depths(film, still, self.test_break)
            passes |= holdout_passes.completed(held, passes)
        else:
            passes.pop(MESHES, None)
        passes.pop(SHARE, None)  # no pass of Blender's
        passes |= asked.mattes_of(covered, passes["Combined"].shape[:2])
        self.update_progress(0.9)
        self._deliver(passes, layer.name, view, scene.render, film.options.window)
        asked.stamp(self.get_result(), layer.name, covered)

    def _film(self, depsgraph: bpy.types.Depsgraph, *, depths: bool) -> Film:
        scene = depsgraph.scene
        transparent = scene.render.film_transparent
        black = (0.0, 0.0, 0.0)
        options = picture.Options(
            background=black if transparent else background_of(_light(depsgraph)),
            depths=depths,
            antialias=scene.gscore_render.antialias,
            window=border_window(scene.render, self.resolution_x, self.resolution_y),
        )
        return Film(options=options, transparent=transparent, to_scene=rec709_to_scene())

    def _mean(
        self, film: Film, stage: Stage, asked: RequestedPasses, count: int
    ) -> tuple[dict[str, np.ndarray], dict[Identity, np.ndarray], dict[str, np.ndarray]]:
        """The means of the passes, but depths, from all over the lens and the exposure; how much
        each object adds, and what is held out blocks, in the mean, where that is asked for."""
        plain, last = film.without_depths(), None
        picture, covered, blocked = Mean(), Mean(), Mean()
        shot, parts, held = {}, {}, {}
        _, top, _, height = film.options.window or (0, 0, 0, self.resolution_y)
        # Pictures come with their bottom rows first.
        rows = (np.arange(top, top + height)[::-1] + 0.5) / self.resolution_y
        shares = stage.shares(count, rows)
        with closing(stage.views(count)) as views:
            for i, view in enumerate(views):
                self.update_stats("", f"Sample {i + 1} of {count}")
                if last is None or not view.same(last):
                    last, shot = view, plain.shoot(view, self.test_break)
                    parts = plain.coverage(view, self.test_break) if asked.mattes else {}
                    held = (
                        holdout_passes.blocked(plain, view, self.test_break) if asked.held else {}
                    )
                if self.test_break():
                    raise Cancelled
                row = None if shares is None else shares[i]
                picture.add(shot, row)
                covered.add(parts, row)
                blocked.add(held, row)
                self.update_progress(0.1 + 0.8 * (i + 1) / count)
        return picture.result(), covered.result(), blocked.result()

    def _warn(self, shown: unsupported_settings.Shown) -> None:
        """Say what has no effect or is missing; of an animation with its first frame."""
        if self.is_animation and shown.scene.frame_current != shown.scene.frame_start:
            return
        gaps = (gap_sentence(ob) for ob in shown.splats if plays(ob))
        for sentence in [*unsupported_settings.without_effect(shown), *filter(None, gaps)]:
            self.report({"WARNING"}, sentence)

    def _camera(self, scene: bpy.types.Scene) -> bpy.types.Object:
        ob = self.camera_override or scene.camera
        if ob is None:
            raise ValueError(
                f"Scene {scene.name} has no camera: add one, or choose an imported one as the "
                f"scene's camera."
            )
        main = main_scene(scene)
        if main is not None and main.camera is not None and main.camera.name != ob.name:
            raise ValueError(
                f"Scene {scene.name} looks through {ob.name}, scene {main.name} through "
                f"{main.camera.name}: run Composite Splats with Meshes again in {main.name}."
            )
        if problem := refusal(scene, ob):
            raise ValueError(problem)
        return ob

    def _deliver(
        self,
        passes: dict[str, np.ndarray],
        layer: str,
        view: str,
        render: bpy.types.RenderSettings,
        window: picture.Window | None,
    ) -> None:
        """Hand pictures over, of the window that was drawn; Blender's own may be a little less."""
        full = self.resolution_x, self.resolution_y
        left, bottom = 0, 0
        if window is not None:
            corner = border_corner(render, *full)
            left, bottom = corner[0] - window[0], corner[1] - (full[1] - window[1] - window[3])
        result = self.begin_result(0, 0, *full, layer=layer, view=view)
        size = result.resolution_x, result.resolution_y
        for name, values in passes.items():
            part = picture.crop(values, left, bottom, *size)
            # Flat, and never assigned: rect = array converts every number by itself.
            result.layers[0].passes[name].rect.foreach_set(part.ravel())
        self.end_result(result)


def _light(depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    """[3] scene-linear color of what is behind the splats."""
    return world_light(world_of(depsgraph.scene, depsgraph.view_layer_eval))[0]


CLASSES = (SplatsRenderEngine,)


def on_register() -> None:
    """Have sequences leave their meshes alone while this engine renders."""
    frame_sync.TAKE_FRAMES.add(NAME)


def on_unregister() -> None:
    """Let go of viewports and their splats."""
    frame_sync.TAKE_FRAMES.discard(NAME)
    _leave_viewports()
    for painter in list(_painters):
        painter.close()
    final_cache.clear()
    copies.SHARED.clear()
    holdout_meshes.SHARED.clear()


def _leave_viewports() -> None:
    """Have no viewport draw with the engine: Blender 4.3 never ends after it is gone then."""
    manager = getattr(bpy.context, "window_manager", None)
    for window in [] if manager is None else manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D" and window.scene.render.engine == NAME:
                shading = area.spaces.active.shading
                shading.type = "SOLID" if shading.type == "RENDERED" else shading.type
