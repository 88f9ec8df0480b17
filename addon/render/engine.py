"""The render engine "Gaussian Splats": F12, animations, and the viewport's Rendered shading."""

import traceback
from typing import Any

import bpy
import numpy as np

from ..cameras import RenderCamera, render_camera
from ..compat import rec709_to_scene, world_nodes
from ..core import Cancelled, GsError
from . import color, picture
from .scene import Model, SplatCache, place, sources

NAME = "GSCORE_SPLATS"
"""The engine in `scene.render.engine`."""
MAIN_SCENE = "gs_main_scene"
"""Custom property of a scene that only renders the splats of another: that scene."""
final_cache = SplatCache()
"""Decoded splats of the last picture: the frames of an animation share it."""


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
        self.register_pass(scene, renderlayer, "Combined", 4, "RGBA", "COLOR")
        if renderlayer.use_pass_z:
            self.register_pass(scene, renderlayer, "Depth", 1, "Z", "VALUE")

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Draw one view layer of one frame. In the program this is not the main thread."""
        # An exception would leave a black picture and the word FINISHED.
        try:
            self._render(depsgraph)
        except Cancelled:
            pass
        except (GsError, ValueError) as error:
            self._refuse(str(error))
        except MemoryError:
            self._refuse("Not enough memory to render the splats: close programs or delete some.")
        except Exception as error:
            traceback.print_exc()
            self._refuse(f"Rendering splats failed: {error!r}. Details are in the console.")

    def _refuse(self, message: str) -> None:
        """Stop with a sentence: on the render window, and as the operator's error."""
        self.error_set(message)
        self.report({"ERROR"}, message)

    def _render(self, depsgraph: bpy.types.Depsgraph) -> None:
        scene = depsgraph.scene
        camera = self._camera(depsgraph)
        self.update_stats("", "Reading splats")
        model = collect(depsgraph, final_cache)
        light, problem = world_light(scene.world)
        transparent = scene.render.film_transparent
        if problem and not transparent:
            self.report({"WARNING"}, problem)
        layer = depsgraph.view_layer_eval
        black = (0.0, 0.0, 0.0)
        options = picture.Options(
            background=black if transparent else background_of(light),
            depths=layer.use_pass_z,
            antialias=scene.gscore_render.antialias,
        )
        self.update_progress(0.2)
        self.update_stats("", f"Drawing {len(model.splats):,} splats")
        rendered = picture.draw(model, camera, options, stop=self.test_break)
        self.update_progress(0.8)
        passes = {
            "Combined": color.combined(
                rendered, transparent=transparent, to_scene=rec709_to_scene()
            )
        }
        if layer.use_pass_z:
            passes["Depth"] = color.z_pass(rendered)
        self._deliver(passes, layer.name, scene.render)

    def _camera(self, depsgraph: bpy.types.Depsgraph) -> RenderCamera:
        scene = depsgraph.scene
        ob = self.camera_override or scene.camera
        if ob is None:
            raise ValueError(
                f"Scene {scene.name} has no camera: add one, or choose an imported one as the "
                f"scene's camera."
            )
        main = scene.get(MAIN_SCENE)
        if main is not None and main.camera is not None and main.camera.name != ob.name:
            raise ValueError(
                f"Scene {scene.name} looks through {ob.name}, scene {main.name} through "
                f"{main.camera.name}: run Composite Splats with Meshes again in {main.name}."
            )
        if scene.render.use_multiview:
            raise ValueError(
                "Splats are not rendered in stereo: turn off Stereoscopy in the output properties."
            )
        size = {"width": self.resolution_x, "height": self.resolution_y}
        return render_camera(ob, scene, depsgraph=depsgraph, **size)

    def _deliver(
        self, passes: dict[str, np.ndarray], layer: str, render: bpy.types.RenderSettings
    ) -> None:
        """Hand full-size pictures over; with a border Blender's result is that window of them."""
        full = self.resolution_x, self.resolution_y
        left, bottom = border_corner(render, *full) if render.use_border else (0, 0)
        result = self.begin_result(0, 0, *full, layer=layer)
        size = result.resolution_x, result.resolution_y
        for name, values in passes.items():
            window = picture.crop(values, left, bottom, *size)
            # Flat, and never assigned: rect = array converts every number by itself.
            result.layers[0].passes[name].rect.foreach_set(window.ravel())
        self.end_result(result)


def collect(depsgraph: bpy.types.Depsgraph, cache: SplatCache) -> Model:
    """The model of everything a depsgraph shows.

    Raises:
        ValueError: there is nothing to draw, or an object cannot be drawn; it is named.
    """
    placed = [place(source) for source in sources(depsgraph)]
    if not placed:
        raise ValueError(
            "There are no splats to render: import a splat PLY, or enable the splat object and its "
            "collection for renders."
        )
    return cache.model(placed)


def world_light(world: bpy.types.World | None) -> tuple[np.ndarray, str]:
    """Scene-linear colour of the background [3], and a sentence where the world is not that."""
    if world is None:
        return np.zeros(3), ""
    tree = world_nodes(world)
    if tree is None:
        return np.array(world.color), ""
    node = next((n for n in tree.nodes if n.type == "BACKGROUND"), None)
    if node is not None and not any(s.is_linked for s in node.inputs):
        return np.array(node.inputs[0].default_value[:3]) * node.inputs[1].default_value, ""
    return (
        np.array(world.color),
        f"World {world.name} is not one colour, which is all that splats are rendered over: its "
        f"viewport colour is used. Turn on Transparent and composite the splats over the world.",
    )


def background_of(light: np.ndarray) -> tuple[float, float, float]:
    """sRGB values of a scene-linear colour."""
    rec709 = np.linalg.solve(rec709_to_scene(), np.asarray(light, np.float64))
    r, g, b = (float(v) for v in color.encode(rec709))
    return r, g, b


def border_corner(render: bpy.types.RenderSettings, width: int, height: int) -> tuple[int, int]:
    """Left and bottom pixel of the render border, as Blender computes them: in float32."""
    left = np.float32(render.border_min_x) * np.float32(width)
    bottom = np.float32(render.border_min_y) * np.float32(height)
    return int(left), int(bottom)


def register() -> None:
    """Make the engine known."""
    bpy.utils.register_class(SplatsRenderEngine)


def unregister() -> None:
    """Forget the engine and its splats."""
    bpy.utils.unregister_class(SplatsRenderEngine)
    final_cache.clear()
