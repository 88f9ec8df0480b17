"""Scenes, finite differences and comparisons for the rasterizer's tests.

Helpers reach the tests as fixtures that return functions:

- `random_scene(seed, ...)`: splats and a posed camera, every value exact in float32;
- `smooth_scene(seed, ...)`: the same, redrawn until nothing sits near a discontinuity or kink;
- `hostile_rows()`: named damages to one splat that must cull it;
- `central_difference(function, tensor, ...)`: numerical derivatives in float64;
- `assert_grad_close(actual, expected, ...)`: element-wise comparison that refuses zero gradients;
- `one_splat(...)`: a single isotropic splat with closed-form pixels;
- `client`: a client of a render server, which ends with the test.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from gscore.raster import reference
from gscore.raster.render_client import RenderClient
from gscore.raster.request import Frustum
from gscore.stress import chain, scenes
from tests.isas import isa  # noqa: F401

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

    def tensors(self) -> tuple[reference.SplatTensors, Frustum]:
        """The arguments of the reference's stages."""
        return (
            reference.SplatTensors(*(getattr(self, name) for name in PARAMETERS)),
            Frustum(self.viewmat, self.K, self.width, self.height),
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


def to_torch(scene: scenes.SplatScene) -> RasterScene:
    """The same scene as float64 tensors."""
    fields = {
        name: torch.from_numpy(getattr(scene, name).astype(np.float64))
        for name in (*PARAMETERS, "viewmat", "K")
    }
    return RasterScene(**fields, width=scene.width, height=scene.height)


def to_numpy(scene: RasterScene) -> scenes.SplatScene:
    """The same scene as float32 arrays."""
    fields = {name: getattr(scene, name).float().numpy() for name in (*PARAMETERS, "viewmat", "K")}
    return scenes.SplatScene(**fields, width=scene.width, height=scene.height)


def draw_scene(seed: int, **options: Any) -> RasterScene:
    """`gscore.stress.scenes.draw_scene` as tensors."""
    return to_torch(scenes.draw_scene(seed, **options))


def find_smooth_scene(
    seed: int, *, edit: Callable[[RasterScene], RasterScene] | None = None, **options: Any
) -> RasterScene:
    """`gscore.stress.chain.smooth_scene` as tensors; `edit` changes each scene drawn."""
    change = None if edit is None else lambda scene: to_numpy(edit(to_torch(scene)))
    return to_torch(chain.smooth_scene(seed, edit=change, **options))


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

    A zero `expected` is refused, because two zeros prove nothing. The message has the worst
    element, the relative L2 error, the cosine and the mean signed error.
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
    """`find_smooth_scene`: a scene without jumps within reach of finite differences."""
    return find_smooth_scene


@pytest.fixture(scope="session")
def hostile_rows() -> dict[str, dict[str, Any]]:
    """Names and field values of damages that must remove a splat from the picture."""
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


@pytest.fixture
def client(tmp_path: Path) -> Iterator[RenderClient]:
    """A client, whose server ends with the test."""
    made = RenderClient("cpu", folder=str(tmp_path))
    yield made
    made.close()
