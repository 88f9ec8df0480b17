"""Render panels of the Properties editor: Blender's panels for this engine, and its own."""

from typing import Any, ClassVar

import bpy

from ..cameras.panorama import KINDS, kind_of
from ..compat import panorama_settings
from ..interface.base_operator import letters, wrapped
from ..splats.objects import is_native, is_splats
from ..timeline.settings import plays
from . import unsupported_settings
from .engine import NAME
from .holdout_meshes import may_hide
from .operators import changes_colors
from .shutter_lens import blurs

_OTHERS = {"EEVEE_WORLD_PT_surface", "WORLD_PT_context_world"}
"""Panels that are declared for other engines only, but show settings that this one uses."""
_UNUSED = ("freestyle", "gpencil", "grease", "simplify")
"""Name parts of panels for all engines whose settings this one does not use."""


def draw_render(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw settings, warnings and their fixes; for the properties editor and the sidebar."""
    scene, layer, width = context.scene, context.view_layer, letters()
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    column.prop(scene.render, "film_transparent", text="Transparent")
    column.prop(scene.gscore_render, "antialias")
    column.prop(scene.gscore_render, "live")
    column.prop(scene.render, "use_motion_blur")
    if scene.render.use_motion_blur:
        column.prop(scene.render, "motion_blur_position")
        column.prop(scene.render, "motion_blur_shutter")
        if hasattr(scene, "cycles"):
            column.prop(scene.cycles, "rolling_shutter_type", text="Rolling Shutter")
            if scene.cycles.rolling_shutter_type != "NONE":
                column.prop(scene.cycles, "rolling_shutter_duration", text="Duration")
    if scene.camera is not None and blurs(scene, scene.camera):
        column.prop(scene.gscore_render, "blur_samples")
    changes = changes_colors(scene)
    if changes:
        box = layout.box()
        box.label(text=f"{changes} changes the colors", icon="ERROR")
        box.operator("gscore.use_photo_colors", icon="CHECKMARK")
    shown = unsupported_settings.Shown(scene=scene, layer=layer, camera=scene.camera)
    for text in unsupported_settings.refused(shown):
        wrapped(layout, text, icon="ERROR", width=width)
    for text in unsupported_settings.without_effect(shown):
        wrapped(layout, text, icon="INFO", width=width)


class _EnginePanel:
    """Mixed in before bpy.types.Panel: a panel of the properties editor for this engine."""

    bl_space_type, bl_region_type = "PROPERTIES", "WINDOW"
    COMPAT_ENGINES: ClassVar[set[str]] = {NAME}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether this engine is active."""
        return context.engine in cls.COMPAT_ENGINES


class RENDER_PT_gscore(_EnginePanel, bpy.types.Panel):  # noqa: N801 Blender's rule
    """Film and colours."""

    bl_label = "Gaussian Splats"
    bl_context = "render"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        draw_render(self.layout, context)


class VIEWLAYER_PT_gscore_passes(_EnginePanel, bpy.types.Panel):  # noqa: N801 Blender's rule
    """Passes of the engine."""

    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, layer = self.layout, context.view_layer
        layout.use_property_split, layout.use_property_decorate = True, False
        column = layout.column(heading="Data")
        column.prop(layer, "use_pass_z", text="Depth")
        column.prop(layer, "use_pass_position", text="Position")
        column.prop(layer, "use_pass_normal", text="Normal")
        column.prop(layer, "use_pass_vector", text="Vector")
        column.prop(layer, "use_pass_object_index", text="Object Index")
        if layer.use_pass_object_index:
            column.prop(layer, "pass_alpha_threshold", text="Alpha Threshold")
        column.prop(context.scene.gscore_render, "splat_index")
        column.prop(layer, "use_pass_diffuse_color", text="Diffuse Color")
        column.prop(layer, "use_pass_shadow", text="Shadow")
        column = layout.column(heading="Cryptomatte")
        column.prop(layer, "use_pass_cryptomatte_object", text="Object")
        column.prop(layer, "use_pass_cryptomatte_asset", text="Asset")
        if layer.use_pass_cryptomatte_object or layer.use_pass_cryptomatte_asset:
            column.prop(layer, "pass_cryptomatte_depth", text="Levels")
        wrapped(layout, "Splats have no materials, so there are no other passes.", icon="INFO")


class DATA_PT_gscore_panorama(_EnginePanel, bpy.types.Panel):  # noqa: N801 Blender's rule
    """Settings of panoramic cameras, which Blender's own panel shows for Cycles only."""

    bl_label = "Panorama"
    bl_context = "data"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether this engine and a panoramic camera are active."""
        camera = context.camera
        return super().poll(context) and camera is not None and camera.type == "PANO"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        draw_panorama(self.layout, context.camera)


class OBJECT_PT_gscore_motion_blur(_EnginePanel, bpy.types.Panel):  # noqa: N801 Blender's rule
    """Switches of an object's motion blur, which Blender's own panel shows for Cycles only."""

    bl_label = "Motion Blur"
    bl_context = "object"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether this engine renders the active object or renders through it."""
        ob = context.object
        if ob is None or not super().poll(context):
            return False
        counts = ob.type == "CAMERA" or is_splats(ob) or is_native(ob) or may_hide(ob)
        return counts and hasattr(ob, "cycles")

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the switch."""
        self.layout.active = context.scene.render.use_motion_blur
        self.layout.prop(context.object.cycles, "use_motion_blur", text="")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the switch of frames that change within an exposure."""
        ob = context.object
        self.layout.active = context.scene.render.use_motion_blur and ob.cycles.use_motion_blur
        if plays(ob):
            self.layout.prop(ob.cycles, "use_deform_motion", text="Frames of the Sequence")


def draw_panorama(layout: bpy.types.UILayout, camera: bpy.types.Camera) -> None:
    """Draw the type of a panoramic camera and its settings."""
    own, column = panorama_settings(camera), layout.column()
    column.use_property_split = True
    if own is None:
        column.label(text="Enable Cycles, which stores these settings", icon="ERROR")
        return
    column.prop(own, "panorama_type")
    for name in KINDS.get(kind_of(camera), ()):
        column.prop(own, name)


def _shared() -> list[Any]:
    """Blender's panels whose settings this engine uses."""
    found = []
    for panel in bpy.types.Panel.__subclasses__():
        name = panel.__name__
        # BLENDER_RENDER is no longer an engine; it marks panels for all engines.
        general = "BLENDER_RENDER" in getattr(panel, "COMPAT_ENGINES", set())
        if name in _OTHERS or (general and not any(word in name for word in _UNUSED)):
            found.append(panel)
    return found


def on_register() -> None:
    """Add this engine to Blender's own panels."""
    for panel in _shared():
        panel.COMPAT_ENGINES.add(NAME)


def on_unregister() -> None:
    """Undo that. The add-on's own panels keep the name: Blender may enable the classes again."""
    for panel in bpy.types.Panel.__subclasses__():
        if panel.__module__ != __name__:
            getattr(panel, "COMPAT_ENGINES", set()).discard(NAME)
