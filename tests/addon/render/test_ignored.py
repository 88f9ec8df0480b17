"""Oracle: pictures with a setting and without it, to the bit, and the reports of the render."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from addon import compat
from addon.render import compositor, panels, unsupported_settings
from addon.render.engine import NAME
from addon.render.operators import changes_colors, use_photo_colors
from tests.addon import splat_scenes as lab


def shown() -> unsupported_settings.Shown:
    """The `Shown` of the open file."""
    context = bpy.context
    context.view_layer.update()
    return unsupported_settings.Shown(
        scene=context.scene, layer=context.view_layer, camera=context.scene.camera
    )


def others(scene: bpy.types.Scene) -> None:
    """A mesh in front of the camera."""
    mesh = bpy.data.meshes.new("board")
    mesh.from_pydata([(-1, -1, 2), (1, -1, 2), (0, 1, 2)], [], [(0, 1, 2)])
    scene.collection.objects.link(bpy.data.objects.new("board", mesh))


def catcher(scene: bpy.types.Scene) -> None:
    """The same, as a shadow catcher."""
    others(scene)
    bpy.data.objects["board"].is_shadow_catcher = True


def composited(scene: bpy.types.Scene) -> None:
    """The same, with compositing set up, and then the splats' engine."""
    others(scene)
    scene.render.engine = "CYCLES"
    compositor.set_up(scene, transparent=False)
    scene.render.engine = NAME


def modified(scene: bpy.types.Scene) -> None:
    """A modifier that would move every splat."""
    bpy.data.objects["splats"].modifiers.new("Move", "DISPLACE")


def striped_world(scene: bpy.types.Scene) -> None:
    """A world with a color texture; its viewport color stays the same."""
    tree = compat.world_nodes(scene.world)
    if tree is None:
        scene.world.use_nodes = True
        tree = scene.world.node_tree
    texture = tree.nodes.new("ShaderNodeTexWave")
    background = next(n for n in tree.nodes if n.type == "BACKGROUND")
    tree.links.new(texture.outputs[0], background.inputs[0])


def override(scene: bpy.types.Scene) -> None:
    """A material override."""
    bpy.context.view_layer.material_override = bpy.data.materials.new("clay")


def mirror_ball(scene: bpy.types.Scene) -> None:
    """An unsupported type of panorama."""
    data = scene.camera.data
    data.type = "PANO"
    compat.panorama_settings(data).panorama_type = "MIRRORBALL"


def many_cameras(scene: bpy.types.Scene) -> None:
    """Multi-View with other cameras."""
    scene.render.use_multiview, scene.render.views_format = True, "MULTIVIEW"


def setting(path: str, value: object) -> Callable[[bpy.types.Scene], None]:
    """One property of the scene's rendering, the layer, or the camera."""

    def spoil(scene: bpy.types.Scene) -> None:
        owner, name = path.split(".")
        owners = {"render": scene.render, "layer": bpy.context.view_layer}
        owners |= {"splats": bpy.data.objects["splats"], "camera": scene.camera.data}
        setattr(owners[owner], name, value)

    return spoil


WITHOUT_EFFECT = {
    "Clip End of Camera": setting("camera.clip_end", 3.5),
    "World World is not one uniform color": striped_world,
    "Composite Splats with Meshes renders both": others,
    "which disables compositing": composited,
    "shape keys of splats": modified,
    "Shadow Catcher of splats": setting("splats.is_shadow_catcher", True),
    "Shadow Catcher board is not drawn": catcher,
    "Material Override clay": override,
    "has no pass Mist": setting("layer.use_pass_mist", True),
    "black for splats: press Relight Splats": setting("layer.use_pass_diffuse_color", True),
    "Freestyle": setting("render.use_freestyle", True),
    "Simplify": setting("render.use_simplify", True),
    "Threads": setting("render.threads_mode", "FIXED"),
    "pixel filter": setting("render.filter_size", 5.0),
}
ELSEWHERE = {"Depth of Field", "Holdout", "Holdout among meshes", "Composite", "Apply", "Join"}
"""Tried in test_panorama.py with a panorama, below with meshes, in test_compositor.py, and in
splats/test_mending.py."""
REFUSED = {
    "mirrorball": mirror_ball,
    "Multi-View is not supported": many_cameras,
}


