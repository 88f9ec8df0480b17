"""Unsupported settings: one table of the Blender settings that the engine ignores."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Vector

from ..cameras.panorama import KINDS, kind_of
from ..compat import matrix_to_numpy
from ..interface.blocks import first_few
from ..nodes import display
from ..splats import mending
from ..splats.objects import is_native, is_splats
from .compositing_scene import SPLAT_SCENE, main_scene
from .holdout_meshes import is_holdout, may_hide, not_taken_over
from .passes import SWITCHES
from .stereo import refusal
from .world import world_light, world_of

NOT_TAKEN_OVER = "Holdout of {} hides no splats yet: press Composite Splats with Meshes again."
"""Sentence on meshes that were held out after that."""
_DRAWN_BY_OTHERS = {
    *("MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME"),
    *("GPENCIL", "GREASEPENCIL"),
}
"""Types of objects that other engines draw."""
_FILTER = bpy.types.RenderSettings.bl_rna.properties["filter_size"]


@dataclass(frozen=True, kw_only=True)
class Shown:
    """What is rendered."""

    scene: bpy.types.Scene
    layer: bpy.types.ViewLayer
    camera: bpy.types.Object | None

    @property
    def splats(self) -> list[bpy.types.Object]:
        """The splat objects of the layer that are rendered."""
        return [ob for ob in self.layer.objects if is_splats(ob) and not ob.hide_render]


@dataclass(frozen=True)
class Check:
    """One row of the table."""

    sentence: str
    """What has no effect, and what to do; `{}` stands for what the test names."""
    test: Callable[[Shown], str]
    """Names what it concerns; empty where all is well."""
    refused: bool = False
    """Whether the render ends with an error instead."""


def refused(shown: Shown) -> list[str]:
    """Sentences on settings with which the engine draws nothing."""
    return [text for check, text in _found(shown) if check.refused]


def without_effect(shown: Shown) -> list[str]:
    """Sentences on settings that make no difference to the picture."""
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
    """The camera's name where splats lie beyond its far clipping plane."""
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
    """Passes that are asked for and not made."""
    wanted = []
    for prop in shown.layer.bl_rna.properties:
        name = prop.identifier
        asked = name.startswith("use_pass_") and prop.type == "BOOLEAN" and not prop.default
        if asked and name not in SWITCHES and getattr(shown.layer, name):
            wanted.append(prop.name)
    return ", ".join(wanted)


def _others(shown: Shown) -> str:
    """The first objects that are for other engines."""
    names = [
        ob.name
        for ob in shown.layer.objects
        if ob.type in _DRAWN_BY_OTHERS and not ob.hide_render and "gs_kind" not in ob
        if not is_native(ob)
        if not (may_hide(ob) and is_holdout(shown.layer, ob))
        if not ob.is_shadow_catcher
    ]
    return first_few(names, 2)


def _catchers(shown: Shown) -> str:
    """Objects of other engines that are to show shadows alone."""
    return ", ".join(
        ob.name
        for ob in shown.layer.objects
        if ob.type in _DRAWN_BY_OTHERS and ob.is_shadow_catcher and not ob.hide_render
        if "gs_kind" not in ob and not is_native(ob)
        if not (may_hide(ob) and is_holdout(shown.layer, ob))
    )


def _composited(shown: Shown) -> bool:
    """Whether splats are set up to be composited with what is rendered."""
    return isinstance(shown.scene.original.get(SPLAT_SCENE), bpy.types.Scene)


def _held_without_faces(shown: Shown) -> str:
    """Objects that are cut out and have no faces."""
    return ", ".join(
        ob.name
        for ob in shown.layer.objects
        if ob.type in _DRAWN_BY_OTHERS and "gs_kind" not in ob and not ob.hide_render
        if not may_hide(ob) and is_holdout(shown.layer, ob)
    )


def _modified(shown: Shown) -> str:
    """Splat objects that more than their display modifier would change."""
    return ", ".join(ob.name for ob in shown.splats if _changes(ob))


def _changes(ob: bpy.types.Object) -> bool:
    own = display.modifier_of(ob)
    others = any(m.show_render and (own is None or m.name != own.name) for m in ob.modifiers)
    return others or getattr(ob.data, "shape_keys", None) is not None


def _behind(sentence: str) -> Callable[[Shown], str]:
    """A test for the splat objects of which a sentence of `mending` is true."""

    def test(shown: Shown) -> str:
        return ", ".join(ob.name for ob in shown.splats if mending.problem(ob.original) == sentence)

    return test


def _world(shown: Shown) -> str:
    world = world_of(shown.scene, shown.layer)
    return "" if shown.scene.render.film_transparent else world_light(world)[1]


CHECKS = (
    Check(
        "The camera is {}, and splats are rendered by perspective, orthographic, equirectangular "
        "and fisheye ones (equidistant, equisolid): change its type.",
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
        "{} is not drawn by this engine, with which compositing rests: Cycles and EEVEE render "
        "both.",
        lambda s: _others(s) if _composited(s) else "",
    ),
    Check("Holdout of {} hides no splats: only faces do.", _held_without_faces),
    Check(
        NOT_TAKEN_OVER,
        lambda s: not_taken_over(main_scene(s.scene), s.scene),
    ),
    Check("Modifiers and shape keys of {} have no effect: Export what they show.", _modified),
    *(
        Check(f"{text} {button} under Result mends it.", _behind(text))
        for text, button in (
            (mending.APPLIED, "Turn Shapes and Colors Along"),
            (mending.JOINED, "Turn Shapes and Colors Along"),
            (mending.STRETCHED, "Take Stretching Back"),
        )
    ),
    Check(
        "Shadow Catcher of {} has no effect: light throws no shadows on splats.",
        lambda s: ", ".join(ob.name for ob in s.splats if ob.is_shadow_catcher),
    ),
    Check(
        "Shadow Catcher {} is not drawn by this engine: Cycles lays its shadows over splats, with "
        "Composite Splats with Meshes.",
        _catchers,
    ),
    Check(
        "The Material Override {} has no effect: splats have colors of their own.",
        lambda s: getattr(s.layer.material_override, "name", ""),
    ),
    Check(
        "The passes are picture, depth, object index, and Cryptomatte of objects and assets: there "
        "is no {}.",
        _passes,
    ),
    Check("Freestyle has no effect.", lambda s: _if(s.scene.render.use_freestyle)),
    Check("Simplify has no effect on splats.", lambda s: _if(s.scene.render.use_simplify)),
    Check(
        "Threads has no effect on splats: all processors draw.",
        lambda s: _if(s.scene.render.threads_mode == "FIXED"),
    ),
    Check(
        "The pixel filter's size has no effect: splats are filtered as in training.",
        lambda s: _if(abs(s.scene.render.filter_size - _FILTER.default) > 1e-3),
    ),
)
