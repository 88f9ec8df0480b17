"""Heal: fill a hole with splats from around it, on a smooth surface through its border."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..errors import ConfigError
from ..formats.joined import joined
from ..importance import importance_of
from ..shared_constants import SH_C0
from ..splats import Splats, sigmoid
from ..text_format import count_text
from ..transforms import quat_multiply, quat_to_rotmat, transform_splats
from .clusters import reached_from
from .implicit_surface import Field, farthest_points, nearest, surface_through

_AROUND = 2.0
"""Extent of the surroundings that are used, in sizes of the region."""
_OPAQUE = 0.2
"""Least opacity of splats that define the surface."""
_FAINT = 0.005
"""Least opacity of splats that are copied."""
_LARGEST = 0.5
"""Largest standard deviation of splats that are used, in sizes of the region."""
_FEWEST = 50
"""Least number of splats around a hole."""
_MOST = 500_000
"""Largest number of splats around a hole: a minute of one core."""
_ESTIMATED = 20_000
"""Splats from which densities are estimated, at most."""
_CENTERS = 600
"""Splats that define the surface, at most."""
_SMOOTHED = 16
"""Splats whose mean colour is that of a place."""
_SAMPLES, _ROUNDS = 5000, 6
"""Points in the region that are moved onto the surface, and steps of that."""
_PATCH = 0.25
"""Radius of a patch, in sizes of the region."""
_HEIGHT = 0.5
"""Largest distance of copied splats from the surface, in radii of a patch."""
_FINEST = 4.0
"""Least radius of a patch, in spacings of splats."""
_COVERED = 2.0
"""Distance to a splat, in spacings, up to which the surface is not a hole."""
_HOLLOW = 0.01
"""Least share of the surface in the region at twice that distance: less are gaps between splats."""
_SECTORS, _OPPOSITE = 16, 2
"""Directions along the surface, and the least number of opposite pairs with splats."""
_COLOR, _ANGLE, _AGAIN = 0.03, np.radians(45), 0.25
"""Differences of colour (sRGB values) and of normals (radians) between patch and donor that cost as
much as a distance of the region's size, and the cost of each earlier use of a donor."""


class Healed(NamedTuple):
    """Filling of a hole: new splats, and values at them."""

    splats: Splats
    values: np.ndarray
    """[N, C] float64, the given values at the new splats: interpolated from the border as colours
    are, within the least and the largest one there."""


def heal(
    splats: Splats,
    from_unit: np.ndarray,
    *,
    sphere: bool = True,
    seed: int = 0,
    values: np.ndarray | None = None,
    check: Callable[[], None] = lambda: None,
) -> Healed:
    """Splats that fill a hole.

    A smooth surface is laid through the splats around the hole; it may join several borders.
    Patches of splats from around the hole are bent onto it, each from where colours and normals
    are close. Low frequencies of their colours are replaced by those interpolated from the border,
    so that only their texture stays (after Perez et al. 2003).

    Args:
        splats: Raw parameters, without those that were removed.
        from_unit: [4, 4] float64, from the cube [-1, 1]^3 to the box that contains the hole.
        sphere: Fill only the ellipsoid inscribed in the box.
        seed: Of the points that sample the surface.
        values: [N, C], any values of the splats; None: none.
        check: Called between steps; may raise, to cancel.

    Returns:
        The new splats only, as dense as those around.

    Raises:
        ConfigError: the region has no volume, too few or too many splats are around it, or the
            surface does not continue into it, or is covered there.
    """
    region = _Region(np.asarray(from_unit, np.float64), sphere=sphere)
    if values is None:
        values = np.zeros((len(splats), 0))
    patches = _Patches(*_surroundings(splats, values, region), region, seed, check)
    made = []
    for number in range(len(patches.centers)):
        check()
        made.append(patches.filled(number))
    filled = joined(made)
    if not len(filled):
        raise ConfigError("The splats around the hole are too sparse to fill it: enlarge it.")
    around = patches.values(filled.means.astype(np.float64))
    filled = replace(
        filled,
        means=(filled.means * region.size + region.middle).astype(np.float32),
        scales=filled.scales + np.float32(np.log(region.size)),
    )
    return Healed(filled, around)


