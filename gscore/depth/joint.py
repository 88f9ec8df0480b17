"""Joint alignment of all depth maps: the end values with the least contradiction.

Let r be the log ratio between the inverse depth of a point and that of a map at its pixel, in units
of the log ratio between the map's ends. The objective is the sum of a bounded penalty of r over the
SfM points of each view, and over sampled pixels of each map, unprojected with its own ends, in the
maps of its neighbours. The bound limits the influence of hidden surfaces, edges and bad maps; the
units avoid flat maps, which would agree best otherwise. The Levenberg-Marquardt method optimises
the logs of all ends; the curvature of the sum gives the uncertainty of each map.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from .posed_depth_map import PosedDepthMap, inverse_depth

MAP_SIGMA = 0.1
"""Standard deviation of r: maps have correlated errors of some per cent."""
_BOUND = 2.0
"""Maximum penalty of one r: that of 2 standard deviations in a sum of squares."""
POINTS = 0.3
"""Total weight of the points of a view, in independent observations: they are in one part of the
picture, with correlated errors. Tuned on simulated maps of studio, like MAP_SIGMA and
_SPAN_SIGMA."""
PAIRS = 1.0
"""Weight of a map in a neighbour that shows all of it, in independent observations."""
_SPAN_SIGMA = 0.7
"""Standard deviation of the log ratio of a map's ends around the median of the capture, a prior for
maps with few points and neighbours: all show the same place."""
_DAMPING = 1e-4
"""Damping of the first step, relative to the curvature."""
_STEPS = 30
_DONE = 1e-4
"""Relative decrease of the sum at convergence."""
_LONGEST = 0.5
"""Maximum step of a log."""
_SPAN = (0.01, 6.0)
"""Minimum and maximum log ratio between the ends of a map."""
_NARROWER = np.array([1.0, -1.0])
"""Negative derivative of the log ratio of a map's ends by their logs."""
_DELTA = 1e-3
"""Relative change of an inverse depth in finite differences."""


@dataclass(frozen=True, kw_only=True)
class Web:
    """Maps and their neighbours."""

    depth_maps: list[PosedDepthMap]
    neighbours: list[list[int]]
    """Neighbours of each map, into which its pixels are projected."""

    def projected_onto(self, index: int) -> list[int]:
        """The maps whose pixels are projected into map `index`."""
        return [i for i, others in enumerate(self.neighbours) if index in others]

    def only(self, chosen: list[int]) -> "Web":
        """A subset of the maps, renumbered 0, 1, ... in this order."""
        place = {k: n for n, k in enumerate(chosen)}
        neighbours = [[place[i] for i in self.neighbours[k] if i in place] for k in chosen]
        return Web(depth_maps=[self.depth_maps[k] for k in chosen], neighbours=neighbours)

    def thinned(self, step: int) -> "Web":
        """The same with every `step`-th of the sampled pixels."""
        depth_maps = [
            replace(c, tones=c.tones[::step], directions=c.directions[::step])
            for c in self.depth_maps
        ]
        return Web(depth_maps=depth_maps, neighbours=self.neighbours)


def _penalty(r: np.ndarray, sigma: float) -> np.ndarray:
    """Geman-McClure function of r / sigma: half a square, bounded; 0 for NaN."""
    square = (r / sigma) ** 2
    return np.where(np.isfinite(r), _BOUND * square / (square + 2 * _BOUND), 0.0)


def _weight(r: np.ndarray, sigma: float) -> np.ndarray:
    """The weight of r^2 / 2 in a sum of squares with the same derivative; 0 for NaN."""
    weight = (2 * _BOUND / ((r / sigma) ** 2 + 2 * _BOUND)) ** 2 / sigma**2
    return np.where(np.isfinite(r), weight, 0.0)


def place(
    web: Web, logs: np.ndarray, *, factors: Sequence[float] = (1.0,)
) -> tuple[float, np.ndarray]:
    """Minimise the objective from `logs`; return the contradiction and the logs [V, 2] of the ends.

    Bounded penalties have many local minima, wide ones fewer: `factors` are multiples of MAP_SIGMA
    for successive minimisations. The contradiction is the mean penalty, with the last factor, of
    pixels visible in a neighbour plus that of points, so maps do not gain by leaving the others'
    frames.
    """
    system = None
    for factor in factors:
        logs, system = _descend(web, logs, factor * MAP_SIGMA)
    assert system is not None
    return system.mean_penalty, logs


def _descend(web: Web, logs: np.ndarray, sigma: float) -> tuple[np.ndarray, "_System"]:
    damping = _DAMPING
    typical = float(np.median(logs[:, 1] - logs[:, 0]))
    system = _linearised(web, logs, sigma, typical)
    # A pixel that no neighbour shows costs as much as others, or maps would leave all frames.
    unseen = system.mean
    for _ in range(_STEPS):
        damped = system.curvature + damping * np.diag(np.diag(system.curvature) + 1e-3)
        step = np.clip(-np.linalg.solve(damped, system.slope), -_LONGEST, _LONGEST)
        far, near = (logs + step.reshape(-1, 2)).T
        tried = np.stack([np.clip(far, near - _SPAN[1], near - _SPAN[0]), near], 1)
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
    """Covariances [V, 2, 2] of the logs of each map's ends, from the curvature at `logs`."""
    typical = float(np.median(logs[:, 1] - logs[:, 0]))
    curvature = _linearised(web, logs, MAP_SIGMA, typical).curvature
    # A weak prior: standard deviation 10 of the logs.
    inverse = np.linalg.inv(curvature + 1e-2 * np.eye(len(curvature)))
    count = len(logs)
    every = np.arange(count)
    return inverse.reshape(count, 2, count, 2)[every, :, every, :]


