"""S24, spherical harmonics: degrees 0 to 4, at the poles and at the clamp."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from . import native, truth
from .case import EmptyTestError, Measure, case
from .compare import different_bits, gradient_measures, picture_measures
from .scenes import SplatScene, draw_scene


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
