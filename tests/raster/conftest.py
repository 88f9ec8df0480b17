"""Scenes, finite differences and comparisons for the rasterizer's tests.

Helpers reach the tests as fixtures that return functions:

- `random_scene(seed, ...)`: splats and a posed camera, every value exact in float32;
- `smooth_scene(seed, ...)`: the same, redrawn until nothing sits near a discontinuity or kink;
- `hostile_rows()`: named damages to one splat that must cull it;
- `central_difference(function, tensor, ...)`: numerical derivatives in float64;
- `assert_grad_close(actual, expected, ...)`: element-wise comparison that refuses zero gradients;
- `one_splat(...)`: a single isotropic splat with closed-form pixels.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest
import torch
from torch import Tensor

from gscore.raster import reference

PARAMETERS = ("means", "quats", "scales", "opacities", "sh0", "shN")


@dataclass(frozen=True, kw_only=True)
class RasterScene:
    """Raw splats (log scales, logit opacities) and one camera, float64 but exact in float32."""

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    sh0: Tensor
    shN: Tensor
    viewmat: Tensor
    K: Tensor
    width: int
    height: int

    def inputs(self, dtype: torch.dtype = torch.float64) -> dict[str, Any]:
        """Fresh leaf tensors that require gradients, and the camera: arguments of `rasterize`."""
        leaves = {
            name: getattr(self, name).to(dtype).clone().requires_grad_()
            for name in (*PARAMETERS, "viewmat")
        }
        return {**leaves, "K": self.K.to(dtype), "width": self.width, "height": self.height}

    def tensors(self) -> tuple[reference.SplatTensors, reference.PinholeView]:
        """The arguments of the reference's stages."""
        return (
            reference.SplatTensors(*(getattr(self, name) for name in PARAMETERS)),
            reference.PinholeView(self.viewmat, self.K, self.width, self.height),
        )

    def activated(self) -> "RasterScene":
        """The same splats with exp and sigmoid applied, for raw=False."""
        return replace(
            self,
            scales=self.scales.exp().float().double(),
            opacities=self.opacities.sigmoid().float().double(),
        )

    def rows(self, index: Tensor) -> "RasterScene":
        """The splats selected by a mask or an index."""
        return replace(self, **{name: getattr(self, name)[index] for name in PARAMETERS})

    def with_row(self, row: int, **values: Any) -> "RasterScene":
        """The scene with fields of one splat overwritten."""
        changed = {}
        for name, value in values.items():
            changed[name] = getattr(self, name).clone()
            changed[name][row] = torch.as_tensor(value, dtype=torch.float64)
        return replace(self, **changed)


def draw_scene(
    seed: int,
    *,
    count: int = 10,
    width: int = 24,
    height: int = 20,
    sh_degree: int = 3,
    focal: tuple[float, float] = (30.0, 30.0),
    center: tuple[float, float] | None = None,
    sigma_px: tuple[float, float] = (1.5, 5.0),
    logits: tuple[float, float] = (-1.5, 2.0),
    depths: tuple[float, float] = (1.5, 6.0),
    overscan: float = 0.0,
    elongation: float = 0.0,
) -> RasterScene:
    """Draw splats in front of a camera that stands anywhere.

    Args:
        seed: seed of the scene.
        count: number of splats.
        width: pixels.
        height: pixels.
        sh_degree: degree of the stored SH coefficients.
        focal: fx, fy, pixels.
        center: cx, cy, pixels; None is the middle.
        sigma_px: range of the standard deviations, pixels (log-uniform).
        logits: range of the opacity logits.
        depths: range of camera z, world units.
        overscan: how far beyond the image centres may lie, in image sizes.
        elongation: e-folds by which one axis of each splat is stretched.

    Returns:
        The scene.
    """
    rng = torch.Generator().manual_seed(seed)

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(*shape, generator=rng, dtype=torch.float64)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=rng, dtype=torch.float64)

    fx, fy = focal
    cx, cy = center if center is not None else (width / 2, height / 2)
    z = uniform(*depths, count)
    x = (uniform(-overscan, 1 + overscan, count) * width - cx) / fx * z
    y = (uniform(-overscan, 1 + overscan, count) * height - cy) / fy * z
    log_sigma = torch.tensor(sigma_px).double().log()
    scales = uniform(float(log_sigma[0]), float(log_sigma[1]), count, 3)
    scales = scales + (z / fx).log()[:, None]
    scales[:, 0] += elongation

    rotation = torch.linalg.qr(normal(3, 3)).Q
    rotation = rotation * torch.linalg.det(rotation)  # a proper rotation
    viewmat = torch.eye(4, dtype=torch.float64)
    viewmat[:3, :3], viewmat[:3, 3] = rotation, normal(3)
    means = (torch.stack([x, y, z], 1) - viewmat[:3, 3]) @ rotation

    exact = {
        "means": means,
        "quats": normal(count, 4) * uniform(0.3, 3.0, count, 1),
        "scales": scales,
        "opacities": uniform(*logits, count),
        "sh0": 0.8 * normal(count, 1, 3),
        "shN": 0.25 * normal(count, (sh_degree + 1) ** 2 - 1, 3),
        "viewmat": viewmat,
        "K": torch.tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=torch.float64),
    }
    exact = {name: value.float().double() for name, value in exact.items()}
    return RasterScene(**exact, width=width, height=height)