class _Region:
    """The ellipsoid or box to fill. Its middle and size define the unit of all work."""

    def __init__(self, from_unit: np.ndarray, *, sphere: bool) -> None:
        fits = from_unit.shape == (4, 4) and bool(np.isfinite(from_unit).all())
        volume = abs(float(np.linalg.det(from_unit[:3, :3]))) if fits else 0.0
        if not volume > 0:
            raise ConfigError("The region to fill has no volume: give it a size above 0.")
        self.middle, self.size = from_unit[:3, 3], float(np.cbrt(volume))
        self._axes = from_unit[:3, :3] / self.size
        self._sphere = sphere

    def depths(self, points: np.ndarray) -> np.ndarray:
        """[N], 0 in the middle and 1 at the border, of points [N, 3] in the unit."""
        local = points @ np.linalg.inv(self._axes).T
        return np.linalg.norm(local, axis=1) if self._sphere else np.abs(local).max(axis=1)

    def sampled(self, count: int, seed: int) -> np.ndarray:
        """Random points [N, 3] of the region, in the unit."""
        points = np.random.default_rng(seed).uniform(-1, 1, (count, 3)) @ self._axes.T
        return points[self.depths(points) <= 1]


def _surroundings(splats: Splats, values: np.ndarray, region: _Region) -> tuple[Splats, np.ndarray]:
    """The splats in and near a region, in its unit, without faint and very large ones; and their
    values, of [N, C]."""
    means = (splats.means - region.middle) / region.size
    scales = splats.scales - np.float32(np.log(region.size))
    near = region.depths(means) <= _AROUND
    near &= splats.opacities >= np.log(_FAINT / (1 - _FAINT))
    near &= (scales <= np.log(_LARGEST)).all(axis=1)
    found = replace(splats, means=means.astype(np.float32), scales=scales).subset(near)
    count = int((sigmoid(found.opacities) >= _OPAQUE).sum())
    if count < _FEWEST:
        raise ConfigError(
            f"Only {count_text(count, 'splat')} of opacity {_OPAQUE:g} or more around the hole, "
            f"within {_AROUND:g} radii, and filling it takes {_FEWEST}: choose a region whose "
            "border is on a surface, or a larger one."
        )
    if count > _MOST:
        raise ConfigError(
            f"{count_text(count, 'splat')} around the hole are too many: choose a smaller region."
        )
    return found, values[near]


