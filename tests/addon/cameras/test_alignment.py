"""Oracle: synthetic captures whose up, ground and size are known, turned by a random rotation."""

from pathlib import Path

import numpy as np
import pytest

from addon.cameras.alignment import align, camera_extent, find_ground, find_up, focus
from addon.core import DataConfig, read_capture

STUDIO = Path(__file__).parents[3] / "examples" / "studio"


def look_at(center: np.ndarray, target: np.ndarray, roll: float = 0.0) -> np.ndarray:
    """[4, 4] viewmat of a level camera in a world with z up, then rolled by radians."""
    z = (target - center) / np.linalg.norm(target - center)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    x, y = np.cos(roll) * x + np.sin(roll) * y, np.cos(roll) * y - np.sin(roll) * x
    viewmat = np.eye(4)
    viewmat[:3, :3] = [x, y, z]
    viewmat[:3, 3] = -viewmat[:3, :3] @ center
    return viewmat


def orbit(
    rng: np.random.Generator, *, arc: float = 2 * np.pi, count: int = 40, roll: float = 0.0
) -> np.ndarray:
    """Cameras 2 to 5 units high around the z axis, with 2 degrees of random tilt."""
    angles = np.linspace(0, arc, count, endpoint=False)
    heights = rng.uniform(2, 5, count)
    centers = np.stack([6 * np.cos(angles), 6 * np.sin(angles), heights], axis=1)
    rolls = roll + rng.normal(0, np.radians(2), count)
    target = np.array([0, 0, 1.0])
    return np.stack([look_at(c, target, r) for c, r in zip(centers, rolls, strict=True)])


def room(rng: np.random.Generator) -> np.ndarray:
    """A floor at z = 0, a thing on it, points far outside and a few mirrored below."""
    floor = rng.uniform([-6, -6, -0.02], [6, 6, 0.02], (800, 3))
    thing = rng.normal([0, 0, 1], [0.4, 0.4, 0.4], (1500, 3))
    far = rng.normal(0, 60, (60, 3))
    below = rng.uniform([-4, -4, -3], [4, 4, -0.5], (40, 3))
    return np.concatenate([floor, thing, far, below])