def _shares(ends: np.ndarray, tones: np.ndarray) -> np.ndarray:
    """[..., N, 2] derivative of log inverse depth by the logs of the ends."""
    value = inverse_depth(ends, tones)[..., None]
    return ends[..., None, :] * np.stack([1 - tones, tones], -1) / value


class _System(NamedTuple):
    """The objective and its derivatives at given logs."""

    points: float
    """Penalties of the points of all views, each view's weighted to one, times POINTS."""
    spans: float
    """Prior of the ratios of the maps' ends, half a sum of squares."""
    pairs: float
    """Penalties of all sampled pixels in the neighbours that show them."""
    seen: int
    """Number of these pairs of pixel and neighbour."""
    unseen: int
    """Number of pairs whose neighbour does not show the pixel."""
    share: float
    """Weight of a pixel."""
    views: int
    """Number of maps."""
    curvature: np.ndarray
    """[2V, 2V], without second derivatives of r."""
    slope: np.ndarray
    """[2V] gradient."""

    @property
    def mean(self) -> float:
        """Mean penalty of a visible pixel."""
        return self.pairs / max(self.seen, 1)

    @property
    def mean_penalty(self) -> float:
        """Mean penalty of a visible pixel plus that of a point."""
        return self.mean + self.points / (POINTS * self.views)

    def total(self, unseen: float) -> float:
        """The objective, with the penalty `unseen` for pixels that no neighbour shows."""
        return self.points + self.spans + self.share * (self.pairs + unseen * self.unseen)


def _linearised(web: Web, logs: np.ndarray, sigma: float, typical: float) -> _System:
    ends, spans, count = np.exp(logs), logs[:, 1] - logs[:, 0], len(logs)
    points, pairs, visible, neighbours = 0.0, 0.0, 0, 0
    unlike = (spans - typical) / _SPAN_SIGMA
    curvature, slope = np.zeros((count, 2, count, 2)), -unlike[:, None] * _NARROWER / _SPAN_SIGMA
    for j in range(count):
        curvature[j, :, j] = np.outer(_NARROWER, _NARROWER) / _SPAN_SIGMA**2
    tones = np.stack([depth_map.tones for depth_map in web.depth_maps])
    share = PAIRS / tones.shape[1]
    depths = inverse_depth(ends, tones)
    shares = _shares(ends, tones)
    places = [
        c.points(np.stack([d, d * (1 + _DELTA)]))
        for c, d in zip(web.depth_maps, depths, strict=True)
    ]
    for j, depth_map in enumerate(web.depth_maps):
        if len(depth_map.point_weights):
            r = (
                np.log(inverse_depth(ends[j], depth_map.point_tones) / depth_map.point_inverse)
                / spans[j]
            )
            weight = POINTS * depth_map.point_weights
            points += float(weight @ _penalty(r, sigma))
            weight = weight * _weight(r, sigma)
            jacobian = (_shares(ends[j], depth_map.point_tones) + r[:, None] * _NARROWER) / spans[j]
            curvature[j, :, j] += jacobian.T @ (weight[:, None] * jacobian)
            slope[j] += jacobian.T @ (weight * r)
        projected_onto = web.projected_onto(j)
        if not projected_onto:
            continue
        span = 0.5 * (spans[projected_onto] + spans[j])[:, None]  # [S, 1]
        seen, inverse = depth_map.look_up(
            np.stack([places[i] for i in projected_onto])
        )  # [S, 2, P]
        r, moved = np.moveaxis(np.log(inverse / inverse_depth(ends[j], seen)), 1, 0) / span
        pairs += float(_penalty(r, sigma).sum())
        visible, neighbours = visible + int(np.isfinite(r).sum()), neighbours + r.size
        known = np.isfinite(r) & np.isfinite(moved)
        weight = share * np.where(known, _weight(r, sigma), 0.0)
        r, change = np.where(known, r, 0.0), np.where(known, (moved - r) / _DELTA, 0.0)
        narrower = 0.5 * (r / span)[..., None] * _NARROWER
        theirs = change[..., None] * shares[projected_onto] + narrower  # [S, P, 2]
        mine = narrower - np.nan_to_num(_shares(ends[j], seen[:, 0])) / span[..., None]
        curvature[j, :, j] += np.einsum("sp,spa,spb->ab", weight, mine, mine)
        slope[j] += np.einsum("sp,spa->a", weight * r, mine)
        across = np.einsum("sp,spa,spb->sab", weight, theirs, mine)
        own = np.einsum("sp,spa,spb->sab", weight, theirs, theirs)
        down = np.einsum("sp,spa->sa", weight * r, theirs)
        for s, i in enumerate(projected_onto):
            curvature[i, :, i] += own[s]
            curvature[i, :, j] += across[s]
            curvature[j, :, i] += across[s].T
            slope[i] += down[s]
    return _System(
        points=points,
        spans=float(unlike @ unlike) / 2,
        pairs=pairs,
        seen=visible,
        unseen=neighbours - visible,
        share=share,
        views=count,
        curvature=curvature.reshape(2 * count, 2 * count),
        slope=slope.ravel(),
    )
