"""Ground truth of a scene: the float64 reference, its gradients, and its undecided pixels.

torch is imported on use, so that cases can be listed without it.
"""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ..raster.request import Frustum, Settings
from ..splats import PARAMETERS
from .native import BACKGROUND, PICTURES, random_weights
from .scenes import SplatScene


@dataclass(frozen=True, kw_only=True)
class Truth:
    """Result of the reference, as float64 arrays named like those of `native.Drawn`."""

    pictures: dict[str, np.ndarray]
    band: np.ndarray
    """[H, W] bool, pixels that depend on a comparison that rounding could change."""
    weights: dict[str, np.ndarray]
    """Weights of the differentiated sum(weights * pictures); zero in the band."""
    gradients: dict[str, np.ndarray]
    projected: dict[str, np.ndarray]
    """Zero rows where culled."""


def tensors(scene: SplatScene, *, grad: bool = False) -> dict[str, Any]:
    """Arguments of the reference: float64 tensors, with gradients if `grad`."""
    import torch

    leaves = {
        name: torch.from_numpy(getattr(scene, name).astype(np.float64)).requires_grad_(grad)
        for name in (*PARAMETERS, "viewmat")
    }
    K = torch.from_numpy(scene.K.astype(np.float64))
    return {**leaves, "K": K, "width": scene.width, "height": scene.height}


def request_of(inputs: dict[str, Any], **options: Any) -> tuple[Any, Frustum, Settings]:
    """Arguments of the reference's stages: `SplatTensors`, a view and settings.

    Args:
        inputs: Arguments of `rasterize_reference`, from `tensors`.
        **options: near, far, orthographic; raw, sh_degree, antialias, eps2d.
    """
    from ..raster import reference

    given = {**inputs, **options}
    splats = reference.SplatTensors(*(given.pop(name) for name in PARAMETERS))
    names = [field.name for field in fields(Frustum) if field.name in given]
    view = Frustum(**{name: given.pop(name) for name in names})
    return splats, view, Settings(**given)


def reference_truth(
    scene: SplatScene,
    *,
    gradients: bool = True,
    weigh: tuple[str, ...] = PICTURES,
    **options: Any,
) -> Truth:
    """Pictures, band and gradients of a scene.

    Args:
        scene: Splats and camera.
        gradients: Whether to compute gradients.
        weigh: Pictures in the differentiated sum.
        **options: raw, sh_degree, antialias, near, far, eps2d, orthographic, as in `native.draw`.
    """
    import torch

    from ..raster import reference

    inputs = tensors(scene, grad=gradients)
    given, view, settings = request_of(inputs, **options)
    with torch.set_grad_enabled(gradients):
        splats = reference.project(given, view, settings)
        if gradients:
            splats.means2d.retain_grad()
        out = reference.composite(
            splats,
            scene.width,
            scene.height,
            background=torch.tensor(BACKGROUND, dtype=torch.float64),
            inverse_depth=True,
            depth=True,
        )
        assert out.inverse_depth is not None and out.depth is not None
        assert out.median_depth is not None
        pictures = {
            "rgb": out.rgb,
            "alpha": out.alpha,
            "inverse_depth": out.inverse_depth,
            "depth": out.depth * out.alpha,  # the undivided sum
            "median_depth": out.median_depth,
        }
        band = reference.boundary_band(given, view, settings)
        weights = random_weights(scene, 5, *weigh)
        for name in weights:
            weights[name][band.numpy()] = 0
        grads: dict[str, np.ndarray] = {}
        if gradients:
            total = sum((pictures[k] * torch.from_numpy(weights[k])).sum() for k in weights)
            total.backward()  # pyright: ignore[reportAttributeAccessIssue]
            grads = {name: _grad(inputs[name]) for name in PARAMETERS}
            grads["means2d"] = _rows(scene, splats.index, splats.means2d.grad)
            grads["viewmat"] = _grad(inputs["viewmat"])
    projected = {
        name: _rows(scene, splats.index, getattr(splats, name).detach())
        for name in ("means2d", "depths", "conics", "colors", "opacities")
    }
    return Truth(
        pictures={name: p.detach().numpy() for name, p in pictures.items()},
        band=band.numpy(),
        weights=weights,
        gradients=grads,
        projected=projected,
    )


def _grad(leaf: Any) -> np.ndarray:
    return np.zeros(leaf.shape) if leaf.grad is None else leaf.grad.numpy()


def _rows(scene: SplatScene, index: Any, values: Any) -> np.ndarray:
    if values is None:
        return np.zeros((len(scene), 2))
    whole = np.zeros((len(scene), *values.shape[1:]))
    whole[index.numpy()] = values.numpy()
    return whole
