"""S23, optimizer: Adam over a thousand steps in which few splats receive gradients.

S21: the exponential function of the blending loops.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..raster import _native
from ..raster.gpu.gpu_raster import GpuRaster
from ..raster.gpu.header import TEST_EXP2
from ..shared_constants import ADAM_BETA1, ADAM_BETA2, ADAM_EPS
from ..text_format import count_text
from . import native
from .case import EmptyTestError, Measure, case

_ROWS = 120
_SHAPES = {"means": 3, "quats": 4, "scales": 3, "opacities": 1, "sh0": 3, "shN": 45}
_RATES = {"means": 1e-3, "quats": 1e-3, "scales": 5e-3, "opacities": 0.02, "sh0": 2.5e-3}


class _Dense:
    """Dense Adam (Kingma and Ba 2015): all rows at each step."""

    def __init__(self, values: dict[str, np.ndarray], dtype: type[np.floating]) -> None:
        self.dtype = dtype
        self.values = {k: v.astype(dtype) for k, v in values.items()}
        self.first = {k: np.zeros_like(v) for k, v in self.values.items()}
        self.second = {k: np.zeros_like(v) for k, v in self.values.items()}
        self.steps = 0

    def step(self, gradients: dict[str, np.ndarray], rates: dict[str, float]) -> None:
        self.steps += 1
        c = self.dtype  # NumPy float64 scalars would promote float32 arrays
        unbias = c(1 / (1 - ADAM_BETA1**self.steps)), c(1 / (1 - ADAM_BETA2**self.steps))
        for name, gradient in gradients.items():
            m, v, g = self.first[name], self.second[name], gradient.astype(c)
            m += c(1 - ADAM_BETA1) * (g - m)
            v += c(1 - ADAM_BETA2) * (g * g - v)
            size = np.sqrt(v * unbias[1]) + c(ADAM_EPS)
            self.values[name] -= c(rates[name]) * (m * unbias[0]) / size

    def edit(self, keep: np.ndarray, copied: np.ndarray) -> None:
        for values, new in ((self.values, True), (self.first, False), (self.second, False)):
            for name, array in values.items():
                more = array[copied] if new else np.zeros_like(array[copied])
                values[name] = np.concatenate([array[keep], more])

    def reset_opacities(self, ceiling: float) -> None:
        self.values["opacities"] = np.minimum(self.values["opacities"], self.dtype(ceiling))
        self.first["opacities"][:] = self.second["opacities"][:] = 0


def _model(values: dict[str, np.ndarray]) -> Any:
    import torch

    from ..engine.cpu.model import CpuModel

    return CpuModel({n: torch.from_numpy(v.copy()) for n, v in values.items()}, threads=2)


def _step(
    model: Any, gradients: dict[str, np.ndarray], seen: np.ndarray, rates: dict[str, float]
) -> None:
    import torch

    for name, g in gradients.items():
        model.grads[name].copy_(torch.from_numpy(g))
    model.set_rates(rates)
    model.step(torch.from_numpy(seen.astype(np.int32)))


@case("S23", "optimizer, splats seen now and then")
def adam(full: bool) -> Iterator[Measure]:
    """Oracle: dense Adam, float32 and float64, through pruning, copying, reordering and resets."""

    from ..engine.base import RowEdit

    steps = 1000 if full else 300
    rng = np.random.default_rng(2300)
    values = {
        name: rng.normal(size=(_ROWS, width)).astype(np.float32) for name, width in _SHAPES.items()
    }
    values["opacities"] = values["opacities"][:, 0]
    values["sh0"], values["shN"] = values["sh0"][:, None], values["shN"].reshape(_ROWS, 15, 3)
    start = values["means"][0].copy()
    model = _model(values)
    twin, true = _Dense(values, np.float32), _Dense(values, np.float64)
    unseen = 10
    for step in range(steps):
        seen = rng.random(len(model)) < 0.3
        seen[:unseen] = False
        gradients = {}
        for name, array in true.values.items():
            g = rng.normal(size=array.shape).astype(np.float32) * np.float32(
                10.0 ** rng.uniform(-6, 1)
            )
            g[~seen] = 0
            gradients[name] = g
        decay = 0.01 ** (step / steps)
        rates = {name: rate * decay for name, rate in _RATES.items()} | {"shN": 1.25e-4 * decay}
        _step(model, gradients, seen, rates)
        twin.step(gradients, rates)
        true.step(gradients, rates)
        if step % 97 == 50:
            rest = unseen + rng.permutation(len(model) - unseen)
            keep = np.concatenate([np.arange(unseen), rest[: _ROWS - 30 - unseen]])
            copied = rest[:20]
            model.edit(RowEdit(keep=keep, parents=copied))
            twin.edit(keep, copied)
            true.edit(keep, copied)
        if step % 131 == 100:
            ceiling = np.log(0.01 / 0.99)
            lowered = np.minimum(model.column("opacities"), np.float32(ceiling))
            model.edit(RowEdit(values={"opacities": lowered}, forget=("opacities",)))
            twin.reset_opacities(ceiling)
            true.reset_opacities(ceiling)
    moved, synced = 0.0, model.synced()
    # Rounding of a thousand steps: two trainings in float32 differ by 2.4e-6, and both by 2.7e-6
    # from float64.
    tolerance = 4e-6 if full else 2e-6
    for name, values64 in true.values.items():
        found = synced[name].detach().numpy()
        size = np.maximum(np.abs(values64), 1.0)
        moved = max(moved, float(np.abs(values64[unseen:]).std()))
        # Delayed rows of shN catch up in one sum instead of step by step.
        same_steps = tolerance if name == "shN" else 5e-7
        for other, dense, limit in (
            ("float32", twin.values[name], same_steps),
            ("float64", values64, tolerance),
        ):
            yield Measure(f"{name}, {other}", float((np.abs(found - dense) / size).max()), limit)
    if not moved > 0.5 or (true.values["means"][unseen] == start).all():
        raise EmptyTestError("the parameters did not move")
    still = np.abs(synced["means"].numpy()[0] - start).max()
    yield Measure("a row never seen, movement", float(still), 0)


_LOWEST = -40.0
_BLOCK = 1 << 22


def _exp2(x: np.ndarray) -> np.ndarray:
    """2^x by the function of the blending loops."""
    with native.workspace() as raster:
        if isinstance(raster, GpuRaster):
            return raster.test(TEST_EXP2, x).view(np.float32)
    return _native.exp2(x)


@case("S21", "exp2", on_device=True, needs=())
def exponential(full: bool) -> Iterator[Measure]:
    """Oracle: exp2 in float64; all float32 in [-40, 0] in the full suite, else one in 997 and the
    neighbourhoods of the seams of the range reduction, monotonic within one ulp."""
    last = int(np.array(_LOWEST, np.float32).view(np.uint32))
    first = int(np.array(-0.0, np.float32).view(np.uint32))
    step = 1 if full else 997
    worst = disorder = 0.0
    count = 0
    for start in range(first, last + 1, _BLOCK * step):
        bits = np.arange(start, min(start + _BLOCK * step, last + 1), step, dtype=np.int64)
        x = bits.astype(np.uint32).view(np.float32)
        y = _exp2(x)
        worst = np.maximum(worst, np.abs(y / np.exp2(x.astype(np.float64)) - 1).max())
        disorder = np.maximum(disorder, _disorder(y))
        count += len(x)
    for seam in np.arange(-39.5, 0, 0.5):
        near = np.array(seam, np.float32).view(np.int32) + np.arange(-2000, 2000, dtype=np.int32)
        x = near.astype(np.uint32).view(np.float32)
        y = _exp2(x)
        worst = np.maximum(worst, np.abs(y / np.exp2(x.astype(np.float64)) - 1).max())
        disorder = np.maximum(disorder, _disorder(y))
    if not worst > 0 or count < 1_000_000:
        raise EmptyTestError("nothing was measured")
    yield Measure("relative error", float(worst), 2.5e-7, count_text(count, "value"))
    yield Measure("order, ulp", float(disorder), 1.0)


def _disorder(y: np.ndarray) -> float:
    """Largest increase, in units of the last place, of values that should decrease."""
    rise = y[1:] - y[:-1]
    return float(np.maximum(0.0, (rise / np.spacing(y[:-1])).max()))
