"""S26, S27, depth: rendered depths and the alignment of depth maps."""

from collections.abc import Iterator

import numpy as np

from ..depth.align import align_robust
from . import native, truth
from .case import EmptyTestError, Measure, case
from .compare import require_covered, row_errors
from .scenes import draw_scene


@case("S26", "rendered depths")
def rendered_depths(full: bool) -> Iterator[Measure]:
    """Oracle: the reference and its autograd, where alpha is at least a half."""
    for seed in range(2600, 2606 if full else 2602):
        scene = draw_scene(seed, count=400, width=48, height=40, sh_degree=0)
        true = truth.reference_truth(scene)
        require_covered(true.pictures["alpha"])
        solid = (true.pictures["alpha"] > 0.5) & ~true.band
        drawn = native.draw(scene)
        z = true.pictures["depth"] / np.maximum(true.pictures["alpha"], 1e-9)
        found = drawn.pictures["depth"] / np.maximum(drawn.pictures["alpha"], np.float32(1e-9))
        yield Measure("expected depth", float(np.abs(found / z - 1)[solid].max()), 1e-5)
        yield Measure(
            "inverse depth",
            float(
                np.abs(drawn.pictures["inverse_depth"] / true.pictures["inverse_depth"] - 1)[
                    solid
                ].max()
            ),
            1e-5,
        )
        median = true.pictures["median_depth"]
        same = np.abs(drawn.pictures["median_depth"] - median) <= 1e-5 * median
        yield Measure(
            "median depth, share of pixels that choose another splat", float(1 - same.mean()), 2e-3
        )
        for name in ("inverse_depth", "depth"):
            alone = truth.reference_truth(scene, weigh=(name,))
            gradients = native.draw(scene, alone.weights).gradients
            for field in ("means", "opacities", "scales"):
                errors = row_errors(gradients[field], alone.gradients[field])
                yield Measure(f"gradient of {name}, median", float(np.median(errors)), 1e-5)
                yield Measure(
                    f"gradient of {name}, 99.9 %", float(np.quantile(errors, 0.999)), 1e-3
                )


@case("S26b", "faint pixels", needs=())
def faint_pixels(full: bool) -> Iterator[Measure]:
    """Oracle: the reference. Alpha is a sum of weights; computed as 1 - transmittance, it would
    lose digits at faint pixels to cancellation."""
    for seed in range(2650, 2656 if full else 2652):
        scene = draw_scene(
            seed, count=6, width=48, height=40, sh_degree=0, sigma_px=(8.0, 20.0), logits=(-5.2, -4)
        )
        true = truth.reference_truth(scene, gradients=False)
        alpha = true.pictures["alpha"]
        faint = (alpha > 0) & ~true.band
        if faint.sum() < 200 or alpha.max() > 0.1:
            raise EmptyTestError(f"{faint.sum()} pixels are faint, the largest {alpha.max():.2g}")
        drawn = native.draw(scene)
        for name in ("alpha", "inverse_depth"):
            off = np.abs(drawn.pictures[name] / np.where(faint, true.pictures[name], 1) - 1)[faint]
            yield Measure(f"{name}, mean", float(off.mean()), 6e-7)


@case("S27", "alignment of depth maps", per_isa=False, needs=())
def alignment(full: bool) -> Iterator[Measure]:
    """Oracle: scale and offset of the generated map; rejection of maps without a fit."""
    scale, offset = 0.37, 0.021
    for share, bound in ((0.0, 1e-3), (0.2, 1e-2), (0.4, 1e-2), (0.6, 3e-2)):
        for seed in range(20 if full else 5):
            rng = np.random.default_rng(2700 + seed)
            inverse = 1 / rng.uniform(1.5, 9.0, 600)
            mono = (inverse - offset) / scale
            mono += 1e-3 * np.ptp(mono) * rng.normal(size=600)
            wrong = rng.random(600) < share
            mono[wrong] = rng.uniform(mono.min(), mono.max(), wrong.sum())
            fit = align_robust(mono, inverse, np.ones(600), seed=seed)
            if not fit.accepted:
                yield Measure(f"{share:.0%} outliers, scale", float("inf"), bound, fit.reason)
                continue
            yield Measure(f"{share:.0%} outliers, scale", abs(fit.scale / scale - 1), bound)
    rng = np.random.default_rng(2700)
    inverse = 1 / rng.uniform(1.5, 9.0, 200)
    hopeless = {
        "a map of one value": np.full(200, 0.5),
        "a map of noise": rng.normal(size=200),
        "a map upside down": -inverse,
        "three points": np.where(np.arange(200) < 3, inverse, np.nan),
        "a map of NaN": np.full(200, np.nan),
    }
    for name, mono in hopeless.items():
        fit = align_robust(mono, inverse, np.ones(200))
        yield Measure(f"{name} accepted", float(fit.accepted), 0, fit.reason)
    if not align_robust(inverse, inverse, np.ones(200)).accepted:
        raise EmptyTestError("a perfect map is rejected too")
