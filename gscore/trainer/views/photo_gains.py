"""Photo gains: exposure and white balance of each photo as optimised factors by channel.

The rendered image with the photo's gain is compared with the photo. Gains are those of encoded
values (`gscore.photo_exposure`): a change of exposure by s stops is 2^(s / 2.4), and white balance
a gain by channel. A gain is stored as three coefficients of `_BASIS`, so that Adam changes the
exposure, the largest difference between photos, along one axis.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from ...camera_neighbours import natural_key
from ...engine.base import Color
from ...shared_constants import EXPOSURE_POWER
from .photo_adam import PhotoAdam, checked_array

STOP = math.log(2.0) / EXPOSURE_POWER
"""ln of the gain of one stop, in encoded values."""
_BASIS = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, -1.0], [-0.5, 1.0, -0.5]])
"""Rows: ln gain of R, G and B by exposure, by warmth and by green; orthogonal."""
_NAME = "gain"
"""Prefix of the arrays in checkpoints."""
_FIXED = f"{_NAME}/fixed"
"""Array that marks fixed gains."""


class PhotoGains:
    """Gains of the training photos; those of held-out photos are predicted, see `HeldOutGains`.

    Their geometric mean over the training photos is one after every step: otherwise splats could
    become darker and all gains larger, and the exposure of new views would be undefined.
    """

    def __init__(self, train: Sequence[int], log_gains: np.ndarray, *, fixed: bool = False) -> None:
        """Create the gains.

        Args:
            train: Training views.
            log_gains: [V, 3] float64, initial ln gain of R, G, B of all views; only those of
                `train` are used.
            fixed: Whether the gains stay as they are; their mean is then that of another run.
        """
        self.fixed = fixed
        self.train = np.array(train, np.int64)
        """[T] training views."""
        self._trained = frozenset(train)
        self._value = np.zeros_like(log_gains)
        self._value[self.train] = log_gains[self.train] @ np.linalg.inv(_BASIS)
        self._adam = PhotoAdam(len(log_gains), 3)
        self._centre()

    def __contains__(self, index: int) -> bool:
        """Return whether view `index` is a training view."""
        return index in self._trained

    @property
    def log_gains(self) -> np.ndarray:
        """[V, 3] float64: ln gain of R, G, B of each view."""
        return self._value @ _BASIS

    def of(self, index: int) -> Color:
        """Gain of training view `index`, rounded to float32."""
        return as_gain(self._value[index] @ _BASIS)

    def learn(self, index: int, v_log_gain: Sequence[float], rate: float) -> None:
        """Adam step for the gain of one photo; then all gains are centred.

        Args:
            index: Training view.
            v_log_gain: Derivative of the loss in ln gain of R, G, B; skipped unless finite.
            rate: Learning rate.
        """
        grad = _BASIS @ np.asarray(v_log_gain, np.float64)
        if np.isfinite(grad).all() and not self.fixed:
            self._value[index] += self._adam.step(index, grad, rate)
            self._centre()

    def arrays(self) -> dict[str, np.ndarray]:
        """State by name; no copies."""
        out = {f"{_NAME}/value": self._value} | self._adam.arrays(_NAME)
        # exposure.json of the start splats may be gone when the run is resumed.
        return out | ({_FIXED: np.ones(1, np.uint8)} if self.fixed else {})

    @staticmethod
    def are_in(arrays: Mapping[str, np.ndarray]) -> bool:
        """Return whether a checkpoint has gains."""
        return f"{_NAME}/value" in arrays

    @classmethod
    def restored(
        cls,
        train: Sequence[int],
        views: int,
        arrays: Mapping[str, np.ndarray],
        *,
        fixed: bool = False,
    ) -> "PhotoGains":
        """Restore the gains of `views` photos from the arrays of a checkpoint; `fixed`: also fix
        those of a checkpoint from before it recorded that.

        Raises:
            ValueError, KeyError: the arrays are invalid.
        """
        out = cls(train, np.zeros((views, 3)), fixed=fixed or _FIXED in arrays)
        out._value = checked_array(f"{_NAME}/value", arrays, (views, 3))
        out._adam.restore(_NAME, arrays)
        return out

    def _centre(self) -> None:
        if self.fixed:
            return
        values = self._value[self.train]
        self._value[self.train] = values - values.mean(axis=0)


def as_gain(log_gain: np.ndarray) -> Color:
    """Gain of an ln gain [3], rounded to float32."""
    r, g, b = np.exp(log_gain).astype(np.float32).tolist()
    return (r, g, b)


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
