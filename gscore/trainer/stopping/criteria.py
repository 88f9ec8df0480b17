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
"""Measurements in a run, about."""
_FEWEST, _MOST = 25, 500
"""Steps between two of them."""
_VIEWS = 16
"""Views that are measured at most."""
_WINDOW = 0.15
"""Share of the run over which the PSNR has to rise."""
_LEAST_RISE = 0.1
"""By how much, dB."""
_END_PHASE = 0.2
"""Share of a run that has converged left to its end phase."""


class StoppingCriteria:
    """Measures a run in progress and says when it may end; the same bits, the same end."""

    def __init__(self, config: TrainConfig, trainer: Trainer, evaluator: Evaluator) -> None:
        self._config = config
        self._trainer = trainer
        self._evaluator = evaluator
        count = min(len(evaluator.indices), _VIEWS)
        places = np.linspace(0, len(evaluator.indices) - 1, count).round().astype(int)
        self._views = [evaluator.indices[i] for i in places]
        self._found: list[tuple[int, float]] = []
        self.length = 0
        """Steps after which a run that has converged ends; 0: it has not."""

    def due(self) -> bool:
        """Whether to measure after the step just taken."""
        config = self._config
        if not (config.target_psnr or (config.early_stop and not self.length)):
            return False
        every = min(max(self._trainer.plan.iterations // _MEASURES, _FEWEST), _MOST)
        return self._trainer.steps - (self._found[-1][0] if self._found else 0) >= every

    def measure(self) -> float:
        """Mean PSNR of the measured views as they are now, dB, of the pixels that count."""
        trainer, values = self._trainer, []
        trainer.make_room()
        photos, background = trainer.photos, trainer.renderer.background
        for view in self._views:
            photo, mask = photos.image(view), photos.mask(view)
            target, weights = target_picture(photo, mask, photos.mask_mode, background)
            if weights is None or weights.any():
                values.append(psnr(self._evaluator.picture(view), target, mask=weights))
        found = float(np.mean(values)) if values else math.nan
        self._found.append((trainer.steps, found))
        return found

    def reached(self) -> bool:
        """Whether the last measurement is as high as was asked for."""
        target = self._config.target_psnr
        return bool(target and self._found and self._found[-1][1] >= target)

    def converged(self) -> bool:
        """Whether the PSNR no longer rises; from then on `length` says when to end."""
        if not self._config.early_stop or self.length or not self._found:
            return False
        step, plan = self._found[-1][0], self._trainer.plan
        if plan.factor_at(step) > 1:  # what larger photos show is still to come
            return False
        since = step - _WINDOW * plan.iterations
        before = [value for at, value in self._found if at <= since]
        lately = [value for at, value in self._found if at > since]
        if not before or max(lately) - max(before) >= _LEAST_RISE:
            return False
        self.length = min(round(step / (1 - _END_PHASE)), plan.iterations)
        return True

    def state(self) -> dict[str, Any]:
        """What a checkpoint keeps, as JSON values; `restore` takes it back."""
        return {"found": self._found, "length": self.length}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from what `state` returned; ValueError or KeyError where it did not."""
        self._found = as_measurements("found", state["found"])
        self.length = as_int("length", state["length"]) if self._config.early_stop else 0
