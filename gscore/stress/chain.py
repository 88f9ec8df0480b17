"""S1, S2, S28, gradient chain: gradients compared to numerical derivatives in float64."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from ..shared_constants import COMPENSATION_MIN, EPS2D, JACOBIAN_MARGIN
from ..splats import PARAMETERS
from . import native, truth
from .case import Measure, case
from .compare import require_covered, row_errors
from .native import BACKGROUND
from .scenes import SplatScene, first_scene_without

_MARGIN = 1e-3
"""Distance from the limit of a clamped quantity within which differences may cross it."""
_LONG_STEP = 1e-3
"""Step of the five-point formula: truncation (step^4) and rounding (1e-16 / step) are both about
1e-13 of the value for functions that vary over lengths of one."""


def five_point(
    function: Callable[[np.ndarray], np.ndarray], at: np.ndarray, *, step: float = _LONG_STEP
) -> np.ndarray:
    """Derivatives [L, *at.shape] of a vector-valued function [L] at `at`, float64.

    Fourth-order central differences (Abramowitz and Stegun 1964, 25.3.6). Each element moves by up
    to twice the step, which must not reach a nearby jump.
    """
    columns = []
    for position in range(at.size):
        values = []
        for k in (-2, -1, 1, 2):
            moved = at.astype(np.float64).ravel().copy()
            moved[position] += k * step
            values.append(function(moved.reshape(at.shape)))
        columns.append((values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * step))
    return np.stack(columns, -1).reshape(-1, *at.shape)


def relative(actual: np.ndarray, true: np.ndarray, *, floor: float = 0.01) -> float:
    """Largest |error| / (|truth| + floor * max(1, largest truth)); infinite if all is zero."""
    if not np.abs(true).max() > 1e-6:
        return float("inf")
    scale = np.abs(true) + floor * max(1.0, float(np.abs(true).max()))
    return float((np.abs(actual - true) / scale).max())


def has_kink(scene: SplatScene) -> bool:
    """Whether a clamped quantity of a splat (colour, slope, compensation) is near its limit."""
    import torch

    from ..raster import reference

    t = truth.tensors(scene)
    cam = reference.means_to_camera(t["means"], t["viewmat"])
    slopes = cam[:, :2] / cam[:, 2:]
    focal, center = t["K"].diagonal()[:2], t["K"][:2, 2]
    size = torch.tensor([scene.width, scene.height]).double()
    extra = JACOBIAN_MARGIN * 0.5 * size / focal
    limits = torch.stack([-(center / focal + extra), (size - center) / focal + extra])  # [2, 2]
    covars = reference.covariance(t["quats"], t["scales"].exp())
    jacobian = reference.projection_jacobian(cam, t["K"], scene.width, scene.height)
    covars2d = reference.project_covariance(
        reference.covariance_to_camera(covars, t["viewmat"]), jacobian
    )
    _, compensation = reference.conic(covars2d, EPS2D)
    offsets = t["means"] + t["viewmat"][:3, :3].T @ t["viewmat"][:3, 3]
    basis = reference.sh_basis(offsets / offsets.norm(dim=1, keepdim=True), 3)
    kinked = (slopes[None] - limits[:, None]).abs().min() < _MARGIN
    above = compensation - COMPENSATION_MIN
    kinked |= bool((above.abs() < 1e-5).any() and (above > 0).any())
    for degree in range(4):
        count = (degree + 1) ** 2
        stored = torch.cat([t["sh0"], t["shN"]], 1)[:, :count]
        color = 0.5 + torch.einsum("nk,nkc->nc", basis[:, : stored.shape[1]], stored)
        kinked |= color.abs().min() < _MARGIN
    return bool(kinked)


def has_jump(scene: SplatScene) -> bool:
    """Whether a pixel is in the band, plain or antialiased, or a splat is near a kink."""
    from ..raster import reference

    inputs = truth.tensors(scene)
    return has_kink(scene) or any(
        bool(reference.boundary_band(*truth.request_of(inputs, antialias=antialias)).any())
        for antialias in (False, True)
    )


def smooth_scene(
    seed: int, *, edit: Callable[[SplatScene], SplatScene] | None = None, **options: Any
) -> SplatScene:
    """The first scene from `seed` on without kinks and with an empty band, also antialiased."""
    return first_scene_without(seed, has_jump, edit=edit, **options)


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


@case("S01", "gradients of the whole chain", on_device=True)
def chain(full: bool) -> Iterator[Measure]:
    """Oracle: fourth-order differences of the float64 reference, every raw parameter."""
    yield from _check(100, PARAMETERS, sh_degree=3 if full else 1)
    if full:
        yield from _check(200, PARAMETERS, antialias=True)


@case("S28", "gradients of the camera", on_device=True)
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