class _Patches:
    """Patches of a hole, and donors for them."""

    def __init__(
        self,
        splats: Splats,
        values: np.ndarray,
        region: _Region,
        seed: int,
        check: Callable[[], None],
    ) -> None:
        self._splats, self._means = splats, splats.means.astype(np.float64)
        is_opaque = sigmoid(splats.opacities) >= _OPAQUE
        opaque = splats.subset(is_opaque)
        means = opaque.means.astype(np.float64)
        self._field, some, spacing = surface_through(opaque, centers=_CENTERS)
        check()
        self._smooth = _Smooth(opaque, values[is_opaque], some)
        self._hole = self._open(region, means, spacing, seed)
        check()
        self._radius = max(_PATCH, _FINEST * spacing)
        rows = farthest_points(self._hole, len(self._hole), gap=self._radius)
        self.centers = self._hole[rows]
        self._owners = nearest(self._hole, self.centers)[1][:, 0]
        self._within = max(_COVERED * spacing, _between_samples(self._hole))
        self._donors = self._chosen(self._field.onto(means[some], 0.0, 3), self._smooth.rough)

    def _open(self, region: _Region, means: np.ndarray, spacing: float, seed: int) -> np.ndarray:
        """Points [H, 3] of the surface in the region without splats, `means` [N, 3], that are
        connected with splats and between them."""
        points = self._field.onto(region.sampled(_SAMPLES, seed), 0.0, _ROUNDS)
        values, slopes = self._field.slopes(points)
        on = np.abs(values) <= 0.1 * spacing * np.linalg.norm(slopes, axis=1)
        points = points[on & (region.depths(points) <= 1)]
        if len(points):
            distances = nearest(points, means)[0][:, 0]
            is_hole = (distances > 2 * _COVERED * spacing).mean() >= _HOLLOW
            points = points[(distances > _COVERED * spacing) & is_hole]
        gap = 2 * max(spacing, _between_samples(points))
        both = np.concatenate([points, means])
        known = np.arange(len(both)) >= len(points)
        points = points[reached_from(both, known, gap)[: len(points)]]
        if len(points):
            points = points[self._enclosed(points, means)]
        if len(points) < 3:
            raise ConfigError(
                "There is no hole in the region: splats cover it, or no surface around it "
                "continues into it."
            )
        return points

    def _enclosed(self, points: np.ndarray, means: np.ndarray) -> np.ndarray:
        """[H] bool of the points [H, 3] of the surface with splats on opposite sides, unlike those
        beyond an edge of the surface."""
        some = means[farthest_points(means, _CENTERS)]
        normals = _unit(self._field.slopes(points)[1])
        across = np.eye(3)[np.abs(normals).argmin(axis=1)]
        first = _unit(np.cross(normals, across))
        second = np.cross(normals, first)
        off = some - points[:, None]
        x, y = (np.einsum("hki,hi->hk", off, axis) for axis in (first, second))
        near = np.abs(np.einsum("hki,hi->hk", off, normals)) <= 1
        sectors = np.floor(np.arctan2(y, x) / (2 * np.pi) * _SECTORS).astype(int) % _SECTORS
        taken = np.zeros((len(points), _SECTORS), bool)
        rows = np.broadcast_to(np.arange(len(points))[:, None], near.shape)
        taken[rows[near], sectors[near]] = True
        half = _SECTORS // 2
        return (taken[:, :half] & taken[:, half:]).sum(axis=1) >= _OPPOSITE

    def _chosen(self, places: np.ndarray, rough: np.ndarray) -> np.ndarray:
        """The donor place of each patch, [T, 3], of some on the surface [K, 3], where colours
        differ from their low frequencies by `rough` [K]."""
        beside = np.linalg.norm(places[:, None] - places, axis=2) <= self._radius
        rough = np.sqrt(beside @ rough**2 / beside.sum(axis=1))
        distances = nearest(places, self._hole)[0][:, 0]
        free = np.flatnonzero(distances > self._radius)
        if not len(free):
            free = np.argsort(-distances)[: max(len(places) // 4, 1)]
        places, rough = places[free], rough[free]
        sides = [_unit(self._field.slopes(points)[1]) for points in (self.centers, places)]
        angles = np.arccos(np.clip(sides[0] @ sides[1].T, -1, 1))
        colors = [self._color(points) for points in (self.centers, places)]
        differences = np.linalg.norm(colors[0][:, None] - colors[1], axis=2) * SH_C0
        ways = np.linalg.norm(self.centers[:, None] - places, axis=2)
        covers = np.log(np.maximum(self._covers(places), 1e-12))
        costs = ways + angles / _ANGLE + (differences + rough) / _COLOR
        costs += np.abs(covers - np.median(covers))  # neither sparse nor several surfaces
        used, chosen = np.zeros(len(places)), []
        for row in costs:
            best = int((row + _AGAIN * used).argmin())
            used[best] += 1
            chosen.append(places[best])
        return np.array(chosen)

    def _covers(self, places: np.ndarray) -> np.ndarray:
        """[K], importance of the splats near each place [K, 3], estimated from some of them."""
        some = slice(None, None, -(-len(self._means) // _ESTIMATED))
        weights, means = importance_of(self._splats)[some], self._means[some]
        squares = [((means - place) ** 2).sum(axis=1) for place in places]
        return np.array([weights[row <= self._radius**2].sum() for row in squares])

    def filled(self, number: int) -> Splats:
        """The splats of a patch: those of its donor, rotated, bent onto the surface and with other
        low frequencies of their colours."""
        target, donor = self.centers[number], self._donors[number]
        near = np.linalg.norm(self._means - donor, axis=1) <= 1.5 * self._radius
        before = self._means[near]
        levels, slope = self._field.slopes(before)
        flat = np.abs(levels) <= _HEIGHT * self._radius
        before, levels, rows = before[flat], levels[flat], np.flatnonzero(near)[flat]
        sides = (_unit(self._field.slopes(point[None])[1]) for point in (donor, target))
        matrix = np.eye(4)
        matrix[:3, :3] = quat_to_rotmat(_between(*sides)[0])
        matrix[:3, 3] = target - matrix[:3, :3] @ donor
        moved = transform_splats(self._splats.subset(rows), matrix)
        after = self._field.onto(moved.means.astype(np.float64), levels, 3)
        axes = (_unit(slope[flat] @ matrix[:3, :3].T), _unit(self._field.slopes(after)[1]))
        bends = _between(*axes)
        feet = self._field.onto(after, 0.0, 1)
        distances, nearest_rows = nearest(feet, self._hole)
        kept = (distances[:, 0] <= self._within) & (self._owners[nearest_rows[:, 0]] == number)
        colors = moved.sh0[:, 0] + self._color(feet) - self._color(before)
        return replace(
            moved,
            means=after.astype(np.float32),
            quats=quat_multiply(bends, moved.quats.astype(np.float64)).astype(np.float32),
            sh0=colors[:, None].astype(np.float32),
        ).subset(kept)

    def _color(self, points: np.ndarray) -> np.ndarray:
        """[N, 3], low frequencies of sh0 at points [N, 3]."""
        return self._smooth(points)[:, :3]

    def values(self, points: np.ndarray) -> np.ndarray:
        """[N, C], low frequencies of the values at points [N, 3]."""
        return self._smooth(points)[:, 3:]


def _between_samples(points: np.ndarray) -> float:
    """Distance between neighbours of random points [N, 3] on a surface, 0 for fewer than two; the
    median to the nearest is half of it."""
    if len(points) < 2:
        return 0.0
    return 2 * float(np.median(nearest(points, points, 2)[0].max(axis=1)))


class _Smooth:
    """Low frequencies of sh0 and of other values of splats."""

    def __init__(self, splats: Splats, values: np.ndarray, some: np.ndarray) -> None:
        """Fit.

        Args:
            splats: Opaque splats.
            values: [N, C] of them.
            some: Indices [K] of splats; each gives the mean of those around it.
        """
        means = splats.means.astype(np.float64)
        near = nearest(means[some], means, _SMOOTHED)[1]
        weights = sigmoid(splats.opacities)[near].astype(np.float64)
        weights /= weights.sum(axis=1, keepdims=True)
        every = np.concatenate([splats.sh0[:, 0].astype(np.float64), values], axis=1)
        local = np.einsum("kn,knc->kc", weights, every[near])
        places = np.einsum("kn,kni->ki", weights, means[near])
        self._field = Field(places, local, power=1)
        self._bounds = local.min(axis=0), local.max(axis=0)
        self.rough = np.linalg.norm((local - self._field(places))[:, :3], axis=1) * SH_C0
        """[K], how much the mean colours around each place differ from low frequencies."""

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """[N, 3 + C] at points [N, 3]: sh0, then the values."""
        return np.clip(self._field(points), *self._bounds)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def _between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Quaternions [N, 4] of the shortest rotations between unit vectors [N, 3]; any half turn
    between opposite ones."""
    cosines = (one * other).sum(axis=1)
    quats = np.concatenate([1 + cosines[:, None], np.cross(one, other)], axis=1)
    opposite = cosines < -1 + 1e-9
    across = np.eye(3)[np.abs(one[opposite]).argmin(axis=1)]
    quats[opposite, 0], quats[opposite, 1:] = 0, np.cross(one[opposite], across)
    return _unit(quats)
