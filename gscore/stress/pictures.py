"""S3 to S6, S24 and S25, pictures: float32 compared to the float64 reference; spherical harmonics,
opacity compensation of splats far below a pixel. S22, S34: the image loss with its gradient, and
the metrics."""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from ..raster.gpu.gpu_loss import gpu_image_loss
from ..raster.gpu.gpu_raster import GpuRaster
from ..shared_constants import SSIM_C1, SSIM_C2
from . import native, truth
from .case import EmptyTestError, Measure, case
from .compare import (
    different_bits,
    gradient_measures,
    picture_measures,
    require_covered,
    row_errors,
)
from .scenes import SplatScene, draw_scene
from .truth import Truth


@lru_cache(maxsize=24)
def _random(seed: int, full: bool) -> tuple[SplatScene, Truth]:
    count, size = (10_000, (0.4, 3.0)) if full else (1200, (0.9, 4.0))
    scene = draw_scene(
        seed,
        count=count,
        width=64 if full else 48,
        height=48 if full else 40,
        focal=(60.0, 57.0),
        sigma_px=size,
        logits=(-4.0, 2.0) if full else (-1.5, 2.0),
        overscan=0.05,
        sh_degree=1 if full else 3,
    )
    return scene, truth.reference_truth(scene)


def _seeds(full: bool) -> range:
    return range(400, 420 if full else 402)


@case("S03", "random scenes, pictures", on_device=True)
def random_pictures(full: bool) -> list[Measure]:
    """Oracle: the reference outside the boundary band, flips counted inside."""
    found = []
    for seed in _seeds(full):
        scene, true = _random(seed, full)
        found += picture_measures(native.draw(scene), true)
    return found


@case("S04", "random scenes, gradients", on_device=True)
def random_gradients(full: bool) -> list[Measure]:
    """Oracle: the reference's autograd; errors relative to the rows of the true gradient."""
    found = []
    for seed in _seeds(full):
        scene, true = _random(seed, full)
        found += gradient_measures(native.draw(scene, true.weights), true)
    return found


@lru_cache(maxsize=4)
def _off_screen(seed: int) -> tuple[SplatScene, Truth]:
    scene = draw_scene(
        seed,
        count=400,
        width=64,
        height=48,
        focal=(40.0, 44.0),
        center=(9.5, 41.25),
        overscan=2.0,  # slopes up to five half fields of view
        sigma_px=(8.0, 60.0),
        logits=(-3.0, 1.0),
        sh_degree=1,
    )
    return scene, truth.reference_truth(scene)


@case("S05", "splats far off screen, principal point off centre", on_device=True)
def off_screen(full: bool) -> Iterator[Measure]:
    """Oracle: the reference, whose Jacobian is clamped separately on each side."""
    for seed in range(500, 503 if full else 501):
        scene, true = _off_screen(seed)
        drawn = native.draw(scene, true.weights)
        yield from picture_measures(drawn, true)
        yield from gradient_measures(drawn, true)
        both = (drawn.radii > 0) & (true.projected["depths"] > 0)
        if both.sum() < 50:
            raise EmptyTestError(f"only {both.sum()} splats reach the picture")
        errors = row_errors(drawn.projected["conics"][both], true.projected["conics"][both])
        yield Measure("conics, median", float(np.median(errors)), 2.3e-6)
        yield Measure("conics, largest", float(errors.max()), 1e-4)


@lru_cache(maxsize=8)
def _needles(ratio: float) -> tuple[SplatScene, Truth]:
    scene = draw_scene(
        600, count=160, width=64, height=48, sigma_px=(10.0, 30.0), logits=(0.0, 4.0), sh_degree=0
    )
    scales = scene.scales.copy()
    scales[:, 1:] = scales[:, :1] - np.float32(np.log(ratio))
    scene = scene.with_row(slice(None), scales=scales)
    return scene, truth.reference_truth(scene)


@case("S06", "needles", on_device=True)
def needles(full: bool) -> Iterator[Measure]:
    """Oracle: the reference; axes 1 : 1e4 to 1 : 1e6 in all orientations."""
    for ratio in (1e4, 1e5, 1e6):
        scene, true = _needles(ratio)
        drawn = native.draw(scene, true.weights)
        yield Measure("numbers not finite", float(not drawn.finite()), 0)
        # Means are about 5e-7; determinants with cancellation would make them 1.3e-6 and more.
        pictures = picture_measures(drawn, true, mean=1e-6)
        for m in (*pictures, *gradient_measures(drawn, true)):
            yield replace(m, what=f"1 : {ratio:.0e}, {m.what}")
    # So long that float32 squares lose the width: only finiteness is required.
    for pixels in (1e6, 1e8, 1e10):
        scene = _needles(1e4)[0]
        longer = np.array([np.log(pixels / 20), 0, 0], np.float32)
        scene = scene.with_row(slice(None), scales=scene.scales + longer)
        drawn = native.draw(scene, native.random_weights(scene, 0))
        require_covered(drawn.pictures["alpha"])
        yield Measure(f"{pixels:.0e} px long, not finite", float(not drawn.finite()), 0)


