"""CPU model: parameters, Adam moments and per-splat counters, kept in the same rows."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import torch

from ...morton import cell_order
from ...raster import adam
from ...raster.memory import zeros
from ...raster.request import Frustum
from ...splats import PARAMETERS, SH_REST_BY_DEGREE
from ..base import EngineModel, RowEdit, ShUpdate, column_key
from . import sanitize

LAZY_COUNTERS = _VISIBLE, _PENDING = "shN_visible", "shN_pending"
"""Names of the counters of pending steps, [N] uint8."""
ACCUMULATED = "gathered/shN"
"""Name of the accumulated gradient of shN in checkpoints; other ranks append /1, /2 ..."""


class Moments(NamedTuple):
    """Adam state of a parameter."""

    first: torch.Tensor
    second: torch.Tensor
    steps: int
    """Number of Adam steps so far."""
    accumulated: torch.Tensor | None = None
    """Accumulated gradients for the next step; None: zeros."""


class CpuModel(EngineModel):
    """N splats with their parameters, gradients, Adam moments and counters (`EngineModel`).

    SH coefficients are stored up to the degree in use.

    Rows of shN, three quarters of all numbers, use lazy Adam: a row that receives no gradient is
    pending until a view may show it or it is read, and then catches up on all skipped steps. So
    `params["shN"]` is current only after `sync` or, for a view, `sync_visible`; `synced` returns
    current parameters.
    """

    def __init__(
        self,
        tensors: Mapping[str, torch.Tensor],
        moments: Mapping[str, Moments] | None = None,
        *,
        counters: Sequence[str] = (),
        threads: int = 0,
    ) -> None:
        """Take ownership of raw float32 tensors as in `Splats` and of `moments`; None: zeros.

        `counters`: names of the float32 counters of a strategy; `threads`: 0: all cores.
        """
        self._threads = threads
        self.params: dict[str, torch.Tensor] = {}
        self.grads: dict[str, torch.Tensor] = {}
        """Gradients, shaped as `params`. Those of shN accumulate until its next step."""
        n = len(tensors["means"])
        self.rows: dict[str, torch.Tensor] = {
            name: zeros(n, dtype=torch.uint8) for name in (_VISIBLE, _PENDING)
        } | {name: zeros(n) for name in counters}
        """[N] counters: those of the strategy, float32, and pending steps of shN rows, uint8."""
        self.factors = zeros(adam.PENDING_SIZE, dtype=torch.float64)
        """Factor of the pending update of a shN row, by number of skipped steps."""
        self._moments: dict[str, tuple[torch.Tensor, torch.Tensor]] = {}
        self.adam_steps = dict.fromkeys(PARAMETERS, 0)
        self._rates: dict[str, float] = dict.fromkeys(PARAMETERS, 0.0)
        self._synced: dict[str, torch.Tensor] | None = None
        for name in PARAMETERS:
            value = tensors[name].detach()
            if moments is None:
                self.replace(name, value, torch.zeros_like(value), torch.zeros_like(value))
            else:
                first, second, steps, gathered = moments[name]
                self.replace(name, value, first, second, grad=gathered, steps=steps)

    def __len__(self) -> int:
        return len(self.params["means"])

    def moments(self, name: str) -> tuple[torch.Tensor, torch.Tensor]:
        """First and second moment of a parameter, same shape."""
        return self._moments[name]

    def part(self, begin: int, end: int) -> dict[str, np.ndarray]:
        """Return the raw parameters of some rows, see `EngineModel.part`."""
        return {name: t.numpy() for name, t in self.synced_rows(slice(begin, end)).items()}

    def finish(self) -> None:
        """Apply all pending steps and free moments and gradients."""
        self.sync()
        self.drop_moments()

    def save(self) -> dict[str, np.ndarray]:
        """Return all that the next step depends on, see `EngineModel.save`."""
        out: dict[str, torch.Tensor] = {}
        for name, p in self.params.items():
            out[column_key(name)] = p
            if name in self._moments:
                out[f"m1/{name}"], out[f"m2/{name}"] = self._moments[name]
        if "shN" in self.grads:
            out[ACCUMULATED] = self.grads["shN"]
        out["drift"] = self.factors
        out |= {column_key(name): counter for name, counter in self.rows.items()}
        return {name: t.numpy() for name, t in out.items()}

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
        self.adam_steps[name] = self.adam_steps[name] if steps is None else steps
        self._synced = None

    @property
    def widths(self) -> dict[str, tuple[int, ...]]:
        """Shape of a row of each column, by name."""
        return {name: tuple(t.shape[1:]) for name, t in (self.params | self.rows).items()}

    def column(self, name: str) -> np.ndarray:
        """Return a copy of a parameter or counter, [N, ...], after all pending steps."""
        if name == "shN":
            return self.synced()[name].numpy().copy()
        return self._tensor(name).numpy().copy()

    def gather(self, name: str, rows: np.ndarray) -> np.ndarray:
        """Return some rows, [M] int64, of a parameter or counter, after all pending steps."""
        tensor = self.synced()[name] if name == "shN" else self._tensor(name)
        return tensor[torch.from_numpy(rows)].numpy()

    def edit(self, edit: RowEdit) -> None:
        """Apply an edit to parameters, moments and counters."""
        if edit.moves_rows:
            self.sync()
        self._synced = None
        rows = slice(None) if edit.rows is None else torch.from_numpy(edit.rows)
        for name, values in edit.values.items():
            self._tensor(name)[rows] = torch.from_numpy(values)
        for name in edit.forget:
            for moment in self._moments[name]:
                moment[rows] = 0
        if edit.moved is not None and edit.sources is not None:
            self._move(torch.from_numpy(edit.moved), torch.from_numpy(edit.sources))
        if edit.keep is not None or edit.parents is not None or edit.morton:
            self._rebuild(edit)

    def widen_sh(self, degree: int) -> None:
        """Extend the SH coefficients to at least `degree`; new ones and their moments are zero."""
        missing = SH_REST_BY_DEGREE[degree] - self.params["shN"].shape[1]
        if missing <= 0:
            return
        self.sync()
        wider = partial(torch.nn.functional.pad, pad=(0, 0, 0, missing))
        self.params["shN"] = wider(self.params["shN"]).contiguous()
        self._map_rest("shN", wider)

    def clamp_runaways(self, extent: float) -> int:
        """Reset runaway rows and clamp saturated parameters; returns the number of reset rows."""
        return sanitize.clamp_runaways(self, extent=extent)

    def _tensor(self, name: str) -> torch.Tensor:
        return self.params[name] if name in self.params else self.rows[name]

    def _move(self, targets: torch.Tensor, sources: torch.Tensor) -> None:
        for name, p in self.params.items():
            p[targets] = p[sources]
            for cleared in (*self._moments[name], self.grads[name]):
                cleared[targets] = 0
        for counter in self.rows.values():
            counter[targets] = 0

    def _rebuild(self, edit: RowEdit) -> None:
        """Keep rows and append copies, one tensor after another, so that no more than one exists
        twice."""
        keep = None if edit.keep is None else torch.from_numpy(edit.keep)
        if edit.morton:
            means = self.params["means"] if keep is None else self.params["means"][keep]
            order = morton_order(means)
            keep = order if keep is None else keep[order]
        parents = None if edit.parents is None else torch.from_numpy(edit.parents)
        kept = len(self) if keep is None else len(keep)
        added = 0 if parents is None else len(parents)

        def rebuilt(old: torch.Tensor, new: torch.Tensor | None = None) -> torch.Tensor:
            out = old.new_empty((kept + added, *old.shape[1:]))
            if keep is None:
                out[:kept] = old
            else:
                torch.index_select(old, 0, keep, out=out[:kept])
            out[kept:] = 0 if new is None else new
            return out

        for name in PARAMETERS:
            new = None
            if name in edit.changes:
                new = torch.from_numpy(edit.changes[name])
            elif parents is not None:
                new = self.params[name][parents]
            self.params[name] = rebuilt(self.params[name], new)
            self._map_rest(name, rebuilt)
        for name, counter in self.rows.items():
            self.rows[name] = rebuilt(counter)

    def _map_rest(self, name: str, function: Callable[[torch.Tensor], torch.Tensor]) -> None:
        """Apply a function to the moments and the accumulated gradient of a parameter."""
        first, second = self._moments.pop(name)
        first = function(first).contiguous()
        second = function(second).contiguous()
        self._moments[name] = first, second
        self.grads[name] = function(self.grads[name]).contiguous()
        self._synced = None

    def set_rates(self, rates: Mapping[str, float]) -> None:
        """Set learning rates by parameter name."""
        self._rates = dict(rates)

    def step(
        self,
        radii: torch.Tensor | None = None,
        *,
        shN: ShUpdate = ShUpdate.STEP,
        photos: int = 1,
    ) -> int:
        """Take an Adam step with `grads`; gradients that are not finite count as zero.

        Args:
            radii: [N] int32, above 0 for visible splats; None: all.
            shN: Update of shN.
            photos: Number of photos averaged in `grads`: steps are counted in photos, and momentum
                decays as in that number of steps. shN, which accumulates gradients anyway, counts
                its own steps.

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
            self.adam_steps[name] += at_once if does is ShUpdate.STEP else 0
            slots.append(self._slot(name, wait=does is ShUpdate.ACCUMULATE, photos=at_once))
        self._synced = None
        return adam.step(slots, radii, threads=self._threads)

    def sync_visible(self, view: Frustum) -> None:
        """Apply the pending steps of rows that `view` may show."""
        self._synced = None  # a step follows, so the cached copy is not read again
        self._catch_up(view)

    def sync(self) -> None:
        """Apply the pending steps of all rows, for example before rows are reordered."""
        self._synced = None
        self._catch_up(None)

    def synced(self) -> dict[str, torch.Tensor]:
        """Return the parameters as after `sync` without changing the model, so that rendering
        changes no bit of the training."""
        if self._synced is None:
            shN = self.params["shN"]
            if self._waiting():
                shN = torch.empty_like(shN)
                self._catch_up(None, out=shN)
            self._synced = self.params | {"shN": shN}
        return self._synced

    def synced_rows(self, rows: slice) -> dict[str, torch.Tensor]:
        """Return some rows of `synced`, without the memory for all."""
        if self._synced is not None:
            return {name: p[rows] for name, p in self._synced.items()}
        params = {name: p[rows] for name, p in self.params.items()}
        if self._waiting():
            out = torch.empty_like(params["shN"])
            slot = self._slot("shN", wait=False, rows=rows)
            adam.catch_up(slot, params, None, out=out, threads=self._threads)
            params["shN"] = out
        return params

    def drop_moments(self) -> None:
        """Free moments and gradients, which only further steps need. Call `sync` first."""
        self._moments.clear()
        self.grads.clear()

    def _waiting(self) -> bool:
        return bool(self.rows[_PENDING].any()) and self.params["shN"].numel() > 0

    def _catch_up(self, view: Frustum | None, *, out: torch.Tensor | None = None) -> None:
        if self._waiting():
            slot = self._slot("shN", wait=False)
            adam.catch_up(slot, self.params, view, out=out, threads=self._threads)

    def _slot(
        self, name: str, *, wait: bool, rows: slice = slice(None), photos: int = 1
    ) -> adam.Slot:
        skips = None
        if name == "shN":
            skips = adam.Skips(
                self.rows[_VISIBLE][rows], self.rows[_PENDING][rows], self.factors, wait
            )
        first, second = self._moments[name]
        return adam.Slot(
            self.params[name][rows],
            self.grads[name][rows],
            first[rows],
            second[rows],
            rate=self._rates[name],
            step=self.adam_steps[name],
            skips=skips,
            photos=photos,
        )


