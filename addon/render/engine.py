"""Render engine "Gaussian Splats": F12, animations, and the viewport's Rendered shading."""

import traceback
from contextlib import closing
from dataclasses import replace
from typing import Any
from weakref import WeakSet, finalize

import bpy
import numpy as np

from ..cameras.render_camera import Eye
from ..compat import matrix_to_numpy, rec709_to_scene
from ..core import Cancelled, GsError
from ..interface.option_labels import error_text
from ..timeline import frame_sync
from ..timeline.frame_at import gap_sentence
from ..timeline.settings import plays
from . import device, holdout_meshes, picture, unsupported_settings, viewport_copies
from .color import NOTHING, background_of, light_of
from .compositing_scene import main_scene
from .geometry_passes import position_pass, vector_pass
from .model import SplatCache
from .pass_renderer import PassRenderer, Shot
from .passes import RequestedPasses, requested_passes
from .regions import border_window, camera_of, drawn_window
from .samples import Mean
from .scene import Placed, sources
from .selections import tinted_in
from .shutter_lens import ShutterLens
from .stereo import eyes_of, refusal
from .unsupported_settings import renders_only
from .viewport import (
    EXACT,
    FALLBACKS,
    OVER,
    Request,
    Viewport,
    ViewRenderer,
    redraw_when_ready,
    view_camera,
)

