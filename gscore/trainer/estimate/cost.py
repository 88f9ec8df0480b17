"""Cost model of training steps: seconds on a reference machine."""

import math
import os
from functools import cached_property
from itertools import accumulate

from ...engine.base import CostModel
from ...engine.cpu.pace import COST
from ..schedule.plan import Plan

_SECONDS_A_POINT = 2e-6
"""Seconds per SfM point to read it and to look for its neighbours."""
_SECONDS_A_PHOTO_PIXEL = 1.5e-8
"""Seconds per stored pixel to decode JPEG photos and reduce them, on one core."""
_GROWTH = 0.5
"""Largest expected growth of `default` at a refinement, relative to the number of splats."""
_LATER_GROWTH = 2.2e-4
"""Expected growth at the first refinement, times `grow_grad`; at the k-th it is k^-1.15 of that.
Fitted to trainings with all presets (docs/benchmarks.md, "Captures")."""
_SURFACE = 2.3
"""Time of a step with the surface term, which draws a second picture, relative to one without:
drafts of the studio take 173 instead of 110 s of processor time, with the term in 30 % of steps."""
_SAMPLES = 64
"""Most steps that are evaluated to predict the rest of a run."""


def reading_seconds(points: int, pixels: int, threads: int) -> float:
    """Predicted seconds until the first step, on the reference machine.

    Args:
        points: Number of SfM points.
        pixels: Number of pixels of all photos as stored, in the time of JPEG
            (`Dataset.decoding_pixels`).
        threads: Number of photos that are decoded at once; 0: one per core.
    """
    at_once = threads or os.cpu_count() or 1
    return _SECONDS_A_POINT * points + _SECONDS_A_PHOTO_PIXEL * pixels / at_once


class Cost:
    """Predicted seconds and number of splats of a run that follows a plan."""

    def __init__(self, plan: Plan, model: CostModel = COST) -> None:
        """`model`: seconds of a step of the engine that follows the plan."""
        self.plan = plan
        self.model = model

    def seconds_at(self, step: int, splats: float) -> float:
        """Seconds of `step` on the reference machine, with `splats` in all models together.

        Other machines differ by a factor that is about the same for all steps.
        """
        plan = self.plan
        drawn = plan.pixels / plan.factor_at(step) ** 2
        one = self.model.seconds(splats, plan.sh_degree_at(step), drawn, plan.models)
        return _SURFACE * one if step > plan.surface_after else one

    def seconds_after(self, step: int, splats: int) -> float:
        """Seconds of the steps after `step`, which ends with `splats`, on the reference machine."""
        plan = self.plan
        left = plan.iterations - step
        if left <= 0:
            return 0.0
        count = min(left, _SAMPLES)
        total = 0.0
        for i in range(count):
            later = step + 1 + int((i + 0.5) * left / count)
            later = min(later, plan.iterations)
            total += self.seconds_at(later, self.splats_at(later, step, splats))
        return total * left / count

    def splats_at(self, later: int, step: int, splats: int) -> float:
        """Expected number of splats before step `later`, with `splats` after `step`."""
        plan = self.plan
        kept = plan.kept if step < plan.refine_stop < later else 1.0
        first = max(step + 1, plan.refine_start)
        last = min(later - 1, plan.refine_stop)
        last -= last % plan.refine_every
        cap = plan.models * plan.cap_for(plan.factor_at(last))
        if last < first or splats >= cap:
            return kept * splats
        before, there = self._refinements(first - 1), self._refinements(last)
        grown = math.log(max(splats, 1)) + self._growths[there] - self._growths[before]
        return kept * min(math.exp(min(grown, 50.0)), cap)

    def _refinements(self, step: int) -> int:
        """Number of refinements up to `step`."""
        plan = self.plan
        return max(step // plan.refine_every - (plan.refine_start - 1) // plan.refine_every, 0)

    @cached_property
    def _growths(self) -> list[float]:
        """Logarithm of the expected growth factor after 0, 1, 2, ... refinements, uncapped."""
        plan = self.plan
        count = self._refinements(min(plan.refine_stop, plan.iterations))
        later = _LATER_GROWTH / plan.grow_grad if plan.grow_grad else _GROWTH
        growths = (plan.mcmc_growth or min(_GROWTH, later * k**-1.15) for k in range(1, count + 1))
        return [0.0, *accumulate(math.log1p(growth) for growth in growths)]
