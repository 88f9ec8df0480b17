"""Clusters against scenes with known clusters, and components against scipy's."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gscore.edit import cluster_sizes, reached_from
from gscore.edit.clusters import _merged
from gscore.splats import Splats

Make = Callable[..., Splats]


def small(means: np.ndarray, size: float = 1e-3) -> Splats:
    """Round splats of one size."""
    n = len(means)
    quats = np.zeros((n, 4), np.float32)
    quats[:, 0] = 1
    return Splats(
        means=means.astype(np.float32),
        quats=quats,
        scales=np.full((n, 3), np.log(size), np.float32),
        opacities=np.zeros(n, np.float32),
        sh0=np.zeros((n, 1, 3), np.float32),
        shN=np.zeros((n, 0, 3), np.float32),
    )


@pytest.fixture
def clumps() -> np.ndarray:
    """A dense ball of 3,000, a string of 40 next to it, two single splats far away."""
    rng = np.random.default_rng(1)
    ball = rng.normal(0, 1, (3000, 3))
    ball *= np.cbrt(rng.uniform(0, 1, (3000, 1))) / np.linalg.norm(ball, axis=1, keepdims=True)
    string = np.stack([np.linspace(1.5, 2.0, 40), np.zeros(40), np.zeros(40)], axis=1)
    return np.concatenate([ball, string, [[0, 9, 0], [0, -9, 0]]])


def test_separate_groups_are_clusters(clumps: np.ndarray) -> None:
    """Oracle: the construction of the scene."""
    sizes = cluster_sizes(small(clumps), 0.25)
    assert sizes.tolist() == [3000] * 3000 + [40] * 40 + [1, 1]


def test_a_large_splat_joins_what_it_reaches(clumps: np.ndarray) -> None:
    """Oracle: the same scene with one splat of the string as a needle that points at the ball;
    turned away, it joins no cluster."""
    splats = small(clumps)
    scales = splats.scales.copy()
    scales[3000, 0] = np.log(0.35)
    assert cluster_sizes(replace(splats, scales=scales), 0.25)[3000] == 3040
    quats = splats.quats.copy()
    quats[3000] = np.sqrt(0.5), 0, 0, np.sqrt(0.5)  # a quarter around z
    turned = replace(splats, scales=scales, quats=quats)
    assert cluster_sizes(turned, 0.25)[3000] == 40


def test_a_background_far_away_hangs_together() -> None:
    """Oracle: a shell of 2,000 touching splats at 40 times the size of the scene, one cluster but
    for a few; separate clusters for small splats."""
    rng = np.random.default_rng(2)
    directions = rng.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    means = np.concatenate([rng.uniform(-1, 1, (5000, 3)), 40 * directions])
    sizes = np.concatenate([np.full(5000, 0.02), np.full(2000, 2.0)])
    splats = replace(small(means), scales=np.log(np.tile(sizes[:, None], 3)).astype(np.float32))
    assert (cluster_sizes(splats, 0.05)[5000:] > 1990).mean() > 0.995
    assert cluster_sizes(small(means), 0.05)[5000:].max() < 1000


def test_a_wall_of_few_large_splats_is_no_floater(clumps: np.ndarray) -> None:
    """Oracle: the scene with six flat round splats of radius 3, turned at random in their plane,
    that overlap in a wall next to the ball."""
    rng = np.random.default_rng(5)
    wall = np.stack([np.full(6, -2.5), np.repeat([-1.5, 1.5], 3), np.tile([-2.0, 0, 2], 2)], axis=1)
    splats = small(np.concatenate([clumps, wall]))
    scales, quats = splats.scales.copy(), splats.quats.copy()
    scales[-6:, 1:] = np.log(1.5)
    half = rng.uniform(0, np.pi, 6)
    quats[-6:] = np.stack([np.cos(half), np.sin(half), 0 * half, 0 * half], axis=1)
    sizes = cluster_sizes(replace(splats, scales=scales, quats=quats), 0.05)
    assert sizes[-6:].tolist() == [6] * 6
    assert sizes[3040:-6].tolist() == [1, 1]


def test_enclosing_sky_belongs_to_the_scene(clumps: np.ndarray) -> None:
    """Oracle: the scene within a sky of one splat with its middle far away; a smaller sky does not
    reach it."""
    splats = small(np.concatenate([clumps, [[0, 0, 50.0]]]))
    scales = splats.scales.copy()
    scales[-1] = np.log(40)
    assert cluster_sizes(replace(splats, scales=scales), 0.25)[-1] > 3000
    scales[-1] = np.log(15)
    assert cluster_sizes(replace(splats, scales=scales), 0.25)[-1] == 1


def test_place_size_and_order_do_not_matter(make_splats: Make) -> None:
    """Oracle: the same splats moved by cells, scaled and shuffled."""
    splats = make_splats(3000, spread=3.0)
    splats = replace(splats, scales=splats.scales - 2)
    wanted = cluster_sizes(splats, 0.05)
    assert len(np.unique(wanted)) > 5
    order = np.random.default_rng(0).permutation(3000)
    np.testing.assert_array_equal(cluster_sizes(splats.subset(order), 0.05), wanted[order])
    doubled = replace(splats, means=splats.means * 2, scales=splats.scales + np.float32(np.log(2)))
    np.testing.assert_array_equal(cluster_sizes(doubled, 0.05), wanted)


@pytest.mark.parametrize("edges", [0, 300, 700, 5000])
def test_components_equal_scipy(edges: int) -> None:
    """Oracle: scipy's connected components of random graphs, and of a chain in random order."""
    rng = np.random.default_rng(edges)
    first, second = rng.integers(0, 1000, (2, edges))
    if edges == 700:
        nodes = rng.permutation(701)
        first, second = nodes[:-1], nodes[1:]
    graph = coo_array((np.ones(edges), (first, second)), shape=(1000, 1000))
    wanted = connected_components(graph, directed=False)[1]
    got = _merged(np.arange(1000), first, second)
    pairs = set(zip(got.tolist(), wanted.tolist(), strict=True))
    assert len(pairs) == len(set(got.tolist())) == len(set(wanted.tolist()))