def _seen_by(scene: SplatScene, others: SplatScene) -> SplatScene:
    """Splats in camera coordinates, moved to the world of `scene`."""
    means = (others.means - scene.viewmat[:3, 3]) @ scene.viewmat[:3, :3]
    return others.with_row(slice(None), means=means)


@lru_cache(maxsize=8)
def _dots(low: float, high: float, logits: tuple[float, float]) -> tuple[SplatScene, Truth]:
    scene = draw_scene(
        2500, count=1500, width=32, height=28, sigma_px=(low, high), logits=logits, sh_degree=0
    )
    back = draw_scene(2503, count=40, width=32, height=28, sh_degree=0, posed=False)
    scene = scene.joined(_seen_by(scene, back))
    return scene, truth.reference_truth(scene, antialias=True)


@case("S25", "anti-aliased dots", on_device=True)
def dots(full: bool) -> Iterator[Measure]:
    """Oracle: the reference, whose gradient passes through the factor above its floor."""
    for name, low, high in (("0.15 to 0.6 px", 0.15, 0.6), ("1e-3 to 0.5 px", 1e-3, 0.5)):
        # Splats with high opacity, and a backdrop that fills the picture.
        scene, true = _dots(low, high, (3.0, 6.0))
        drawn = native.draw(scene, true.weights, antialias=True)
        factor = true.projected["opacities"] * (1 + np.exp(-scene.opacities.astype(np.float64)))
        if not (factor[factor > 0] < 0.5).any():
            raise EmptyTestError("nothing is compensated")
        for m in (*picture_measures(drawn, true), *gradient_measures(drawn, true)):
            yield replace(m, what=f"{name}, {m.what}")
        yield Measure("numbers not finite", float(not drawn.finite()), 0)
    tiny = draw_scene(
        2501, count=400, width=32, height=28, sigma_px=(1e-9, 1e-4), logits=(5.0, 9.0)
    )
    big = draw_scene(2502, count=60, width=32, height=28, posed=False)
    floor = tiny.joined(_seen_by(tiny, big))
    drawn = native.draw(floor, native.random_weights(floor, 1), antialias=True)
    yield Measure("numbers not finite", float(not drawn.finite()), 0)


def _around(seed: int) -> SplatScene:
    """Splats in all viewing directions, including the poles of the harmonics."""
    scene = draw_scene(seed, count=40, width=32, height=28, sh_degree=4)
    rotation = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    axes = np.eye(3)[seed % 3] * (1 if seed % 2 else -1)
    # A camera at the origin along a world axis: the middle of the picture is a pole.
    view = np.eye(4, dtype=np.float32)
    other = np.roll(axes, 1)
    view[:3, :3] = np.stack([other, np.cross(axes, other), axes]).astype(np.float32)
    cam = scene.means @ scene.viewmat[:3, :3].T + scene.viewmat[:3, 3]
    cam[0] = [0, 0, 2.5]
    means = (cam @ view[:3, :3]).astype(np.float32)
    return replace(scene, means=means, viewmat=view)


@case("S24", "spherical harmonics", on_device=True)
def harmonics(full: bool) -> Iterator[Measure]:
    """Oracle: the reference; truncated coefficients, bit for bit, for lower degrees."""
    clamped = 0
    for seed in range(2400, 2406):
        scene = _around(seed)
        for degree in range(5):
            true = truth.reference_truth(scene, sh_degree=degree, weigh=("rgb",))
            drawn = native.draw(scene, true.weights, sh_degree=degree)
            seen = (drawn.radii > 0) & (true.projected["depths"] > 0)
            colors = true.projected["colors"][seen]
            clamped += int((colors == 0).sum())
            error = np.abs(drawn.projected["colors"][seen] - colors) / np.maximum(1, colors)
            if seen.sum() < 20 or not drawn.radii[0]:
                raise EmptyTestError("too few splats, or none at the pole, are visible")
            yield Measure("colours", float(error.max()), 1e-6)
            yield from picture_measures(drawn, true)
            yield from gradient_measures(drawn, true)
            rest = (degree + 1) ** 2 - 1
            less = replace(scene, shN=scene.shN[:, :rest])
            short = native.draw(less, true.weights)
            changed = different_bits(drawn.pictures, short.pictures)
            above = np.count_nonzero(drawn.gradients["shN"][:, rest:])
            yield Measure("a lower degree is a prefix, bits changed", float(changed + above), 0)
    if clamped < 5:
        raise EmptyTestError("no colour is clamped at zero")


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


