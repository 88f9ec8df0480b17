"""S22, S34, SSIM: the image loss with its gradient, and the metrics."""

from collections.abc import Iterator
from typing import Literal

import numpy as np

from ..shared_constants import SSIM_C1, SSIM_C2
from .case import EmptyTestError, Measure, case


def _pairs(full: bool) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Names, float32 images and uint8 targets."""
    rng = np.random.default_rng(2200)

    def noise(h: int, w: int) -> np.ndarray:
        return rng.random((h, w, 3)).astype(np.float32)

    checker = (np.indices((40, 44)).sum(0) % 2).repeat(3).reshape(40, 44, 3)
    white = np.full((48, 40, 3), 250, np.uint8)
    flat = np.full((30, 30, 3), 0.25, np.float32)
    yield "constant", flat, np.full((30, 30, 3), 191, np.uint8)
    yield "black", flat * 0, np.zeros((30, 30, 3), np.uint8)
    yield "checkers", checker.astype(np.float32), (255 * (1 - checker)).astype(np.uint8)
    yield "white wall", (0.98 + 0.002 * rng.normal(size=white.shape)).astype(np.float32), white
    yield "beyond 0 to 1", 3 * noise(33, 37) - 1, (noise(33, 37) * 255).astype(np.uint8)
    sizes = [(8, 8), (1, 1), (5, 70), (67, 35)]
    for h, w in [*sizes, (300, 260), (1, 400), (400, 1)] if full else sizes:
        yield f"{w} x {h}", noise(h, w), (noise(h, w) * 255).astype(np.uint8)


@case("S22", "image loss")
def loss_by_autograd(full: bool) -> Iterator[Measure]:
    """Oracle: the loss in float64 torch, with its autograd.

    Flat pictures have a larger tolerance: their variances are zero, and the float32 error of
    E[d^2] - E[d]^2, 3e-8 for d = 0.5, is divided by C2 = 9e-4.
    """
    import torch

    from ..raster import loss
    from ..raster.reference import image_loss_reference

    rng = np.random.default_rng(2201)
    moved = False
    for name, image, target in _pairs(full):
        masks = {"none": None, "composite": 1.0, "ignore": 1.0, "empty mask": 0.0}
        for mode, share in masks.items():
            mask = None
            if share is not None:
                soft = (rng.random(image.shape[:2]) * 255 * share).astype(np.uint8)
                mask = torch.from_numpy(soft)
            options = {
                "mask": mask,
                "mask_mode": "ignore" if share == 0 else mode,
                "background": (0.2, 0.5, 0.9),
            }
            exact = torch.from_numpy(image.astype(np.float64)).requires_grad_()
            true, ssim = image_loss_reference(exact, torch.from_numpy(target), **options)
            true.backward()
            leaf = torch.from_numpy(image.copy()).requires_grad_()
            found = loss.image_loss(leaf, torch.from_numpy(target), **options)
            found.loss.backward()
            assert exact.grad is not None and leaf.grad is not None
            flat = name in ("constant", "white wall")
            kind = " of flat pictures" if flat else ""
            yield Measure(
                f"loss{kind}", abs(found.loss.item() - true.item()), 5e-6 if flat else 1e-6
            )
            yield Measure(
                f"SSIM{kind}", abs(found.ssim - ssim.item()), 3e-5 if flat else 1e-6, name
            )
            # At x = y the derivative of |x - y| is any value between -1 and 1.
            kink = np.abs(image - target.astype(np.float64) / 255) < 1e-6
            gradient = exact.grad.numpy()
            error = np.where(kink, 0, np.abs(leaf.grad.numpy() - gradient))
            scale = max(float(np.abs(gradient).max()), 1 / image.size)
            bound = 1e-4 if flat else 1e-5
            yield Measure(f"gradient{kind}", float(error.max()) / scale, bound, name)
            moved |= bool(np.abs(gradient).max() > 0)
    target = (rng.random((40, 50, 3)) * 255).astype(np.uint8)
    same = torch.from_numpy(target).float() * (1 / 255)
    found = loss.image_loss(same, torch.from_numpy(target))
    yield Measure("identical pictures, 1 - SSIM", abs(1 - found.ssim), 1e-7)
    if not moved:
        raise EmptyTestError("all gradients are zero")


@case("S34", "metrics of 8-bit pictures", per_isa=False, needs=("scipy",))
def metrics(full: bool) -> Iterator[Measure]:
    """Oracle: PSNR and SSIM from their definitions, one window at a time."""
    from ..metrics.image import psnr_u8, ssim

    rng = np.random.default_rng(3400)
    taps = np.exp(-((np.arange(11) - 5) ** 2) / (2 * 1.5**2))
    window = np.outer(taps, taps) / taps.sum() ** 2
    for seed in range(6 if full else 2):
        h, w = 24 + seed, 31
        smooth = np.add.outer(np.linspace(0, 0.6, h), np.linspace(0, 0.4, w))[..., None]
        a = np.clip((smooth + 0.1 * rng.normal(size=(h, w, 3))) * 255, 0, 255).astype(np.uint8)
        b = np.clip(a + 20.0 * rng.normal(size=a.shape), 0, 255).astype(np.uint8)
        squares = sum((int(x) - int(y)) ** 2 for x, y in zip(a.flat, b.flat, strict=True))
        decibels = 10 * np.log10(255**2 / (squares / a.size))
        yield Measure("PSNR, dB", abs(psnr_u8(a, b) - decibels), 1e-4)
        cases: tuple[tuple[Literal["zero", "valid"], int], ...] = (("zero", 5), ("valid", 0))
        for padding, edge in cases:
            x, y = (np.pad(v / 255.0, ((edge, edge), (edge, edge), (0, 0))) for v in (a, b))
            values = [
                _one_window(x[i : i + 11, j : j + 11, c], y[i : i + 11, j : j + 11, c], window)
                for i in range(x.shape[0] - 10)
                for j in range(x.shape[1] - 10)
                for c in range(3)
            ]
            error = abs(ssim(a, b, padding=padding) - float(np.mean(values)))
            yield Measure(f"SSIM, {padding}", error, 1e-5)


def _one_window(x: np.ndarray, y: np.ndarray, window: np.ndarray) -> float:
    mx, my = (window * x).sum(), (window * y).sum()
    vx, vy = (window * (x - mx) ** 2).sum(), (window * (y - my) ** 2).sum()
    cov = (window * (x - mx) * (y - my)).sum()
    top = (2 * mx * my + SSIM_C1) * (2 * cov + SSIM_C2)
    return top / ((mx * mx + my * my + SSIM_C1) * (vx + vy + SSIM_C2))
