"""Joint alignment of all depth maps: the end values with the least contradiction.

Let r be the log of the ratio between the inverse depth of a point and that which a map states for
it, in units of the log ratio between the map's ends. What is minimised is the sum of a bounded
penalty of r over the points of structure from motion that each view sees, and over sampled pixels
of each map, placed by its own ends, in the maps of its neighbours. Bounded, so that hidden
surfaces, edges and bad maps decide nothing; in units of the maps' own span, or maps drawn flat
would agree best. Levenberg and Marquardt's method moves the logs of all ends; the curvature of the
sum says how well each map is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from .chart import Chart, inverse_depth

MAP_SIGMA = 0.1
"""Standard deviation of r: maps err by some per cents, in large parts of them alike."""
_BOUND = 2.0
"""No single r adds more to the sum; as much as 2 standard deviations would to a sum of squares."""
POINTS = 0.3
"""Independent observations that all points of a view are worth: they lie in a part of the picture
where the map errs alike. Chosen on simulated maps of studio, as MAP_SIGMA and _ALIKE were."""
PAIRS = 1.0
"""Independent observations that a map is worth to a neighbour that sees all of it."""
_ALIKE = 0.7
"""Standard deviation of the log ratio of a map's ends from the median one of a capture, for maps of
which points and neighbours say little: all show the same place."""
_DAMPING = 1e-4
"""Of the first step, as a share of the curvature."""
_STEPS = 30
_DONE = 1e-4
"""Relative decrease of the sum below which it is at its minimum."""
_LONGEST = 0.5
"""Longest step of a log."""
_SPAN = (0.01, 6.0)
"""Least and largest log of the ratio between the ends of a map."""
_NARROWER = np.array([1.0, -1.0])
"""What a log of the ratio of a map's ends falls by with the logs of these."""
_DELTA = 1e-3
"""Relative change of an inverse depth that derivatives are taken over."""


@dataclass(frozen=True, kw_only=True)
class Web:
    """Maps and who is compared with whom."""

    charts: list[Chart]
    asked: list[list[int]]
    """By map, those whose maps its pixels are looked up in."""

    def asking(self, index: int) -> list[int]:
        """The maps whose pixels are looked up in map `index`."""
        return [i for i, others in enumerate(self.asked) if index in others]

    def only(self, chosen: list[int]) -> "Web":
        """Some of the maps, which become 0, 1, ... in this order."""
        place = {k: n for n, k in enumerate(chosen)}
        asked = [[place[i] for i in self.asked[k] if i in place] for k in chosen]
        return Web(charts=[self.charts[k] for k in chosen], asked=asked)

    def thinned(self, step: int) -> "Web":
        """The same with every `step`-th of the sampled pixels."""
        charts = [
            replace(c, tones=c.tones[::step], directions=c.directions[::step]) for c in self.charts
        ]
        return Web(charts=charts, asked=self.asked)


def _penalty(r: np.ndarray, sigma: float) -> np.ndarray:
    """Geman and McClure's function of r / sigma: half a square, bounded; 0 for NaN."""
    square = (r / sigma) ** 2
    return np.where(np.isfinite(r), _BOUND * square / (square + 2 * _BOUND), 0.0)


def _weight(r: np.ndarray, sigma: float) -> np.ndarray:
    """The weight of r^2 / 2 in a sum of squares with the same derivative; 0 for NaN."""
    weight = (2 * _BOUND / ((r / sigma) ** 2 + 2 * _BOUND)) ** 2 / sigma**2
    return np.where(np.isfinite(r), weight, 0.0)


def place(
    web: Web, logs: np.ndarray, *, factors: Sequence[float] = (1.0,)
) -> tuple[float, np.ndarray]:
    """Logs [V, 2] of the ends, from `logs` downhill, and how much the maps contradict each other.

    Bounded penalties have many minima, wide ones fewer: `factors` are multiples of MAP_SIGMA to go
    downhill with, one after the other. What is returned with the logs is the mean penalty, with the
    last factor, of pixels that a neighbour shows plus that of points: maps that are not seen by
    others do not look better by it.
    """
    system = None
    for factor in factors:
        logs, system = _descend(web, logs, factor * MAP_SIGMA)
    assert system is not None
    return system.doubt, logs


def _descend(web: Web, logs: np.ndarray, sigma: float) -> tuple[np.ndarray, "_System"]:
    damping = _DAMPING
    typical = float(np.median(logs[:, 1] - logs[:, 0]))
    system = _linearised(web, logs, sigma, typical)
    # A pixel that nobody shows costs as much as others, or maps would be put out of sight.
    unseen = system.mean
    for _ in range(_STEPS):
        damped = system.curvature + damping * np.diag(np.diag(system.curvature) + 1e-3)
        step = np.clip(-np.linalg.solve(damped, system.slope), -_LONGEST, _LONGEST)
        tried = _bounded(logs + step.reshape(-1, 2))
        found = _linearised(web, tried, sigma, typical)
        gain = system.total(unseen) - found.total(unseen)
        if gain > 0:
            done = gain < _DONE * system.total(unseen)
            logs, system = tried, found
            damping = max(damping / 10, 1e-7)
            if done:
                break
        else:
            damping *= 10
            if damping > 1e4:
                break
    return logs, system