def _image_loss(
    image: np.ndarray, target: np.ndarray, *, mask: Any = None, gain: Any = None, **options: Any
) -> tuple[float, float, np.ndarray]:
    """Loss, SSIM and gradient [H, W, 3], of the device, of `image_loss`, or with a gain of
    `image_loss_gradient`."""
    import torch

    from ..raster import loss

    if native.draws_on_device():
        with native.workspace() as raster:
            assert isinstance(raster, GpuRaster)
            words = None if mask is None else mask.numpy()
            on_device = gpu_image_loss(raster, image, target, mask=words, gain=gain, **options)
        return on_device.loss, on_device.ssim, on_device.v_image
    if gain is not None:
        v_image, shown = torch.empty(image.shape), torch.from_numpy(image)
        options |= {"mask": mask, "gain": torch.tensor(gain)}
        values = loss.image_loss_gradient(shown, torch.from_numpy(target), v_image, **options)
        return values.loss, values.ssim, v_image.numpy()
    leaf = torch.from_numpy(image.copy()).requires_grad_()
    found = loss.image_loss(leaf, torch.from_numpy(target), mask=mask, **options)
    found.loss.backward()
    assert leaf.grad is not None
    return found.loss.item(), found.ssim, leaf.grad.numpy()


@case("S22", "image loss", on_device=True)
def loss_by_autograd(full: bool) -> Iterator[Measure]:
    """Oracle: the loss in float64 torch, with its autograd.

    Flat pictures have a larger tolerance: their variances are zero, and the float32 error of
    E[d^2] - E[d]^2, 3e-8 for d = 0.5, is divided by C2 = 9e-4.
    """
    import torch

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
            options: dict[str, Any] = {
                "mask": mask,
                "mask_mode": "ignore" if share == 0 else mode,
                "background": (0.2, 0.5, 0.9),
            }
            exact = torch.from_numpy(image.astype(np.float64)).requires_grad_()
            true, ssim = image_loss_reference(exact, torch.from_numpy(target), **options)
            true.backward()
            found, found_ssim, found_gradient = _image_loss(image, target, **options)
            assert exact.grad is not None
            flat = name in ("constant", "white wall")
            kind = " of flat pictures" if flat else ""
            yield Measure(f"loss{kind}", abs(found - true.item()), 5e-6 if flat else 1e-6)
            yield Measure(
                f"SSIM{kind}", abs(found_ssim - ssim.item()), 3e-5 if flat else 1e-6, name
            )
            # At x = y the derivative of |x - y| is any value between -1 and 1.
            kink = np.abs(image - target.astype(np.float64) / 255) < 1e-6
            gradient = exact.grad.numpy()
            error = np.where(kink, 0, np.abs(found_gradient - gradient))
            scale = max(float(np.abs(gradient).max()), 1 / image.size)
            bound = 1e-4 if flat else 1e-5
            yield Measure(f"gradient{kind}", float(error.max()) / scale, bound, name)
            moved |= bool(np.abs(gradient).max() > 0)
    yield from _exposed_losses(rng)
    target = (rng.random((40, 50, 3)) * 255).astype(np.uint8)
    found_ssim = _image_loss(target * np.float32(1 / 255), target)[1]
    yield Measure("identical pictures, 1 - SSIM", abs(1 - found_ssim), 1e-7)
    if not moved:
        raise EmptyTestError("all gradients are zero")


def _exposed_losses(rng: np.random.Generator) -> Iterator[Measure]:
    """Losses with gains, of pictures partly in the dark and below zero, with and without masks."""
    import torch

    from ..raster.reference import image_loss_reference

    gain = (0.6, 1.0, 1.5)
    image = (rng.random((33, 37, 3)) - 0.05).astype(np.float32)
    target, soft = (rng.integers(0, 255, (33, 37, *rgb), np.uint8) for rgb in ((3,), ()))
    for mode in ("none", "composite", "ignore"):
        mask = None if mode == "none" else torch.from_numpy(soft)
        options: dict[str, Any] = {"mask": mask, "mask_mode": mode, "background": (0.2, 0.5, 0.9)}
        exact = torch.from_numpy(image.astype(np.float64)).requires_grad_()
        factors = torch.tensor(gain, dtype=torch.float64)
        true, _ = image_loss_reference(exact, torch.from_numpy(target), gain=factors, **options)
        true.backward()
        found, _, gradient = _image_loss(image, target, gain=gain, **options)
        assert exact.grad is not None
        error = np.abs(gradient - exact.grad.numpy()).max() / exact.grad.abs().max().item()
        yield Measure("loss with a gain", abs(found - true.item()), 1e-6, mode)
        yield Measure("gradient with a gain", float(error), 1e-5, mode)


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
