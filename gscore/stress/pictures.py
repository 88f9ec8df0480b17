"""S3 to S6, pictures: float32 pictures and gradients compared to the float64 reference."""

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from . import native, truth
from .case import EmptyTestError, Measure, case
from .compare import gradient_measures, picture_measures, require_covered, row_errors
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
