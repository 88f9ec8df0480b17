"""Render panel: render splats from Blender's cameras, and compare with the photos."""

import bpy

from ..cameras.objects import is_camera
from ..render import operators
from ..render.composite_nodes import combine_node, is_older
from ..render.compositing_scene import SPLAT_SCENE, helper, missing_splats
from ..render.engine import NAME
from ..render.holdout_meshes import missing_holdouts
from ..render.panels import draw_render
from ..render.proxy import left_over
from ..render.shadow_scene import missing as missing_casters
from ..render.unsupported_settings import NOT_COMPOSITED, NOT_TAKEN_OVER
from ..splats.objects import active_splats
from ..stored_paths import RUN
from .widgets import TabPanel, root, sentence


class RenderPanel(TabPanel, bpy.types.Panel):
    """Pictures of the splats"""

    bl_idname = "GSCORE_PT_render"
    bl_label = "Render"
    bl_order = 6

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, scene = self.layout, context.scene
        if scene.render.engine == NAME:
            draw_render(layout, context)
        else:
            text = "The render engine Gaussian Splats draws splats exactly as trained."
            sentence(layout, text, icon="INFO")
            layout.operator("gscore.use_engine", icon="SCENE")
        if operators.ends_early(scene):
            most = scene.cycles.transparent_max_bounces
            text = f"Cycles ends rays after {most} splats, so soft splats render too dark."
            sentence(layout, text, icon="ERROR")
            layout.operator("gscore.see_through_splats", icon="LIGHT")
        row = layout.row(align=True)
        row.enabled = scene.camera is not None
        row.operator("render.render", text="Picture", icon="RENDER_STILL").use_viewport = True
        row.operator("render.render", text="Animation", icon="RENDER_ANIMATION").animation = True
        if problem := operators.size_problem(scene):
            sentence(layout, problem, icon="ERROR")
            layout.operator("gscore.make_size_even")
        if scene.camera is None:
            layout.label(text="The scene has no camera", icon="ERROR")
        if root(context) is not None:
            row = layout.row()
            row.enabled = is_camera(context.object) or is_camera(scene.camera)
            row.operator("gscore.compare_photo", icon="IMAGE_REFERENCE")
        if RUN in (active_splats(context) or ()):
            layout.operator("gscore.compare_worst_photo")
        draw_compositing(layout, context)
        row = layout.row(align=True)
        row.operator("gscore.world_from_splats", icon="WORLD")
        row.operator("gscore.match_sun", icon="LIGHT_SUN")
        row = layout.row(align=True)
        row.operator("gscore.use_as_proxy", icon="MOD_SUBSURF")
        row.operator("gscore.remove_proxy", text="", icon="X")
        if names := ", ".join(sorted(ob.name for ob in left_over(scene))):
            text = f"The splats of {names} were removed, but it still casts shadows: press the X."
            sentence(layout, text, icon="INFO")


def draw_compositing(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the buttons that add and remove compositing, and notes on its state."""
    scene = context.scene
    there = combine_node(scene) is not None
    if there and scene.render.engine == NAME:
        text = "Compositing with meshes is off, because this engine draws the splats itself. The "
        sentence(layout, f"{text}button restores it with the former engine.", icon="INFO")
    elif is_older(scene):
        text = "Compositing was set up by an earlier version: press the button again to update it."
        sentence(layout, text, icon="INFO")
    elif names := missing_splats(scene, helper(scene, SPLAT_SCENE)):
        sentence(layout, NOT_COMPOSITED.format(names), icon="INFO")
    elif names := missing_holdouts(scene, helper(scene, SPLAT_SCENE)):
        sentence(layout, NOT_TAKEN_OVER.format(names), icon="INFO")
    elif there and (names := missing_casters(scene)):
        text = f"Shadows do not follow {names} yet: press the button again, or use collections."
        sentence(layout, text, icon="INFO")
    row = layout.row(align=True)
    row.operator("gscore.set_up_compositing", icon="NODE_COMPOSITING")
    if there:
        row.operator("gscore.remove_compositing", text="", icon="X")
