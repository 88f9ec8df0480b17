"""Blender's own Gaussian splats: made by the display's nodes, and converted from its importers."""

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest

from addon import attributes
from addon.compat import splat_cloud_type
from addon.core import Splats, read_splats, transform_splats, write_splat_file
from addon.nodes import display
from addon.panels import result
from addon.process.incremental_tasks import TaskRunner
from addon.render import unsupported_settings
from addon.splats import objects, settings
from addon.splats.filters import visible_mask
from tests.addon import splat_scenes as lab
from tests.addon.calls import read_world
from tests.addon.drawn import drawn
from tests.addon.splats.test_operators import close
from tools.measure.windowless import windowless

Make = Callable[..., Splats]
COUNT = 300
needs_resize = pytest.mark.skipif(
    "resize" not in bpy.types.PointCloud.bl_rna.functions,
    reason="this Blender cannot size point clouds",
)
needs_native = pytest.mark.skipif(
    not splat_cloud_type(), reason="this Blender has no Gaussian splats of its own"
)


@pytest.fixture
def ob(scene: bpy.types.Scene, make_splats: Make) -> bpy.types.Object:
    """An active splat object."""
    ob = objects.create(make_splats(COUNT), "ours")
    bpy.context.view_layer.objects.active = ob
    return ob


def theirs(scene: bpy.types.Scene, given: Splats) -> bpy.types.Object:
    """An active, transformed point cloud with the attributes of Blender's own splats."""
    cloud = bpy.data.pointclouds.new("theirs")
    cloud.resize(len(given))
    attributes.write(cloud, given)
    base = attributes.column(cloud, attributes.BASE).ravel()
    attributes.declare(cloud, attributes.BASE, "FLOAT4")  # as Blender's importers
    attributes.fill(cloud, attributes.BASE, "FLOAT4", base)
    ob = bpy.data.objects.new("theirs", cloud)
    scene.collection.objects.link(ob)
    ob.rotation_euler, ob.location = (0.5, 1, 2), (1, 2, 3)
    bpy.context.view_layer.objects.active = ob
    bpy.context.view_layer.update()
    return ob


def test_native_splats_are_offered_where_blender_has_them(ob: bpy.types.Object) -> None:
    """Oracle: the type of the geometry made by the display's nodes."""
    items = ob.gscore.bl_rna.properties["display"].enum_items
    assert ("NATIVE" in items) == bool(splat_cloud_type())
    if "NATIVE" not in items:
        return
    ob.gscore.display = "NATIVE"
    ob.gscore.opacity_min = 0.5
    graph = bpy.context.evaluated_depsgraph_get()
    geometry = ob.evaluated_get(graph).evaluated_geometry()
    cloud = geometry.pointcloud
    assert cloud.type == "GAUSSIAN_SPLAT"
    shown = visible_mask(ob)
    assert 0 < shown.sum() < COUNT and len(cloud.points) == shown.sum()
    close(attributes.read(cloud), objects.read(ob).subset(shown))


@needs_native
def test_files_of_older_blenders_show_native_splats(ob: bpy.types.Object) -> None:
    """Oracle: the nodes, which are rebuilt if a file has those of a Blender without native
    splats."""
    group = display.modifier_of(ob).node_group
    group["gs_nodes"] = group["gs_nodes"].removesuffix(" native")
    ob.gscore.display = "NATIVE"
    assert display.modifier_of(ob).node_group != group


def test_files_of_another_blender_get_its_display(ob: bpy.types.Object, tmp_path: Path) -> None:
    """Oracle: the nodes of this Blender, immediately after loading."""
    group = display.modifier_of(ob).node_group
    tag = group["gs_nodes"]
    group["gs_nodes"] = tag.removesuffix(" native") if tag.endswith(" native") else f"{tag} native"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    modifier = display.modifier_of(bpy.data.objects["ours"])
    assert modifier.node_group["gs_nodes"] == tag


