"""Unsupported settings: table of the Blender settings that the engine ignores, and the effects that
renders show and 3D views do not.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Vector

from ..cameras.panorama import KINDS, kind_of
from ..compat import matrix_to_numpy
from ..interface.blocks import first_few
from ..nodes import display
from ..splats import lag
from ..splats.objects import has_albedo, is_native, is_splats
from .color import world_light, world_of
from .compositing_scene import SPLAT_SCENE, main_scene, missing_splats
from .holdout_meshes import is_holdout, may_hide, missing_holdouts
from .passes import SWITCHES, splats_of
from .shutter_lens import has_depth_of_field, has_motion_blur
from .stereo import refusal

NOT_COMPOSITED = "{} is not composited yet: press Composite Splats with Meshes again."
"""Message about splats that were added after the set-up."""
NOT_TAKEN_OVER = "Holdout of {} hides no splats yet: press Composite Splats with Meshes again."
"""Message about meshes that became holdouts after the set-up."""
_DRAWN_BY_OTHERS = {
    *("MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME"),
    *("GPENCIL", "GREASEPENCIL"),
}
"""Object types that only other engines draw."""
_FILTER = bpy.types.RenderSettings.bl_rna.properties["filter_size"]


@dataclass(frozen=True, kw_only=True)
class Shown:
    """Scene, view layer and camera of a render."""

    scene: bpy.types.Scene
    layer: bpy.types.ViewLayer
    camera: bpy.types.Object | None

    @property
    def splats(self) -> list[bpy.types.Object]:
        """The rendered splat objects of the layer."""
        return [ob for ob in self.layer.objects if is_splats(ob) and not ob.hide_render]


@dataclass(frozen=True)
class Check:
    """One row of the table."""

    sentence: str
    """Message; `{}` is replaced by the result of the test."""
    test: Callable[[Shown], str]
    """Returns names of the objects or settings concerned; empty: none."""
    refused: bool = False
    """Whether the render ends with an error."""


def refused(shown: Shown) -> list[str]:
    """Messages about settings with which the engine does not render."""
    return [text for check, text in _found(shown) if check.refused]


def without_effect(shown: Shown) -> list[str]:
    """Messages about settings that have no effect on the picture."""
    return [text for check, text in _found(shown) if not check.refused]


def _found(shown: Shown) -> Iterator[tuple[Check, str]]:
    for check in CHECKS:
        if name := check.test(shown):
            yield check, check.sentence.format(name)


def _if(condition: bool) -> str:
    return "yes" if condition else ""


def _no_camera_type(shown: Shown) -> str:
    data = getattr(shown.camera, "data", None)
    kind = getattr(data, "type", "")
    if kind == "PANO" and (own := kind_of(data)) not in KINDS:
        return f"panoramic ({own.replace('_', ' ').lower() or 'without Cycles'})"
    return "custom" if kind == "CUSTOM" else ""


def _sharp_panorama(shown: Shown) -> str:
    data = getattr(shown.camera, "data", None)
    sharp = getattr(data, "type", "") == "PANO" and data.dof.use_dof
    return shown.camera.name if sharp else ""


def _clip_end(shown: Shown) -> str:
    """The camera's name if splats are beyond its far clipping plane."""
    camera = shown.camera
    if camera is None or camera.type != "CAMERA":
        return ""
    forward = -matrix_to_numpy(camera.matrix_world)[:3, 2]
    eye = matrix_to_numpy(camera.matrix_world)[:3, 3]
    for ob in shown.splats:
        corners = np.array(
            [(ob.matrix_world @ Vector(corner))[:] for corner in ob.original.bound_box]
        )
        if ((corners - eye) @ forward).max() > camera.data.clip_end:
            return camera.name
    return ""


def _passes(shown: Shown) -> str:
    """Requested passes that the engine does not make."""
    missing = []
    for prop in shown.layer.bl_rna.properties:
        name = prop.identifier
        switch = name.startswith("use_pass_") and prop.type == "BOOLEAN" and not prop.default
        if switch and name not in SWITCHES and getattr(shown.layer, name):
            missing.append(prop.name)
    return ", ".join(missing)


def _without_albedo(shown: Shown) -> str:
    """Splats whose albedo the requested pass needs."""
    if not shown.layer.use_pass_diffuse_color:
        return ""
    return ", ".join(ob.name for ob in splats_of(shown.layer) if not has_albedo(ob))


def _by_others(shown: Shown, *, catchers: bool) -> list[str]:
    """Names of the shadow catchers, or of the other objects, that only other engines draw."""
    return [
        ob.name
        for ob in shown.layer.objects
        if ob.type in _DRAWN_BY_OTHERS and not ob.hide_render and "gs_kind" not in ob
        if not is_native(ob) and not (may_hide(ob) and is_holdout(shown.layer, ob))
        if ob.is_shadow_catcher == catchers and ob.visible_camera
    ]


def _others(shown: Shown) -> str:
    return first_few(_by_others(shown, catchers=False), 2)


def _composited(shown: Shown) -> bool:
    """Whether compositing of splats is set up in the rendered scene."""
    return isinstance(shown.scene.original.get(SPLAT_SCENE), bpy.types.Scene)


