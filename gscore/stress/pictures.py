"""S3 to S6, S24 and S25, pictures: float32 compared to the float64 reference; spherical harmonics,
opacity compensation of splats far below a pixel."""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np

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


@case("S03", "random scenes, pictures")
def random_pictures(full: bool) -> list[Measure]:
    """Oracle: the reference outside the boundary band, flips counted inside."""
    found = []
    for seed in _seeds(full):
        scene, true = _random(seed, full)
        found += picture_measures(native.draw(scene), true)
    return found


@case("S04", "random scenes, gradients")
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


@case("S05", "splats far off screen, principal point off centre")
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


@case("S06", "needles")
def needles(full: bool) -> Iterator[Measure]:
    """Oracle: the reference; axes 1 : 1e4 to 1 : 1e6 in all orientations."""
    for ratio in (1e4, 1e5, 1e6):
        scene, true = _needles(ratio)
        drawn = native.draw(scene, true.weights)
        yield Measure("numbers not finite", float(not drawn.finite()), 0)
        # Means are about 5e-7; determinants with cancellation would make them 1.3e-6 and more.
        pictures = picture_measures(drawn, true, mean=1e-6)
        for m in (*pictures, *gradient_measures(drawn, true)):
            yield Measure(f"1 : {ratio:.0e}, {m.what}", m.error, m.tolerance, m.note)
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


@case("S25", "anti-aliased dots")
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
            yield Measure(f"{name}, {m.what}", m.error, m.tolerance, m.note)
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


@case("S24", "spherical harmonics")
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