def reported(capfd: pytest.CaptureFixture[str]) -> list[str]:
    """The warnings that Blender has printed since the last call."""
    lines = capfd.readouterr().out.splitlines()
    return [line.removeprefix("Warning: ") for line in lines if line.startswith("Warning: ")]


def test_every_row_is_tried() -> None:
    """The numbers of rows and of test cases for them."""
    assert len(unsupported_settings.CHECKS) == len(WITHOUT_EFFECT) + len(REFUSED) + len(ELSEWHERE)


@pytest.mark.parametrize("words", WITHOUT_EFFECT)
def test_ignored_settings_are_reported(
    scene: bpy.types.Scene, tmp_path: Path, capfd: pytest.CaptureFixture[str], words: str
) -> None:
    """One message, in the panel and from the render; the picture does not change."""
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    before = lab.render_exr(tmp_path, "before")
    assert unsupported_settings.without_effect(shown()) == reported(capfd) == []
    WITHOUT_EFFECT[words](scene)
    np.testing.assert_array_equal(lab.render_exr(tmp_path, "after"), before)
    (sentence,) = unsupported_settings.without_effect(shown())
    assert words in sentence and reported(capfd) == [sentence]
    assert sentence.replace(" ", "") in drawn()


def test_objects_that_no_camera_sees_are_not_named(
    scene: bpy.types.Scene, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Such as proxies."""
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    others(scene)
    for ob in scene.objects:
        ob.visible_camera = "gs_kind" in ob
    lab.render_exr(tmp_path)
    assert unsupported_settings.without_effect(shown()) == reported(capfd) == []


def test_faceless_holdouts_are_named(
    scene: bpy.types.Scene, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the volume's name, and not that of a mesh, which does hide splats."""
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    others(scene)
    smoke = bpy.data.objects.new("smoke", bpy.data.volumes.new("smoke"))
    scene.collection.objects.link(smoke)
    for name in ("board", "smoke"):
        scene.objects[name].is_holdout = True
    lab.render_exr(tmp_path)
    (said,) = [text for text in reported(capfd) if "Holdout" in text]
    assert "Holdout of smoke hides no splats" in said


def test_mattes_of_materials_are_named(scene: bpy.types.Scene) -> None:
    """Oracle: the name of Blender's switch."""
    layer = bpy.context.view_layer
    layer.use_pass_cryptomatte_object = layer.use_pass_cryptomatte_asset = True
    layer.use_pass_object_index = True
    assert unsupported_settings.without_effect(shown()) == []
    layer.use_pass_cryptomatte_material = True
    (sentence,) = unsupported_settings.without_effect(shown())
    assert "has no pass Cryptomatte Material." in sentence


@pytest.mark.parametrize("words", REFUSED)
def test_refusal_is_shown_before_the_render(scene: bpy.types.Scene, words: str) -> None:
    """The panel has the reason before the render ends with it."""
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    REFUSED[words](scene)
    (sentence,) = unsupported_settings.refused(shown())
    assert words in sentence and sentence.replace(" ", "") in drawn()
    assert words in lab.error_of(bpy.ops.render.render)


def drawn() -> str:
    """All labels of the Render panel, without spaces, because lines wrap at the region's width."""
    labels: list[str] = []
    layout = SimpleNamespace(prop=lambda *a, **k: None, operator=lambda *a, **k: None)
    layout.label = lambda text="", icon="": labels.append(text)
    layout.column = layout.box = lambda **k: layout
    panels.draw_render(layout, bpy.context)
    return "".join(labels).replace(" ", "")


def test_an_animation_says_it_once(
    scene: bpy.types.Scene, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """One report for three frames."""
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    scene.render.use_freestyle = True
    scene.frame_start, scene.frame_end = 4, 6
    scene.render.filepath = str(tmp_path / "f")
    bpy.ops.render.render(animation=True)
    assert len(reported(capfd)) == 1 and len(list(tmp_path.iterdir())) == 3


def test_white_balance_changes_colors(scene: bpy.types.Scene) -> None:
    """Blender's switch of that name, if it has one."""
    view = scene.view_settings
    view.view_transform = "Standard"
    if not hasattr(view, "use_white_balance"):
        pytest.skip("this Blender has no white balance")
    view.use_white_balance = True
    assert changes_colors(scene) == "White Balance"
    use_photo_colors(scene)
    assert changes_colors(scene) == "" and not view.use_white_balance
