"""Transients: masks of what only single training photos show, found with the model."""

from collections.abc import Mapping, Sequence

import numpy as np

from ...events import Decision
from ...quoting import first_few
from ...text_format import count_text
from ..model.checkpoint_schema import as_int
from .transient_search import Residual, find_transients, nearest_cells

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
        self._last = 0
        """Step after which the transients were found; 0: they were not."""

    @property
    def shares(self) -> dict[int, float]:
        """Masked share of each photo that has transients."""
        return {index: float(mask.mean()) for index, mask in self._masks.items()}

    @property
    def version(self) -> int:
        """Another number for other masks."""
        return self._last

    def of(self, index: int, width: int, height: int) -> np.ndarray | None:
        """Mask of photo `index` at a size, [height, width] uint8, 0: masked; None: none."""
        mask = self._masks.get(index)
        if mask is None:
            return None
        rows, columns = nearest_cells(height, mask.shape[0]), nearest_cells(width, mask.shape[1])
        return np.where(mask[np.ix_(rows, columns)], np.uint8(0), np.uint8(255))

    def due(self, planned: Sequence[int], step: int) -> bool:
        """Return whether to measure the photos after `step`, by the steps planned for that."""
        is_planned = any(self._last < one <= step for one in planned)
        return len(self.train) >= _FEWEST and is_planned

    def note(self, residuals: Mapping[int, Residual], step: int) -> None:
        """Replace the masks by those found in the residuals after `step`."""
        self._masks, self._last = find_transients(residuals), step

    def decision(self, names: Sequence[str]) -> Decision | None:
        """Sentences on the photos that are masked; None: there are none."""
        shares = self.shares
        if not shares:
            return None
        order = sorted(shares, key=shares.__getitem__, reverse=True)
        named = first_few([names[i] for i in order], _NAMED)
        show = count_text(len(shares), "training photo shows", "training photos show")
        return Decision(
            "transients",
            f"{show} what others do not show there, such as people or shadows, in up to "
            f"{100 * shares[order[0]]:.0f} % of a photo: {named}. These parts are left out. "
            "`--no-transient-masks` trains on them.",
        )

    def arrays(self) -> dict[str, np.ndarray]:
        """State by name; no copies."""
        if not self._last:
            return {}
        packed = [np.packbits(mask) for mask in self._masks.values()]
        photos = [(index, *mask.shape) for index, mask in self._masks.items()]
        return {
            f"{_NAME}/step": np.array([self._last], np.int64),
            f"{_NAME}/photos": np.array(photos, np.int64).reshape(-1, 3),
            f"{_NAME}/masks": np.concatenate(packed) if packed else np.zeros(0, np.uint8),
        }

    def restore(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restore the state that `arrays` returned.

        Raises:
            ValueError, KeyError: the arrays are invalid.
        """
        self._masks, self._last = {}, 0
        if f"{_NAME}/step" not in arrays:
            return
        (last,), photos = arrays[f"{_NAME}/step"].tolist(), arrays[f"{_NAME}/photos"].tolist()
        packed, masks, at = arrays[f"{_NAME}/masks"], {}, 0
        if not {index for index, _, _ in photos} <= set(self.train):
            raise ValueError(f"{_NAME}/photos are not training photos")
        for index, height, width in photos:
            count = -(-width * height // 8)
            bits = np.unpackbits(packed[at : at + count], count=width * height)
            masks[index], at = bits.reshape(height, width).astype(bool), at + count
        if at != len(packed):
            raise ValueError(f"{_NAME}/masks has {len(packed)} bytes, expected {at}")
        self._masks, self._last = masks, as_int(f"{_NAME}/step", last, low=1)