def covariances(web: Web, logs: np.ndarray) -> np.ndarray:
    """[V, 2, 2] of the logs of each map's ends, as the curvature of the sum at `logs` has them."""
    typical = float(np.median(logs[:, 1] - logs[:, 0]))
    curvature = _linearised(web, logs, MAP_SIGMA, typical).curvature
    # Where nothing is known, a factor of e^10.
    inverse = np.linalg.inv(curvature + 1e-2 * np.eye(len(curvature)))
    count = len(logs)
    every = np.arange(count)
    return inverse.reshape(count, 2, count, 2)[every, :, every, :]


def _bounded(logs: np.ndarray) -> np.ndarray:
    """The near end stays nearer than the far one, and that at a finite distance."""
    far, near = logs.T
    return np.stack([np.clip(far, near - _SPAN[1], near - _SPAN[0]), near], 1)


def _shares(ends: np.ndarray, tones: np.ndarray) -> np.ndarray:
    """[..., N, 2] derivative of log inverse depth by the logs of the ends."""
    value = inverse_depth(ends, tones)[..., None]
    return ends[..., None, :] * np.stack([1 - tones, tones], -1) / value


class _System(NamedTuple):
    """The sum and its derivatives at some place."""

    points: float
    """Penalties of the points of all views, each view's weighted to one, times POINTS."""
    spans: float
    """Half the squares of how unlike the ratios of the maps' ends are."""
    pairs: float
    """Penalties of all sampled pixels where a neighbour shows them."""
    seen: int
    """How many these are."""
    unseen: int
    """And how many no neighbour shows."""
    share: float
    """What a pixel counts."""
    views: int
    """Maps."""
    curvature: np.ndarray
    """[2V, 2V], without second derivatives of r."""
    slope: np.ndarray
    """[2V]"""

    @property
    def mean(self) -> float:
        """Penalty of a seen pixel."""
        return self.pairs / max(self.seen, 1)

    @property
    def doubt(self) -> float:
        """Penalty of a seen pixel plus that of a point."""
        return self.mean + self.points / (POINTS * self.views)

    def total(self, unseen: float) -> float:
        """The sum, with a penalty for pixels that no neighbour shows."""
        return self.points + self.spans + self.share * (self.pairs + unseen * self.unseen)


def _linearised(web: Web, logs: np.ndarray, sigma: float, typical: float) -> _System:
    ends, spans, count = np.exp(logs), logs[:, 1] - logs[:, 0], len(logs)
    points, pairs, visible, asked = 0.0, 0.0, 0, 0
    unlike = (spans - typical) / _ALIKE
    curvature, slope = np.zeros((count, 2, count, 2)), -unlike[:, None] * _NARROWER / _ALIKE
    for j in range(count):
        curvature[j, :, j] = np.outer(_NARROWER, _NARROWER) / _ALIKE**2
    tones = np.stack([chart.tones for chart in web.charts])
    share = PAIRS / tones.shape[1]
    depths = inverse_depth(ends, tones)
    shares = _shares(ends, tones)
    places = [
        c.points(np.stack([d, d * (1 + _DELTA)])) for c, d in zip(web.charts, depths, strict=True)
    ]
    for j, chart in enumerate(web.charts):
        if len(chart.point_weights):
            r = np.log(inverse_depth(ends[j], chart.point_tones) / chart.point_inverse) / spans[j]
            weight = POINTS * chart.point_weights
            points += float(weight @ _penalty(r, sigma))
            weight = weight * _weight(r, sigma)
            jacobian = (_shares(ends[j], chart.point_tones) + r[:, None] * _NARROWER) / spans[j]
            curvature[j, :, j] += jacobian.T @ (weight[:, None] * jacobian)
            slope[j] += jacobian.T @ (weight * r)
        asking = web.asking(j)
        if not asking:
            continue
        span = 0.5 * (spans[asking] + spans[j])[:, None]  # [S, 1]
        seen, inverse = chart.look_up(np.stack([places[i] for i in asking]))  # [S, 2, P]
        r, moved = np.moveaxis(np.log(inverse / inverse_depth(ends[j], seen)), 1, 0) / span
        pairs += float(_penalty(r, sigma).sum())
        visible, asked = visible + int(np.isfinite(r).sum()), asked + r.size
        known = np.isfinite(r) & np.isfinite(moved)
        weight = share * np.where(known, _weight(r, sigma), 0.0)
        r, change = np.where(known, r, 0.0), np.where(known, (moved - r) / _DELTA, 0.0)
        narrower = 0.5 * (r / span)[..., None] * _NARROWER
        theirs = change[..., None] * shares[asking] + narrower  # [S, P, 2]
        mine = narrower - np.nan_to_num(_shares(ends[j], seen[:, 0])) / span[..., None]
        curvature[j, :, j] += np.einsum("sp,spa,spb->ab", weight, mine, mine)
        slope[j] += np.einsum("sp,spa->a", weight * r, mine)
        across = np.einsum("sp,spa,spb->sab", weight, theirs, mine)
        own = np.einsum("sp,spa,spb->sab", weight, theirs, theirs)
        down = np.einsum("sp,spa->sa", weight * r, theirs)
        for s, i in enumerate(asking):
            curvature[i, :, i] += own[s]
            curvature[i, :, j] += across[s]
            curvature[j, :, i] += across[s].T
            slope[i] += down[s]
    return _System(
        points=points,
        spans=float(unlike @ unlike) / 2,
        pairs=pairs,
        seen=visible,
        unseen=asked - visible,
        share=share,
        views=count,
        curvature=curvature.reshape(2 * count, 2 * count),
        slope=slope.ravel(),
    )
