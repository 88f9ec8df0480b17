"""Refits on devices in software; oracles: the CPU's, torch's gradients by the CPU."""

from typing import Any

import numpy as np
import pytest
import torch

from gscore.errors import BackendError
from gscore.raster.autograd import rasterize
from gscore.raster.gpu.choice import CPU, Chosen
from gscore.raster.gpu.devices import Device
from gscore.raster.gpu.gpu_raster import opened
from gscore.raster.request import Frustum
from gscore.splats import Splats
from gscore.stress.capture import toy_photos, toy_splats
from gscore.trainer.photos.view_sampler import training_camera
from gscore.viewers.refit import RefitSettings, refit, tensors_of
from gscore.viewers.rules import VIEWERS


def _views(count: int) -> list[Frustum]:
    cameras = toy_photos(size=40).scene.cameras
    sizes = zip(cameras.widths.tolist(), cameras.heights.tolist(), strict=True)
    found = zip(cameras.viewmats, cameras.Ks, sizes, strict=True)
    return [training_camera(viewmat, K, *size, 0.01) for viewmat, K, size in found][:count]


def _gradients(splats: Splats, view: Frustum, device: Any, *, between: bool) -> list[np.ndarray]:
    """Gradients of a sum over a picture; `between`: another view is drawn before they are."""
    tensors = [t.clone().requires_grad_() for t in tensors_of(splats)]

    def draw(frustum: Frustum, given: list[torch.Tensor]) -> torch.Tensor:
        means, quats, scales, opacities, sh0, shN = given
        return rasterize(
            means,
            quats,
            scales,
            opacities,
            sh0,
            shN,
            torch.as_tensor(frustum.viewmat, dtype=torch.float32),
            torch.as_tensor(frustum.K, dtype=torch.float32),
            frustum.width,
            frustum.height,
            raw=True,
            device=device,
        ).rgb

    loss = (draw(view, tensors) ** 2).sum()
    if between:
        draw(_views(2)[1], tensors)
    loss.backward()
    found = [t.grad for t in tensors]
    assert None not in found
    return [g.numpy() for g in found if g is not None]


@pytest.mark.parametrize("between", [False, True])
def test_gradients_of_a_picture_are_the_cpu_s(device: Device, between: bool) -> None:
    """Oracle: the CPU's to 1e-3 of the largest; the same where another view was drawn between."""
    splats, view = toy_splats(count=40), _views(1)[0]
    true = _gradients(splats, view, None, between=False)
    for a, b in zip(_gradients(splats, view, opened(device), between=between), true, strict=True):
        if b.size:
            np.testing.assert_allclose(a, b, atol=1e-3 * np.abs(b).max())


def _refitted(chosen: Chosen) -> Splats:
    settings = RefitSettings(steps=3, antialias=False, device=chosen)
    rules = VIEWERS["blender"]
    return refit(toy_splats(count=40), _views(3), rules, settings, on_step=lambda *_: None)


def test_a_refit_is_the_cpu_s(device: Device) -> None:
    """Oracle: the CPU's refit, within a tenth of a step of Adam."""
    found, true = _refitted(Chosen(device=device)), _refitted(CPU)
    for name, rate in (("scales", 1e-2), ("opacities", 5e-2), ("sh0", 1e-2)):
        np.testing.assert_allclose(getattr(found, name), getattr(true, name), atol=0.1 * rate)
        assert (getattr(found, name) != getattr(toy_splats(count=40), name)).any()


def test_the_cpu_finishes_a_refit(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the CPU's refit from the lost step on, and both names; an error where the device was
    named."""
    monkeypatch.setenv("GSCORE_GPU_FAULT", "lost:3")
    chosen = Chosen(device=device, fallback=True)
    found, true = _refitted(chosen), _refitted(CPU)
    np.testing.assert_allclose(found.opacities, true.opacities, atol=5e-3)
    assert chosen.name == f"{device.name}, then cpu"
    with pytest.raises(BackendError, match="lost"):
        _refitted(Chosen(device=device))
