"""Transients: masks of what only single training photos show, found with the model."""

from collections.abc import Mapping, Sequence

import numpy as np

from ...events import Decision
from ...quoting import first_few
from ...text_format import count_text
from ..model.checkpoint_schema import as_int
from .transient_search import MOST_CELLS, Residual, find_transients, nearest_cells

_NAME = "transient"
"""Prefix of the arrays in checkpoints."""
_FEWEST = 8
"""Photos from which others tell what is usual."""
_NAMED = 8
"""Photos that the decision names."""


class Transients:
    """Masks of the transients of training photos; none until they are measured."""

    def __init__(self, train: Sequence[int]) -> None:
        """Create no masks of views `train`."""
        self.train = list(train)
        self._masks: dict[int, np.ndarray] = {}
        self._packed = np.zeros(0, np.uint8)
        self.step = 0
        """Step after which the transients were found; 0: they were not."""

    @property
    def shares(self) -> dict[int, float]:
        """Masked share of each photo that has transients."""
        return {index: float(mask.mean()) for index, mask in self._masks.items()}

    def of(self, index: int, width: int, height: int) -> np.ndarray | None:
        """Mask of photo `index` at a size, [height, width] uint8, 0: masked; None: none."""
        mask = self._masks.get(index)
        if mask is None:
            return None
        shown = np.where(mask, np.uint8(0), np.uint8(255))
        rows, columns = nearest_cells(height, mask.shape[0]), nearest_cells(width, mask.shape[1])
        return np.ascontiguousarray(shown[:, columns][rows])

    def due(self, planned: Sequence[int], step: int) -> bool:
        """Return whether to measure the photos after `step`, by the steps planned for that: the
        later ones only if there are transients."""
        is_planned = any(self.step < one <= step for one in planned)
        may_be = bool(self._masks) or self.step < planned[1]
        return len(self.train) >= _FEWEST and is_planned and may_be

    def note(self, residuals: Mapping[int, Residual], step: int) -> None:
        """Replace the masks by those found in the residuals after `step`."""
        self._use(find_transients(residuals), step)

    def decision(self, names: Sequence[str]) -> Decision | None:
        """Sentences on the photos that are masked; None: there are none."""
        shares = self.shares
        if not shares:
            return None
        order = sorted(shares, key=shares.__getitem__, reverse=True)
        named = first_few([names[i] for i in order], _NAMED)
        have = count_text(len(shares), "training photo has", "training photos have")
        return Decision(
            "transients",
            f"{have} parts that other photos contradict (people, cars, shadows), up to "
            f"{100 * shares[order[0]]:.0f} % of a photo: {named}. These parts are left out, and "
            "the report shows them. `--no-transient-masks` trains on them.",
        )

    def arrays(self) -> dict[str, np.ndarray]:
        """State by name."""
        if not self.step:
            return {}
        photos = [(index, *mask.shape) for index, mask in self._masks.items()]
        return {
            f"{_NAME}/step": np.array([self.step], np.int64),
            f"{_NAME}/photos": np.array(photos, np.int64).reshape(-1, 3),
            f"{_NAME}/masks": self._packed,
        }

    def _use(self, masks: dict[int, np.ndarray], step: int) -> None:
        self._masks, self.step = masks, step
        packed = [np.packbits(mask) for mask in masks.values()]
        self._packed = np.concatenate(packed) if packed else np.zeros(0, np.uint8)

    def restore(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restore the state that `arrays` returned.

        Raises:
            ValueError, KeyError: the arrays are invalid.
        """
        self._use({}, 0)
        if f"{_NAME}/step" not in arrays:
            return
        step, photos = arrays[f"{_NAME}/step"], arrays[f"{_NAME}/photos"]
        packed, masks, at = arrays[f"{_NAME}/masks"], {}, 0
        shapes = step.shape, photos.shape[1:], packed.ndim
        if shapes != ((1,), (3,), 1) or packed.dtype != np.uint8 or photos.dtype != np.int64:
            raise ValueError(f"{_NAME}/ has arrays of other shapes")
        for index, height, width in photos.tolist():
            sizes = 1 <= height <= MOST_CELLS and 1 <= width <= MOST_CELLS
            if index not in self.train or index in masks or not sizes:
                raise ValueError(f"{_NAME}/photos has another photo or size: {index}")
            count = -(-width * height // 8)
            bits = np.unpackbits(packed[at : at + count], count=width * height)
            masks[index], at = bits.reshape(height, width).astype(bool), at + count
        if at != len(packed):
            raise ValueError(f"{_NAME}/masks has {len(packed)} bytes, expected {at}")
        self._use(masks, as_int(f"{_NAME}/step", step.tolist()[0], low=1))
