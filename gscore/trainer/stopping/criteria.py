"""Stopping criteria before the last step: a target PSNR, or a PSNR plateau."""

import math
from typing import Any

import numpy as np

from ...config import TrainConfig
from ...metrics.evaluate import target_picture
from ...metrics.image import psnr
from ..evaluation import Evaluator
from ..model.checkpoint_schema import as_int, as_measurements
from ..trainer import Trainer

_MEASURES = 40
"""Approximate number of measurements in a run."""
_FEWEST, _MOST = 25, 500
"""Limits of the steps between two measurements."""
_VIEWS = 16
"""Most views that are measured."""
_WINDOW = 0.15
"""Share of the run within which the PSNR must rise."""
_LEAST_RISE = 0.1
"""Least rise within `_WINDOW`, dB."""
_END_PHASE = 0.2
"""Share of a converged run that remains for its end phase."""


class StoppingCriteria:
    """Measures a run in progress and decides when it may end; deterministic, without a clock."""

    def __init__(self, config: TrainConfig, trainer: Trainer, evaluator: Evaluator) -> None:
        self._config = config
        self._trainer = trainer
        self._evaluator = evaluator
        count = min(len(evaluator.indices), _VIEWS)
        places = np.linspace(0, len(evaluator.indices) - 1, count).round().astype(int)
        self._views = [evaluator.indices[i] for i in places]
        self._measured: list[tuple[int, float]] = []
        """Step and PSNR, dB, of each measurement."""
        self.length = 0
        """Last step of a converged run; 0: not converged."""

    def due(self) -> bool:
        """Return whether to measure after the last step."""
        config = self._config
        if not (config.target_psnr or (config.early_stop and not self.length)):
            return False
        every = min(max(self._trainer.plan.iterations // _MEASURES, _FEWEST), _MOST)
        return self._trainer.steps - (self._measured[-1][0] if self._measured else 0) >= every

    def measure(self) -> float:
        """Measure the mean PSNR over the views, dB, unmasked pixels only."""
        trainer, values = self._trainer, []
        trainer.engine.release()
        photos, background = trainer.photos, trainer.renderer.background
        for view in self._views:
            photo, mask = photos.image(view), photos.mask(view)
            target, weights = target_picture(photo, mask, photos.mask_mode, background)
            if weights is None or weights.any():
                values.append(psnr(self._evaluator.picture(view), target, mask=weights))
        mean = float(np.mean(values)) if values else math.nan
        self._measured.append((trainer.steps, mean))
        return mean

    def reached(self) -> bool:
        """Return whether the last measurement reaches the target PSNR."""
        target = self._config.target_psnr
        return bool(target and self._measured and self._measured[-1][1] >= target)

    def converged(self) -> bool:
        """Return whether the PSNR has just stopped rising; sets `length`."""
        if not self._config.early_stop or self.length or not self._measured:
            return False
        step, plan = self._measured[-1][0], self._trainer.plan
        if plan.factor_at(step) > 1:  # larger photos still add detail
            return False
        since = step - _WINDOW * plan.iterations
        before = [value for at, value in self._measured if at <= since]
        recent = [value for at, value in self._measured if at > since]
        if not before or max(recent) - max(before) >= _LEAST_RISE:
            return False
        self.length = min(round(step / (1 - _END_PHASE)), plan.iterations)
        return True

    def state(self) -> dict[str, Any]:
        """State for `restore`, as JSON values."""
        return {"found": self._measured, "length": self.length}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the values of `state`; ValueError or KeyError if they are invalid."""
        self._measured = as_measurements("found", state["found"])
        self.length = as_int("length", state["length"]) if self._config.early_stop else 0
