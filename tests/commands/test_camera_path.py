"""Camera paths: cameras on the path, directions of turns, and smoothness."""

import math
from itertools import pairwise

import numpy as np
import pytest

from gscore.commands.pictures.camera_path import (
    focus_point,
    look_at,
    orbit_path,
    spline_path,
)
from gscore.errors import ConfigError
from gscore.transforms import invert_rigid
from gscore.upright import find_up

AHEAD = np.array([0, 0, 1.0])


def centers(viewmats):
    return invert_rigid(viewmats)[:, :3, 3]


def angle_between(a, b):
    """Angle of the rotation from viewmat a to viewmat b, radians."""
    cosine = (np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2
    return math.acos(np.clip(cosine, -1, 1))


def Ks_of(count, focal=50.0):  # noqa: N802  the field's name
    K = np.array([[focal, 0, 24.0], [0, focal, 18.0], [0, 0, 1]])
    return np.tile(K, (count, 1, 1))


@pytest.fixture
def wild():
    """Twelve cameras at uneven distances, turned at random by up to a right angle each."""
    rng = np.random.default_rng(2)
    eyes = np.cumsum(rng.normal(0, 1, (12, 3)) * rng.uniform(0.05, 3, (12, 1)), axis=0)
    aims = eyes + np.array([0, 0, 10.0]) + rng.normal(0, 4, (12, 3))
    return np.stack(
        [look_at(e, a, np.array([0, -1.0, 0])) for e, a in zip(eyes, aims, strict=True)]
    )


def test_spline_passes_every_camera(wild):
    """Oracle: the cameras themselves; some frame comes within half a frame's distance of each."""
    viewmats, _ = spline_path(wild, Ks_of(12), 6000)
    np.testing.assert_allclose(viewmats[0], wild[0], atol=1e-9)
    np.testing.assert_allclose(viewmats[-1], wild[-1], atol=1e-9)
    path = centers(viewmats)
    step = np.linalg.norm(np.diff(path, axis=0), axis=1).max()
    for key in wild:
        away = np.linalg.norm(path - centers(key[None])[0], axis=1)
        nearest = int(away.argmin())
        assert away[nearest] <= step
        assert angle_between(viewmats[nearest], key) < 0.01


def test_spline_poses_are_rigid_and_lenses_plain(wild):
    """Oracle: rotation matrices; a K that the rasterizer takes bit for bit."""
    Ks = Ks_of(12)
    Ks[5, 0, 0] = 80.0
    viewmats, path_Ks = spline_path(wild, Ks, 500)
    rotations = viewmats[:, :3, :3]
    np.testing.assert_allclose(
        rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (500, 1, 1)), atol=1e-12
    )
    assert (np.linalg.det(rotations) > 0.999).all()
    assert (path_Ks[:, 2] == [0, 0, 1]).all() and (path_Ks[:, 0, 1] == 0).all()
    assert path_Ks[:, 0, 0].max() == pytest.approx(80, abs=1) and path_Ks[0, 0, 0] == 50


def test_spline_moves_at_a_steady_pace_without_jerks(wild):
    """Oracle: distance plus angle of each frame; uneven keys must not show in the pace."""
    viewmats, _ = spline_path(wild, Ks_of(12), 1200)
    path = centers(viewmats)
    unit = np.median(np.linalg.norm(np.diff(centers(wild), axis=0), axis=1))
    way = np.linalg.norm(np.diff(path, axis=0), axis=1) / unit
    turn = np.array([angle_between(a, b) for a, b in pairwise(viewmats)])
    pace = way + turn
    assert pace.std() / pace.mean() < 0.02
    kinks = np.linalg.norm(np.diff(path, 2, axis=0), axis=1) / unit
    assert kinks.max() < 0.35 * pace.mean()


def test_spline_on_a_straight_line_is_the_line():
    """Oracle: cameras on a line at uneven distances, all of the same orientation."""
    eyes = np.array([[x, 0, 0] for x in (0.0, 1.0, 1.5, 4.0, 4.2)])
    keys = np.stack([look_at(e, e + AHEAD, np.array([0, -1.0, 0])) for e in eyes])
    path = centers(spline_path(keys, Ks_of(5), 43)[0])
    np.testing.assert_allclose(path[:, 0], np.linspace(0, 4.2, 43), atol=2e-3)
    np.testing.assert_allclose(path[:, 1:], 0, atol=1e-12)


