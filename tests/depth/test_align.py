"""Both alignment rules against independent computations and against known scales."""

import numpy as np
import pytest

from gscore.depth.align import align_official, align_robust, reliable
from gscore.depth.fit import Fit, median_scale, scale_reason
from gscore.depth.observations import Observations

SEEDS = range(40)


def make_observations(x, y, inverse_depth, width, height, weights=None):
    """Observations from plain lists."""
    return Observations(
        x=np.asarray(x, np.float64),
        y=np.asarray(y, np.float64),
        inverse_depth=np.asarray(inverse_depth, np.float64),
        weights=np.ones(len(x)) if weights is None else np.asarray(weights, np.float64),
        width=width,
        height=height,
    )


@pytest.mark.parametrize("seed", range(8))
def test_official_rule(seed, official_by_hand):
    """Oracle: the rule computed one point at a time in plain Python."""
    rng = np.random.default_rng(seed)
    width, height, factor = 64, 48, (1.0, 0.5, 2.0, 0.37)[seed % 4]
    shape = round(height * factor), round(width * factor)
    values = (rng.integers(0, 65536, shape) / 65536).astype(np.float32)
    count = int(rng.integers(11, 60))
    # Some points are outside the picture or behind the camera.
    x, y = rng.uniform(-4, width + 4, count), rng.uniform(-4, height + 4, count)
    inverse = rng.uniform(-0.05, 0.5, count)
    fit = align_official(values, make_observations(x, y, inverse, width, height))
    points = list(zip(x.tolist(), y.tolist(), inverse.tolist(), strict=True))
    scale, offset = official_by_hand(values.tolist(), points, width, height)
    assert fit.accepted is (scale > 0)
    assert fit.scale == pytest.approx(scale, rel=2e-5)
    assert fit.offset == pytest.approx(offset, abs=2e-5 * abs(scale))


@pytest.mark.parametrize(
    ("count", "spread", "accepted"),
    [(10, 0.5, False), (11, 0.5, True), (40, 0.9e-3, False), (40, 1.1e-3, True)],
)
def test_official_thresholds(count, spread, accepted):
    """Oracle: more than 10 points and a range of inverse depth above 1e-3, by the rule."""
    rng = np.random.default_rng(0)
    values = rng.random((20, 20)).astype(np.float32)
    inverse = 0.3 + spread * np.linspace(0, 1, count)
    x, y = rng.uniform(1, 19, (2, count))
    fit = align_official(values, make_observations(x, y, inverse, 20, 20))
    assert fit.accepted is accepted
    assert (fit.scale > 0) is accepted and bool(fit.reason) is not accepted


def test_official_constant_map_is_refused():
    """Oracle: no scale without a deviation; a reason instead of infinity in the file."""
    x = np.linspace(1, 19, 30)
    seen = make_observations(x, x, np.linspace(0.1, 0.5, 30), 20, 20)
    fit = align_official(np.full((20, 20), 0.25, np.float32), seen)
    assert (fit.scale, fit.offset, fit.accepted) == (0.0, 0.0, False)
    assert "one value" in fit.reason


@pytest.mark.parametrize("factor", [0.19, 0.21, 1.0, 4.9, 5.1])
def test_reliability(factor):
    """Oracle: the interval [0.2, 5] times the median of the positive scales."""
    scales = [2.0, 2.0, 2.0, 2.0 * factor, 0.0, -1.0, 2.0]
    assert median_scale(scales) == 2.0
    assert (scale_reason(2.0 * factor, 2.0) == "") is (0.2 <= factor <= 5)
    fits: list[Fit | None] = [Fit(scale=s, offset=0.0, accepted=True) for s in scales[:4]]
    evaluated = reliable([*fits, None], median_scale(scales))
    assert evaluated[4] is None and evaluated[0] == fits[0]
    assert evaluated[3] is not None and evaluated[3].accepted is (0.2 <= factor <= 5)


