"""A wall of small splats, wide enough for three levels, and its levels of detail."""

from pathlib import Path

import numpy as np
import pytest

from gscore.io.ply.splats import write_splats
from gscore.lod import groups
from gscore.lod.build import LodFacts, build_lod
from gscore.lod.measure import measured_levels
from gscore.splats import Splats
from tests.run_verb import gscore  # noqa: F401

COUNT = 6000
CHUNK = 400
"""Splats of a chunk in these tests: 16 chunks of 375."""


def wall(count: int = COUNT, seed: int = 5, degree_rest: int = 3) -> Splats:
    """Small discs on the plane z = 0, 8 by 8 wide, in smoothly changing colours."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-4, 4, (count, 3)) * [1, 1, 0.01]
    colors = np.stack([np.sin(places[:, 0]), np.cos(places[:, 1]), np.sin(places[:, 0] + 1)], 1)
    scales = np.log([0.06, 0.06, 0.004]) + rng.normal(0, 0.2, (count, 3))
    quats = np.tile([1.0, 0, 0, 0], (count, 1)) + rng.normal(0, 0.03, (count, 4))
    return Splats(
        means=places.astype(np.float32),
        quats=quats.astype(np.float32),
        scales=scales.astype(np.float32),
        opacities=rng.uniform(0, 4, count).astype(np.float32),
        sh0=colors[:, None].astype(np.float32),
        shN=rng.normal(0, 0.05, (count, degree_rest, 3)).astype(np.float32),
    )


def camera(away: float, width: int = 96, height: int = 64) -> tuple[np.ndarray, np.ndarray]:
    """K and viewmat of a camera at this distance in front of the wall that faces a place off its
    middle."""
    viewmat = np.eye(4)
    viewmat[:3, 3] = 0.4, -0.3, away
    return np.array([[90.0, 0, width / 2], [0, 90.0, height / 2], [0, 0, 1]]), viewmat


@pytest.fixture(scope="session")
def ply(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wall on disk."""
    path = tmp_path_factory.mktemp("wall") / "wall.ply"
    write_splats(path, wall())
    return path


@pytest.fixture(scope="session")
def lod(ply: Path) -> Path:
    """Its levels of detail, with small chunks."""
    path = ply.with_name("wall.lod")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(groups, "MOST_IN_A_CHUNK", CHUNK)
        build_lod(ply, path, LodFacts(near=0.02), measured=measured_levels)
    return path