NAME = "GSCORE_SPLATS"
"""The engine in `scene.render.engine`."""
ENGINE_BEFORE = "gs_engine_before"
"""Custom property of a scene: the engine that it had before this one."""
final_cache = SplatCache()
"""Decoded splats of the last picture, shared by the frames of an animation."""
_renderers: WeakSet[ViewRenderer] = WeakSet()
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
        for one in requested_passes(scene, renderlayer, main_scene(scene)).registered():
            self.register_pass(scene, renderlayer, *one)

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Render one view layer of one frame. With a window this is not the main thread."""
        # An exception would leave a black picture and the result FINISHED.
        self._device = device.CHOICE.device()
        failures = [] if self._device is None else self._device.sentences
        known = len(failures)
        try:
            self._render(depsgraph)
        except Cancelled:
            pass
        except (GsError, ValueError) as error:
            self._refuse(error_text(error))
        except MemoryError:
            self._refuse(
                "Not enough memory to render the splats: close other programs or delete splats."
            )
        except Exception as error:
            traceback.print_exc()
            self._refuse(f"Rendering splats failed: {error!r}. Details are in the console.")
        for sentence in failures[known:]:
            self.report({"WARNING"}, sentence)

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
            self.update_stats("", error_text(error))
            return
        live = next((one for one in FALLBACKS if one.draws_live(context)), None)
        meshes = holdout_meshes.SHARED.of(depsgraph)
        has_holdouts = bool(meshes) or any(one.holdout for one in placed)
        stays = live is not None and not has_holdouts and live.stays(context)
        over = not stays and any(one.covers_photos(context) for one in FALLBACKS)
        request = self._request(context, depsgraph, placed, meshes, over=over)
        status = ""
        if not complete:
            status = "Reading splats"
            if viewport_copies.SHARED.under_way(found):
                self.tag_redraw()
        elif not placed:
            view.renderer.pixels = None
            status = "There are no splats to show"
        elif live is None or not (stays or live.moves(context)):
            status = self._request_picture(view, request)
        self.update_stats("", status or renders_only(depsgraph, camera_of(context)))
        view.renderer.fresh = False
        if complete and not stays and view.renderer.shows(request):
            EXACT.add(pointer)
        made = view.renderer.made
        is_meant = made is not None and made.over_view == over
        pixels, window = view.renderer.pixels if is_meant else None, view.window
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
    _device: device.RenderDevice | None = None
    """Device that draws renders; None: the CPU."""

    def _viewport(self) -> Viewport:
        # Not in __init__, whose arguments differ between versions of Blender.
        if self._view is None:
            self._view = Viewport(final_cache)
            holdout_meshes.SHARED.clear()  # changes were not reported while no view was drawn
            _renderers.add(self._view.renderer)
            # Not in __del__ either, which cannot read the instance's attributes any more.
            finalize(self, self._view.renderer.close)
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
        light = np.zeros(3) if transparent else light_of(depsgraph)
        return Request(
            placed=placed,
            holdout_meshes=meshes,
            camera=view_camera(*matrices, *size, perspective=rv3d.is_perspective),
            options=picture.Options(
                background=background_of(light),
                antialias=scene.gscore_render.antialias,
                window=drawn_window(context, matrices[1], *size),
                device=device.CHOICE.device(),
            ),
            transparent=transparent,
            to_scene=rec709_to_scene(),
            over_view=over,
            tinted=tinted_in(context.space_data, own=True),
        )

    def _request_picture(self, view: Viewport, request: Request) -> str:
        """Start drawing a picture; return why there is none, or an empty string."""
        renderer = view.renderer
        renderer.submit(request)
        if renderer.busy:
            redraw_when_ready(renderer, request.options.device)
        drawn_by = request.options.device
        waits = "" if drawn_by is None else drawn_by.status or drawn_by.problem
        return renderer.problem or waits

    def _empty(self, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
        """A picture without splats, [1, 1, 4]."""
        if depsgraph.scene.render.film_transparent:
            return np.zeros((1, 1, 4), np.float32)
        return np.array([[[*light_of(depsgraph), 1]]], np.float32)

    def _refuse(self, message: str) -> None:
        """Stop with an error, in the render window and as the operator's report."""
        self.error_set(message)
        self.report({"ERROR"}, message)

    def _render(self, depsgraph: bpy.types.Depsgraph) -> None:
        scene, layer = depsgraph.scene, depsgraph.view_layer_eval
        main = main_scene(scene)
        camera = self._camera(scene, main)
        self._warn(unsupported_settings.Shown(scene=scene, layer=layer, camera=camera))
        requested = requested_passes(scene, layer, main)
        for view, eye in eyes_of(self, scene.render):
            self._render_view(depsgraph, camera, requested, view, eye)

    def _render_view(
        self,
        depsgraph: bpy.types.Depsgraph,
        camera: bpy.types.Object,
        requested: RequestedPasses,
        view: str,
        eye: Eye | None,
    ) -> None:
        """Render the picture of one eye, or the only one."""
        scene, layer = depsgraph.scene, depsgraph.view_layer_eval
        size = self.resolution_x, self.resolution_y
        self.update_stats("", "Reading splats")
        window, corner = border_window(scene.render, *size)
        transparent = scene.render.film_transparent
        light = np.zeros(3) if transparent else light_of(depsgraph)
        pass_renderer = PassRenderer(
            options=picture.Options(
                background=background_of(light),
                depths=requested.depth or requested.position or requested.vector,
                normals=requested.normal,
                antialias=scene.gscore_render.antialias,
                window=window,
                device=self._device,
            ),
            transparent=transparent,
            to_scene=rec709_to_scene(),
            mattes=requested.mattes,
            holdouts=requested.holdout_depth,
            values=requested.values,
        )
        shutter_lens = ShutterLens(
            *(depsgraph, camera, size, final_cache, self.frame_set, eye),
            values=tuple(requested.values),
        )
        still = shutter_lens.view()
        owners = {owner for owner, _ in still.model.owners} - {None}
        if requested.vector and len(owners) > 1:
            pass_renderer = replace(pass_renderer, mattes=True)
        self.update_progress(0.1)
        self.update_stats("", f"Drawing {len(still.model.splats):,} splats")
        if shutter_lens.blurs:
            shot = self._mean(
                pass_renderer.without(at_frame=True),
                shutter_lens,
                scene.gscore_render.blur_samples,
            )
            # At the frame, through the lens's middle: mean depths are useless.
            if pass_renderer.at_frame:
                plain = pass_renderer.without(surface=True)
                found = plain.render(still, self._stops)
                shot.passes.update((name, found[name]) for name in found if name not in shot.passes)
        else:
            shot = pass_renderer.expose(still, self._stops)
        passes = pass_renderer.completed(shot, still, self._stops)
        if requested.position or requested.vector:
            depth = passes["Depth"] if requested.depth else passes.pop("Depth")
            places = position_pass(depth, still.camera, window)
            if requested.vector:
                frames, known = shutter_lens.neighbours(), depth < NOTHING
                covered = shot.covered or dict.fromkeys(owners, known)
                passes["Vector"] = vector_pass(places, known, frames, covered)
            if requested.position:
                passes["Position"] = places
        mattes, stamps = requested.mattes_of(shot.covered, passes["Combined"].shape[:2], layer.name)
        self.update_progress(0.9)
        result = self.begin_result(0, 0, *size, layer=layer.name, view=view)
        drawn = result.resolution_x, result.resolution_y  # may be smaller than the window
        for name, values in (passes | mattes).items():
            part = picture.crop(values, *corner, *drawn)
            # Flat, and not assigned: rect = array converts each number separately.
            result.layers[0].passes[name].rect.foreach_set(part.ravel())
        self.end_result(result)
        for key, value in stamps.items():
            self.get_result().stamp_data_add_field(key, value)

    def _stops(self) -> bool:
        """Whether the user cancels; shows what the device does meanwhile."""
        if self._device is not None and self._device.status:
            self.update_stats("", self._device.status)
        return self.test_break()

    def _mean(self, pass_renderer: PassRenderer, shutter_lens: ShutterLens, count: int) -> Shot:
        """Means over lens and exposure."""
        last, shot, means = None, Shot({}, {}, {}), (Mean(), Mean(), Mean())
        _, top, _, height = pass_renderer.options.window or (0, 0, 0, self.resolution_y)
        # Pictures have the bottom row first.
        rows = (np.arange(top, top + height)[::-1] + 0.5) / self.resolution_y
        shares = shutter_lens.shares(count, rows)
        with closing(shutter_lens.views(count)) as views:
            for i, view in enumerate(views):
                self.update_stats("", f"Sample {i + 1} of {count}")
                if last is None or not view.same(last):
                    last, shot = view, pass_renderer.expose(view, self._stops)
                if self.test_break():
                    raise Cancelled
                for mean, pictures in zip(means, shot, strict=True):
                    mean.add(pictures, None if shares is None else shares[i])
                self.update_progress(0.1 + 0.8 * (i + 1) / count)
        return Shot(*(mean.result() for mean in means))

    def _warn(self, shown: unsupported_settings.Shown) -> None:
        """Report settings without effect and missing frames, once per animation."""
        if self.is_animation and shown.scene.frame_current != shown.scene.frame_start:
            return
        gaps = (gap_sentence(ob) for ob in shown.splats if plays(ob))
        for sentence in [*unsupported_settings.without_effect(shown), *filter(None, gaps)]:
            self.report({"WARNING"}, sentence)

    def _camera(self, scene: bpy.types.Scene, main: bpy.types.Scene | None) -> bpy.types.Object:
        ob = self.camera_override or scene.camera
        if ob is None:
            raise ValueError(
                f"Scene {scene.name} has no camera: add one, or choose an imported one as the "
                f"scene's camera."
            )
        if main is not None and main.camera is not None and main.camera.name != ob.name:
            raise ValueError(
                f"The camera of scene {scene.name} is {ob.name}, that of scene {main.name} is "
                f"{main.camera.name}: run Composite Splats with Meshes again in {main.name}."
            )
        if problem := refusal(scene, ob):
            raise ValueError(problem)
        return ob


def on_register() -> None:
    """Keep sequences from changing their meshes while this engine renders."""
    frame_sync.TAKE_FRAMES.add(NAME)


def on_unregister() -> None:
    """Stop the viewports and drop their splats."""
    frame_sync.TAKE_FRAMES.discard(NAME)
    _leave_viewports()
    for renderer in list(_renderers):
        renderer.close()
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
