"""Priors as targets; oracles: means of blocks, a plane's inverse depth, and sizes in memory."""

from dataclasses import dataclass

import numpy as np
import pytest

from gscore.datasets.resolution import scale_intrinsics
from gscore.trainer.depth.targets import DepthTargets, area_mean


@dataclass
class Prior:
    inverse_depth: np.ndarray
    confidence: np.ndarray
    aligned: bool = True


def prior(values: np.ndarray, confidence: np.ndarray | None = None, aligned: bool = True) -> Prior:
    sure = np.ones(values.shape, np.float32) if confidence is None else confidence
    return Prior(values.astype(np.float32), sure.astype(np.float32), aligned)


def test_whole_factors_give_means_of_blocks() -> None:
    """Oracle: numpy's mean over 3 x 2 blocks."""
    values = np.random.default_rng(0).normal(size=(12, 10))
    expected = values.reshape(4, 3, 5, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(area_mean(values, 5, 4), expected, atol=1e-12)


def test_any_factor_keeps_the_sum() -> None:
    """Oracle: the mean over the picture, which area averaging keeps."""
    values = np.random.default_rng(1).normal(size=(48, 37))
    small = area_mean(values, 26, 34)
    assert small.shape == (34, 26)
    assert small.mean() == pytest.approx(values.mean(), rel=1e-12)


def test_a_plane_stays_where_the_scaled_camera_sees_it() -> None:
    """Oracle: inverse depth of a plane is affine in the pixel, evaluated with K at both sizes."""
    old, new = (48, 36), (34, 25)
    K = np.array([[60.0, 0, 25.3], [0, 58.0, 17.1], [0, 0, 1]])

    def inverse_depth(matrix: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        x, y = np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5
        rays = np.stack([*np.meshgrid(x, y), np.ones(size[::-1])], -1) @ np.linalg.inv(matrix).T
        return rays @ np.array([0.1, -0.2, 0.5])

    target = DepthTargets([prior(inverse_depth(K, old))], train=[0], views=1)
    small = target.at(0, *new)
    assert small is not None
    expected = inverse_depth(scale_intrinsics(K, old, new), new)
    found = small.inverse_depth.numpy() * target.unit
    np.testing.assert_allclose(found, expected, rtol=2e-3)  # half floats: 2^-11 in each step
    assert target.at(0, *new) is small, "scaled once"
    assert target.at(0, *old) is not small


def test_unknown_depths_do_not_bleed_in() -> None:
    """Oracle: by hand. A block with an unknown half: the value of the rest, half its confidence."""
    values = np.full((4, 4), 0.5)
    confidence = np.ones((4, 4))
    values[:, 1], confidence[:, 1] = 99.0, 0.0
    values[:, 2:], confidence[:, 2:] = np.nan, 1.0
    targets = DepthTargets([prior(values, confidence)], train=[0], views=1)
    small = targets.at(0, 2, 2)
    assert small is not None
    assert targets.unit == pytest.approx(0.5)
    np.testing.assert_allclose(small.inverse_depth[:, 0].numpy(), 1.0)
    np.testing.assert_array_equal(small.confidence[:, 0].numpy(), 128)
    np.testing.assert_array_equal(small.confidence[:, 1].numpy(), 0)


def test_the_unit_comes_from_aligned_training_views_alone() -> None:
    """Oracle: the median of 0.2 and 0.4 by number of pixels; 5 is held out, 70 not aligned."""
    views = [
        prior(np.full((2, 2), 5.0)),
        prior(np.full((4, 4), 0.2)),
        prior(np.full((2, 2), 0.4)),
        prior(np.full((9, 9), 70.0), aligned=False),
        None,
    ]
    targets = DepthTargets(views, train=[1, 2, 3, 4], views=4)
    assert targets.unit == pytest.approx(0.2)
    assert 0 in targets
    assert 4 not in targets
    assert targets.is_aligned(1)
    assert not targets.is_aligned(3)


def test_three_bytes_a_pixel() -> None:
    """Oracle: the sizes of the tensors."""
    target = DepthTargets([prior(np.full((10, 20), 0.3))], train=[0], views=1).at(0, 20, 10)
    assert target is not None
    assert target.inverse_depth.nbytes + target.confidence.nbytes == 3 * 200


def test_hash_distinguishes_maps_and_alignments() -> None:
    """Oracle: equal hashes for equal input only."""

    def hash_of(*views: Prior | None) -> str:
        return DepthTargets(views, train=range(len(views)), views=1).content_hash()

    ramp = np.linspace(0.2, 0.4, 12).reshape(3, 4)
    same = hash_of(prior(ramp), None)
    assert same == hash_of(prior(ramp.copy()), None)
    others = {
        hash_of(None, prior(ramp)),
        hash_of(prior(ramp[::-1]), None),
        hash_of(prior(2 * ramp), None),
        hash_of(prior(ramp, aligned=False), None),
        hash_of(prior(ramp, np.full((3, 4), 0.5)), None),
    }
    assert len(others) == 5
    assert same not in others
