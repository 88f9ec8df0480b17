"""Splits; oracle: closed forms, eigenvectors and the covariance of many children."""

from collections.abc import Callable

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from gscore.engine.cpu.model import CpuModel
from gscore.trainer.strategy import default as splitting

Make = Callable[..., CpuModel]


def test_split_draws_from_the_splat(marked_model: Make) -> None:
    """Oracle: the covariance R S^2 R^T, estimated from many children."""
    model = marked_model(1)
    quat = torch.tensor([[0.9, 0.3, -0.2, 0.4]])
    scale = torch.tensor([[0.5, 0.1, 0.02]])
    zeros = torch.zeros_like(quat)
    model.replace("quats", quat * 3, zeros, zeros)
    model.replace("scales", scale.log(), torch.zeros(1, 3), torch.zeros(1, 3))
    many = torch.zeros(20_000, dtype=torch.int64)
    children = splitting.split(model.params, many, torch.Generator().manual_seed(0))
    assert len(children["means"]) == 40_000
    torch.testing.assert_close(children["scales"][7], (scale[0] / 1.6).log())
    w, x, y, z = (quat[0] / quat[0].norm()).tolist()
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    expected = R @ np.diag(scale[0].numpy() ** 2) @ R.T
    found = np.cov(children["means"].numpy().T.astype(np.float64))
    np.testing.assert_allclose(found, expected, atol=0.01 * expected.max())


def test_halves_lie_side_by_side_along_the_longest_axis(marked_model: Make) -> None:
    """Oracle: the eigenvector of the largest eigenvalue of R S^2 R^T as the axis."""
    model = marked_model(2)
    quats = torch.tensor([[0.9, 0.3, -0.2, 0.4], [-0.1, 0.7, 0.6, 0.2]])
    scales = torch.tensor([[0.5, 0.1, 0.02], [0.03, 0.04, 0.9]])
    model.replace("quats", quats * 3, torch.zeros(2, 4), torch.zeros(2, 4))
    model.replace("scales", scales.log(), torch.zeros(2, 3), torch.zeros(2, 3))
    before = {name: p.clone() for name, p in model.params.items()}
    halves = splitting.halve(model.params, torch.tensor([0, 1]))
    assert all((p == before[name]).all() for name, p in model.params.items())
    for row in range(2):
        R = Rotation.from_quat(quats[row].numpy(), scalar_first=True).as_matrix()
        covariance = R @ np.diag(scales[row].numpy().astype(np.float64) ** 2) @ R.T
        values, vectors = np.linalg.eigh(covariance)
        offsets = (halves["means"][row::2] - before["means"][row]).numpy()
        np.testing.assert_allclose(offsets[0], -offsets[1], atol=1e-6)
        along = abs(offsets[0] @ vectors[:, 2])
        np.testing.assert_allclose(along, splitting.HALF_OFFSET * np.sqrt(values[2]), rtol=1e-4)
        np.testing.assert_allclose(np.linalg.norm(offsets[0]), along, rtol=1e-5)
        factors = (halves["scales"][row::2] - before["scales"][row]).exp()
        expected = np.full((2, 3), splitting.HALF_WIDTH)
        expected[:, scales[row].argmax()] = splitting.HALF_LENGTH
        np.testing.assert_allclose(factors.numpy(), expected, rtol=1e-5)
        opacity = splitting.HALF_OPACITY * torch.sigmoid(before["opacities"][row])
        torch.testing.assert_close(torch.sigmoid(halves["opacities"][row::2]), opacity.expand(2))
    assert set(halves) == {"means", "scales", "opacities"}


def test_halves_of_splats_without_bounds_are_numbers(marked_model: Make) -> None:
    """Oracle: finite logits for opacities of 0 and 1, and some longest axis of a ball."""
    model = marked_model(2)
    model.params["opacities"].copy_(torch.tensor([-200.0, 200.0]))
    model.params["scales"].zero_()
    halves = splitting.halve(model.params, torch.tensor([0, 1]))
    assert all(rows.isfinite().all() for rows in halves.values())
