"""Photo Adam: Adam for the parameters of photos, updated one photo at a time."""

from collections.abc import Mapping, Sequence

import numpy as np

from ...shared_constants import ADAM_BETA1, ADAM_BETA2, ADAM_EPS
from ..model.checkpoint_schema import as_int


def rate_at(first: float, last: float, done: float) -> float:
    """Learning rate after the share `done` of a schedule: exponential from `first` to `last`; 0 if
    either is 0."""
    if first <= 0 or last <= 0:
        return 0.0
    return first * (last / first) ** min(done, 1.0)


_BETAS = ADAM_BETA1, ADAM_BETA2
_SHARES = np.array([[1 - beta] for beta in _BETAS])
"""Share of a gradient in the mean of gradients, and of its square in that of squares."""


class PhotoAdam:
    """Adam with W parameters for each of V views (Kingma and Ba 2015); a step changes the moments
    of one view only."""

    def __init__(self, views: int, width: int) -> None:
        self._moments = np.zeros((2, views, width))
        self._steps = np.zeros(views, np.int64)

    def step(self, index: int, grad: np.ndarray, rate: float) -> np.ndarray:
        """[W]: update of the parameters of view `index` for the gradient `grad`."""
        self._steps[index] += 1
        count = int(self._steps[index])
        moments = self._moments[:, index]
        moments += _SHARES * (np.array([grad, grad * grad]) - moments)
        mean, square = moments / [[1 - beta**count] for beta in _BETAS]
        return -rate * mean / (np.sqrt(square) + ADAM_EPS)

    def arrays(self, name: str) -> dict[str, np.ndarray]:
        """State, names prefixed by `name`; no copies."""
        return {f"{name}/moments": self._moments, f"{name}/steps": self._steps}

    def restore(self, name: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Restore the state that `arrays` returned.

        Raises:
            ValueError, KeyError: the arrays are invalid.
        """
        self._moments = checked_array(f"{name}/moments", arrays, self._moments.shape)
        steps = arrays[f"{name}/steps"].tolist()
        if not isinstance(steps, list) or len(steps) != len(self._steps):
            raise ValueError(f"{name}/steps does not have one number per view")
        self._steps = np.array([as_int(f"{name}/steps", count) for count in steps], np.int64)


def checked_array(name: str, arrays: Mapping[str, np.ndarray], shape: Sequence[int]) -> np.ndarray:
    """Return a copy of a float64 array; ValueError unless it is finite and has this shape."""
    found = arrays[name]
    if found.shape != tuple(shape) or found.dtype != np.float64:
        raise ValueError(f"{name} is {found.dtype} {list(found.shape)}, expected {list(shape)}")
    if not np.isfinite(found).all():
        raise ValueError(f"{name} is not finite")
    return found.copy()
