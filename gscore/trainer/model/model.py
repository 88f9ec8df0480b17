"""Model in training: parameters, Adam moments and per-splat counters, kept in the same rows."""

from collections.abc import Callable, Mapping
from enum import Enum, auto
from typing import NamedTuple

import torch

from ...raster import adam
from ...raster.memory import zeros
from ...raster.request import Frustum
from ...splats import PARAMETERS

_SEEN, _LAG = "shN_seen", "shN_lag"


class ShUpdate(Enum):
    """What the higher SH coefficients do in a step of the others."""

    STEP = auto()
    ACCUMULATE = auto()
    """Their gradients add up for a later step."""
    OFF = auto()
    """They are not in use: as if there were none."""


class Moments(NamedTuple):
    """What Adam keeps for a parameter."""

    first: torch.Tensor
    second: torch.Tensor
    steps: int
    """Taken so far."""
    gathered: torch.Tensor | None = None
    """Gradients that have added up for its next step; None: none."""


class Model:
    """N splats with everything that is kept for each of them.

    Rows are added, removed and overwritten by `strategy.ops` only, so that parameters, moments and
    counters cannot get out of step. SH coefficients are stored up to the degree in use.

    Rows of shN, three quarters of all numbers, take Adam's steps late: one that got no gradient
    waits until a view may show it or somebody asks, and then makes up for all steps at once. So
    `params["shN"]` holds what a rasterizer should see only after `settle` or `settle_for`, or in
    `settled`.
    """

    def __init__(
        self, tensors: Mapping[str, torch.Tensor], moments: Mapping[str, Moments] | None = None
    ) -> None:
        """Take over raw float32 tensors as in `Splats` and their moments; None: zero ones."""
        self.params: dict[str, torch.Tensor] = {}
        self.grads: dict[str, torch.Tensor] = {}
        """Where gradients go, as `params`. Those of shN are added up until it takes a step."""
        n = len(tensors["means"])
        self.rows: dict[str, torch.Tensor] = {
            name: zeros(n, dtype=torch.uint8) for name in (_SEEN, _LAG)
        }
        """[N] counters: those of the strategy, float32, and which rows of shN wait, uint8."""
        self.drift = zeros(adam.LAGS, dtype=torch.float64)
        """What a row of shN that waits has to make up for, by number of steps."""
        self._moments: dict[str, tuple[torch.Tensor, torch.Tensor]] = {}
        self._steps: dict[str, int] = dict.fromkeys(PARAMETERS, 0)
        self._rates: dict[str, float] = dict.fromkeys(PARAMETERS, 0.0)
        self._settled: dict[str, torch.Tensor] | None = None
        for name in PARAMETERS:
            value = tensors[name].detach()
            if moments is None:
                self.replace(name, value, torch.zeros_like(value), torch.zeros_like(value))
            else:
                first, second, steps, gathered = moments[name]
                self.replace(name, value, first, second, grad=gathered, steps=steps)

    def __len__(self) -> int:
        return len(self.params["means"])

    @property
    def sh_degree(self) -> int:
        """Degree of the SH coefficients stored, 0 to 3."""
        return round((self.params["shN"].shape[1] + 1) ** 0.5) - 1

    def moments(self, name: str) -> tuple[torch.Tensor, torch.Tensor]:
        """First and second moment of a parameter, same shape."""
        return self._moments[name]

    def steps(self, name: str) -> int:
        """Adam steps that a parameter has taken."""
        return self._steps[name]

    def replace(
        self,
        name: str,
        value: torch.Tensor,
        moment1: torch.Tensor,
        moment2: torch.Tensor,
        *,
        grad: torch.Tensor | None = None,
        steps: int | None = None,
    ) -> None:
        """Put another tensor, with its moments, in the place of a parameter.

        `grad` is what has gathered of its gradient; None: nothing.
        """
        self.params[name] = value.detach().contiguous()
        self._moments[name] = moment1.contiguous(), moment2.contiguous()
        self.grads[name] = torch.zeros_like(value) if grad is None else grad.contiguous()
        self._steps[name] = self._steps[name] if steps is None else steps
        self._settled = None

    def rebuild(
        self,
        name: str,
        of_value: Callable[[torch.Tensor], torch.Tensor],
        of_rest: Callable[[torch.Tensor], torch.Tensor],
    ) -> None:
        """Put what functions make of them in the places of a parameter and of its moments and
        gathered gradient: one after the other, so that no more than one is there twice."""
        self.params[name] = of_value(self.params[name]).contiguous()
        first, second = self._moments.pop(name)
        first = of_rest(first).contiguous()
        second = of_rest(second).contiguous()
        self._moments[name] = first, second
        self.grads[name] = of_rest(self.grads[name]).contiguous()
        self._settled = None

    def set_rates(self, rates: Mapping[str, float]) -> None:
        """Set learning rates by parameter name."""
        self._rates = dict(rates)

    def step(
        self,
        radii: torch.Tensor | None = None,
        *,
        shN: ShUpdate = ShUpdate.STEP,
        photos: int = 1,
        threads: int = 0,
    ) -> int:
        """One Adam step with `grads`; rows of those that are not finite count as zero.

        Args:
            radii: [N] int32, above 0 where the view showed a splat; None: everywhere.
            shN: What the higher SH coefficients do.
            photos: Whose gradients `grads` are the mean of: steps are counted in photos, and
                momentum fades as it would in so many steps. Higher SH coefficients, whose
                gradients gather anyway, count their own steps.
            threads: 0: all cores.

        Returns:
            Number of splats whose gradients were not finite.
        """
        if len(self) == 0:
            return 0
        slots = []
        for name in PARAMETERS:
            does = shN if name == "shN" else ShUpdate.STEP
            if does is ShUpdate.OFF or self.params[name].numel() == 0:
                continue
            at_once = 1 if name == "shN" else photos
            self._steps[name] += at_once if does is ShUpdate.STEP else 0
            slots.append(self._slot(name, wait=does is ShUpdate.ACCUMULATE, photos=at_once))
        self._settled = None
        return adam.step(slots, radii, threads=threads)

    def sync_visible(self, view: Frustum, *, threads: int = 0) -> None:
        """Let the rows that `view` may show make up for the steps they skipped."""
        self._settled = None  # a step follows: nobody looks at them again
        self._catch_up(view, threads=threads)

    def sync(self, *, threads: int = 0) -> None:
        """Let all rows make up for the steps they skipped, so that they may be moved about."""
        self._settled = None
        self._catch_up(None, threads=threads)

    def synced(self, *, threads: int = 0) -> dict[str, torch.Tensor]:
        """The parameters as `settle` would leave them, which this does not do: looking at a model
        changes no bit of its training."""
        if self._settled is None:
            shN = self.params["shN"]
            if self._waiting():
                shN = torch.empty_like(shN)
                self._catch_up(None, out=shN, threads=threads)
            self._settled = self.params | {"shN": shN}
        return self._settled

    def synced_rows(self, rows: slice, *, threads: int = 0) -> dict[str, torch.Tensor]:
        """Some rows of what `settled` returns, without the memory that all of them take."""
        if self._settled is not None:
            return {name: p[rows] for name, p in self._settled.items()}
        params = {name: p[rows] for name, p in self.params.items()}
        if self._waiting():
            out = torch.empty_like(params["shN"])
            slot = self._slot("shN", wait=False, rows=rows)
            adam.catch_up(slot, params, None, out=out, threads=threads)
            params["shN"] = out
        return params

    def drop_moments(self) -> None:
        """Forget what only further steps need: moments and gradients. Settle before."""
        self._moments.clear()
        self.grads.clear()

    def _waiting(self) -> bool:
        return bool(self.rows[_LAG].any()) and self.params["shN"].numel() > 0

    def _catch_up(
        self, view: Frustum | None, *, out: torch.Tensor | None = None, threads: int
    ) -> None:
        if self._waiting():
            slot = self._slot("shN", wait=False)
            adam.catch_up(slot, self.params, view, out=out, threads=threads)

    def _slot(
        self, name: str, *, wait: bool, rows: slice = slice(None), photos: int = 1
    ) -> adam.Slot:
        skips = None
        if name == "shN":
            skips = adam.Skips(self.rows[_SEEN][rows], self.rows[_LAG][rows], self.drift, wait)
        first, second = self._moments[name]
        return adam.Slot(
            self.params[name][rows],
            self.grads[name][rows],
            first[rows],
            second[rows],
            rate=self._rates[name],
            step=self._steps[name],
            skips=skips,
            photos=photos,
        )
