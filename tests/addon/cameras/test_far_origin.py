"""Georeferenced captures in Blender: imported near its origin, with the local origin stored, and
exported to the original coordinates."""

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from addon.cameras import capture_transform
from addon.cameras.camera_path import NERFSTUDIO
from addon.cameras.importing import ImportedCapture
from addon.compat import matrix_to_numpy
from addon.core import DataConfig, Splats, read_capture, read_colmap, write_colmap, write_splat_file
from addon.splats import objects, splat_files, splat_framing
from gscore.datasets.camera_path_json import read_camera_path
from gscore.formats import read_splat_file
from tests.addon.calls import (
    export_colmap,
    export_path,
    export_splats,
    export_transforms,
    import_capture,
    import_path,
    import_splats,
    read_world,
)
from tests.addon.captures import write_capture

UTM = np.array([500000.0, 5600000.0, 120.0])
PINHOLES = {1: ("PINHOLE", 640, 480, (500.0, 500.0, 320.0, 240.0))}


@pytest.fixture
def far(tmp_path: Path) -> Path:
    """A capture of pinholes at UTM coordinates."""
    folder = tmp_path / "far"
    model = write_capture(folder, np.random.default_rng(0), cameras=PINHOLES)
    write_colmap(replace(model, origin=UTM).about(None), folder / "sparse/0")
    return folder


def splats_in(made: ImportedCapture, make_splats, path: Path, about: np.ndarray) -> Splats:
    """A splat file with a local origin, with splats around the capture's own."""
    splats = make_splats(50)
    shift = capture_transform.origin_of(made.root) - about
    write_splat_file(
        path,
        replace(splats, means=(splats.means + shift).astype(np.float32)),
        origin=about if about.any() else None,
    )
    return splats


def centers(views) -> np.ndarray:
    """[V, 3] of viewmats."""
    return np.array([-v[:3, :3].T @ v[:3, 3] for v in views])


def test_cameras_and_splats_land_in_one_frame_near_the_origin(
    scene, far: Path, make_splats, tmp_path: Path
) -> None:
    """Oracle: poses of the files minus the local origin, in float64; splats relative to that
    origin, to another one, and without one are at the file's positions, to 1e-4 of the capture."""
    made = import_capture(scene, far, align=False)
    origin = capture_transform.origin_of(made.root)
    assert origin is not None and (np.abs(origin - UTM) < 10).all()
    assert any("local origin" in sentence for sentence in made.warnings)
    bpy.context.view_layer.update()
    wanted = {i.name: centers([i.viewmat])[0] - origin for i in read_colmap(far).images}
    for ob in made.cameras:
        place = matrix_to_numpy(ob.matrix_world)[:3, 3]
        np.testing.assert_allclose(place, wanted[ob["gs_image"]], atol=4e-6)
    for number, about in enumerate((origin, origin + np.array([5, -3, 2]))):
        path = tmp_path / f"{number}.ply"
        splats = splats_in(made, make_splats, path, about)
        ob = import_splats(bpy.context, path, parent=made.root)
        bpy.context.view_layer.update()
        np.testing.assert_allclose(read_world(ob).means, splats.means, atol=1e-5)
        np.testing.assert_array_equal(capture_transform.noted_origin(ob), about)
        assert export_splats([ob], tmp_path / "out.ply")[0] == 50
        back = read_splat_file(tmp_path / "out.ply")
        np.testing.assert_array_equal(back.origin, origin)
        np.testing.assert_allclose(back.splats.means, splats.means, atol=1e-5)
    lost = tmp_path / "lost.ply"
    write_splat_file(lost, splats)
    ob = import_splats(bpy.context, lost, parent=made.root)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(read_world(ob).means, splats.means, atol=1e-6)


def test_splats_without_a_capture_keep_their_origin(scene, make_splats, tmp_path: Path) -> None:
    """Oracle: the origin of the file, to the bit, in the property and in the export."""
    splats, origin = make_splats(20), UTM + 1 / 3
    write_splat_file(tmp_path / "in.ply", splats, origin=origin)
    ob = import_splats(bpy.context, tmp_path / "in.ply")
    np.testing.assert_array_equal(ob[capture_transform.ORIGIN][:], origin)
    bpy.context.view_layer.update()
    export_splats([ob], tmp_path / "out.ply")
    back = read_splat_file(tmp_path / "out.ply")
    np.testing.assert_array_equal(back.origin, origin)
    np.testing.assert_array_equal(back.splats.means, splats.means)


