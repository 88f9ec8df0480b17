"""Alignment on the bundled capture: COLMAP's own points, exact depth distorted in known ways."""

from pathlib import Path

import numpy as np
import pytest

from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.depth.align import align_official, align_robust
from gscore.depth.maps import read_map
from gscore.depth.observations import observations
from gscore.depth.samples import sampled

STUDIO = Path(__file__).parents[2] / "examples" / "studio"
VIEWS = range(0, 60, 5)
EXACT = 4.0
"""1/m per unit of value / 65536, from the capture's README."""


@pytest.fixture(scope="module")
def studio():
    """The capture's views, its points, and its exact maps."""
    config = DataConfig(source=STUDIO, resolution=1)
    dataset = load_dataset(config)
    seen = observations(config, dataset)
    maps = {i: read_map(STUDIO / "depths" / f"view_{i:03d}.png") for i in VIEWS}
    return seen, maps


def _robust(values, seen):
    part = sampled(values, seen)
    return align_robust(part.values, part.inverse_depth, part.weights)


@pytest.mark.parametrize("index", VIEWS)
def test_exact_maps(studio, index):
    """Oracle: the unit of the renderer, and the exact depth of every pixel within 1 %."""
    seen, maps = studio
    fit = _robust(maps[index], seen[index])
    assert fit.accepted and fit.inliers > 0.95 and fit.error < 2e-3
    assert fit.scale == pytest.approx(EXACT, rel=0.06)
    aligned = fit.scale * maps[index] + fit.offset
    shown = maps[index] > 0
    off = np.abs(aligned / (EXACT * np.where(shown, maps[index], 1)) - 1)[shown]
    assert np.quantile(off, 0.9) < 0.01


@pytest.mark.parametrize("index", VIEWS)
def test_40_percent_outliers(studio, index):
    """Oracle: the fit without outliers, within 1 %, with values of 40 % of the points replaced."""
    seen, maps = studio
    part = sampled(maps[index], seen[index])
    clean = align_robust(part.values, part.inverse_depth, part.weights)
    rng = np.random.default_rng(index)
    values = part.values.copy()
    wrong = rng.random(len(values)) < 0.4
    low, high = np.nanquantile(values, (0.01, 0.99))
    values[wrong] = rng.uniform(low, high, int(wrong.sum()))
    fit = align_robust(values, part.inverse_depth, part.weights)
    assert fit.accepted and fit.scale == pytest.approx(clean.scale, rel=0.01)


def _monocular(exact, seed):
    """A map like those of networks: blurred, distorted by a few per cent, noisy, scaled and
    shifted."""
    rng = np.random.default_rng(seed)
    height, width = exact.shape
    rows, columns = np.mgrid[:height, :width] / 200.0
    values = exact.astype(np.float64)
    for axis in (0, 1):  # three box filters approximate a Gaussian
        for _ in range(3):
            shifted = [np.roll(values, k, axis) for k in range(-3, 4)]
            values = np.mean(shifted, axis=0)
    phase = rng.uniform(0, 6.3, 4)
    bend = np.sin(3 * rows + phase[0]) + np.sin(4 * columns + phase[1])
    values *= 1 + 0.02 * bend + 0.01 * rng.normal(size=exact.shape)
    scale, offset = rng.uniform(0.5, 5), rng.uniform(-0.2, 0.2)
    return (scale * values + offset).astype(np.float32)


def test_like_a_network(studio):
    """Oracle: the exact depth of all pixels, to which the robust rule is closer; half of 5 % as the
    error of pixels with a stated error within 5 %."""
    seen, maps = studio
    errors = {"official": [], "robust": []}
    wrong = []
    for index in VIEWS:
        exact = EXACT * maps[index]
        shown = exact > 0
        values = _monocular(maps[index], index)
        robust = _robust(values, seen[index])
        if not robust.accepted:
            assert "too close in depth" in robust.reason
            continue
        for name, fit in (("official", align_official(values, seen[index])), ("robust", robust)):
            off = np.abs((fit.scale * values + fit.offset)[shown] / exact[shown] - 1)
            errors[name].append(float(np.median(off)))
        sure = robust.relative_error(values[shown]) < 0.05
        off = np.abs((robust.scale * values + robust.offset)[shown] / exact[shown] - 1)
        wrong.append(float(np.median(off[sure])))
    medians = {name: float(np.median(found)) for name, found in errors.items()}
    assert len(errors["robust"]) >= 9
    assert medians["robust"] < 0.8 * medians["official"]
    assert max(wrong) < 0.08 and np.median(wrong) < 0.025