def _holdouts_without_faces(shown: Shown) -> str:
    """Holdout objects without faces."""
    return ", ".join(
        ob.name
        for ob in shown.layer.objects
        if ob.type in _DRAWN_BY_OTHERS and "gs_kind" not in ob and not ob.hide_render
        if not may_hide(ob) and is_holdout(shown.layer, ob)
    )


def _changes(ob: bpy.types.Object) -> bool:
    """Whether a splat object has modifiers other than its display, or shape keys."""
    own = display.modifier_of(ob)
    others = any(m.show_render and (own is None or m.name != own.name) for m in ob.modifiers)
    return others or getattr(ob.data, "shape_keys", None) is not None


def _with_problem(sentence: str) -> Callable[[Shown], str]:
    """A test for splat objects with a given problem of `lag`."""

    def test(shown: Shown) -> str:
        obs = [ob.original for ob in shown.splats]
        return ", ".join(ob.name for ob in obs if lag.problem(ob.data) == sentence)

    return test


def _world(shown: Shown) -> str:
    world = world_of(shown.scene, shown.layer)
    return "" if shown.scene.render.film_transparent else world_light(world)[1]


CHECKS = (
    Check(
        "The camera is {}: change its type. Splats are rendered by perspective, orthographic, "
        "equirectangular and fisheye cameras (equidistant, equisolid).",
        _no_camera_type,
        refused=True,
    ),
    Check("{}", lambda s: refusal(s.scene, s.camera), refused=True),
    Check(
        "Depth of Field of {} has no effect: panoramas are sharp at every distance.",
        _sharp_panorama,
    ),
    Check("Clip End of {} has no effect: splats beyond it are drawn.", _clip_end),
    Check("{}", _world),
    Check(
        "{} is not drawn by this engine: Composite Splats with Meshes renders both.",
        lambda s: "" if _composited(s) else _others(s),
    ),
    Check(
        "{} is not drawn by this engine, which disables compositing: Cycles and EEVEE render both.",
        lambda s: _others(s) if _composited(s) else "",
    ),
    Check("Holdout of {} hides no splats: only faces do.", _holdouts_without_faces),
    Check(NOT_COMPOSITED, lambda s: missing_splats(main_scene(s.scene), s.scene)),
    Check(NOT_TAKEN_OVER, lambda s: missing_holdouts(main_scene(s.scene), s.scene)),
    Check(
        "Modifiers and shape keys of {} have no effect: only exports apply them.",
        lambda s: ", ".join(ob.name for ob in s.splats if _changes(ob)),
    ),
    Check(
        f"{lag.APPLIED} Update Shapes and Colors under Result fixes it.",
        _with_problem(lag.APPLIED),
    ),
    Check(lag.JOINED, _with_problem(lag.JOINED)),
    Check(
        "Shadow Catcher of {} has no effect: proxies of splats catch shadows.",
        lambda s: ", ".join(ob.name for ob in s.splats if ob.is_shadow_catcher),
    ),
    Check(
        "Shadow Catcher {} is not drawn by this engine: to get its shadows on splats, use Cycles "
        "and Composite Splats with Meshes.",
        lambda s: ", ".join(_by_others(s, catchers=True)),
    ),
    Check(
        "The Material Override {} has no effect: splats have no materials.",
        lambda s: getattr(s.layer.material_override, "name", ""),
    ),
    Check(
        "This engine has no pass {}. Its passes are Combined, Depth, Position, Normal, Vector, "
        "Diffuse Color, Shadow, Object Index, Splat Index, and Cryptomatte of objects and assets.",
        _passes,
    ),
    Check(
        "The pass Diffuse Color is left out or black for {}: press Relight Splats, which estimates "
        "it.",
        _without_albedo,
    ),
    Check("Freestyle has no effect.", lambda s: _if(s.scene.render.use_freestyle)),
    Check("Simplify has no effect on splats.", lambda s: _if(s.scene.render.use_simplify)),
    Check(
        "Threads has no effect on splats: all processors are used.",
        lambda s: _if(s.scene.render.threads_mode == "FIXED"),
    ),
    Check(
        "The pixel filter size has no effect: splats are filtered as in training.",
        lambda s: _if(abs(s.scene.render.filter_size - _FILTER.default) > 1e-3),
    ),
)


def renders_only(depsgraph: bpy.types.Depsgraph, camera: bpy.types.Object | None) -> str:
    """Status text with the effects that a view in Rendered shading lacks; empty: none.

    Args:
        depsgraph: Depsgraph of the view.
        camera: Camera of the view; None: no camera.
    """
    if camera is None or camera.type != "CAMERA":
        return ""
    scene, data = depsgraph.scene, camera.data
    found = {
        "Depth of Field": has_depth_of_field(camera),
        "Motion Blur": has_motion_blur(scene.render) and depsgraph.view_layer_eval.use_motion_blur,
        "Panoramic": data.type == "PANO",
        "Stereoscopy": scene.render.use_multiview,
    }
    names = [name for name, there in found.items() if there]
    return f"In renders only: {', '.join(names)}" if names else ""
