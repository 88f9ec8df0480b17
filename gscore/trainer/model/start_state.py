"""Start state: what a run starts from besides its options; equal on all ranks."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...formats import Decoded
from .training_frame import TrainingFrame, checkpoint_origin


@dataclass(frozen=True, kw_only=True)
class StartState:
    """Facts of a checkpoint, if any, and start splats."""

    taken: int = 0
    """Steps that a resumed run has already taken."""
    stereo: bool = True
    """Whether to compute start points by stereo."""
    frame: dict[str, Any] | None = None
    """Training frame of the checkpoint, as `TrainingFrame.to_dict`; None: fit a new one."""
    splats: Decoded | None = None
    """Start splats, COLMAP world; None: start from points."""

    @property
    def origin(self) -> np.ndarray | None:
        """Local origin of the checkpoint, zeros if it has none; else that of the start splats, so
        that consecutive models share their origin; None: neither."""
        if self.frame is not None:
            return checkpoint_origin(self.frame)
        return None if self.splats is None else self.splats.origin

    @property
    def training_frame(self) -> TrainingFrame | None:
        """The training frame of the checkpoint; None: fit a new one.

        Raises:
            ValueError, KeyError: it is invalid.
        """
        return None if self.frame is None else TrainingFrame.from_dict(self.frame)
