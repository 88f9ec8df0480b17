"""Gains of held-out photos, predicted from those of the training photos; never from own pixels."""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from ...camera_neighbours import natural_key
from .photo_gains import STOP

_NEIGHBOURS = 4
"""Number of nearest training cameras of the mean in place."""
_SOFT = 1e-3
"""Distance that limits the weights of that mean, in camera extents."""


class _WeightedMean(NamedTuple):
    """Weighted mean of some training photos for each of V photos."""

    places: np.ndarray
    """[V, K] int64: places in the list of training views."""
    weights: np.ndarray
    """[V, K] float64, each row adds up to 1, or to 0 without neighbours."""

    @classmethod
    def of(cls, places: np.ndarray, weights: np.ndarray) -> Self:
        """Return the mean with these weights, not normalised."""
        return cls(places, weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-30))

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Return the means, [V, 3], of the values of the training photos, [T, 3]."""
        return (values[self.places] * self.weights[..., None]).sum(axis=1)


class HeldOutGains:
    """Linear prediction of a photo's ln gain from up to three values, shared by all channels:

    - the mean of the previous and the next training photo in the order of names, which is the order
      in time of photos of most cameras and of frames of videos,
    - the mean of the nearest training cameras, weighted by inverse distance,
    - the exposure stated by EXIF.

    The weights are non-negative least squares over the training photos, each of which is left out
    of its own means: where gains are unrelated, weights and prediction go to zero, the mean
    exposure.
    """

    def __init__(
        self,
        names: Sequence[str],
        centers: np.ndarray,
        train: Sequence[int],
        *,
        stops: np.ndarray | None = None,
    ) -> None:
        """Note the V photos; their neighbours are found when they are needed.

        Args:
            names: Names of the photos.
            centers: [V, 3] camera positions, any unit.
            train: Training views, at least one.
            stops: [V] exposures by EXIF, stops; None or some NaN: unknown, not used.
        """
        self._names, self._centers = names, centers
        self._train = np.array(train, np.int64)
        self._stated = None
        if stops is not None and np.isfinite(stops).all():
            self._stated = STOP * (stops - stops[self._train].mean())

    @cached_property
    def _means(self) -> tuple[_WeightedMean, _WeightedMean]:
        order = sorted(range(len(self._names)), key=lambda index: natural_key(self._names[index]))
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        return _in_order(rank, self._train), _in_place(self._centers, self._train)

    def predict(self, log_gains: np.ndarray) -> np.ndarray:
        """Return ln gains of all photos, [V, 3] float64.

        Args:
            log_gains: [V, 3] ln gains, zero on average over the training photos; those of others
                are ignored.
        """
        from scipy.optimize import nnls

        known = log_gains[self._train]
        values = [mean(known) for mean in self._means]
        if self._stated is not None:
            values.append(np.repeat(self._stated[:, None], 3, axis=1))
        table = np.stack(values, axis=-1)
        weights, _ = nnls(table[self._train].reshape(-1, len(values)), known.ravel())
        return table @ weights


def _in_order(rank: np.ndarray, train: np.ndarray) -> _WeightedMean:
    """Mean of the previous and the next training photo in the order of `rank`."""
    order = np.argsort(rank[train])
    ranks = rank[train][order]
    places = np.stack(
        [np.searchsorted(ranks, rank) - 1, np.searchsorted(ranks, rank, side="right")], axis=1
    )
    there = (places >= 0) & (places < len(train))
    return _WeightedMean.of(order[np.clip(places, 0, len(train) - 1)], there.astype(np.float64))


def _in_place(centers: np.ndarray, train: np.ndarray) -> _WeightedMean:
    """Mean of the nearest training cameras, by inverse distance."""
    count = min(_NEIGHBOURS, len(train))
    size = max(float(np.ptp(centers, axis=0).max()), 1e-30)
    places = np.empty((len(centers), count), np.int64)
    weights = np.empty((len(centers), count))
    for row, center in enumerate(centers):
        distance = np.linalg.norm(centers[train] - center, axis=1) / size
        distance[train == row] = np.inf
        places[row] = np.argsort(distance, kind="stable")[:count]
        weights[row] = 1.0 / (distance[places[row]] + _SOFT)
    return _WeightedMean.of(places, weights)
