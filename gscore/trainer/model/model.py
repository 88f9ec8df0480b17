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
    """Update of shN in a training step."""

    STEP = auto()
    ACCUMULATE = auto()
    """Gradients accumulate for a later step."""
    OFF = auto()
    """The coefficients are not in use yet."""


class Moments(NamedTuple):
    """Adam state of a parameter."""

    first: torch.Tensor
    second: torch.Tensor
    steps: int
    """Number of Adam steps so far."""
    gathered: torch.Tensor | None = None
    """Accumulated gradients for the next step; None: zeros."""


class Model:
    """N splats with their parameters, gradients, Adam moments and counters.

    Rows are added, removed and overwritten by `strategy.row_ops` only, so that parameters, moments
    and counters stay aligned. SH coefficients are stored up to the degree in use.

    Rows of shN, three quarters of all numbers, use lazy Adam: a row that receives no gradient is
    pending until a view may show it or it is read, and then catches up on all skipped steps. So
    `params["shN"]` is current only after `sync` or, for a view, `sync_visible`; `synced` returns
    current parameters.
    """

    def __init__(
        self, tensors: Mapping[str, torch.Tensor], moments: Mapping[str, Moments] | None = None
    ) -> None:
        """Take ownership of raw float32 tensors as in `Splats` and of `moments`; None: zeros."""
        self.params: dict[str, torch.Tensor] = {}
        self.grads: dict[str, torch.Tensor] = {}
        """Gradients, shaped as `params`. Those of shN accumulate until its next step."""
        n = len(tensors["means"])
        self.rows: dict[str, torch.Tensor] = {
            name: zeros(n, dtype=torch.uint8) for name in (_SEEN, _LAG)
        }
        """[N] counters: those of the strategy, float32, and pending steps of shN rows, uint8."""
        self.drift = zeros(adam.LAGS, dtype=torch.float64)
        """Factor of the pending update of a shN row, by number of skipped steps."""
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
        """Replace a parameter and its moments.

        `grad` is its accumulated gradient; None: zeros.
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
        """Apply functions to a parameter, and to its moments and accumulated gradient: one tensor
        after another, so that no more than one exists twice."""
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
        """Take an Adam step with `grads`; gradients that are not finite count as zero.

        Args:
            radii: [N] int32, above 0 for visible splats; None: all.
            shN: Update of shN.
            photos: Number of photos averaged in `grads`: steps are counted in photos, and momentum
                decays as in that number of steps. shN, which accumulates gradients anyway, counts
                its own steps.
            threads: 0: all cores.

        Returns:
            Number of splats with gradients that were not finite.
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
        """Apply the pending steps of rows that `view` may show."""
        self._settled = None  # a step follows, so the cached copy is not read again
        self._catch_up(view, threads=threads)

    def sync(self, *, threads: int = 0) -> None:
        """Apply the pending steps of all rows, for example before rows are reordered."""
        self._settled = None
        self._catch_up(None, threads=threads)

    def synced(self, *, threads: int = 0) -> dict[str, torch.Tensor]:
        """Return the parameters as after `sync` without changing the model, so that rendering
        changes no bit of the training."""
        if self._settled is None:
            shN = self.params["shN"]
            if self._waiting():
                shN = torch.empty_like(shN)
                self._catch_up(None, out=shN, threads=threads)
            self._settled = self.params | {"shN": shN}
        return self._settled

    def synced_rows(self, rows: slice, *, threads: int = 0) -> dict[str, torch.Tensor]:
        """Return some rows of `synced`, without the memory for all."""
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
        """Free moments and gradients, which only further steps need. Call `sync` first."""
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