@pytest.mark.parametrize("count", [0, 1, 3])
def test_few_splats(count: int) -> None:
    """Oracle: by hand; copies in one place are one cluster."""
    assert cluster_sizes(small(np.ones((count, 3))), 0.05).tolist() == [count] * count


@pytest.mark.parametrize("gap", [0.05, 0.35, 0.45])
def test_touching_cells_are_connected(gap: float) -> None:
    """Oracle: scipy's components of the graph of touching cells, built explicitly."""
    rng = np.random.default_rng(3)
    means = rng.uniform(-5, 5, (3000, 3)).astype(np.float32)
    seeds = np.arange(3000) < 2
    cells = np.floor((means - np.median(means[seeds].astype(np.float64), axis=0)) / gap)
    touch = np.abs(cells[:, None] - cells[None]).max(axis=2) <= 1
    labels = connected_components(coo_array(touch))[1]
    got = reached_from(means, seeds, gap)
    np.testing.assert_array_equal(got, np.isin(labels, labels[seeds]))
    assert not reached_from(means, np.zeros(3000, bool), gap).any()


def test_two_clouds_with_a_gap_between() -> None:
    """Oracle: the construction, far from the origin, and cells that close the gap."""
    rng = np.random.default_rng(4)
    cloud = rng.uniform(0, 1, (4000, 3))
    means = np.concatenate([cloud, cloud + np.array([3.0, 0, 0])]) + 1000
    seeds = np.arange(8000) == 17
    np.testing.assert_array_equal(reached_from(means, seeds, 0.5), np.arange(8000) < 4000)
    assert reached_from(means, seeds, 2.5).all()
