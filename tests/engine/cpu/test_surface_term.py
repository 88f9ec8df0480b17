"""Surface terms. Oracles: the definition in float64 through the reference rasterizer, central
differences, and walls whose surface is known."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from gscore.bench.synthetic import synthetic_scene
from gscore.engine.base import StepPhoto
from gscore.engine.cpu import surface_term
from gscore.engine.cpu.engine import CpuEngine
from gscore.raster.normals import NormalPicture
from gscore.raster.reference import quat_to_rotmat, rasterize_reference
from gscore.raster.request import Frustum
from gscore.shared_constants import SH_C0
from gscore.splats import PARAMETERS, Splats
from gscore.stress.capture import ToyPhotos
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.trainer import Trainer
from tests.trainer.short_run import CONFIG

GEOMETRY = ("means", "quats", "scales", "opacities")


def tensors_of(splats: Splats, dtype: torch.dtype = torch.float32) -> dict[str, torch.Tensor]:
    return {name: torch.from_numpy(getattr(splats, name)).to(dtype) for name in PARAMETERS}


def photo_of(view: Frustum, mask: np.ndarray | None = None) -> StepPhoto:
    image = np.zeros((view.height, view.width, 3), np.uint8)
    return StepPhoto(image=image, mask=mask, mask_mode="none" if mask is None else "ignore")


def terms_of(
    splats: dict[str, torch.Tensor], view: Frustum, mask: np.ndarray | None = None, **more: Any
) -> surface_term.SurfaceTerms:
    photo = photo_of(view, mask)
    how = {"antialias": False, "threads": 1} | more
    return surface_term.surface_terms(splats, photo, view, 1.0, **how)


def by_definition(tensors: dict[str, torch.Tensor], view: Frustum) -> torch.Tensor:
    """The sum of the terms in float64; differentiable."""
    small = surface_term.smaller(view)
    viewmat, K = torch.as_tensor(small.viewmat), torch.as_tensor(small.K)
    axes = quat_to_rotmat(tensors["quats"])
    scales, order = tensors["scales"].sort(dim=1)
    normals = axes[torch.arange(len(axes)), :, order[:, 0]] @ viewmat[:3, :3].T
    places = tensors["means"] @ viewmat[:3, :3].T + viewmat[:3, 3]
    normals = normals * -torch.sign((normals * places).sum(1, keepdim=True))
    sh0 = normals[:, None] / (2 * SH_C0)  # colours of (normal + 1) / 2
    rest = {"sh0": sh0, "shN": sh0.new_zeros(len(sh0), 0, 3)}
    how: dict[str, Any] = {"raw": True, "depth": True, "inverse_depth": True}
    size = {"width": small.width, "height": small.height}
    drawn = rasterize_reference(**(tensors | rest), viewmat=viewmat, K=K, **size, **how)
    sums = 2 * drawn.rgb - drawn.alpha[..., None]
    picture = NormalPicture(sums, drawn.alpha, drawn.inverse_depth, drawn.depth)
    bent, spread = surface_term.picture_terms(picture, K)
    flat = (scales[:, 0] - scales[:, 1].detach()).exp().mean()
    weights = surface_term.NORMALS, surface_term.DISTORTION, surface_term.FLATNESS
    return weights[0] * bent + weights[1] * spread + weights[2] * flat


def test_gradients() -> None:
    splats, cameras = synthetic_scene(40, 48, 32)
    K, viewmat = (torch.from_numpy(a[0]) for a in (cameras.Ks, cameras.viewmats))
    view = Frustum(viewmat, K, 48, 32)
    exact = tensors_of(splats, torch.float64)
    inputs = {name: exact[name].requires_grad_() for name in GEOMETRY}
    value = by_definition(exact, view)
    expected = torch.autograd.grad(value, list(inputs.values()))
    rng = np.random.default_rng(1)
    with torch.no_grad():
        for name, gradient in zip(GEOMETRY, expected, strict=True):
            direction = torch.from_numpy(rng.normal(size=gradient.shape))
            if name == "scales":  # the middle one has no gradient by definition
                shortest = exact[name].argmin(dim=1, keepdim=True)
                direction = torch.zeros_like(direction).scatter(1, shortest, direction)
            values = []
            for sign in (1, -1):
                moved = exact | {name: exact[name] + sign * 1e-7 * direction}
                values.append(by_definition(moved, view))
            slope = (values[0] - values[1]) / 2e-7
            assert abs(slope - (gradient * direction).sum()) < 1e-4 * abs(slope), name
    single = Frustum(viewmat.float(), K.float(), 48, 32)
    found = terms_of({n: t.detach().float() for n, t in exact.items()}, single)
    assert found.value == pytest.approx(value.item(), rel=1e-4)
    for name, true in zip(GEOMETRY, expected, strict=True):
        assert (found.gradients[name] - true).norm() < 2e-3 * true.norm(), name


def wall(tilt: float = 0.0, depth: float = 0.0) -> dict[str, torch.Tensor]:
    """Opaque flat splats at z = 3, turned by `tilt` out of their plane, every second one `depth`
    in front of it."""
    along = np.indices((41, 41)).reshape(2, -1).T / 10.0 - 2
    near = np.full((len(along), 1), 3.0) - depth * (np.arange(len(along)) % 2)[:, None]
    quat = [np.cos(tilt / 2), np.sin(tilt / 2), 0, 0]
    splats = Splats(
        means=np.concatenate([along, near], axis=1).astype(np.float32),
        quats=np.tile(np.array(quat, np.float32), (len(along), 1)),
        scales=np.tile(np.log([0.08, 0.08, 0.004]).astype(np.float32), (len(along), 1)),
        opacities=np.full(len(along), 2.0, np.float32),
        sh0=np.zeros((len(along), 1, 3), np.float32),
        shN=np.zeros((len(along), 0, 3), np.float32),
    )
    return tensors_of(splats)


VIEW = Frustum(torch.eye(4), torch.tensor([[60.0, 0, 32], [0, 60, 32], [0, 0, 1]]), 64, 64)


def test_a_flat_wall_has_only_its_flatness() -> None:
    ratio = surface_term.FLATNESS * 0.004 / 0.08
    assert terms_of(wall(), VIEW).value == pytest.approx(ratio, abs=2e-5)


def test_turned_splats_and_two_layers_cost() -> None:
    turned, layers = terms_of(wall(tilt=0.5), VIEW), terms_of(wall(depth=0.3), VIEW)
    expected = surface_term.NORMALS * (1 - np.cos(0.5)) * (30 / 32) ** 2
    assert turned.value == pytest.approx(expected, rel=0.2)
    assert layers.value > 20 * terms_of(wall(), VIEW).value


def test_masked_pixels_do_not_count() -> None:
    splats, hidden = wall(tilt=0.5, depth=0.3), np.zeros((64, 64), np.uint8)
    found = terms_of(splats, VIEW, hidden)
    assert all((found.gradients[n] == 0).all() for n in ("means", "quats", "opacities"))
    half = np.where(np.arange(64) < 32, 255, 0).astype(np.uint8)
    left = terms_of(splats, VIEW, np.tile(half, (64, 1))).gradients["quats"].norm(dim=1) > 0
    assert left.any()
    assert splats["means"][left, 0].max() < 0.4  # its own size beyond the middle


def test_tiles_that_are_not_drawn_are_left_out() -> None:
    """Oracle: the picture of all tiles, of which those of the left half are kept."""
    splats = wall(tilt=0.5)
    photo = replace(photo_of(VIEW), tiles=np.array([[1, 1, 0, 0]] * 4, np.uint8))
    how = {"antialias": False, "threads": 1}
    half = surface_term.surface_terms(splats, photo, VIEW, 1.0, **how)
    assert half.value < 0.65 * terms_of(splats, VIEW).value


def test_frozen_splats_hide_others() -> None:
    """Oracle: a wall behind an opaque one has no gradients, and frozen ones are not returned."""
    behind = wall(tilt=0.5)
    behind["means"] = behind["means"] + torch.tensor([0, 0, 2.0])
    front = wall() | {"opacities": torch.full((41 * 41,), 8.0)}
    found = terms_of(behind, VIEW, frozen=front)
    assert found.gradients["quats"].shape == behind["quats"].shape
    alone = terms_of(behind, VIEW).gradients["quats"].abs().sum()
    assert found.gradients["quats"].abs().sum() < 0.05 * alone


def test_a_training_flattens_splats(photos: ToyPhotos) -> None:
    """Oracle: the same training without; and the same one until the terms begin."""
    ratios, losses = [], []
    for weight in (0.0, 10.0):
        config = replace(CONFIG, surface_weight=weight, surface_from=0.5, threads=1)
        trainer = Trainer(config, Analysis(photos=photos), CpuEngine(threads=1))
        losses.append([trainer.step().loss for _ in range(config.iterations)])
        scales = np.sort(trainer.splats().scales, axis=1)
        ratios.append(np.median(np.exp(scales[:, 0] - scales[:, 1])))
    assert losses[0][:30] == losses[1][:30]
    assert losses[0][30] < losses[1][30]
    assert ratios[1] < 0.95 * ratios[0]