def near_a_kink(scene: RasterScene, *, eps2d: float = 0.3, margin: float = 1e-3) -> bool:
    """Whether a clamped quantity of a splat (colour, slope, compensation) is near its limit."""
    cam = reference.means_to_camera(scene.means, scene.viewmat)
    slopes = cam[:, :2] / cam[:, 2:]
    focal, center = scene.K.diagonal()[:2], scene.K[:2, 2]
    size = torch.tensor([scene.width, scene.height]).double()
    extra = 0.3 * 0.5 * size / focal
    limits = torch.stack([-(center / focal + extra), (size - center) / focal + extra])  # [2, 2]
    covars = reference.covariance(scene.quats, scene.scales.exp())
    jacobian = reference.projection_jacobian(cam, scene.K, scene.width, scene.height)
    _, compensation = reference.conic(
        reference.project_covariance(
            reference.covariance_to_camera(covars, scene.viewmat), jacobian
        ),
        eps2d,
    )
    offsets = scene.means + scene.viewmat[:3, :3].T @ scene.viewmat[:3, 3]
    basis = reference.sh_basis(offsets / offsets.norm(dim=1, keepdim=True), 3)
    kinked = (slopes[None] - limits[:, None]).abs().min() < margin
    kinked |= bool(((compensation - 0.005).abs() < 1e-5).any() and (compensation > 0.005).any())
    for degree in range(4):
        count = (degree + 1) ** 2
        stored = torch.cat([scene.sh0, scene.shN], 1)[:, :count]
        color = 0.5 + torch.einsum("nk,nkc->nc", basis[:, : stored.shape[1]], stored)
        kinked |= color.abs().min() < margin
    return bool(kinked)


def settle_scene(seed: int, *, edit: Callable[[RasterScene], RasterScene] | None = None, **options):
    """The first scene from `seed` on without kinks, its band empty both plain and antialiased.

    Args:
        seed: first seed tried.
        edit: changes each drawn scene before it is judged.
        **options: of `draw_scene`.

    Returns:
        The scene.
    """
    for attempt in range(seed, seed + 400):
        scene = draw_scene(attempt, **options)
        scene = edit(scene) if edit else scene
        inputs = scene.inputs()
        if near_a_kink(scene) or any(
            reference.boundary_band(**inputs, raw=True, antialias=antialias).any()
            for antialias in (False, True)
        ):
            continue
        return scene
    raise AssertionError(f"no scene without discontinuities within 400 seeds of {seed}")


def numerical_gradient(
    function: Callable[[Tensor], Tensor], at: Tensor, *, step: float = 1e-5
) -> Tensor:
    """Central differences of a vector-valued function in float64.

    Args:
        function: maps a tensor shaped like `at` to [L] values.
        at: point; every element is moved by plus and minus `step`.
        step: absolute step. Truncation grows with its square, rounding with its inverse.

    Returns:
        [L, *at.shape].
    """
    columns = []
    with torch.no_grad():
        for position in range(at.numel()):
            moved = [at.detach().clone().flatten() for _ in range(2)]
            moved[0][position] += step
            moved[1][position] -= step
            high, low = (function(point.reshape(at.shape)) for point in moved)
            columns.append((high - low) / (2 * step))
    return torch.stack(columns, -1).reshape(-1, *at.shape)


