"""S1, S2, S28, gradient chain: gradients compared to differences of the float64 reference."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from ..splats import PARAMETERS
from . import native, truth
from .case import Measure, case
from .compare import require_covered, row_errors
from .derivatives import five_point, relative, smooth_scene
from .native import BACKGROUND
from .scenes import SplatScene

_SCENE: dict[str, Any] = {"count": 6, "width": 24, "height": 20, "sigma_px": (2.0, 6.0)}
_STEP = 1e-5
"""Too short to reach a jump of a smooth scene; the rounding error is about 1e-10."""
_EXACT = 1e-6
"""Tolerance of the reference's autograd compared to differences, both in float64."""


def _weighted(scene: SplatScene, weights: dict[str, np.ndarray], **options: Any) -> float:
    """sum(weights * pictures) of the reference; fields of the scene may be float64."""
    import torch

    from ..raster import reference

    with torch.no_grad():
        out = reference.rasterize_reference(
            **truth.tensors(scene),
            raw=True,
            background=torch.tensor(BACKGROUND, dtype=torch.float64),
            inverse_depth=True,
            depth=True,
            **options,
        )
    assert out.inverse_depth is not None and out.depth is not None
    pictures = (out.rgb, out.alpha, out.inverse_depth, out.depth * out.alpha)
    pairs = zip(native.PICTURES, pictures, strict=True)
    return sum(float((p.numpy() * weights[name]).sum()) for name, p in pairs)


@lru_cache(maxsize=16)
def _known(
    seed: int, names: tuple[str, ...], sh_degree: int, antialias: bool
) -> tuple[SplatScene, truth.Truth, dict[str, np.ndarray]]:
    """A smooth scene, the result of the reference, and its differences by parameter."""
    scene = smooth_scene(seed, sh_degree=sh_degree, **_SCENE)
    true = truth.reference_truth(scene, antialias=antialias)
    require_covered(true.pictures["alpha"])
    weights = native.random_weights(scene, 5)

    def of(name: str) -> np.ndarray:
        def value(at: np.ndarray) -> np.ndarray:
            moved = replace(scene, **{name: at})
            return np.array([_weighted(moved, weights, antialias=antialias)])

        return five_point(value, getattr(scene, name), step=_STEP)[0]

    return scene, true, {name: of(name) for name in names}


def _check(
    seed: int, names: tuple[str, ...], *, sh_degree: int = 3, antialias: bool = False
) -> Iterator[Measure]:
    """Compare autograd of the reference, and the native gradients, with differences."""
    scene, true, differences = _known(seed, names, sh_degree, antialias)
    drawn = native.draw(scene, true.weights, antialias=antialias)
    kind = ", antialiased" if antialias else ""
    for name, expected in differences.items():
        yield Measure(f"reference, {name}{kind}", relative(true.gradients[name], expected), _EXACT)
        actual = drawn.gradients[name]
        if name == "viewmat":
            actual, expected = actual.reshape(1, 16), expected.reshape(1, 16)
        worst = float(row_errors(actual, expected).max())
        yield Measure(f"native, {name}{kind}", worst, 2e-5)


@case("S01", "gradients of the whole chain")
def chain(full: bool) -> Iterator[Measure]:
    """Oracle: fourth-order differences of the float64 reference, every raw parameter."""
    yield from _check(100, PARAMETERS, sh_degree=3 if full else 1)
    if full:
        yield from _check(200, PARAMETERS, antialias=True)


@case("S28", "gradients of the camera")
def camera_by_differences(full: bool) -> Iterator[Measure]:
    """Oracle: as in S01, for all entries of the view matrix, which also rotate covariances."""
    for seed in range(300, 303 + 5 * full):
        yield from _check(seed, ("viewmat",))


@case("S02", "gradients of single stages", per_isa=False)
def stages_by_differences(full: bool) -> Iterator[Measure]:
    """Oracle: fourth-order differences of each stage, on random and on nearly flat splats."""
    import torch

    from ..raster import reference

    rng = np.random.default_rng(7)

    def check(what: str, function: Callable[[Any], Any], at: np.ndarray) -> Measure:
        def flat(x: np.ndarray) -> np.ndarray:
            with torch.no_grad():
                return function(torch.from_numpy(x)).flatten().numpy()

        leaf = torch.from_numpy(at.astype(np.float64)).requires_grad_()
        out = function(leaf).flatten()
        rows = [torch.autograd.grad(v, leaf, retain_graph=True)[0].numpy() for v in out]
        return Measure(what, relative(np.stack(rows), five_point(flat, at)), 1e-7)

    n = 3
    quats = rng.normal(size=(n, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    t_quats = torch.from_numpy(quats)
    for name, stretch in (("", 1.0), (" of a needle", 100.0)):
        scales = rng.uniform(0.5, 1.5, (n, 3)) * np.array([stretch, 1.0, 1.0])
        t_scales = torch.from_numpy(scales)
        yield check(
            f"rotation to covariance{name}", lambda q, s=t_scales: reference.covariance(q, s), quats
        )
        yield check(
            f"scales to covariance{name}", lambda s: reference.covariance(t_quats, s), scales
        )
    K = torch.tensor([[30.0, 0, 10], [0, 28.0, 11], [0, 0, 1]], dtype=torch.float64)
    points = np.array([[0.1, -0.2, 3.0], [4.0, 0.3, 2.5], [-0.5, -5.0, 2.0]])  # two are clamped
    yield check("projected means", lambda p: reference.project_means(p, K), points)
    yield check(
        "projection's Jacobian", lambda p: reference.projection_jacobian(p, K, 24, 20), points
    )

    def symmetric(entries: Any) -> Any:
        """[N, 2, 2] from (xx, xy, yy): both off-diagonal entries move together."""
        xx, xy, yy = entries.unbind(-1)
        return torch.stack([torch.stack([xx, xy], -1), torch.stack([xy, yy], -1)], -2)

    covariances = np.array([[3.0, 0.8, 2.0], [25.0, 24.3, 24.0], [0.4, -0.1, 0.3]])
    yield check("conic", lambda c: reference.conic(symmetric(c), 0.3)[0], covariances)
    yield check("compensation", lambda c: reference.conic(symmetric(c), 0.3)[1], covariances)
    view = torch.eye(4, dtype=torch.float64)
    sh0 = torch.from_numpy(rng.normal(size=(n, 1, 3)) + 4)
    shN = torch.from_numpy(0.2 * rng.normal(size=(n, 15, 3)))
    yield check("colour by direction", lambda p: reference.sh_colors(p, view, sh0, shN, 3), points)