def accumulated_of(
    tensors: Mapping[str, torch.Tensor], rank: int, size: int
) -> torch.Tensor | None:
    """Return the accumulated shN gradient of one of `size` ranks from a checkpoint's tensors.

    If `size` ranks wrote the checkpoint, each gets its own; otherwise rank 0 gets the sum and the
    others zeros. None: the checkpoint has none."""
    if ACCUMULATED not in tensors:
        return None
    names = itertools.takewhile(
        tensors.__contains__, (f"{ACCUMULATED}/{k}" for k in itertools.count(1))
    )
    parts = [tensors[ACCUMULATED], *(tensors[name] for name in names)]
    if len(parts) == size:
        return parts[rank]
    if rank:
        return torch.zeros_like(parts[0])
    for part in parts[1:]:
        parts[0] += part
    return parts[0]


def morton_order(means: torch.Tensor) -> torch.Tensor:
    """Return rows, [M] int64, in Morton order of `means`, [M, 3], so that neighbouring splats are
    close in memory; splats in one cell keep their order.

    The grid has 1024 cells per side over the middle 98 % of each axis; splats beyond are clamped
    to the outermost cells.
    """
    if len(means) == 0:
        return zeros(0, dtype=torch.int64)
    points = np.nan_to_num(means.numpy().astype(np.float64))
    low, high = morton_bounds(points[:: max(1, len(points) // 4096)])
    cells = (points - low) / np.maximum(high - low, 1e-30) * (_CELLS - 1)
    return torch.from_numpy(cell_order(np.clip(cells, 0, _CELLS - 1).astype(np.uint64)))


_CELLS = 1024


def morton_bounds(sample: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper corner, [3] float64, of the grid for means, [M, 3], M > 0."""
    points = np.nan_to_num(sample.astype(np.float64))
    low, high = np.percentile(points, (1, 99), axis=0)
    return low, high
