"""Fits by the agreement of maps; oracle: two planes with known inverse depth everywhere."""

from dataclasses import replace

import numpy as np
import pytest

from gscore.config import DataConfig, Switch, TrainConfig
from gscore.datasets import load_dataset
from gscore.depth import fitting, load_priors
from gscore.trainer.depth import rule as depth_rule
from gscore.trainer.depth.setup import prepare_depth

NEAR = (0.25, 0.3)
"""Inverse depths at which SfM has points; the planes also extend farther and nearer."""


def load(planes):
    config = DataConfig(source=planes.folder, depths="depths", resolution=1)
    return load_dataset(config), load_priors(config, load_dataset(config))


def waves(seed: int, size: float):
    """Slow errors of another shape in each map, and another scale and offset."""
    count = iter(range(99))

    def save(path, inverse):
        rng = np.random.default_rng([seed, next(count)])
        rows, columns = np.mgrid[: inverse.shape[0], : inverse.shape[1]]
        angle, phase = rng.uniform(0, 6.3, 2)
        turns = (np.cos(angle) * rows + np.sin(angle) * columns) / rng.uniform(8, 14)
        values = inverse * (1 + size * np.sin(turns + phase))
        np.save(path, (rng.uniform(0.5, 3) * values + rng.uniform(-0.2, 0.2)).astype(np.float32))

    return save


def far_errors(planes, priors) -> list[float]:
    """Mean relative error of each aligned map beyond the points; 1 for a refused one."""
    errors = []
    for i, view in enumerate(priors.views):
        truth = planes.truth(i)
        far = truth < NEAR[0]
        off = np.abs(view.inverse_depth / truth - 1)[far]
        errors.append(float(np.minimum(off, 1).mean()) if view.aligned else 1.0)
    return errors


@pytest.mark.parametrize("seed", [0, 1])
def test_maps_align_maps_without_enough_points(make_planes, monkeypatch, seed):
    """Oracle: the planes. A map that its points alone cannot align is aligned correctly, also where
    it has no points; its fit still counts its own points only."""
    planes = make_planes(reach=NEAR)
    planes.write_maps(waves(seed, 0.03))
    with monkeypatch.context() as alone:
        alone.setattr(fitting, "agreed", lambda fits, maps, cameras: fits)
        _, before = load(planes)
    refused = [i for i, view in enumerate(before.views) if not view.aligned]
    assert refused and max(far_errors(planes, before)) == 1
    _, priors = load(planes)
    assert all(view.aligned for view in priors.views)
    assert max(far_errors(planes, priors)) < 0.06 and np.mean(far_errors(planes, priors)) < 0.04
    for row, old in zip(priors.table, before.table, strict=True):
        assert row["points"] == old["points"] > 20
        assert row["inliers"] > 0.7 * old["inliers"]


def test_held_out_maps_have_no_say(make_planes):
    """Oracle: the same training maps, bit for bit, with other maps of the held-out view."""
    planes = make_planes()
    planes.write_maps(waves(0, 0.03))
    config = DataConfig(
        source=planes.folder, depths="depths", resolution=1, eval=True, test_every=5
    )
    dataset = load_dataset(config)
    (held_out,) = dataset.test
    before = load_priors(config, dataset)
    path = (before.folder / dataset.names[held_out]).with_suffix(".npy")
    np.save(path, 0.2 + 0.6 * np.load(path)[:, ::-1])
    after = load_priors(config, dataset)
    assert before.views[held_out].fit != after.views[held_out].fit
    for i in dataset.train:
        np.testing.assert_array_equal(before.views[i].inverse_depth, after.views[i].inverse_depth)
        np.testing.assert_array_equal(before.views[i].confidence, after.views[i].confidence)
    # In a training that uses this view, it would have one.
    everything = replace(config, eval=False)
    shared = load_priors(everything, load_dataset(everything))
    assert any(shared.views[i].fit != after.views[i].fit for i in dataset.train)


@pytest.mark.parametrize("mode", ["off", "auto"])
def test_unused_maps_are_not_aligned(make_planes, monkeypatch, mode):
    """Oracle: the function that aligns maps, which fails the test where it is called."""

    def called(*_):
        raise AssertionError("maps were placed")

    planes = make_planes()
    planes.write_maps(waves(0, 0.03))
    config = DataConfig(source=planes.folder, depths="depths", resolution=1)
    dataset = load_dataset(config)
    monkeypatch.setattr(fitting, "agreed", called)
    monkeypatch.setattr(depth_rule, "DENSE_VIEWS", 3)
    monkeypatch.setattr(depth_rule, "DENSE_POINTS", 3)
    found = prepare_depth(config, TrainConfig(depth_mode=Switch(mode)), dataset)
    assert not found.supervises and len(found.table) == len(dataset) and found.targets is not None
    with pytest.raises(AssertionError, match="placed"):
        prepare_depth(config, TrainConfig(depth_mode=Switch.ON), dataset)


def test_stored_alignment_is_read_back(make_planes, gscore):
    """Oracle: the alignment itself. depth_params.json has scale and offset alone; their confidence
    is computed again from points and other maps, without another alignment."""
    planes = make_planes(reach=NEAR)
    planes.write_maps(waves(0, 0.03))
    _, aligned = load(planes)
    code, _, _ = gscore("depth", planes.folder)
    assert code == 0 and (planes.folder / "sparse" / "0" / "depth_params.json").is_file()
    _, again = load(planes)
    assert again.warnings == ()
    for old, new in zip(aligned.views, again.views, strict=True):
        assert new.fit.scale == pytest.approx(old.fit.scale, rel=0.05)
        assert abs(float(new.confidence.mean()) - float(old.confidence.mean())) < 0.05


def test_exact_maps_stay_exact(make_planes):
    """Oracle: the planes."""
    planes = make_planes(reach=NEAR)
    planes.write_maps(lambda path, s: np.save(path, (17 * s + 3).astype(np.float32)))
    _, priors = load(planes)
    for i, view in enumerate(priors.views):
        inner = np.s_[2:-2, 2:-2]
        assert view.inverse_depth[inner] == pytest.approx(planes.truth(i)[inner], rel=3e-3)


def test_a_map_of_noise_is_not_talked_into_a_scale(make_planes):
    """Oracle: noise, which has no scale and spoils none of the others."""
    planes = make_planes(reach=NEAR)
    planes.write_maps(waves(5, 0.01))
    rng = np.random.default_rng(0)
    np.save(planes.folder / "depths" / "cam" / "v_2.npy", rng.random((80, 120), np.float32))
    _, priors = load(planes)
    assert [view.aligned for view in priors.views] == [True, True, False, True, True]
    errors = far_errors(planes, priors)
    assert max(errors[i] for i in (0, 1, 3, 4)) < 0.04