def test_spline_between_two_turned_cameras_follows_the_slerp():
    """Oracle: a rotation about one axis by 50 degrees, of which 25 at half time."""
    start = look_at(np.zeros(3), np.array([0, 0, 1.0]), np.array([0, -1.0, 0]))
    end = look_at(
        np.array([0.3, 0, 0]),
        np.array([0.3 + math.sin(math.radians(50)), 0, math.cos(math.radians(50))]),
        np.array([0, -1.0, 0]),
    )
    path, _ = spline_path(np.stack([start, end]), Ks_of(2), 101)
    assert math.degrees(angle_between(path[0], path[50])) == pytest.approx(25, abs=0.2)
    assert math.degrees(angle_between(path[0], path[25])) == pytest.approx(12.5, abs=1)


def test_spline_takes_cameras_in_one_place():
    """Oracle: a camera that only turns, across quaternions of opposite sign."""
    angles = np.linspace(0, 1.9 * math.pi, 8)
    aims = np.stack([np.sin(angles), np.zeros(8), np.cos(angles)], axis=1)
    keys = np.stack([look_at(np.zeros(3), a, np.array([0, -1.0, 0])) for a in aims])
    path, _ = spline_path(keys, Ks_of(8), 200)
    turn = [math.degrees(angle_between(a, b)) for a, b in pairwise(path)]
    assert max(turn) < 2.6 and min(turn) > 1.0  # 342 degrees in 199 steps: 1.72 each


def test_focus_and_up_of_a_ring(ring):
    """Oracle: the origin, which the ring faces, with z up."""
    np.testing.assert_allclose(focus_point(ring), 0, atol=0.01)
    np.testing.assert_allclose(find_up(ring), [0, 0, 1], atol=1e-9)


def test_up_of_cameras_that_look_down():
    """Oracle: level cameras facing 60 degrees down on one side of a table; z is up."""
    eyes = [np.array([x, -1.0, 2.0]) for x in (-0.5, -0.2, 0.1, 0.6)]
    keys = np.stack([look_at(e, np.zeros(3), np.array([0, 0, 1.0])) for e in eyes])
    assert math.degrees(math.acos(find_up(keys) @ [0, 0, 1])) < 8


def test_focus_of_a_walk_lies_ahead():
    """Oracle: parallel axes without a nearest point; a point ahead of the cameras' middle is
    used."""
    eyes = [np.array([0.01 * i % 2, 0, 2.0 * i]) for i in range(10)]
    keys = np.stack([look_at(e, e + AHEAD, np.array([0, -1.0, 0])) for e in eyes])
    focus = focus_point(keys)
    assert np.isfinite(focus).all() and abs(focus[0]) < 2 and 9 < focus[2] < 40


def test_orbit_of_a_ring_is_the_ring(ring):
    """Oracle: radius 5, height 1, facing the origin, closed and even."""
    path = orbit_path(ring, 90)
    eyes = centers(path)
    np.testing.assert_allclose(np.hypot(eyes[:, 0], eyes[:, 1]), 5, atol=0.02)
    np.testing.assert_allclose(eyes[:, 2], 1, atol=0.02)
    steps = np.linalg.norm(np.diff(np.concatenate([eyes, eyes[:1]]), axis=0), axis=1)
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-2)
    in_camera = path @ [0, 0, 0, 1.0]
    np.testing.assert_allclose(in_camera[:, :2], 0, atol=0.02)
    assert (in_camera[:, 2] > 4.9).all()
    np.testing.assert_allclose(eyes[0], centers(ring)[0], atol=0.02)


def test_an_orbit_is_level_as_the_capture_states_it(ring):
    """Oracle: horizontals of the path at right angles to the stated up, which the cameras do not
    share."""
    up = np.array([math.sin(0.5), 0, math.cos(0.5)])
    path = orbit_path(ring, 60, up=up)
    np.testing.assert_allclose(path[:, 0, :3] @ up, 0, atol=1e-9)
    assert (-path[:, 1, :3] @ up > 0).all()