def _scene(seed, *, outliers, noise, count=None, low=0.1):
    """Values of a map, inverse depths of points, the scale and offset between them."""
    rng = np.random.default_rng(seed)
    count = count or int(rng.integers(150, 900))
    inverse = low + rng.beta(2, 3, count) * 0.5
    scale, offset = 10 ** rng.uniform(-2, 2), rng.uniform(-0.3, 0.1)
    mono = (inverse - offset) / scale
    mono *= 1 + noise * rng.normal(size=count)
    wrong = rng.permutation(count)[: round(outliers * count)]
    return rng, mono, inverse, scale, offset, wrong


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("sided", ["anywhere", "nearer", "same"])
def test_scale_with_40_percent_outliers(seed, sided):
    """Oracle: the scale that the map was made with, within 1 %, and inliers near 60 %."""
    rng, mono, inverse, scale, offset, wrong = _scene(seed, outliers=0.4, noise=0.005)
    span = np.ptp(mono)
    if sided == "anywhere":
        mono[wrong] = rng.uniform(mono.min(), mono.max(), len(wrong))
    elif sided == "nearer":  # all errors on one side, as where a map bleeds over an edge
        mono[wrong] += rng.uniform(0.2, 1.0, len(wrong)) * span
    else:  # a wrong but consistent surface
        mono[wrong] = rng.uniform(0.4, 0.45, len(wrong)) * span + mono.min()
    fit = align_robust(mono, inverse, np.ones(len(mono)))
    assert fit.accepted, fit.reason
    assert fit.scale == pytest.approx(scale, rel=0.01)
    assert fit.offset == pytest.approx(offset, abs=0.01 * np.median(inverse))
    assert 0.58 < fit.inliers < 0.85
    assert fit.points == len(mono)


def test_the_official_rule_fails_there():
    """Oracle: a change of the official scale by more than 10 % in most captures, by the same
    outliers."""
    worse = 0
    for seed in SEEDS:
        rng, mono, inverse, scale, _, wrong = _scene(seed, outliers=0.4, noise=0.005)
        mono[wrong] += rng.uniform(0.2, 1.0, len(wrong)) * np.ptp(mono)
        count = len(mono)
        seen = make_observations(np.arange(count) + 0.0, np.zeros(count), inverse, count + 1, 1)
        strip = np.append(mono, 0)[None].astype(np.float32)
        worse += abs(align_official(strip, seen).scale / scale - 1) > 0.1
    assert worse > 0.9 * len(SEEDS)


@pytest.mark.parametrize("seed", range(10))
def test_weights_decide(seed):
    """Oracle: the line with the trusted points, of two with equally many points."""
    rng = np.random.default_rng(seed)
    mono = rng.uniform(0, 1, 200)
    trusted = rng.permutation(200) < 100
    inverse = np.where(trusted, 0.1 + 0.4 * mono, 0.6 - 0.3 * mono)
    fit = align_robust(mono, inverse, np.where(trusted, 5.0, 1.0))
    assert fit.scale == pytest.approx(0.4, rel=0.01)
    assert fit.inliers > 0.8


@pytest.mark.parametrize("seed", range(10))
def test_points_on_a_slanted_plane(seed):
    """Oracle: the scale, because inverse depth is affine across a plane."""
    rng = np.random.default_rng(seed)
    inverse = 0.2 + 0.1 * rng.uniform(0, 1, 120)
    fit = align_robust((inverse - 0.05) / 3.0, inverse, np.ones(120))
    assert fit.accepted and fit.scale == pytest.approx(3.0, rel=1e-6)
    assert fit.error < 1e-6


def test_points_at_one_depth_are_refused():
    """Oracle: a plane facing the camera, whose one inverse depth fits any scale."""
    rng = np.random.default_rng(1)
    inverse = 0.25 * (1 + 0.002 * rng.normal(size=300))
    fit = align_robust(rng.uniform(0, 1, 300), inverse, np.ones(300))
    assert not fit.accepted and "same depth" in fit.reason


@pytest.mark.parametrize("count", [0, 1, 5, 19])
def test_few_points_are_refused(count):
    """Oracle: the count in the reason."""
    inverse = np.linspace(0.1, 0.5, count)
    fit = align_robust(inverse * 2, inverse, np.ones(count))
    assert not fit.accepted and fit.reason.startswith(f"only {count} point")
    assert fit.points == count


