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
from . import holdout_meshes, holdout_passes, picture, unsupported_settings, viewport_copies
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
    FALLBACKS,
    OVER,
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
"""Custom property of a scene: the engine that it had before this one."""
final_cache = SplatCache()
"""Decoded splats of the last picture, shared by the frames of an animation."""
_painters: WeakSet[ViewPainter] = WeakSet()
"""Painters of all viewports in Rendered shading."""


class SplatsRenderEngine(bpy.types.RenderEngine):
    """Renders splat objects only, in the same way as the trainer and `gscore render`."""

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
        """Register the passes of the render for the compositor."""
        for one in requested_passes(scene, renderlayer).registered():
            self.register_pass(scene, renderlayer, *one)

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Render one view layer of one frame. With a window this is not the main thread."""
        # An exception would leave a black picture and the result FINISHED.
        try:
            self._render(depsgraph)
        except Cancelled:
            pass
        except (GsError, ValueError) as error:
            self._refuse(error_words(error))
        except MemoryError:
            self._refuse(
                "Not enough memory to render the splats: close other programs or delete splats."
            )
        except Exception as error:
            traceback.print_exc()
            self._refuse(f"Rendering splats failed: {error!r}. Details are in the console.")

    def view_update(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Mark changed data for new copies."""
        viewport_copies.SHARED.forget_changed(depsgraph)
        holdout_meshes.SHARED.forget_changed(depsgraph)

    def view_draw(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Show the last finished picture, and request the current one.

        With live drawing, that draws the splats until the current picture is ready. Blender would
        draw background photos over the picture; live drawing then draws the picture over them.
        """
        view, region = self._viewport(), context.region
        pointer = region.as_pointer()
        EXACT.discard(pointer)
        OVER.pop(pointer, None)
        try:
            found = sources(depsgraph)
            placed, complete = viewport_copies.SHARED.copied(found)
        except ValueError as error:
            self.update_stats("", error_words(error))
            return
        live = next((one for one in FALLBACKS if one.draws_live(context)), None)
        meshes = holdout_meshes.SHARED.of(depsgraph)
        holds = bool(meshes) or any(one.holdout for one in placed)
        stays = live is not None and not holds and live.stays(context)
        over = not stays and any(one.covers_photos(context) for one in FALLBACKS)
        request = self._request(context, depsgraph, placed, meshes, over=over)
        status = ""
        if not complete:
            status = "Reading splats"
            if viewport_copies.SHARED.under_way(found):
                self.tag_redraw()
        elif not placed:
            view.painter.pixels = None
            status = "There are no splats to show"
        elif live is None or not (stays or live.moves(context)):
            status = self._request_picture(view, request)
        self.update_stats("", status or renders_only(depsgraph, camera_of(context)))
        view.painter.fresh = False
        if complete and not stays and view.painter.shows(request):
            EXACT.add(pointer)
        made = view.painter.made
        is_meant = made is not None and made.over_view == over
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
            holdout_meshes.SHARED.clear()  # changes were not reported while no view was drawn
            _painters.add(self._view.painter)
            # Not in __del__ either, which cannot read the instance's attributes any more.
            finalize(self, self._view.painter.close)
        return self._view

    def _request(
        self,
        context: bpy.types.Context,
        depsgraph: bpy.types.Depsgraph,
        placed: list[Placed],
        meshes: tuple[holdout_meshes.HoldoutMesh, ...],
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
            holdout_meshes=meshes,
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

    def _request_picture(self, view: Viewport, request: Request) -> str:
        """Start drawing a picture; return why there is none, or an empty string."""
        painter = view.painter
        painter.submit(request)
        if painter.busy:
            redraw_when_ready(painter)
        return painter.problem

    def _empty(self, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
        """A picture without splats, [1, 1, 4]."""
        if depsgraph.scene.render.film_transparent:
            return np.zeros((1, 1, 4), np.float32)
        return np.array([[[*_light(depsgraph), 1]]], np.float32)

    def _refuse(self, message: str) -> None:
        """Stop with an error, in the render window and as the operator's report."""
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
        """Render the picture of one eye, or the only one."""
        scene, layer = depsgraph.scene, depsgraph.view_layer_eval
        size = self.resolution_x, self.resolution_y
        self.update_stats("", "Reading splats")
        eye = eye_of(self, view)
        stage = Stage(depsgraph, camera, size, final_cache, self.frame_set, eye)
        still = stage.view()
        requested = requested_passes(scene, layer)
        film = self._film(depsgraph, depths=requested.depth)
        self.update_progress(0.1)
        self.update_stats("", f"Drawing {len(still.model.splats):,} splats")
        if stage.blurs:
            count = scene.gscore_render.blur_samples
            passes, covered, blocked = self._mean(film, stage, requested, count)
            if requested.depth:  # at the frame, through the lens's middle: mean depths are useless
                passes["Depth"] = film.render(still, self.test_break)["Depth"]
        else:
            passes = film.render(still, self.test_break)
            covered = film.coverage(still, self.test_break) if requested.mattes else {}
            blocked = (
                holdout_passes.blocked(film, still, self.test_break)
                if requested.holdout_depth
                else {}
            )
        if requested.holdout_depth:
            blocked |= holdout_passes.depths(film, still, self.test_break)
            passes |= holdout_passes.completed(blocked, passes)
        else:
            passes.pop(MESHES, None)
        passes.pop(SHARE, None)  # internal, not a pass of Blender
        passes |= requested.mattes_of(covered, passes["Combined"].shape[:2])
        self.update_progress(0.9)
        self._deliver(passes, layer.name, view, scene.render, film.options.window)
        requested.stamp(self.get_result(), layer.name, covered)

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
        self, film: Film, stage: Stage, requested: RequestedPasses, count: int
    ) -> tuple[dict[str, np.ndarray], dict[Identity, np.ndarray], dict[str, np.ndarray]]:
        """Means over lens and exposure: the passes without depths, the coverage of each object, and
        the light that holdouts block, the last two if requested."""
        plain, last = film.without_depths(), None
        picture, covered, blocked = Mean(), Mean(), Mean()
        shot, parts, light = {}, {}, {}
        _, top, _, height = film.options.window or (0, 0, 0, self.resolution_y)
        # Pictures have the bottom row first.
        rows = (np.arange(top, top + height)[::-1] + 0.5) / self.resolution_y
        shares = stage.shares(count, rows)
        with closing(stage.views(count)) as views:
            for i, view in enumerate(views):
                self.update_stats("", f"Sample {i + 1} of {count}")
                if last is None or not view.same(last):
                    last, shot = view, plain.render(view, self.test_break)
                    parts = plain.coverage(view, self.test_break) if requested.mattes else {}
                    light = (
                        holdout_passes.blocked(plain, view, self.test_break)
                        if requested.holdout_depth
                        else {}
                    )
                if self.test_break():
                    raise Cancelled
                row = None if shares is None else shares[i]
                picture.add(shot, row)
                covered.add(parts, row)
                blocked.add(light, row)
                self.update_progress(0.1 + 0.8 * (i + 1) / count)
        return picture.result(), covered.result(), blocked.result()

    def _warn(self, shown: unsupported_settings.Shown) -> None:
        """Report settings without effect and missing frames, once per animation."""
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
                f"The camera of scene {scene.name} is {ob.name}, that of scene {main.name} is "
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
        """Write the passes of the drawn window to Blender, whose own window may be smaller."""
        full = self.resolution_x, self.resolution_y
        left, bottom = 0, 0
        if window is not None:
            corner = border_corner(render, *full)
            left, bottom = corner[0] - window[0], corner[1] - (full[1] - window[1] - window[3])
        result = self.begin_result(0, 0, *full, layer=layer, view=view)
        size = result.resolution_x, result.resolution_y
        for name, values in passes.items():
            part = picture.crop(values, left, bottom, *size)
            # Flat, and not assigned: rect = array converts each number separately.
            result.layers[0].passes[name].rect.foreach_set(part.ravel())
        self.end_result(result)


def _light(depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    """Scene-linear background color, [3]."""
    return world_light(world_of(depsgraph.scene, depsgraph.view_layer_eval))[0]


CLASSES = (SplatsRenderEngine,)


def on_register() -> None:
    """Keep sequences from changing their meshes while this engine renders."""
    frame_sync.TAKE_FRAMES.add(NAME)


def on_unregister() -> None:
    """Stop the viewports and drop their splats."""
    frame_sync.TAKE_FRAMES.discard(NAME)
    _leave_viewports()
    for painter in list(_painters):
        painter.close()
    final_cache.clear()
    viewport_copies.SHARED.clear()
    holdout_meshes.SHARED.clear()


def _leave_viewports() -> None:
    """Switch viewports away from the engine: otherwise Blender 4.3 hangs after its removal."""
    manager = getattr(bpy.context, "window_manager", None)
    for window in [] if manager is None else manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D" and window.scene.render.engine == NAME:
                shading = area.spaces.active.shading
                shading.type = "SOLID" if shading.type == "RENDERED" else shading.type
