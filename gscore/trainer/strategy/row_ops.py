"""Row operations of a model: the only code that adds, removes or overwrites splats."""

import math
from collections.abc import Mapping
from functools import partial

import numpy as np
import torch

from ...raster.memory import zeros
from ...splats import PARAMETERS, SH_REST_BY_DEGREE
from ..host.random import gaussian, uniform
from ..model.model import Model

SPLIT_COUNT = 2
"""Number of splats that replace a split one (Kerbl et al. 2023, section 5.2)."""
SPLIT_SHRINK = 1.6
"""Divisor of their scales."""
HALF_OFFSET, HALF_LENGTH, HALF_WIDTH, HALF_OPACITY = 0.7, 0.5, 0.85, 0.6
"""Halves of a splat relative to it: distance from its centre and length along the longest axis,
width along the others, and opacity (factors of Deng et al. 2024; the distance was measured)."""
MAX_COPIES = 51
"""Most copies of one splat that a relocation accounts for (Kheradmand et al. 2024)."""


def logit(p: float) -> float:
    """Inverse of the sigmoid."""
    return math.log(p / (1 - p))


def edit(
    model: Model,
    *,
    keep: torch.Tensor | None = None,
    append: Mapping[str, torch.Tensor] | None = None,
) -> None:
    """Keep some rows and append others in parameters, Adam moments and counters.

    Args:
        model: Changed in place.
        keep: [M] int64 rows to keep, in their new order; None: all.
        append: Parameters of A new rows, whose moments and counters are zero.
    """
    n = len(model)
    kept = n if keep is None else len(keep)
    added = len(append["means"]) if append else 0

    def rebuilt(old: torch.Tensor, new: torch.Tensor | None = None) -> torch.Tensor:
        out = old.new_empty((kept + added, *old.shape[1:]))
        if keep is None:
            out[:kept] = old
        else:
            torch.index_select(old, 0, keep, out=out[:kept])
        out[kept:] = 0 if new is None else new
        return out

    model.sync()
    for name in PARAMETERS:
        new = append[name] if append else None
        model.rebuild(name, partial(rebuilt, new=new), rebuilt)
    for name, counter in model.rows.items():
        model.rows[name] = rebuilt(counter)


