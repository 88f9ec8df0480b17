"""Stress scenes: seeded random splats in front of a camera; every number exact in float32."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..splats import PARAMETERS


@dataclass(frozen=True, kw_only=True)
class SplatScene:
    """N raw splats (log scales, logit opacities) and one camera; arrays are float32."""

    means: np.ndarray
    """[N, 3] world."""
    quats: np.ndarray
    """[N, 4] wxyz, of any length."""
    scales: np.ndarray
    """[N, 3] natural logs."""
    opacities: np.ndarray
    """[N] logits."""
    sh0: np.ndarray
    """[N, 1, 3]."""
    shN: np.ndarray
    """[N, K-1, 3]."""
    viewmat: np.ndarray
    """[4, 4] world to camera."""
    K: np.ndarray
    """[3, 3] pixels."""
    width: int
    height: int

    def __len__(self) -> int:
        return len(self.means)

    def rows(self, index: Any) -> "SplatScene":
        """The splats selected by a mask or an index."""
        return replace(self, **{name: getattr(self, name)[index] for name in PARAMETERS})

    def with_row(self, row: Any, **values: Any) -> "SplatScene":
        """The scene with fields of one splat, or of several, overwritten."""
        changed = {}
        for name, value in values.items():
            changed[name] = getattr(self, name).copy()
            changed[name][row] = value
        return replace(self, **changed)

    def joined(self, other: "SplatScene") -> "SplatScene":
        """These splats followed by those of `other`, with this camera."""
        both = {n: np.concatenate([getattr(self, n), getattr(other, n)]) for n in PARAMETERS}
        return replace(self, **both)


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """[3, 3] float64, a proper rotation."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


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
    posed: bool = True,
) -> SplatScene:
    """Draw random splats in front of a random camera.

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
        overscan: distance of means beyond the picture, in picture sizes.
        elongation: e-folds by which one axis of each splat is stretched.
        posed: whether the camera has a random pose; else the identity.
    """
    rng = np.random.default_rng(seed)
    fx, fy = focal
    cx, cy = center if center is not None else (width / 2, height / 2)
    z = rng.uniform(*depths, count)
    x = (rng.uniform(-overscan, 1 + overscan, count) * width - cx) / fx * z
    y = (rng.uniform(-overscan, 1 + overscan, count) * height - cy) / fy * z
    # Behind the camera, sizes in pixels refer to the mirrored depth.
    scales = (
        rng.uniform(np.log(sigma_px[0]), np.log(sigma_px[1]), (count, 3))
        + np.log(np.abs(z) / fx)[:, None]
    )
    scales[:, 0] += elongation
    rotation = random_rotation(rng)
    translation = rng.normal(size=3)
    quats = rng.normal(size=(count, 4)) * rng.uniform(0.3, 3.0, (count, 1))
    opacities = rng.uniform(*logits, count)
    sh0 = 0.8 * rng.normal(size=(count, 1, 3))
    shN = 0.25 * rng.normal(size=(count, (sh_degree + 1) ** 2 - 1, 3))
    viewmat = np.eye(4)
    if posed:
        viewmat[:3, :3], viewmat[:3, 3] = rotation, translation
    means = (np.stack([x, y, z], 1) - viewmat[:3, 3]) @ viewmat[:3, :3]
    arrays = {
        "means": means,
        "quats": quats,
        "scales": scales,
        "opacities": opacities,
        "sh0": sh0,
        "shN": shN,
        "viewmat": viewmat,
        "K": np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]),
    }
    arrays = {name: value.astype(np.float32) for name, value in arrays.items()}
    return SplatScene(**arrays, width=width, height=height)


def first_scene_without(
    seed: int,
    rough: Callable[[SplatScene], bool],
    *,
    edit: Callable[[SplatScene], SplatScene] | None = None,
    tries: int = 400,
    **options: Any,
) -> SplatScene:
    """The first scene from `seed` on that is not `rough` after `edit`."""
    for attempt in range(seed, seed + tries):
        scene = draw_scene(attempt, **options)
        scene = edit(scene) if edit else scene
        if not rough(scene):
            return scene
    raise AssertionError(f"no smooth scene within {tries} seeds of {seed}")