def turned(
    viewmats: np.ndarray, points: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same capture in another world, and the old up direction in it."""
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.linalg.det(q)
    shift = rng.uniform(-20, 20, 3)
    back = np.eye(4)
    back[:3, :3], back[:3, 3] = q.T, -q.T @ shift
    return viewmats @ back, points @ q.T + shift, q[:, 2]


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """Degrees."""
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("arc", [2 * np.pi, np.pi, 0.8])
def test_up_of_an_orbit(arc: float, seed: int) -> None:
    """Oracle: the known up, although all cameras look down; 2 degrees of roll limit the
    accuracy."""
    rng = np.random.default_rng(seed)
    viewmats, _, up = turned(orbit(rng, arc=arc), np.zeros((0, 3)), rng)
    assert angle(find_up(viewmats), up) < (2 if arc > 3 else 6)


def test_up_with_photos_held_sideways() -> None:
    """Oracle: the known up, with every fifth photo rolled by a quarter, and with all of them."""
    rng = np.random.default_rng(0)
    some = orbit(rng)
    some[::5] = orbit(rng, roll=np.pi / 2)[::5]
    viewmats, _, up = turned(some, np.zeros((0, 3)), rng)
    assert angle(find_up(viewmats), up) < 2
    for roll in (np.pi / 2, -np.pi / 2):
        viewmats, _, up = turned(orbit(rng, roll=roll), np.zeros((0, 3)), rng)
        assert angle(find_up(viewmats), up) < 2


def test_up_of_a_walk_and_of_a_flight() -> None:
    """Oracle: forward is level, down is down, to the accuracy that such captures allow."""
    rng = np.random.default_rng(0)
    walk = np.stack([look_at(np.array([0, i, 1.6]), np.array([0, i + 5, 1.6])) for i in range(20)])
    viewmats, _, up = turned(walk, np.zeros((0, 3)), rng)
    assert angle(find_up(viewmats), up) < 1
    flight = []
    for i in range(40):
        center = np.array([5.0 * (i % 8), 5.0 * (i // 8), 30.0])
        heading = np.array([np.cos(i), np.sin(i), 0.0])
        flight.append(look_at(center, center + 0.05 * heading - [0, 0, 1]))
    viewmats, _, up = turned(np.stack(flight), np.zeros((0, 3)), rng)
    assert angle(find_up(viewmats), up) < 3


@pytest.mark.parametrize("seed", range(4))
def test_ground_among_other_points(seed: int) -> None:
    """Oracle: the floor at z = 0, in spite of far points and reflections below it."""
    rng = np.random.default_rng(seed)
    viewmats, points, up = turned(orbit(rng), room(rng), rng)
    found = align(viewmats, points)
    assert found.ground_found
    assert angle(found.up, up) < 0.3
    floor = points[:800] @ found.matrix[:3, :3].T + found.matrix[:3, 3]
    assert np.abs(np.median(floor[:, 2])) < 0.02
    assert np.linalg.norm((found.matrix @ [*focus(viewmats), 1])[:2]) < 1e-9
    np.testing.assert_allclose(found.matrix[:3, :3] @ found.matrix[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(found.matrix[:3, :3]) > 0
    ahead = found.matrix[:3, :3] @ viewmats[0, 2, :3]
    assert abs(ahead[0]) < 1e-9 and ahead[1] > 0


def test_a_shelf_is_no_ground() -> None:
    """Oracle: a dense plane above the floor with many points below it is ignored."""
    rng = np.random.default_rng(0)
    shelf = rng.uniform([-2, -2, 1.5], [2, 2, 1.51], (900, 3))
    floor = rng.uniform([-5, -5, -0.01], [5, 5, 0.01], (600, 3))
    viewmats = orbit(rng)
    centers = np.stack([np.linalg.inv(v)[:3, 3] for v in viewmats])
    normal, height = find_ground(np.concatenate([shelf, floor]), centers, np.array([0, 0, 1.0]))
    assert abs(height) < 0.02 and normal[2] > 0.999


def test_without_ground() -> None:
    """Oracle: a ball has no plane; its lowest 2 % are below height 0. Without points, cameras."""
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(3000, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None] / rng.uniform(0.2, 1, (3000, 1))
    viewmats = orbit(rng)
    found = align(viewmats, ball, up=np.array([0, 0, 1.0]))
    assert not found.ground_found
    heights = ball @ found.matrix[2, :3] + found.matrix[2, 3]
    assert (heights < 0).mean() == pytest.approx(0.02, abs=0.002)
    bare = align(viewmats, np.zeros((0, 3)))
    centers = np.stack([np.linalg.inv(v)[:3, 3] for v in viewmats])
    assert (centers @ bare.matrix[2, :3] + bare.matrix[2, 3]).min() == pytest.approx(0, abs=1e-9)


def test_given_up_wins() -> None:
    """Oracle: upside down on request, exactly if no ground contradicts it."""
    viewmats = orbit(np.random.default_rng(0))
    found = align(viewmats, np.zeros((0, 3)), up=np.array([0, 0, -2.0]))
    np.testing.assert_allclose(found.matrix[2, :3], [0, 0, -1], atol=1e-12)


def test_studio() -> None:
    """Oracle: the example was made with z up and its floor at z = 0, in metres."""
    capture = read_capture(DataConfig(source=STUDIO))
    viewmats = np.stack([view.viewmat for view in capture.views])
    found = align(viewmats, capture.points.points)
    assert found.ground_found
    assert angle(found.up, np.array([0, 0, 1.0])) < 0.2
    assert abs(np.linalg.inv(found.matrix)[2, 3]) < 0.02


def test_extent() -> None:
    """Oracle: the diagonal of a box, with more cameras than one block of the search."""
    rng = np.random.default_rng(0)
    centers = rng.uniform(0, 1, (700, 3))
    centers[3], centers[611] = [-1, -1, -1], [2, 2, 2]
    assert camera_extent(centers) == pytest.approx(27**0.5)
    assert camera_extent(centers[:1]) == 0


def test_refusals() -> None:
    """Oracle: the documented errors."""
    with pytest.raises(ValueError, match="no cameras"):
        align(np.zeros((0, 4, 4)), np.zeros((0, 3)))
    with pytest.raises(ValueError, match="length"):
        align(np.eye(4)[None], np.zeros((0, 3)), up=np.zeros(3))


def test_one_camera() -> None:
    """Oracle: a single camera looking down still gives a rotation."""
    viewmat = np.eye(4)
    viewmat[:3, :3] = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]  # x right, -y up the picture, -z ahead
    matrix = align(viewmat[None], np.zeros((0, 3)), up=np.array([0, 0, 1.0])).matrix
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.isfinite(align(viewmat[None], np.zeros((0, 3))).matrix).all()