def test_exports_are_in_the_coordinates_of_the_capture(scene, far: Path, tmp_path: Path) -> None:
    """Oracle: the imported files; 3e-9 is the rounding of float64 at these coordinates."""
    made = import_capture(scene, far)
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    (tmp_path / "tf").mkdir()
    export_colmap(tmp_path / "out", made.cameras, scene, root=made.root, depsgraph=graph)
    path = tmp_path / "tf/transforms.json"
    export_transforms(path, made.cameras, scene, root=made.root, depsgraph=graph)
    was = read_colmap(far)
    wanted = {image.name: image for image in was.images}
    now = read_colmap(tmp_path / "out")
    for image in now.images:
        np.testing.assert_allclose(
            centers([image.viewmat]), centers([wanted[image.name].viewmat]), atol=1e-8
        )
        np.testing.assert_array_equal(image.point3D_ids, wanted[image.name].point3D_ids)
    np.testing.assert_allclose(now.points.xyz, was.points.xyz, atol=3e-9)
    data = DataConfig(source=path)
    found = read_capture(data, photos_required=False, origin=np.zeros(3))
    assert found.origin is None
    places = {round(float(c[0]), 4): c for c in centers([i.viewmat for i in was.images])}
    for view in found.views:
        place = centers([view.viewmat])[0]
        np.testing.assert_allclose(place, places[round(float(place[0]), 4)], atol=1e-8)


@pytest.mark.parametrize("kind", ["CAMERAS", "TRANSFORMS", NERFSTUDIO])
def test_camera_paths_go_out_and_come_back(scene, far: Path, tmp_path: Path, kind: str) -> None:
    """Oracle: the camera's position in Blender, plus the local origin."""
    made = import_capture(scene, far, align=False)
    data = bpy.data.cameras.new("moving")
    ob = bpy.data.objects.new("moving", data)
    scene.collection.objects.link(ob)
    scene.camera, scene.frame_start, scene.frame_end = ob, 1, 2
    ob.location = (1, 2, 3)
    bpy.context.view_layer.update()
    path = tmp_path / "path.json"
    export_path(path, ob, scene, root=made.root, kind=kind)
    cameras = read_camera_path(path).cameras
    full = cameras.centers + (0 if cameras.origin is None else cameras.origin)
    wanted = capture_transform.origin_of(made.root) + np.array([1, 2, 3])
    np.testing.assert_allclose(full, [wanted] * 2, atol=1e-5)
    back = import_path(path, scene, root=made.root)
    scene.frame_set(1)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(
        matrix_to_numpy(back.camera.matrix_world)[:3, 3], [1, 2, 3], atol=1e-5
    )


def test_reimport_keeps_the_origin_and_warns_of_another_capture(
    scene, far: Path, tmp_path: Path
) -> None:
    """Oracle: the origin of the first import, although a moved model would get another one; a
    warning that names both captures."""
    made = import_capture(scene, far)
    origin = capture_transform.origin_of(made.root)
    model = read_colmap(far)
    write_colmap(replace(model, origin=np.array([40.0, 0, 0])).about(None), far / "sparse/0")
    again = import_capture(scene, far)
    assert again.root == made.root
    np.testing.assert_array_equal(capture_transform.origin_of(again.root), origin)
    other = tmp_path / "other"
    write_capture(other, np.random.default_rng(1), cameras=PINHOLES)
    reported = import_capture(scene, other).warnings
    assert any("local origin" in one and made.root.name in one for one in reported)
    assert capture_transform.ORIGIN not in import_capture(scene, other).root


def test_a_crop_box_stays_where_the_origin_changes(scene, make_splats) -> None:
    """Oracle: splats about another origin, and their crop box, are where both were."""
    ob = objects.create(make_splats(50), "splats")
    splat_files.match_capture_origin(ob, np.array([100.0, 200.0, 0.0]))
    bpy.context.view_layer.objects.active = ob
    bpy.ops.gscore.add_crop_box()
    place = np.array(bpy.context.object.matrix_world)
    before = splat_framing.in_world(ob)
    splats = make_splats(50)
    objects.refresh(ob, replace(splats, means=splats.means - np.float32([1, 2, 0])))
    splat_files.match_capture_origin(ob, np.array([101.0, 202.0, 0.0]))
    bpy.context.view_layer.update()
    np.testing.assert_allclose(splat_framing.in_world(ob), before, atol=1e-5)
    np.testing.assert_allclose(bpy.context.object.matrix_world, place, atol=1e-5)