def test_orbit_of_half_a_ring_stays_where_cameras_were(ring):
    """Oracle: cameras from 0 to 160 degrees; the path swings within them and comes back."""
    eyes = centers(orbit_path(ring[:5], 80))
    angles = np.degrees(np.arctan2(eyes[:, 1], eyes[:, 0]))
    assert angles.min() > 0 and angles.max() < 160 and np.ptp(angles) > 120
    assert np.abs(np.diff(np.concatenate([angles, angles[:1]]))).max() < 10


def test_orbit_follows_the_cameras_in_and_out():
    """Oracle: cameras on an ellipse; the path must not cut through obstacles outside it."""
    angles = np.arange(24) / 24 * 2 * math.pi
    eyes = np.stack([6 * np.cos(angles), 4 * np.sin(angles), np.full(24, 0.5)], axis=1)
    keys = np.stack([look_at(e, np.zeros(3), np.array([0, 0, 1.0])) for e in eyes])
    path = centers(orbit_path(keys, 120))
    nearest = np.linalg.norm(path[:, None] - eyes[None], axis=2).min(axis=1)
    assert nearest.max() < 1.2
    assert np.hypot(path[:, 0], path[:, 1]).max() > 5.3


def test_orbit_keeps_its_distance_where_photos_are_close():
    """Oracle: a ring of 24 cameras, and 8 close ones on one side; the path stays near the ring and
    changes its distance by less than a hundredth from one picture to the next."""
    angles = np.concatenate([np.arange(24) / 24, np.arange(8) / 80]) * 2 * math.pi
    radii = np.repeat([5.0, 1.5], [24, 8])
    eyes = np.stack([radii * np.cos(angles), radii * np.sin(angles), np.full(32, 0.5)], axis=1)
    keys = np.stack([look_at(e, np.zeros(3), np.array([0, 0, 1.0])) for e in eyes])
    path = centers(orbit_path(keys, 240))
    away = np.hypot(path[:, 0], path[:, 1])
    assert away.min() > 4.5
    assert np.abs(np.diff(np.log(np.append(away, away[0])))).max() < 0.01


def test_look_at():
    """Oracle: the target in the middle, ahead; up is up in the picture (negative y)."""
    viewmat = look_at(np.array([1.0, 2, 3]), np.array([4.0, 0, -1]), np.array([0, 0, 1.0]))
    target = viewmat @ [4, 0, -1, 1]
    np.testing.assert_allclose(target[:2], 0, atol=1e-12)
    assert target[2] == pytest.approx(math.sqrt(29))
    assert (viewmat[:3, :3] @ [0, 0, 1.0])[1] < 0
    straight_down = look_at(np.array([0, 0, 5.0]), np.zeros(3), np.array([0, 0, 1.0]))
    assert np.isfinite(straight_down).all()
    assert np.linalg.det(straight_down[:3, :3]) == pytest.approx(1)


def test_paths_that_cannot_be_made(ring):
    """Oracle: the errors."""
    with pytest.raises(ConfigError, match="two cameras, got 1"):
        orbit_path(ring[:1], 10)
    with pytest.raises(ConfigError, match="two frames, got 1"):
        spline_path(ring, Ks_of(9), 1)
    eyes = [np.array([0.1 * (i % 2), 0, 2.0 * i]) for i in range(10)]
    walk = np.stack([look_at(e, e + AHEAD, np.array([0, -1.0, 0])) for e in eyes])
    walk[3:6] = np.diag([-1, 1, -1, 1]) @ walk[3:6]  # some face backwards
    opposite = [np.array([x, 0, z]) for z in (0.0, 20.0) for x in (-1, 0.5, 2)]
    facing = np.stack([look_at(e, 10 * AHEAD, np.array([0, -1.0, 0])) for e in opposite])
    for keys in (walk, facing):
        with pytest.raises(ConfigError, match="common middle"):
            orbit_path(keys, 10)
    same = np.tile(np.eye(4), (3, 1, 1))
    with pytest.raises(ConfigError, match="no orbit"):
        orbit_path(same, 10)
