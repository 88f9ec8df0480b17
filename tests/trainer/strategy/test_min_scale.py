"""The sampling rate of photos; oracle: the formula in float64, splat by splat."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gscore.config import DataConfig, TrainConfig
from gscore.engine.cpu.model import CpuModel
from gscore.io.ply.splats import read_ply
from gscore.raster.request import Frustum
from gscore.trainer.run import train
from gscore.trainer.step.step_edits import min_scale_edit, sampling_rates

PIXELS = 2.0
SHORT = TrainConfig(
    iterations=60, max_splats=300, refine_start=10, refine_every=10, grow_grad=1e-5, finest=PIXELS
)


def views() -> list[Frustum]:
    """Cameras at different distances: along z, along -z, and with all splats behind it."""
    found = []
    for turn, back, focal in ((0.0, 4.0, 50.0), (math.pi, 6.0, 90.0), (math.pi / 2, -900.0, 10.0)):
        c, s = math.cos(turn), math.sin(turn)
        viewmat = np.array([[c, 0, s, 0.1], [0, 1, 0, -0.2], [-s, 0, c, back], [0, 0, 0, 1]])
        K = np.array([[focal, 0, 30], [0, 0.8 * focal, 20], [0, 0, 1]])
        found.append(
            Frustum(torch.from_numpy(viewmat).float(), torch.from_numpy(K).float(), 64, 40)
        )
    return found


def rate_of(place: np.ndarray, looks: list[Frustum]) -> float:
    """Mip-Splatting's sampling rate of one place, float64."""
    best = 0.0
    for view in looks:
        viewmat, K = np.asarray(view.viewmat, np.float64), np.asarray(view.K, np.float64)
        x, y, z = viewmat[:3, :3] @ place + viewmat[:3, 3]
        if z <= view.near:
            continue
        u, v = K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]
        beside = -0.15 * view.width < u < 1.15 * view.width
        if beside and -0.15 * view.height < v < 1.15 * view.height:
            best = max(best, K[0, 0] / z)
    return best


@pytest.fixture
def model() -> CpuModel:
    """Four hundred splats about the origin, SH degree 0, axes from far too short to large."""
    rng = np.random.default_rng(7)
    rows = 400
    arrays = {
        "means": rng.normal(size=(rows, 3)) * 3,
        "quats": rng.normal(size=(rows, 4)),
        "scales": rng.uniform(-9, 1, (rows, 3)),
        "opacities": rng.normal(size=rows),
        "sh0": rng.normal(size=(rows, 1, 3)),
        "shN": np.zeros((rows, 0, 3)),
    }
    return CpuModel({name: torch.from_numpy(a).float() for name, a in arrays.items()})


def test_the_rate_is_that_of_the_nearest_photo(model: CpuModel) -> None:
    """Oracle: float64, one place and one camera at a time."""
    found = sampling_rates(model.params["means"], views())
    expected = [rate_of(place, views()) for place in model.params["means"].double().numpy()]
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-5)
    assert 0.1 < np.mean(np.array(expected) == 0) < 0.9  # some are visible, some are not


def test_only_axes_that_are_too_short_change(model: CpuModel) -> None:
    """Oracle: max(axis, pixels / rate) in float64; splats outside all photos, and all else,
    stay."""
    before = {name: p.clone() for name, p in model.params.items()}
    model.edit(min_scale_edit(model.column, views(), PIXELS))
    rates = np.array([rate_of(place, views()) for place in before["means"].double().numpy()])
    axes = np.exp(before["scales"].double().numpy())
    with np.errstate(divide="ignore"):
        floor = np.where(rates > 0, PIXELS / rates, 0.0)
    found = np.exp(model.params["scales"].double().numpy())
    np.testing.assert_allclose(found, np.maximum(axes, floor[:, None]), rtol=1e-5)
    assert (found != axes).any() and (found == axes).any()
    for name in before.keys() - {"scales"}:
        assert torch.equal(before[name], model.params[name])


def test_no_splats_and_no_views_are_no_error(model: CpuModel) -> None:
    """Oracle: unchanged splats."""
    before = model.params["scales"].clone()
    model.edit(min_scale_edit(model.column, [], PIXELS))
    assert torch.equal(before, model.params["scales"])
    assert sampling_rates(torch.zeros(0, 3), views()).shape == (0,)


def test_a_training_ends_within_the_limit(capture: Path, tmp_path: Path) -> None:
    """Oracle: the limit computed in float64 from the training cameras; axes below it without the
    option."""
    from gscore.io.cameras_json import read_cameras_json

    def shortest(config: TrainConfig, out: Path) -> float:
        train(config, DataConfig(source=capture), out)
        cameras, splats = read_cameras_json(out / "cameras.json"), read_ply(out / "point_cloud.ply")
        looks = [
            Frustum(viewmat, K, int(width), int(height))
            for viewmat, K, width, height in zip(
                cameras.viewmats, cameras.Ks, cameras.widths, cameras.heights, strict=True
            )
        ]
        rates = np.array([rate_of(place, looks) for place in splats.means.astype(np.float64)])
        return float((np.exp(splats.scales.min(axis=1)) * rates)[rates > 0].min())

    assert shortest(SHORT, tmp_path / "with") >= PIXELS * (1 - 1e-4)
    assert shortest(replace(SHORT, finest=0.0), tmp_path / "without") < 0.6 * PIXELS


def test_a_run_goes_on_with_the_same_bits(capture: Path, tmp_path: Path) -> None:
    """Oracle: the uninterrupted run."""
    data = DataConfig(source=capture)
    train(SHORT, data, tmp_path / "whole")
    train(replace(SHORT, checkpoint_iterations=(25,)), data, tmp_path / "parts")
    started = next((tmp_path / "parts" / "checkpoints").glob("*25*"))
    for file in (tmp_path / "parts" / "checkpoints").iterdir():
        if file != started:
            file.unlink()
    (tmp_path / "parts" / "point_cloud.ply").unlink()
    train(replace(SHORT, checkpoint_iterations=(25,)), data, tmp_path / "parts", resume=True)
    whole, parts = (tmp_path / name / "point_cloud.ply" for name in ("whole", "parts"))
    assert whole.read_bytes() == parts.read_bytes()
