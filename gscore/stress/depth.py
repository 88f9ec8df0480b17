"""S26, S27, depth: rendered depths and the alignment of depth maps.

S7, S8, S36: near and far planes, and parallel rays.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..depth.align import align_robust
from ..errors import BackendError
from . import native, truth
from .case import EmptyTestError, Measure, case
from .chain import five_point, relative
from .compare import picture_measures, require_covered, row_errors
from .scenes import SplatScene, draw_scene


@case("S26", "rendered depths", on_device=True)
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


@case("S26b", "faint pixels", on_device=True, needs=())
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


_NEAR = 0.01


def _at_depths(depths: list[float], *, seed: int) -> SplatScene:
    """A backdrop of splats, and in front of it one splat on the axis at each depth."""
    back = draw_scene(seed, count=60, depths=(2.0, 5.0), posed=False, sigma_px=(2.0, 6.0))
    few = draw_scene(seed + 1, count=len(depths), posed=False)
    means = np.zeros((len(depths), 3), np.float32)
    means[:, 2] = depths
    scales = np.log(np.maximum(np.abs(means[:, 2:]), 1e-6) * 0.1).repeat(3, 1)
    return back.joined(few.with_row(slice(None), means=means, scales=scales.astype(np.float32)))


@case("S07", "splats at the near plane", on_device=True)
def near_plane(full: bool) -> Iterator[Measure]:
    """Oracle: drawn splats have z > near in float32; the scene without the others, bit for bit;
    finite numbers everywhere."""
    near = np.float32(_NEAR)
    above = float(np.nextafter(near, np.float32(1)))
    limits = [_NEAR * (1 - 1e-6), _NEAR * (1 + 1e-6), float(near), above]
    depths = [*limits, 1e-3, 1e-6, 0.0, -1e-6, -1.0]
    scene = _at_depths(depths, seed=700)
    seen = scene.means[:, 2] > near
    weights = native.random_weights(scene, 1)
    drawn = native.draw(scene, weights, near=_NEAR)
    without = native.draw(scene.rows(seen), weights, near=_NEAR)
    require_covered(drawn.pictures["alpha"])
    if not (seen[60:64] == [False, True, False, True]).all():
        raise EmptyTestError("float32 does not separate the splats on both sides of the plane")
    yield Measure("splats on the wrong side", float(((drawn.radii > 0) & ~seen).sum()), 0)
    same = sum(int((drawn.pictures[k] != without.pictures[k]).sum()) for k in drawn.pictures)
    yield Measure("pixels changed by culled splats", float(same), 0)
    left = [int(drawn.gradients[k][~seen].any()) for k in ("means", "quats", "scales", "opacities")]
    yield Measure("gradients of culled splats", float(sum(left)), 0)
    yield Measure("numbers not finite", float(not drawn.finite()), 0)
    around = scene.rows(slice(0, 61)).with_row(
        -1, means=[0.0, 0.0, 0.011], scales=[1.0, 1.0, 1.0], opacities=0.5
    )
    weights = native.random_weights(around, 1)
    enclosing = native.draw(around, weights, near=_NEAR)
    if not enclosing.radii[-1] > 0:
        raise EmptyTestError("the splat around the camera is culled")
    yield Measure("around the camera, not finite", float(not enclosing.finite()), 0)
    yield from picture_measures(
        enclosing, truth.reference_truth(around, near=_NEAR, gradients=False)
    )


@case("S08", "splats far away", on_device=True)
def far_away(full: bool) -> Iterator[Measure]:
    """Oracle: the reference, depths from 1 to 1e8; nothing beyond the far plane of 1e10."""
    scene = draw_scene(800, count=200, width=48, height=40, depths=(1.0, 2.0), posed=False)
    factor = np.logspace(0, 8, 200).astype(np.float32)
    scene = scene.with_row(
        slice(None),
        means=scene.means * factor[:, None],
        scales=scene.scales + np.log(factor)[:, None],
    )
    scene = scene.with_row(0, means=[0, 0, 1.1e10], scales=[22.0] * 3)
    true = truth.reference_truth(scene)
    drawn = native.draw(scene, true.weights)
    yield from picture_measures(drawn, true)
    z = drawn.projected["depths"]
    seen = drawn.radii > 0
    if seen.sum() < 100:
        raise EmptyTestError("too few splats are visible")
    yield Measure("splats beyond the far plane", float(seen[0]), 0)
    error = np.abs(z[seen] / scene.means[seen, 2] - 1).max()
    yield Measure("depths", float(error), 1e-6)
    yield Measure("numbers not finite", float(not drawn.finite()), 0)


@case("S36", "parallel rays", on_device=True)
def parallel(full: bool) -> Iterator[Measure]:
    """Oracle: the reference; its Jacobian by finite differences; an error for gradients."""
    import torch

    from ..raster import reference

    scene = draw_scene(3600, count=400, width=64, height=48, overscan=0.2, elongation=1.0)
    K = np.array([[9.0, 0, 30.25], [0, 11.5, 26.75], [0, 0, 1]], np.float32)
    scene = replace(scene, K=K)
    true = truth.reference_truth(scene, orthographic=True, gradients=False)
    yield from picture_measures(native.draw(scene, orthographic=True), true)
    t_K = torch.from_numpy(K.astype(np.float64))
    points = scene.means[:3].astype(np.float64)
    found = five_point(
        lambda p: reference.project_parallel(torch.from_numpy(p), t_K).flatten().numpy(), points
    ).reshape(3, 2, 3, 3)
    wanted = reference.parallel_jacobian(torch.from_numpy(points), t_K).numpy()
    jacobian = np.stack([found[i, :, i] for i in range(3)])
    yield Measure("Jacobian", relative(wanted, jacobian), 1e-6)
    try:
        native.draw(scene, native.random_weights(scene, 1), orthographic=True)
        refused = False
    except BackendError as error:
        refused = "orthographic" in str(error)
    yield Measure("gradients not refused", float(not refused), 0)
