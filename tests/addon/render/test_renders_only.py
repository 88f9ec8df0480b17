"""Status text of camera views about effects that they lack. Oracles are named in the tests."""

import bpy
import pytest

from addon.render.unsupported_settings import renders_only
from tests.addon import splat_scenes as lab


def said(camera: bpy.types.Object | None) -> str:
    """Status text of a view in the open file."""
    bpy.context.view_layer.update()
    return renders_only(bpy.context.evaluated_depsgraph_get(), camera)


def lens(scene: bpy.types.Scene) -> None:
    """Depth of field."""
    scene.camera.data.dof.use_dof = True


def shutter(scene: bpy.types.Scene) -> None:
    """Motion blur."""
    scene.render.use_motion_blur = True


def panorama(scene: bpy.types.Scene) -> None:
    """A panoramic camera."""
    scene.camera.data.type = "PANO"


def eyes(scene: bpy.types.Scene) -> None:
    """Stereo."""
    scene.render.use_multiview = True


SETTINGS = {
    "Depth of Field": lens,
    "Motion Blur": shutter,
    "Panoramic": panorama,
    "Stereoscopy": eyes,
}


@pytest.mark.parametrize("words", SETTINGS)
def test_effects_missing_in_a_view_are_named(scene: bpy.types.Scene, words: str) -> None:
    """Oracle: the names of Blender's panels, only in camera perspective."""
    lab.prepare(scene)
    assert not said(scene.camera)
    SETTINGS[words](scene)
    assert said(scene.camera) == f"In renders only: {words}"
    assert not said(None)


def test_effects_without_influence_are_not_named(scene: bpy.types.Scene) -> None:
    """Oracle: panoramas are sharp at every distance; a layer may disable motion blur; a shutter
    time of 0 blurs nothing. All effects are in one sentence."""
    lab.prepare(scene)
    for change in (lens, shutter, panorama):
        change(scene)
    assert said(scene.camera) == "In renders only: Motion Blur, Panoramic"
    bpy.context.view_layer.use_motion_blur = False
    assert said(scene.camera) == "In renders only: Panoramic"
    bpy.context.view_layer.use_motion_blur = True
    scene.render.motion_blur_shutter = 0
    assert said(scene.camera) == "In renders only: Panoramic"
