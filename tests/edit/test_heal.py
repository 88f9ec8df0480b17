"""Holes filled from around them. Oracle: the surfaces and colours that the holes were cut from."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gscore.edit.heal import heal
from gscore.edit.pipeline import apply_edits
from gscore.edit.request import EditRequest
from gscore.errors import Cancelled, ConfigError
from gscore.splats import Splats
from gscore.transforms import quat_to_rotmat

COLORS = np.array([[0.5, 0, 0.2], [0, 0.4, 0.1], [0, 0, 0]])


def discs(means: np.ndarray, normals: np.ndarray) -> Splats:
    """Flat splats at positions [N, 3], their z axes along unit normals [N, 3]; sh0 is linear in the
    position."""
    count = len(means)
    half = normals + np.array([0, 0, 1])
    quats = np.concatenate([np.zeros((count, 1)), half], axis=1)  # half turns about the middle
    return Splats(
        means=means.astype(np.float32),
        quats=quats.astype(np.float32),
        scales=np.tile(np.log(np.float32([0.03, 0.03, 0.003])), (count, 1)),
        opacities=np.full(count, 3, np.float32),
        sh0=(means @ COLORS)[:, None].astype(np.float32),
        shN=np.zeros((count, 3, 3), np.float32),
    )


def plane(count: int = 4000) -> Splats:
    """A square of two units across z."""
    places = np.random.default_rng(1).uniform(-1, 1, (count, 3)) * [1, 1, 0]
    return discs(places, np.tile([0.0, 0, 1], (count, 1)))


def with_gaps(splats: Splats) -> Splats:
    """The plane without 60 discs of two to three spacings between its splats."""
    middles = np.random.default_rng(3).uniform(-1, 1, (60, 2))
    away = np.linalg.norm(splats.means[:, None, :2] - middles, axis=2)
    return splats.subset((away > 0.06).all(axis=1))


def ball_of(center: tuple[float, float, float], radius: float) -> np.ndarray:
    """The cube around a sphere, [4, 4]."""
    matrix = np.diag([radius, radius, radius, 1.0])
    matrix[:3, 3] = center
    return matrix


def cut(splats: Splats, ball: np.ndarray) -> tuple[Splats, Splats]:
    """The splats outside and inside a ball."""
    inside = np.linalg.norm(splats.means - ball[:3, 3], axis=1) <= ball[0, 0]
    return splats.subset(~inside), splats.subset(inside)


def tilt(new: Splats, normals: np.ndarray) -> float:
    """Largest angle between z axes of splats and unit normals [N, 3], degrees."""
    axes = quat_to_rotmat(new.quats.astype(np.float64))[:, :, 2]
    return np.degrees(np.arccos(np.clip(np.abs((axes * normals).sum(axis=1)).min(), 0, 1)))


def test_a_plane_with_a_gradient() -> None:
    """On the plane, flat on it, of the colour of their place, as many as before within a quarter,
    and everywhere."""
    around, gone = cut(plane(), ball := ball_of((0.1, 0, 0), 0.3))
    new = heal(around, ball).splats
    assert np.abs(new.means[:, 2]).max() < 1e-4
    assert tilt(new, np.array([[0.0, 0, 1]])) < 0.1
    np.testing.assert_allclose(new.sh0[:, 0], new.means @ COLORS, atol=1e-4)
    assert 0.75 < len(new) / len(gone) < 1.25
    off = np.linalg.norm(gone.means[:, None] - new.means, axis=2)
    assert off.min(axis=1).max() < 0.1
    np.testing.assert_array_equal(new.means, heal(around, ball).splats.means)


def test_units_do_not_matter() -> None:
    """The same plane a thousand times as large and far away."""
    around, _ = cut(plane(), ball := ball_of((0.1, 0, 0), 0.3))
    new = heal(around, ball).splats
    scale = np.float32(np.log(1000))
    far = replace(around, means=around.means * 1000 + 5000, scales=around.scales + scale)
    moved = heal(far, ball_of((5100, 5000, 5000), 300)).splats
    assert abs(len(moved) - len(new)) < 0.1 * len(new)
    assert np.abs(moved.means[:, 2] - 5000).max() < 0.1
    np.testing.assert_allclose(np.median(moved.scales) - np.median(new.scales), scale, atol=0.1)


@pytest.mark.parametrize("radius", [0.4, 0.7])
def test_a_sphere(radius: float) -> None:
    """At the radius of the sphere, turned with its surface."""
    unit = np.random.default_rng(2).normal(size=(6000, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    around, gone = cut(discs(unit, unit), ball := ball_of((0.0, 0, 1), radius))
    new, normals = heal(around, ball, values=around.means)
    distances = np.linalg.norm(new.means, axis=1)
    np.testing.assert_allclose(distances, 1, atol=0.02)
    assert tilt(new, new.means / distances[:, None]) < 5
    cosines = (normals * new.means).sum(axis=1) / np.linalg.norm(normals, axis=1) / distances
    assert np.degrees(np.arccos(np.clip(cosines, -1, 1))).max() < 10
    assert 0.7 < len(new) / len(gone) < 1.4


def test_many_splats() -> None:
    """Far denser than the points that sample the surface: as many as before, everywhere."""
    around, gone = cut(plane(60_000), ball := ball_of((0.1, 0, 0), 0.45))
    new = heal(around, ball).splats
    assert 0.75 < len(new) / len(gone) < 1.25
    place = ball[:2, 3] + np.array([[0, 0], [0.2, 0.2], [-0.3, 0]])
    off = np.linalg.norm(new.means[:, :2] - place[:, None], axis=2)
    assert (off.min(axis=1) < 0.03).all()


def test_a_wave() -> None:
    """Between crest and trough, whose curvature differs from that of the donors: on the wave, and
    turned with it."""
    places = np.random.default_rng(5).uniform(-1, 1, (5000, 3))
    places[:, 2] = 0.1 * np.sin(4 * places[:, 0])

    def normals(x: np.ndarray) -> np.ndarray:
        found = np.stack([-0.4 * np.cos(4 * x), 0 * x, 1 + 0 * x], axis=1)
        return found / np.linalg.norm(found, axis=1, keepdims=True)

    around, _ = cut(discs(places, normals(places[:, 0])), ball := ball_of((0.1, 0, 0), 0.3))
    new = heal(around, ball).splats
    x, _, z = new.means.astype(np.float64).T
    np.testing.assert_allclose(z, 0.1 * np.sin(4 * x), atol=0.005)
    assert tilt(new, normals(x)) < 2


def test_two_borders_of_a_tube() -> None:
    """The surface joins them: at the radius of the tube, on all sides."""
    rng = np.random.default_rng(3)
    turn = rng.uniform(0, 2 * np.pi, 6000)
    normals = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    places = 0.3 * normals + np.outer(rng.uniform(-1.5, 1.5, 6000), [0, 0, 1])
    around, gone = cut(discs(places, normals), ball := ball_of((0.0, 0, 0), 0.5))
    new = heal(around, ball).splats
    np.testing.assert_allclose(np.linalg.norm(new.means[:, :2], axis=1), 0.3, rtol=0.1)
    middle = np.abs(new.means[:, 2]) < 0.1
    assert (np.histogram(np.arctan2(*new.means[middle, :2].T), 8)[0] > 5).all()
    assert 0.7 < len(new) / len(gone) < 1.4


def test_only_what_is_open_in_a_box() -> None:
    """A box larger than the hole, turned: nothing is added where there are splats."""
    around, _ = cut(plane(), ball_of((0.0, 0, 0), 0.25))
    box = ball_of((0.0, 0, 0), 0.6)
    box[:2, :2] = 0.6 * np.array([[0.8, -0.6], [0.6, 0.8]])
    new = heal(around, box, sphere=False).splats
    assert len(new) > 50
    assert np.linalg.norm(new.means, axis=1).max() < 0.25 + 0.1


def test_view_dependence_turns_with_the_surface() -> None:
    """Splats of a sphere whose first band points along the normal: so do those of the hole."""
    unit = np.random.default_rng(4).normal(size=(6000, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    splats = discs(unit, unit)
    band = np.stack([-unit[:, 1], unit[:, 2], -unit[:, 0]], axis=1)  # of the basis y, z, x
    splats = replace(splats, shN=np.repeat(band[:, :, None], 3, axis=2).astype(np.float32))
    around, _ = cut(splats, ball := ball_of((0.0, 0, 1), 0.4))
    new = heal(around, ball).splats
    along = np.stack([-new.shN[:, 2, 0], -new.shN[:, 0, 0], new.shN[:, 1, 0]], axis=1)
    assert np.degrees(np.arccos(np.clip((along * new.means).sum(axis=1), -1, 1))).max() < 15


Change = Callable[[Splats], tuple[Splats, np.ndarray]]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda s: (s, ball_of((0.0, 0, 0), 0.3)), "There is no hole"),
        (lambda s: (with_gaps(s), ball_of((0.0, 0, 0), 0.6)), "There is no hole"),
        (
            lambda s: (s, ball_of((0.0, 0, 5), 0.3)),
            "0 splats of opacity 0.2 or more around the hole, within 2 radii",
        ),
        (lambda s: (s, ball_of((1.0, 0, 0), 0.3)), "There is no hole"),
        (lambda s: (s, ball_of((1.0, 1, 0), 0.3)), "There is no hole"),
        (lambda s: (s, ball_of((0.0, 0, 0), 0.0)), "no volume"),
        (lambda s: (s, np.full((4, 4), np.nan)), "no volume"),
        (lambda s: (s.subset(slice(0)), ball_of((0.0, 0, 0), 0.3)), "0 splats of opacity"),
    ],
    ids=["covered", "gaps", "edge", "corner", "in the air", "flat", "not finite", "no splats"],
)
def test_refusals(change: Change, problem: str) -> None:
    """A sentence with the reason."""
    splats, region = change(plane())
    with pytest.raises(ConfigError, match=problem):
        heal(splats, region)


def test_too_many_splats(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refused, with their number."""
    monkeypatch.setattr("gscore.edit.heal._MOST", 1000)
    with pytest.raises(ConfigError, match=r"splats around the hole are too many"):
        heal(plane(), ball_of((0.0, 0, 0), 0.6))


def test_cancelling() -> None:
    """The exception of the check."""

    def check() -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        heal(plane(), ball_of((0.0, 0, 0), 0.3), check=check)


def test_a_step_of_the_pipeline() -> None:
    """Cut and healed in one request; the number of added splats."""
    splats = plane()
    ball = (0.1, 0.0, 0.0, 0.3)
    edited = apply_edits([splats], EditRequest(sphere=ball, outside=True, heal=ball))
    crop, healing = edited.steps
    assert (crop.name, healing.name) == ("crop", "heal")
    assert crop.removed > 100 and healing.removed == crop.left - len(edited.splats) < -100
    with pytest.raises(ConfigError, match="radius of a hole"):
        EditRequest(heal=(0, 0, 0, 0))
