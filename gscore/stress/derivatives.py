"""Numerical derivatives in float64, and scenes without discontinuities for them."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..shared_constants import COMPENSATION_MIN, EPS2D, JACOBIAN_MARGIN
from . import truth
from .scenes import SplatScene, first_scene_without

_STEP = 1e-3
"""Step of the five-point formula: truncation (step^4) and rounding (1e-16 / step) are both about
1e-13 of the value for functions that vary over lengths of one."""


def five_point(
    function: Callable[[np.ndarray], np.ndarray], at: np.ndarray, *, step: float = _STEP
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


def has_kink(scene: SplatScene, *, eps2d: float = EPS2D, margin: float = 1e-3) -> bool:
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
    _, compensation = reference.conic(covars2d, eps2d)
    offsets = t["means"] + t["viewmat"][:3, :3].T @ t["viewmat"][:3, 3]
    basis = reference.sh_basis(offsets / offsets.norm(dim=1, keepdim=True), 3)
    kinked = (slopes[None] - limits[:, None]).abs().min() < margin
    above = compensation - COMPENSATION_MIN
    kinked |= bool((above.abs() < 1e-5).any() and (above > 0).any())
    for degree in range(4):
        count = (degree + 1) ** 2
        stored = torch.cat([t["sh0"], t["shN"]], 1)[:, :count]
        color = 0.5 + torch.einsum("nk,nkc->nc", basis[:, : stored.shape[1]], stored)
        kinked |= color.abs().min() < margin
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
