"""Framing of views. Oracle: scenes of known geometry, and the projection of visible points."""

from collections.abc import Sequence
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Quaternion, Vector

from addon.cameras import capture_transform, captures
from addon.compat import matrix_to_numpy
from addon.interface import framing
from addon.splats import splat_framing
from tests.addon import splat_scenes as lab
from tests.addon.calls import import_capture
from tests.addon.captures import STUDIO

WIDE, HIGH = 0.72, 0.405
"""Tangents of half of the width and height of a view of Blender's usual lens, of 16 to 9."""


@pytest.fixture
def view(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A fake of a new 3D view, because there is none without a window."""
    region = SimpleNamespace(
        view_perspective="PERSP",
        view_location=Vector(),
        view_rotation=Vector((0, -1, -0.5)).to_track_quat("-Z", "Y"),
        view_distance=15.0,
        lock_rotation=False,
    )
    space = SimpleNamespace(
        region_3d=region,
        lens=50.0,
        clip_start=0.01,
        clip_end=1000.0,
        shading=SimpleNamespace(),
        overlay=SimpleNamespace(),
    )
    monkeypatch.setattr(framing, "views_of", lambda scene: [space])
    return space


def eye_of(view: Any) -> np.ndarray:
    """Position of a view, [3]."""
    region = view.region_3d
    away = region.view_rotation @ Vector((0, 0, region.view_distance))
    return np.array(region.view_location + away)


def share_seen(view: Any, places: np.ndarray) -> float:
    """Share of points [N, 3] inside a view."""
    local = (places - eye_of(view)) @ np.array(view.region_3d.view_rotation.to_matrix())
    depth = -local[:, 2]
    x, y = np.abs(local[:, :2]).T
    inside = (x < WIDE * depth) & (y < HIGH * depth)
    return float((inside & (depth > view.clip_start) & (depth < view.clip_end)).mean())


def capture_with(rotations: Sequence[Quaternion], eyes: np.ndarray) -> bpy.types.Object:
    """The empty of a capture with cameras [C, 3]."""
    scene = bpy.context.scene
    root = bpy.data.objects.new("room", None)
    root["gs_kind"] = "capture"
    scene.collection.objects.link(root)
    for eye, rotation in zip(eyes, rotations, strict=True):
        ob = bpy.data.objects.new("photo", bpy.data.cameras.new("photo"))
        ob["gs_kind"], ob.parent = "camera", root
        ob.matrix_basis = Matrix.Translation(Vector(eye)) @ rotation.to_matrix().to_4x4()
        scene.collection.objects.link(ob)
    return root


@pytest.mark.parametrize("scale", [0.01, 1.0, 3000.0])
def test_a_room_is_seen_from_inside_through_haze(
    scene: bpy.types.Scene, view: Any, scale: float
) -> None:
    """Oracle: a table between four walls, photographed from their corners, and as many faint splats
    in a cloud outside of the room; a view that looks along -y and down."""
    rng = np.random.default_rng(0)
    splats = lab.blob(4000)
    walls = rng.uniform((-4, -4, 0), (4, 4, 3), (1200, 3))
    side = rng.integers(0, 4, 1200)
    walls[np.arange(1200), side % 2] = np.where(side < 2, -4, 4)
    table = rng.uniform((-0.5, -0.5, 0.5), (0.5, 0.5, 1), (800, 3))
    haze = rng.normal(size=(2000, 3))
    haze *= rng.uniform(10, 40, (2000, 1)) / np.linalg.norm(haze, axis=1, keepdims=True)
    splats.means[:] = scale * np.concatenate([walls, table, haze])
    splats.opacities[:] = np.repeat([6.0, -4.0], 2000)
    eyes = np.array([[x, y, 1.6] for x in (-3, 3) for y in (-3, 3)], np.float64)
    toward = [Vector(np.array([0, 0, 0.75]) - eye) for eye in eyes]
    rotations = [one.to_track_quat("-Z", "Y") @ Quaternion((0, 0, 1), 0.3) for one in toward]
    ob = lab.add(scene, splats)
    ob.parent = capture_with(rotations, scale * eyes)
    bpy.context.view_layer.update()
    splat_framing.turn_views(scene, ob)
    eye, pivot = eye_of(view), np.array(view.region_3d.view_location)
    assert np.linalg.norm(scale * eyes - eye, axis=1).min() < 1e-3 * scale and eye[1] > 0
    assert np.linalg.norm(pivot - scale * np.array([0, 0, 0.75])) < 0.8 * scale
    assert share_seen(view, scale * table) > 0.9
    across = view.region_3d.view_rotation @ Vector((1, 0, 0))
    assert abs(across.z) < 1e-5  # the photos are not level, the view is
    view.region_3d.view_perspective = "CAMERA"
    before = eye_of(view)
    view.region_3d.view_distance = 1.0
    splat_framing.turn_views(scene, ob)
    assert view.region_3d.view_distance == 1.0 and (eye_of(view) != before).any()


def test_haze_is_not_framed_without_cameras_either(scene: bpy.types.Scene, view: Any) -> None:
    """Oracle: a ball of radius 1 and as many faint splats around it, up to 50 away."""
    rng = np.random.default_rng(0)
    splats = lab.blob(2000)
    directions = rng.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    splats.means[:] = directions * np.repeat([1.0, 1.0], 1000)[:, None]
    splats.means[1000:] *= rng.uniform(5, 50, (1000, 1))
    splats.opacities[:] = np.repeat([6.0, -5.0], 1000)
    ob = lab.add(scene, splats)
    ob.location = 7, 0, 0
    bpy.context.view_layer.update()
    rotation = view.region_3d.view_rotation.copy()
    splat_framing.turn_views(scene, ob)
    middle, radius = splat_framing.frame_of(ob)
    np.testing.assert_allclose(middle, (7, 0, 0), atol=0.3)
    assert 0.8 < radius < 1.3 and view.region_3d.view_rotation == rotation
    assert share_seen(view, splats.means[:1000] + np.array([7, 0, 0])) > 0.9
    assert np.linalg.norm(eye_of(view) - (7, 0, 0)) < 4


def test_the_middle_counts_near_and_far() -> None:
    """Oracle: a figure at 2 and a wall of as many points at 9; points behind the camera."""
    rng = np.random.default_rng(1)
    figure = rng.normal(size=(200, 3)) * 0.05 + (0, 0, 2)
    wall = np.concatenate([rng.uniform(-2, 2, (200, 2)), np.full((200, 1), 9.0)], axis=1)
    behind = np.array([[0, 0, -3.0]] * 500)
    places = np.concatenate([figure, wall, behind])
    found = framing.depth_of(places, np.ones(900), np.zeros(3), np.array([0, 0, 1.0]))
    assert abs(found - 2) < 0.2
    alone = framing.depth_of(behind, np.ones(500), np.zeros(3), np.array([0, 0, 1.0]))
    assert alone == pytest.approx(3)


def test_imported_cameras_are_in_the_view(scene: bpy.types.Scene, view: Any) -> None:
    """Oracle: the projection of the cameras; a repeated import does not change the view."""
    for again in range(2):
        if again:
            view.region_3d.view_location = Vector((1, 2, 3))
        made = import_capture(scene, STUDIO)
        captures.choose(scene, made)
        if again:
            assert view.region_3d.view_location == Vector((1, 2, 3))
        else:
            bpy.context.view_layer.update()
            places = np.array([ob.matrix_world.translation for ob in made.cameras])
            assert share_seen(view, places) > 0.9


@pytest.mark.parametrize("count", [2, 3])
def test_captures_stand_beside_each_other(
    scene: bpy.types.Scene, tmp_path: Any, count: int
) -> None:
    """Oracle: boxes around the cameras and most points of each in Blender's world; the first is
    where it would be alone, heights and rotations stay, and Align to Ground keeps each in place.
    Without alignment the axes of the files stay, whatever is in the scene."""
    made = [import_capture(scene, STUDIO)]
    alone = matrix_to_numpy(made[0].root.matrix_basis)
    for i in range(1, count):
        other = tmp_path / f"copy{i}"
        other.symlink_to(STUDIO, target_is_directory=True)
        made.append(import_capture(scene, tmp_path / f"copy{i}", align=True))
    assert len({one.root for one in made}) == count
    matrices = [matrix_to_numpy(one.root.matrix_basis) for one in made]
    np.testing.assert_array_equal(matrices[0], alone)
    for matrix in matrices[1:]:
        np.testing.assert_allclose(matrix[:, :3], alone[:, :3], atol=1e-6)
        np.testing.assert_allclose(matrix[1:, 3], alone[1:, 3], atol=1e-6)
    spans = []
    for one, matrix in zip(made, matrices, strict=True):
        reach = capture_transform.reach_of(matrix, one.cameras, one.points)
        spans.append(np.quantile(reach[:, 0], (0.05, 0.95)))
    for left, right in pairwise(spans):
        assert right[0] > left[1]
    bpy.ops.gscore.align_capture(capture=made[1].root.name)
    np.testing.assert_allclose(matrix_to_numpy(made[1].root.matrix_basis), matrices[1], atol=1e-4)
    kept = tmp_path / "kept"
    kept.symlink_to(STUDIO, target_is_directory=True)
    stays = import_capture(scene, kept, align=False)
    np.testing.assert_array_equal(matrix_to_numpy(stays.root.matrix_basis), np.eye(4))
