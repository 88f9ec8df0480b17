"""Maps aligned jointly: derivatives against differences of the sum, and predicted errors."""

import numpy as np
import pytest

from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.depth import consensus, joint
from gscore.depth.fit import Fit
from gscore.depth.fitting import find_kind
from gscore.depth.maps import MapFolder
from gscore.depth.observations import observations
from gscore.depth.samples import view_samples


def samples_of(planes):
    config = DataConfig(source=planes.folder, depths="depths", resolution=1)
    dataset = load_dataset(config)
    folder = MapFolder(planes.folder / "depths")
    maps = [folder.find(name) for name in dataset.names]
    found = view_samples(maps, observations(config, dataset), dataset)
    kind, _ = find_kind(found)
    return [part.inverse(kind) for part in found if part is not None], dataset.scene.cameras


def smooth(path, inverse):
    """Another scale for each map, and 2 % of slow waves."""
    number = int(path.stem[-1])
    rows, columns = np.mgrid[: inverse.shape[0], : inverse.shape[1]]
    waves = 0.02 * np.sin(columns / 11 + number) * np.cos(rows / 13 - number)
    np.save(path, ((1 + number) * inverse * (1 + waves) - 0.1).astype(np.float32))


def true_logs(planes, web):
    """Logs of the inverse depths at the ends of `smooth` maps without their waves."""
    ends = [
        [(value + 0.1) / (1 + k) for value in (depth_map.low, depth_map.high)]
        for k, depth_map in enumerate(web.depth_maps)
    ]
    return np.log(ends)


@pytest.fixture
def web(make_planes):
    planes = make_planes(reach=(0.2, 0.32))
    planes.write_maps(smooth)
    maps, cameras = samples_of(planes)
    views, web = consensus._web(maps, cameras)
    assert views == list(range(5)) and all(len(others) == 4 for others in web.neighbours)
    return planes, web


def test_slope_is_that_of_the_sum(web):
    """Oracle: central differences of the sum over all ten unknowns, near the truth and off it."""
    planes, web = web
    rng = np.random.default_rng(0)
    for off in (0.02, 0.2):
        logs = true_logs(planes, web) + off * rng.normal(size=(5, 2))
        typical = float(np.median(logs[:, 1] - logs[:, 0]))

        def total(flat, typical=typical):
            return joint._linearised(web, flat.reshape(5, 2), 0.4, typical).total(0.0)

        slope = joint._linearised(web, logs, 0.4, typical).slope
        step = 1e-5
        for k in range(10):
            moved = step * np.eye(10)[k]
            difference = (total(logs.ravel() + moved) - total(logs.ravel() - moved)) / (2 * step)
            assert slope[k] == pytest.approx(difference, rel=0.05, abs=0.02 * np.abs(slope).max())


def test_from_afar_to_the_truth(web):
    """Oracle: the planes; the ends of each map start 30 to 60 % off."""
    planes, web = web
    truth = true_logs(planes, web)
    wrong = truth + np.array([[0.5, -0.3], [-0.4, 0.3], [0.3, 0.3], [-0.5, 0.2], [0.4, 0.1]])
    _, logs = joint.place(web, wrong, factors=(4.0, 2.0, 1.0))
    assert np.abs(logs - truth).max() < 0.05


def test_errors_are_foretold(web):
    """Oracle: the planes; errors of the ends within three of the stated standard errors."""
    planes, web = web
    truth = true_logs(planes, web)
    _, logs = joint.place(web, truth)
    deviations = np.sqrt(np.diagonal(joint.covariances(web, logs), axis1=1, axis2=2))
    assert (deviations < 0.3).all() and (deviations > 1e-3).all()
    assert (np.abs(logs - truth) < 3 * deviations).all()


def test_an_end_nobody_shows_is_uncertain(web):
    """Oracle: a map compared with no other, with points at its near end: a larger error of its far
    end than with other maps; the fit's errors at both ends from the covariance."""
    planes, web = web
    truth = true_logs(planes, web)
    together = joint.covariances(web, truth)
    alone = joint.covariances(web.only([2]), truth[[2]])[0]
    assert alone[0, 0] > 1.5 * together[2, 0, 0]
    depth_map = web.depth_maps[2]
    numbers = depth_map.uncertainty(np.exp(truth[2]), together[2])
    scale, offset = depth_map.line(np.exp(truth[2]))
    fit = Fit(scale=scale, offset=offset, **numbers)
    expected = np.sqrt(np.diagonal(together[2]))
    assert fit.relative_error(np.array([depth_map.low, depth_map.high])) == pytest.approx(
        expected, rel=1e-4
    )