@needs_native
@pytest.mark.parametrize(("ending", "up"), [("ply", "Z"), ("spz", "-Y")])
def test_native_import_is_converted(
    scene: bpy.types.Scene, make_splats: Make, tmp_path: Path, ending: str, up: str
) -> None:
    """Oracle: Blender's own importers of the add-on's files, and the add-on's readers."""
    file = tmp_path / f"chair.{ending}"
    write_splat_file(file, make_splats(COUNT))
    getattr(bpy.ops.wm, f"{ending}_import")(filepath=str(file))
    cloud = bpy.context.object
    assert cloud.data.type == "GAUSSIAN_SPLAT"
    reported = drawn(result.ResultPanel)
    assert "Blender's own splats" in reported and "(Make Splat Object)" in reported
    assert bpy.ops.gscore.take_native_splats() == {"FINISHED"}
    made = bpy.context.object
    assert objects.is_splats(made) and cloud.hide_get() and cloud.hide_render
    bpy.ops.gscore.import_splats(filepath=str(file), up=up)
    ours = bpy.context.object
    found, wanted = read_world(made), read_world(ours)
    np.testing.assert_allclose(found.means, wanted.means, atol=2e-3)
    np.testing.assert_allclose(found.scales, wanted.scales, atol=0.05)
    np.testing.assert_allclose(found.sh0, wanted.sh0, atol=0.03)


@needs_resize
def test_a_cloud_becomes_a_splat_object(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: the given splats, the cloud's transform, and Blender's undo."""
    cloud = theirs(scene, make_splats(COUNT))
    cloud.parent = bpy.data.objects.new("parent", None)
    scene.collection.objects.link(cloud.parent)
    cloud.parent.location.z = 7
    bpy.context.view_layer.update()
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.gscore.take_native_splats() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="after")
    made = bpy.context.object
    bpy.context.view_layer.update()
    np.testing.assert_allclose(made.matrix_world, cloud.matrix_world, atol=1e-6)
    assert made.parent == cloud.parent
    close(objects.read(made), make_splats(COUNT))
    assert len(bpy.data.pointclouds) == 1  # no copy is left
    bpy.ops.ed.undo()
    obs = bpy.context.scene.objects[:]
    (cloud,) = [ob for ob in obs if ob.type == "POINTCLOUD"]
    assert not cloud.hide_get() and not any(objects.is_splats(ob) for ob in obs)


@needs_resize
def test_a_broken_cloud_is_a_sentence(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: no data are left, and the cloud is visible."""
    cloud = theirs(scene, make_splats(COUNT))
    cloud.data.attributes["scale"].data[3].vector = (float("nan"), 1, 1)
    assert "scale is not finite" in lab.error_of(bpy.ops.gscore.take_native_splats)
    assert len(bpy.data.pointclouds) == 1 and not cloud.hide_get()
    assert not any(objects.is_splats(ob) for ob in scene.objects)


@needs_resize
def test_blenders_splats_are_exported(
    scene: bpy.types.Scene, make_splats: Make, tmp_path: Path
) -> None:
    """Oracle: transform_splats by hand."""
    ob = theirs(scene, make_splats(COUNT))
    bpy.ops.gscore.export_splats(filepath=str(tmp_path / "out.ply"))
    matrix = np.array([tuple(r) for r in ob.matrix_basis], np.float64)
    close(read_splats(tmp_path / "out.ply"), transform_splats(make_splats(COUNT), matrix))


@needs_resize
def test_the_engine_renders_blenders_splats(scene: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: the picture of a splat object of the same splats; no warnings."""
    lab.prepare(scene)
    cloud = theirs(scene, lab.blob())
    cloud.rotation_euler, cloud.location = (0, 0, 0), (0, 0, 0)
    found = lab.render_exr(tmp_path, "theirs")
    shown = unsupported_settings.Shown(
        scene=scene, layer=bpy.context.view_layer, camera=scene.camera
    )
    assert not [text for text in unsupported_settings.without_effect(shown) if "theirs" in text]
    bpy.data.objects.remove(cloud)
    lab.add(scene, lab.blob())
    wanted = lab.render_exr(tmp_path, "ours")
    assert wanted.max() > 0.1
    np.testing.assert_array_equal(found, wanted)


@needs_resize
def test_the_display_is_built_in_parts(
    built_anew: None, scene: bpy.types.Scene, make_splats: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the number of node groups and materials after each step."""
    theirs(scene, make_splats(COUNT))
    for block in [*bpy.data.node_groups, *bpy.data.materials]:
        bpy.data.batch_remove([block])
    monkeypatch.setattr(settings, "BUDGET", 0.0)
    going = TaskRunner(windowless("take_native_splats").steps(bpy.context))
    counts = [0]
    while not going.step():
        counts.append(len(bpy.data.node_groups) + len(bpy.data.materials))
    assert counts[-1] > 8 and np.diff(counts).max() <= 2
    assert display.modifier_of(bpy.context.object).node_group == display.group()
