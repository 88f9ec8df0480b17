"""S15, S31, depth order: splats at one depth, and tiles whose gradient is zero."""

from collections.abc import Iterator

import numpy as np

from ..raster import header
from ..splats import PARAMETERS
from . import native, truth
from .case import EmptyTestError, Measure, case
from .compare import different_bits, picture_errors, require_covered
from .scenes import SplatScene, draw_scene


def _layers(count: int, depths: int, sigma_px: tuple[float, float]) -> SplatScene:
    """Splats at `depths` different depths near 3, which are projected without rounding."""
    scene = draw_scene(
        1500, count=count, posed=False, width=48, height=40, sh_degree=0, sigma_px=sigma_px
    )
    means = scene.means.copy()
    z = 3 + np.random.default_rng(2).integers(depths, size=(count, 1)).astype(np.float32) / 256
    means[:, :2] *= z / means[:, 2:]
    means[:, 2:] = z
    return scene.with_row(slice(None), means=means)


@case("S15", "splats at one depth")
def ties(full: bool) -> Iterator[Measure]:
    """Oracle: the reference, which sorts stably: at equal depth, the order of the rows decides."""
    # Different sorting algorithms: a few splats, many, and many with some ties.
    for name, count, depths, sigmas in (
        ("all", 1000, 1, (1.5, 5.0)),
        ("a short list", 20, 1, (5.0, 12.0)),
        ("in layers", 1000, 100, (1.5, 5.0)),
    ):
        scene = _layers(count, depths, sigmas)
        pictures = []
        for one in (scene, scene.rows(np.random.default_rng(1).permutation(count))):
            # Ties put pixels into the band, which does not matter without rounding in z.
            true = truth.reference_truth(one, gradients=False)
            drawn = native.draw(one)
            require_covered(true.pictures["alpha"])
            errors = picture_errors(drawn, true)
            rough = float(np.quantile(errors, 0.99))
            yield Measure(f"{name}, picture, 99 % of the pixels", rough, 1e-5, "all pixels tie")
            pictures.append(drawn.pictures["rgb"])
        if not np.abs(pictures[0] - pictures[1]).max() > 0.05:
            raise EmptyTestError(f"{name}: the order of the rows makes no difference here")
    apart = draw_scene(1501, count=1000, width=48, height=40, sh_degree=0)
    if len(np.unique(native.draw(apart).projected["depths"])) < 990:
        raise EmptyTestError("depths repeat")
    shuffled = np.random.default_rng(1).permutation(1000)
    one, other = native.draw(apart), native.draw(apart.rows(shuffled))
    yield Measure(
        "distinct depths shuffled, bits changed",
        float(different_bits(one.pictures, other.pictures)),
        0,
    )


@case("S31", "tiles without a gradient", needs=())
def zero_tiles(full: bool) -> Iterator[Measure]:
    """Oracle: the backward pass over all tiles, gradients bit for bit."""
    changed = skipped = 0
    for seed in range(20 if full else 4):
        scene = draw_scene(3100 + seed, count=300, width=96, height=80, overscan=0.1)
        weights = native.random_weights(scene, seed)
        rng = np.random.default_rng(seed)
        mask = np.kron(rng.random((5, 6)) < 0.4, np.ones((16, 16))).astype(np.float32)
        # All non-zero values count, also denormal ones; a zero may have a sign.
        faint = np.kron(rng.choice([1, 1e-30, 1e-42, -1], (5, 6)), np.ones((16, 16)))
        mask *= faint.astype(np.float32)
        masked = {k: w * (mask[..., None] if w.ndim == 3 else mask) for k, w in weights.items()}
        for background in (native.BACKGROUND, tuple(rng.random(3).tolist())):
            fast = native.draw(scene, masked, background=background)
            slow = native.draw(scene, masked, background=background, disable=header.NO_ZERO_TILE)
            require_covered(fast.pictures["alpha"])
            changed += different_bits(fast.gradients, slow.gradients)
            skipped += fast.stats["backward_pairs"] < slow.stats["backward_pairs"]
            if not any(fast.gradients[k].any() for k in PARAMETERS):
                raise EmptyTestError("all gradients are zero")
    if not skipped:
        raise EmptyTestError("no tile was skipped")
    yield Measure("gradient bits changed by skipping", float(changed), 0)
