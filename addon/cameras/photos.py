"""Photo display behind the cameras of a capture: visibility and opacity."""

import bpy

from ..interface import editable_check
from .lookup import panel_root
from .objects import cameras_of


def _cameras(scene: bpy.types.Scene) -> list[bpy.types.Camera]:
    """Camera data of the sidebar's capture, of cameras with a photo."""
    root = panel_root(scene)
    obs = [] if root is None else cameras_of(root)
    return [ob.data for ob in obs if ob.data.background_images]


def changeable(scene: bpy.types.Scene) -> list[bpy.types.Camera]:
    """Cameras whose photos can be shown, hidden and faded: linked ones are left out."""
    return list(filter(editable_check.keeps, _cameras(scene)))


def show(scene: bpy.types.Scene, shown: bool) -> None:
    """Show or hide the photos of the sidebar's capture; other captures stay unchanged."""
    for camera in changeable(scene):
        camera.show_background_images = shown


def _get_shown(self: "PhotoSettings") -> bool:
    return any(camera.show_background_images for camera in _cameras(self.id_data))


def _set_shown(self: "PhotoSettings", shown: bool) -> None:
    show(self.id_data, shown)


def _get_opacity(self: "PhotoSettings") -> float:
    camera = next(iter(_cameras(self.id_data)), None)
    return 1.0 if camera is None else camera.background_images[0].alpha


def _set_opacity(self: "PhotoSettings", opacity: float) -> None:
    for camera in changeable(self.id_data):
        camera.background_images[0].alpha = opacity


class PhotoSettings(bpy.types.PropertyGroup):
    """`Scene.gscore_photos`; the cameras store the values, so that they cannot disagree."""

    shown: bpy.props.BoolProperty(
        name="Show Photos",
        description="Show the capture's photos behind their cameras",
        get=_get_shown,
        set=_set_shown,
    )
    opacity: bpy.props.FloatProperty(
        name="Opacity",
        description="Opacity of the photos; below 1 the scene behind them shows through",
        subtype="FACTOR",
        min=0.0,
        max=1.0,
        get=_get_opacity,
        set=_set_opacity,
    )


PROPERTIES = ((bpy.types.Scene, "gscore_photos", bpy.props.PointerProperty(type=PhotoSettings)),)