def by_place(means: torch.Tensor) -> torch.Tensor:
    """Return rows, [M] int64, in Morton order of `means`, [M, 3], so that neighbouring splats are
    close in memory; splats in one cell keep their order.

    The grid has 1024 cells per side over the middle 98 % of each axis; splats beyond are clamped
    to the outermost cells.
    """
    points = np.nan_to_num(means.numpy().astype(np.float64))
    if len(points) == 0:
        return zeros(0, dtype=torch.int64)
    low, high = np.percentile(points[:: max(1, len(points) // 4096)], (1, 99), axis=0)
    cells = (points - low) / np.maximum(high - low, 1e-30) * (_CELLS - 1)
    cells = np.clip(cells, 0, _CELLS - 1).astype(np.uint32)
    x, y, z = (_spread(cells[:, axis]) for axis in range(3))
    return torch.from_numpy(np.argsort(x | y << 1 | z << 2, kind="stable"))


_CELLS = 1024


def _spread(x: np.ndarray) -> np.ndarray:
    """Insert two zero bits after each bit of numbers below 1024."""
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        x = (x | x << shift) & mask
    return x


def duplicate(model: Model, index: torch.Tensor) -> dict[str, torch.Tensor]:
    """Return copies of the parameters of the rows `index`, [M]."""
    model.sync()
    return {name: p[index] for name, p in model.params.items()}


def split(model: Model, index: torch.Tensor, generator: torch.Generator) -> dict[str, torch.Tensor]:
    """Return the parameters of the splats that replace the rows `index`, [M], in a split: drawn
    from their Gaussians, with scales divided by 1.6.

    Returns:
        SPLIT_COUNT * M rows.
    """
    rows = {
        name: t.repeat(SPLIT_COUNT, *[1] * (t.ndim - 1))
        for name, t in duplicate(model, index).items()
    }
    noise = gaussian(tuple(rows["means"].shape), generator)
    rows["means"] = rows["means"] + rotate(rows["quats"], rows["scales"].exp() * noise)
    rows["scales"] = rows["scales"] - math.log(SPLIT_SHRINK)
    return rows


def halve(model: Model, index: torch.Tensor) -> dict[str, torch.Tensor]:
    """Return the parameters of two halves of each row `index`, [M], next to each other along its
    longest axis. Together they render close to the splat, so that little must be trained again
    (Deng et al. 2024, Efficient Density Control for 3D Gaussian Splatting).

    Returns:
        SPLIT_COUNT * M rows.
    """
    rows = duplicate(model, index)
    longest = torch.nn.functional.one_hot(rows["scales"].argmax(dim=1), 3).bool()
    offset = rotate(rows["quats"], HALF_OFFSET * rows["scales"].exp() * longest)
    length, width = (rows["scales"] + math.log(f) for f in (HALF_LENGTH, HALF_WIDTH))
    rows["scales"] = torch.where(longest, length, width)
    opacities = HALF_OPACITY * torch.sigmoid(rows["opacities"])
    rows["opacities"] = torch.logit(opacities, eps=1e-6)
    halves = {name: torch.cat([t, t]) for name, t in rows.items()}
    halves["means"] += torch.cat([offset, -offset])
    return halves


def join(*parts: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Concatenate the rows of several dictionaries of parameters."""
    return {name: torch.cat([part[name] for part in parts]) for name in PARAMETERS}


def rotate(quats: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
    """Rotate vectors [M, 3] by quaternions [M, 4] wxyz of any non-zero length."""
    unit = quats / quats.square().sum(dim=1, keepdim=True).sqrt().clamp_min(1e-12)
    axis, w = unit[:, 1:], unit[:, :1]
    # v + 2 w (u x v) + 2 u x (u x v)
    cross = torch.linalg.cross(axis, vectors)
    return vectors + 2 * (w * cross + torch.linalg.cross(axis, cross))


def reset_opacities(model: Model, ceiling: float) -> None:
    """Lower all opacities to at most `ceiling` and clear their moments."""
    model.params["opacities"].clamp_(max=logit(ceiling))
    for moment in model.moments("opacities"):
        moment.zero_()


def widen_sh(model: Model, degree: int) -> None:
    """Extend SH coefficients to `degree`; new ones and their moments are zero."""
    missing = SH_REST_BY_DEGREE[degree] - model.params["shN"].shape[1]
    if missing <= 0:
        return
    model.sync()
    wider = partial(torch.nn.functional.pad, pad=(0, 0, 0, missing))
    model.rebuild("shN", wider, wider)


def relocate(
    model: Model,
    dead: torch.Tensor,
    generator: torch.Generator,
    *,
    within: torch.Tensor | None = None,
    min_opacity: float,
) -> int:
    """Move dead splats onto live ones, drawn by opacity, without changing the rendered image.

    A splat that ends up as n copies of itself gets the opacity and scale of equation 9 of
    Kheradmand et al. 2024.

    Args:
        model: Changed in place.
        dead: [N] bool.
        generator: Source of the draw.
        within: [N] bool, allowed targets; None: all.
        min_opacity: Lower bound of the new opacities.

    Returns:
        Number of moved splats; 0 if none is dead, or no live one is `within`.
    """
    targets = dead.nonzero().flatten()
    alive = (~dead if within is None else ~dead & within).nonzero().flatten()
    if len(targets) == 0 or len(alive) == 0:
        return 0
    model.sync()
    chosen = alive[_draw(model, alive, len(targets), generator)]
    _share(model, chosen, min_opacity)
    for name, p in model.params.items():
        p[targets] = p[chosen]
        for cleared in (*model.moments(name), model.grads[name]):
            cleared[targets] = 0
    for counter in model.rows.values():
        counter[targets] = 0
    return len(targets)


def grow(
    model: Model,
    count: int,
    generator: torch.Generator,
    *,
    within: torch.Tensor | None = None,
    min_opacity: float,
) -> int:
    """Add `count` copies of splats drawn by opacity, without changing the rendered image.

    Args:
        model: Changed in place.
        count: Number of copies.
        generator: Source of the draw.
        within: [N] bool, splats that may be copied; None: all.
        min_opacity: Lower bound of the new opacities.

    Returns:
        Number of added splats; 0 if none may be copied.
    """
    rows = torch.arange(len(model), dtype=torch.int64, device="cpu")
    among = rows if within is None else rows[within]
    if count <= 0 or len(among) == 0:
        return 0
    chosen = among[_draw(model, among, count, generator)]
    _share(model, chosen, min_opacity)
    edit(model, append=duplicate(model, chosen))
    return count


def shared_opacity_scale(
    opacity: np.ndarray, scale: np.ndarray, copies: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the opacity and scale with which n coinciding copies render like one (equation 9).

    With o' = 1 - (1 - o)^(1/n) the scale is divided by
    sum_{i=1..n} sum_{k=0..i-1} C(i-1, k) (-1)^k o'^(k+1) / sqrt(k+1) / o; the inner sums over i
    are C(n, k+1), which leaves one sum.

    Args:
        opacity: [M] float64 in (0, 1).
        scale: [M, 3] float64.
        copies: [M] int64, 1 to MAX_COPIES.

    Returns:
        New opacity [M] and scale [M, 3].
    """
    shared = 1 - (1 - opacity) ** (1.0 / copies)
    total = np.zeros_like(opacity)
    for k in range(int(copies.max(initial=0))):
        factor = _BINOMIALS[copies, k + 1] * (-1) ** k / math.sqrt(k + 1)
        total += factor * shared ** (k + 1)
    return shared, scale * (opacity / total)[:, None]


_BINOMIALS = np.array(
    [[math.comb(n, k) for k in range(MAX_COPIES + 1)] for n in range(MAX_COPIES + 1)], np.float64
)


def _draw(
    model: Model, among: torch.Tensor, count: int, generator: torch.Generator
) -> torch.Tensor:
    """Draw [count] positions in `among` by opacity, with replacement.

    Inverts the cumulative sum in float64: unlike torch.multinomial it has no limit of 2^24
    categories, and it is summed in one thread, so the draw does not depend on their number.
    """
    weights = _sigmoid(model.params["opacities"][among].numpy().astype(np.float64))
    weights = np.where(np.isfinite(weights), weights, 0)
    cumulative = np.cumsum(weights)
    drawn = uniform(count, generator, dtype=torch.float64).numpy()
    if not cumulative[-1] > 0:
        return torch.from_numpy((drawn * len(weights)).astype(np.int64))
    found = np.searchsorted(cumulative, drawn * cumulative[-1], side="right")
    return torch.from_numpy(np.minimum(found, len(weights) - 1))


def _share(model: Model, chosen: torch.Tensor, min_opacity: float) -> None:
    """Reduce opacity and scale of the rows `chosen` for one more copy per occurrence."""
    rows, repeats = torch.unique(chosen, return_counts=True)
    opacities, scales = model.params["opacities"], model.params["scales"]
    opacity = _sigmoid(opacities[rows].numpy().astype(np.float64))
    copies = np.minimum(repeats.numpy() + 1, MAX_COPIES)
    opacity = np.clip(opacity, 1e-12, 1 - 1e-7)
    scale = np.exp(scales[rows].numpy().astype(np.float64))
    opacity, scale = shared_opacity_scale(opacity, scale, copies)
    opacity = np.clip(opacity, min_opacity, 1 - 1e-7)
    opacities[rows] = torch.from_numpy(np.log(opacity / (1 - opacity))).float()
    scales[rows] = torch.from_numpy(np.log(scale)).float()
    for name in PARAMETERS:
        for moment in model.moments(name):
            moment[rows] = 0


def _sigmoid(x: np.ndarray) -> np.ndarray:
    return 0.5 * (1 + np.tanh(0.5 * x))
