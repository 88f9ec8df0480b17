"""Depth samples: values of depth maps at SfM points and on a coarse grid."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Self

import numpy as np

from ..datasets import Dataset
from ..datasets.dataset import map_threads
from ..datasets.decode import ViewFile, check_proportions, fit_map
from ..errors import DatasetError, FormatError, ShapeError
from ..text_format import count_text, number
from .maps import DepthKind, read_map, sample
from .observations import Observations

_SIDE = 120
"""Minimum number of columns of the grid, less than twice that; fewer for smaller photos."""


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Values of one view's map at its points, and on a coarse grid."""

    values: np.ndarray
    """[M] float64, values of the map; NaN: unknown."""
    inverse_depth: np.ndarray
    """[M] float64, 1/world unit."""
    weights: np.ndarray
    """[M] float64, positive."""
    grid: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    """[h, w] float32, means over n x n pixels of the map at training resolution; NaN: unknown."""
    problem: str = ""
    """Why the file cannot be used; M is 0 then. Empty: it can."""

    def inverse(self, kind: DepthKind) -> Self:
        """The same with values that are affine in inverse depth."""
        if kind is not DepthKind.DEPTH:
            return self
        return replace(self, values=_inverse(self.values), grid=_inverse(self.grid))


def view_samples(
    maps: list[Path | None],
    seen: list[Observations],
    dataset: Dataset,
    *,
    on_view: Callable[[int], None] | None = None,
) -> list[Samples | None]:
    """Sample each map at the points observed in its view; None where there is no map.

    `on_view` is called with the index of each view after it was read.

    Raises:
        DatasetError: none of the maps can be used.
    """

    def samples(index: int) -> Samples | None:
        path = maps[index]
        return None if path is None else _samples(path, dataset.files[index], seen[index])

    found = []
    for index, part in enumerate(map_threads(samples, list(range(len(dataset))))):
        found.append(part)
        if on_view is not None:
            on_view(index)
    there = [part for part in found if part is not None]
    if there and all(part.problem for part in there):
        raise DatasetError(
            f"None of the {number(len(there))} depth maps can be used. The first: "
            f"{there[0].problem}. Make them again: gscore depth"
        )
    return found


def _samples(path: Path, file: ViewFile, seen: Observations) -> Samples:
    """Samples of a map, or why it is unusable, because one bad file must not stop a training."""
    try:
        values = read_map(path)
        check_proportions(file, values)
    except (FormatError, DatasetError) as error:
        problem = str(error).rstrip(".")
    except ShapeError as error:
        problem = f"{path} cannot be used: {error}. It must cover the whole photo"
    else:
        grid = averaged(fit_map(file, np.where(values == 0, np.float32(np.nan), values)))
        return replace(sampled(values, seen), grid=grid)
    none = np.zeros(0)
    return Samples(values=none, inverse_depth=none, weights=none, problem=problem)


def unusable(samples: list[Samples | None]) -> tuple[str, ...]:
    """Message on the maps whose files cannot be used."""
    problems = [part.problem for part in samples if part is not None and part.problem]
    if not problems:
        return ()
    if len(problems) == 1:
        return (f"One depth map is left out, because its file cannot be used: {problems[0]}.",)
    return (
        f"{count_text(len(problems), 'depth map is', 'depth maps are')} left out, because the "
        f"file cannot be used, the first: {problems[0]}.",
    )


def sampled(values: np.ndarray, seen: Observations) -> Samples:
    """A map's values at the points observed in its view, pixel centres at +0.5 in both."""
    height, width = values.shape
    known = np.where(values == 0, np.float32(np.nan), values)
    x, y = seen.x * (width / seen.width) - 0.5, seen.y * (height / seen.height) - 0.5
    inside = (x >= -0.5) & (y >= -0.5) & (x <= width - 0.5) & (y <= height - 0.5)
    inside &= seen.inverse_depth > 0
    return Samples(
        values=sample(known, x[inside], y[inside]),
        inverse_depth=seen.inverse_depth[inside],
        weights=seen.weights[inside],
    )


def averaged(values: np.ndarray) -> np.ndarray:
    """Means of [H, W] float32 over squares of n = `grid_step(W)` pixels; NaN where less than half
    of the square is known. Remaining pixels at the right and bottom are ignored.

    Means, because the noise of single pixels at this distance looks like edges.
    """
    step = grid_step(values.shape[1])
    height, width = (side // step for side in values.shape)
    squares = values[: height * step, : width * step].reshape(height, step, width, step)
    known = np.isfinite(squares)
    count = known.sum(axis=(1, 3))
    total = np.where(known, squares, 0).sum(axis=(1, 3), dtype=np.float64)
    means = np.divide(total, count, out=np.full(count.shape, np.nan), where=2 * count >= step**2)
    return means.astype(np.float32)


def grid_step(width: int) -> int:
    """Grid spacing for a picture of this width, px."""
    return max(1, width // _SIDE)


def _inverse(values: np.ndarray) -> np.ndarray:
    return np.divide(1, values, out=np.full_like(values, np.nan), where=values > 0)