def check_grad_close(
    actual: Tensor,
    expected: Tensor,
    *,
    rel: float = 1e-6,
    floor: float = 1e-8,
    name: str = "gradient",
) -> None:
    """Assert |actual - expected| <= rel |expected| + floor max(1, |expected|_max) per element.

    A zero `expected` is refused: a comparison of nothing with nothing proves nothing. The message
    holds the worst element, the relative L2 error, the cosine and the mean signed error.
    """
    assert actual.shape == expected.shape, f"{name}: {actual.shape} against {expected.shape}"
    assert expected.abs().max() > 1e-4, f"{name}: the expected gradient is zero everywhere"
    error = (actual - expected).abs()
    allowed = rel * expected.abs() + floor * expected.abs().max().clamp(min=1)
    worst = int((error / allowed).argmax())
    a, e = actual.flatten(), expected.flatten()
    assert (error <= allowed).all(), (
        f"{name}: element {worst} is {float(a[worst]):.9g}, expected {float(e[worst]):.9g}; "
        f"relative L2 {float((a - e).norm() / e.norm()):.2e}, "
        f"cosine {float(a @ e / (a.norm() * e.norm())):.9f}, "
        f"mean signed error {float((a - e).mean()):.2e}"
    )


HOSTILE_ROWS: dict[str, dict[str, Any]] = {
    **{
        f"{value} in {name}": {name: value}
        for name in PARAMETERS
        for value in (float("nan"), float("inf"), float("-inf"))
    },
    "zero quaternion": {"quats": 0.0},
    "quaternion of length 1e-20": {"quats": [1e-20, 0, 0, 0]},
    "log scale 800, overflows": {"scales": 800.0},
    "opacity 0": {"opacities": -1000.0},
}


def make_one_splat(
    *,
    sigma: float = 0.2,
    opacity: float = 0.8,
    color: tuple[float, float, float] = (0.2, 0.5, 0.7),
    position: tuple[float, float, float] = (0.0, 0.0, 2.0),
) -> dict[str, Tensor]:
    """Activated parameters of one round splat of known colour, in the frame of the camera."""
    constant = 0.5 / torch.pi**0.5
    return {
        "means": torch.tensor([position], dtype=torch.float64),
        "quats": torch.tensor([[1.0, 0, 0, 0]], dtype=torch.float64),
        "scales": torch.full((1, 3), sigma, dtype=torch.float64),
        "opacities": torch.tensor([opacity], dtype=torch.float64),
        "sh0": (torch.tensor([[color]], dtype=torch.float64) - 0.5) / constant,
        "shN": torch.zeros(1, 0, 3, dtype=torch.float64),
    }


@pytest.fixture(scope="module", autouse=True)
def one_torch_thread():
    """Small tensors gain nothing from a second thread, and lose much on a busy machine."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="session")
def random_scene() -> Callable[..., RasterScene]:
    """`draw_scene`: splats and a posed camera from a seed."""
    return draw_scene


@pytest.fixture(scope="session")
def smooth_scene() -> Callable[..., RasterScene]:
    """`settle_scene`: a scene on which finite differences see no jump."""
    return settle_scene


@pytest.fixture(scope="session")
def hostile_rows() -> dict[str, dict[str, Any]]:
    """Name and field values of damages that must take a splat out of the picture."""
    return HOSTILE_ROWS


@pytest.fixture(scope="session")
def central_difference() -> Callable[..., Tensor]:
    """`numerical_gradient`: central differences in float64."""
    return numerical_gradient


@pytest.fixture(scope="session")
def assert_grad_close() -> Callable[..., None]:
    """`check_grad_close`: element-wise, and never zero against zero."""
    return check_grad_close


@pytest.fixture(scope="session")
def one_splat() -> Callable[..., dict[str, Tensor]]:
    """`make_one_splat`: one splat whose pixels have a closed form."""
    return make_one_splat
