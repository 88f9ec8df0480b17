"""Node groups through the depsgraph and Cycles. Oracle: the same formulas in numpy."""

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Euler, Quaternion

from addon import compat
from addon.core import Splats, sh0_to_rgb
from addon.nodes import display, filters
from addon.nodes.colors import _VIRIDIS
from addon.splats import objects
from addon.splats import settings as splat_settings
from addon.splats.edit import stats
from addon.splats.filters import visible_mask
from tests.addon import points
from tests.light_changes import decode

pytestmark = pytest.mark.usefixtures("built_anew")
Make = Callable[..., Splats]
COUNT = 800


@pytest.fixture
def ob(scene: bpy.types.Scene, make_splats: Make) -> bpy.types.Object:
    """A splat object that is moved and rotated."""
    ob = objects.create(make_splats(COUNT), "Splats")
    ob.location, ob.rotation_euler, ob.scale = (1, 2, 3), (0.4, 0.5, 0.6), (2, 2, 2)
    bpy.context.view_layer.update()
    return ob


def shown(name: str = "position", key: str = "vector", width: int = 3) -> np.ndarray:
    """An attribute of the evaluated points, [M, width]; [0, width] if there are none."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    found = [np.zeros((0, width), np.float32)]
    for item in depsgraph.object_instances:  # to the end: leaving early leaks
        if item.object.type == "POINTCLOUD":
            data = item.object.data.attributes[name].data
            values = np.empty((len(data), width), np.float32)
            data.foreach_get(key, values.reshape(-1))
            found.append(values)
    return np.concatenate(found)


def mesh_box(scene: bpy.types.Scene) -> bpy.types.Object:
    """A box with its middle off its origin, rotated and scaled unevenly."""
    mesh = bpy.data.meshes.new("Crop")
    mesh.from_pydata([(-1, 0, 0), (2, 1, 1.5), (0, 1, 0.5)], [], [(0, 1, 2)])
    crop = bpy.data.objects.new("Crop", mesh)
    crop.location, crop.rotation_euler = (1, 1, 3), Euler((0.3, 0.5, 0.7))
    crop.scale = (1, 2, 1.5)
    scene.collection.objects.link(crop)
    return crop


def empty_box(scene: bpy.types.Scene) -> bpy.types.Object:
    """An unevenly scaled empty."""
    crop = bpy.data.objects.new("Crop", None)
    crop.location, crop.scale = (1, 2, 3), (1, 1.5, 2.5)
    scene.collection.objects.link(crop)
    return crop


FILTERS = [
    {},
    {"opacity_min": 0.4},
    {"size_min": 0.02},
    {"size_max": 0.05},
    {"opacity_min": 0.1, "size_min": 0.01, "size_max": 0.2},
    {"crop": mesh_box},
    {"crop": mesh_box, "crop_shape": "SPHERE"},
    {"crop": mesh_box, "crop_invert": True, "opacity_min": 0.2},
    {"crop": empty_box},
    {"crop": empty_box, "crop_shape": "SPHERE", "crop_invert": True},
]


@pytest.mark.parametrize("chosen", FILTERS, ids=lambda chosen: " ".join(chosen) or "none")
def test_filters_equal_their_twin(
    ob: bpy.types.Object, scene: bpy.types.Scene, make_splats: Make, chosen: dict
) -> None:
    """Oracle: splat_filter.visible_mask; the same splats in the same order."""
    settings = dict(chosen)
    make_crop = settings.pop("crop", None)
    if make_crop:
        ob.gscore.crop_object = make_crop(scene)
    for name, value in settings.items():
        setattr(ob.gscore, name, value)
    bpy.context.view_layer.update()
    keep = visible_mask(ob)
    assert (5 < keep.sum() < COUNT - 5) or not chosen
    np.testing.assert_array_equal(shown(), make_splats(COUNT).means[keep])


@pytest.mark.skipif(not compat.HAS_GEOMETRY_SETS, reason="this Blender does not show geometry")
def test_points_are_not_selected_by_themselves(ob: bpy.types.Object) -> None:
    """Oracle: in Edit Mode Blender 5 shows points without this attribute as selected."""
    bpy.context.view_layer.objects.active = ob
    ob.data.attributes.remove(ob.data.attributes[".selection"])  # as in older files
    ob.gscore.display = "POINTS"
    objects.refresh(ob, objects.read(ob).subset(np.arange(COUNT) % 2 == 0))
    points.keep(ob.data, np.arange(COUNT // 2) % 2 == 0)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.context.view_layer.update()
    evaluated = ob.evaluated_get(bpy.context.evaluated_depsgraph_get())
    geometry = compat.evaluated_geometry(evaluated)  # which keeps the attribute
    reported = geometry.pointcloud.attributes[".selection"].data
    assert len(reported) == COUNT // 4 and not any(point.value for point in reported)
    bpy.ops.object.mode_set(mode="OBJECT")


def test_moving_the_crop_counts(ob: bpy.types.Object, scene: bpy.types.Scene) -> None:
    """Oracle: the twin after the crop object was moved, without touching a setting."""
    crop = empty_box(scene)
    ob.gscore.crop_object = crop
    before = len(shown())
    crop.location.x += 1
    bpy.context.view_layer.update()
    assert len(shown()) == visible_mask(ob).sum() != before


def test_filters_of_a_flat_crop(ob: bpy.types.Object, scene: bpy.types.Scene) -> None:
    """Oracle: a crop without volume contains nothing, for the twin too."""
    crop = empty_box(scene)
    crop.scale = (1, 0, 1)
    ob.gscore.crop_object = crop
    bpy.context.view_layer.update()
    assert len(shown()) == visible_mask(ob).sum() == 0


@pytest.mark.parametrize("how", ["deleted", "shrunk"])
def test_a_crop_that_is_gone_hides_nothing(
    ob: bpy.types.Object, scene: bpy.types.Scene, how: str
) -> None:
    """Oracle: every splat, for display and twin."""
    crop = empty_box(scene)
    ob.gscore.crop_object = crop
    bpy.context.view_layer.update()
    assert len(shown()) < COUNT
    if how == "deleted":
        bpy.data.objects.remove(crop)
    else:
        crop.scale = (0, 0, 0)
    bpy.context.view_layer.update()
    assert len(shown()) == visible_mask(ob).sum() == COUNT


def test_ellipsoids(ob: bpy.types.Object, make_splats: Make) -> None:
    """Oracle: matrix_world R diag(scale) by mathutils, times the size."""
    splats = make_splats(COUNT)
    ob.gscore.display, ob.gscore.ellipsoid_size = "ELLIPSOIDS", 1.25
    ob.gscore.opacity_min = 0.3
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    found = [
        np.array([tuple(row) for row in item.matrix_world], np.float64)
        for item in depsgraph.object_instances
        if item.is_instance
    ]
    rows = np.flatnonzero(visible_mask(ob))
    assert len(found) == len(rows)
    world = np.array([tuple(row) for row in ob.matrix_world], np.float64)
    for got, row in zip(found, rows, strict=True):
        own = np.eye(4)
        turn = np.array([tuple(r) for r in Quaternion(splats.quats[row]).to_matrix()])
        own[:3, :3] = turn * np.exp(splats.scales[row]) * 1.25
        own[:3, 3] = splats.means[row]
        np.testing.assert_allclose(got, world @ own, atol=2e-6)


def viridis(measure: np.ndarray) -> np.ndarray:
    """[N, 3] scene-linear, linear between the samples."""
    codes = [[int(code[i : i + 2], 16) / 255 for i in (0, 2, 4)] for code in _VIRIDIS]
    table, at = decode(np.array(codes)), np.linspace(0, 1, len(codes))
    return np.stack([np.interp(measure, at, table[:, k]) for k in range(3)], axis=1)


def spread(values: np.ndarray, *, from_zero: bool = False) -> np.ndarray:
    """0 to 1 over mean +- 2 standard deviations."""
    low = 0 if from_zero else values.mean() - 2 * values.std()
    return (values - low) / (values.mean() + 2 * values.std() - low)


def test_base_color(ob: bpy.types.Object, make_splats: Make) -> None:
    """Oracle: 0.5 + C0 f_dc, cut at 0 and decoded from sRGB."""
    wanted = decode(np.maximum(sh0_to_rgb(make_splats(COUNT).sh0[:, 0].astype(np.float64)), 0))
    got = shown("gs_color", "color", 4)
    np.testing.assert_allclose(got[:, :3], wanted, rtol=2e-5, atol=1e-6)
    np.testing.assert_array_equal(got[:, 3], 1)


@pytest.mark.parametrize("mode", ["OPACITY", "SIZE", "ANISOTROPY", "SH_ENERGY", "DEPTH"])
def test_color_maps(
    ob: bpy.types.Object, scene: bpy.types.Scene, make_splats: Make, mode: str
) -> None:
    """Oracle: the measure and the map in numpy; statistics of visible splats only."""
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.rotation_euler = (5, -4, 6), (0.8, 0.1, 0.6)
    scene.collection.objects.link(camera)
    scene.camera = camera
    ob.gscore.colour_by, ob.gscore.opacity_min = mode, 0.2
    bpy.context.view_layer.update()
    splats = make_splats(COUNT).subset(visible_mask(ob))
    assert 100 < len(splats) < COUNT
    scales = np.exp(splats.scales.astype(np.float64))
    world = np.array([tuple(r) for r in ob.matrix_world], np.float64)
    to_camera = np.linalg.inv(np.array([tuple(r) for r in camera.matrix_world], np.float64))
    depths = -((splats.means @ world[:3, :3].T + world[:3, 3]) @ to_camera[2, :3] + to_camera[2, 3])
    measures = {
        "OPACITY": 1 / (1 + np.exp(-splats.opacities.astype(np.float64))),
        "SIZE": spread(np.log10(scales.max(1))),
        "ANISOTROPY": np.log10(scales.max(1) / scales.min(1)) / 2,
        "SH_ENERGY": spread(
            np.sqrt((splats.shN.astype(np.float64) ** 2).sum((1, 2))), from_zero=True
        ),
        "DEPTH": spread(depths),
    }
    assert depths.min() > 0
    got = shown("gs_color", "color", 4)[:, :3]
    assert got.std(axis=0).min() > 0.02
    np.testing.assert_allclose(got, viridis(measures[mode]), atol=3e-3)


def test_without_harmonics(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: without a view-dependent part, the dark end of the map."""
    ob = objects.create(make_splats(20, 0), "Splats")
    ob.gscore.colour_by = "SH_ENERGY"
    bpy.context.view_layer.update()
    np.testing.assert_allclose(
        shown("gs_color", "color", 4)[:, :3], viridis(np.zeros(20)), atol=1e-5
    )