def test_constant_maps_are_refused():
    """Oracle: a refusal of one value at all points, or at nearly all."""
    inverse = np.linspace(0.1, 0.5, 200)
    mono = np.full(200, 0.3)
    for extra in (0.3, 0.9):
        mono[:4] = extra
        fit = align_robust(mono, inverse, np.ones(200))
        assert not fit.accepted and "one value" in fit.reason


@pytest.mark.parametrize("seed", range(10))
def test_depth_instead_of_inverse_depth_is_refused(seed):
    """Oracle: the negative scale of a map that grows with depth."""
    _, mono, inverse, *_ = _scene(seed, outliers=0, noise=0.002)
    fit = align_robust(-mono, inverse, np.ones(len(mono)))
    assert not fit.accepted and "farther" in fit.reason and fit.scale < 0


@pytest.mark.parametrize("count", [25, 60, 300, 2000])
def test_unrelated_maps_are_refused(count):
    """Oracle: a refusal of all 200 maps of noise, for any spread of the depths."""
    for seed in range(200):
        rng = np.random.default_rng(seed)
        a, b = [(2, 5), (1, 1), (8, 2), (0.3, 0.6)][seed % 4]
        inverse = 0.1 + rng.beta(a, b, count) * (0.02 + 0.5 * (seed % 7) / 6)
        inverse[: count // 2] = inverse[0]  # half of them on a wall
        mono = rng.uniform(0, 1, count) if seed % 2 else rng.normal(size=count) ** 3
        assert not align_robust(mono, inverse, rng.uniform(1, 10, count)).accepted


def test_noise_of_the_map_does_not_flatten_it():
    """Oracle: the true scale; least squares of depth on the map would be 12 % too small here."""
    scales, plain = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        inverse = rng.uniform(0.3, 0.45, 600)
        mono = inverse + 0.016 * rng.normal(size=600)
        fit = align_robust(mono, inverse, np.ones(600))
        assert fit.accepted, fit.reason
        scales.append(fit.scale)
        plain.append(np.polyfit(mono, inverse, 1)[0])
    assert np.mean(plain) < 0.9
    assert np.mean(scales) == pytest.approx(1, abs=0.04)


def test_shallow_points_under_a_noisy_map_are_refused():
    """Oracle: noise as large as the spread of the points, which leaves the scale open."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        inverse = rng.uniform(0.39, 0.41, 400)
        mono = inverse + 0.008 * rng.normal(size=400)
        fit = align_robust(mono, inverse, np.ones(400))
        assert not fit.accepted
    exact = align_robust(inverse * 3, inverse, np.ones(400))
    assert exact.accepted and exact.scale == pytest.approx(1 / 3)


def test_expected_error_of_a_fit():
    """Oracle: four times the standard error of a line through 12 points, in closed form."""
    fit = Fit(scale=2.0, offset=0.1, center=0.2, deviation=0.05, noise=0.012, accepted=True)
    assert fit.slope_error == pytest.approx(0.012 / (2 * 0.05 * 12**0.5))
    values = np.array([0.2, 0.25, 0.45, -0.05, -0.2], np.float32)
    error = 4 * 0.012 * np.sqrt((1 + np.array([0, 1, 25]) ** 1.0) / 12)
    expected = error / (2 * values[:3] + 0.1)
    assert fit.relative_error(values)[:3] == pytest.approx(expected, rel=1e-5)
    assert np.isinf(fit.relative_error(values)[3:]).all()


def test_unknown_values_are_left_out():
    """Oracle: the number of points that have a value and are in front of the camera."""
    inverse = np.linspace(0.1, 0.5, 100)
    mono = inverse / 2
    mono[:10] = np.nan
    inverse[10:15] = -1
    fit = align_robust(mono, inverse, np.ones(100))
    assert fit.accepted and fit.points == 85 and fit.scale == pytest.approx(2)


def test_same_seed_same_fit():
    """Oracle: equality, bit for bit."""
    _, mono, inverse, *_ = _scene(3, outliers=0.4, noise=0.02)
    fits = [align_robust(mono, inverse, np.ones(len(mono))) for _ in range(2)]
    assert fits[0] == fits[1]