def test_groups_are_shared_and_renewed(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: one group for all; the add-on's group of another version is replaced, but kept."""
    a, b = (objects.create(make_splats(5), name) for name in "ab")
    group = display.modifier_of(a).node_group
    assert display.modifier_of(b).node_group == group
    assert len([g for g in bpy.data.node_groups if filters.NAME in g.name]) == 1
    group["gs_nodes"] = f"{display.NAME} 0"
    splat_settings.attach(a)
    assert len(a.modifiers) == 1
    assert display.modifier_of(a).node_group != group == display.modifier_of(b).node_group


def test_user_groups_are_left_alone(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: a user's group of the same name is not changed."""
    theirs = bpy.data.node_groups.new(display.NAME, "GeometryNodeTree")
    ob = objects.create(make_splats(5), "Splats")
    assert display.modifier_of(ob).node_group != theirs
    assert len(theirs.nodes) == 0


def test_settings_survive_the_file(
    scene: bpy.types.Scene, make_splats: Make, tmp_path: Path
) -> None:
    """Oracle: the points shown before saving."""
    ob = objects.create(make_splats(COUNT), "Splats")
    ob.gscore.opacity_min, ob.gscore.colour_by = 0.3, "SIZE"
    bpy.context.view_layer.update()
    before = shown("gs_color", "color", 4)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert bpy.data.objects["Splats"].gscore.colour_by == "SIZE"
    np.testing.assert_array_equal(shown("gs_color", "color", 4), before)


def test_reset(ob: bpy.types.Object, scene: bpy.types.Scene) -> None:
    """Oracle: everything is shown; display and colours stay."""
    ob.gscore.crop_object, ob.gscore.size_max = empty_box(scene), 0.01
    ob.gscore.colour_by = "OPACITY"
    splat_settings.reset_filters(ob)
    bpy.context.view_layer.update()
    assert len(shown()) == COUNT
    assert ob.gscore.colour_by == "OPACITY" and ob.gscore.crop_object is None


def test_counts(ob: bpy.types.Object) -> None:
    """Oracle: the twin's count, in every version of Blender."""
    for mode in ("POINTS", "ELLIPSOIDS", "SOFT"):
        ob.gscore.display = mode
        ob.gscore.opacity_min = 0.0
        bpy.context.view_layer.update()
        depsgraph = bpy.context.evaluated_depsgraph_get()
        assert stats(ob, depsgraph).visible == stats(ob).visible == stats(ob).total == COUNT
        ob.gscore.opacity_min = 0.5
        bpy.context.view_layer.update()
        assert stats(ob).visible == visible_mask(ob).sum() < COUNT
        reported = stats(ob, bpy.context.evaluated_depsgraph_get()).visible
        assert reported == stats(ob).visible
        assert stats(ob).sh_degree == 3
    ob.gscore.opacity_min = 1.0
    bpy.context.view_layer.update()
    assert stats(ob, bpy.context.evaluated_depsgraph_get()).visible == 0


def one_splat(opacity: float) -> Splats:
    """A ball of standard deviation 0.2 in sRGB (0.8, 0.4, 0.2)."""
    rgb = np.array([0.8, 0.4, 0.2])
    return Splats(
        means=np.zeros((1, 3), np.float32),
        quats=np.array([[1, 0, 0, 0]], np.float32),
        scales=np.log(np.full((1, 3), 0.2, np.float32)),
        opacities=np.full(1, np.log(opacity / (1 - opacity)), np.float32),
        sh0=((rgb - 0.5) / 0.28209479177387814)[None, None].astype(np.float32),
        shN=np.zeros((1, 0, 3), np.float32),
    )


@pytest.mark.parametrize("mode", ["POINTS", "ELLIPSOIDS", "SOFT"])
def test_cycles_shows_the_color(scene: bpy.types.Scene, tmp_path: Path, mode: str) -> None:
    """Oracle: the photo's sRGB value in the picture; for soft splats times the Gaussian."""
    ob = objects.create(one_splat(0.6), "Splats")
    ob.gscore.display, ob.gscore.point_size, ob.gscore.ellipsoid_size = mode, 0.4, 2.0
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 2.0, (0, 0, 5)
    scene.collection.objects.link(camera)
    scene.camera = camera
    render = scene.render
    render.engine, render.film_transparent = "CYCLES", True
    render.resolution_x = render.resolution_y = 41
    scene.cycles.samples, scene.cycles.use_denoising = 16, False
    scene.cycles.filter_width = 0.01
    scene.view_settings.view_transform = "Standard"
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGBA"
    render.filepath = str(tmp_path / "a.png")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(render.filepath)
    pixels = np.empty(41 * 41 * 4, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(41, 41, 4)
    np.testing.assert_allclose(pixels[20, 20, :3], [0.8, 0.4, 0.2], atol=0.006)
    x = (np.arange(41) - 20) * 2.0 / 41
    if mode == "SOFT":
        wanted = 0.6 * np.exp(-0.5 * (x / 0.2) ** 2) * (np.abs(x) < 0.57)
        np.testing.assert_allclose(pixels[20, :, 3], wanted, atol=0.03)
    else:
        inside = np.abs(x) < 0.37
        np.testing.assert_allclose(pixels[20, inside, 3], 1, atol=0.01)
        np.testing.assert_allclose(pixels[20, np.abs(x) > 0.43, 3], 0, atol=0.01)
