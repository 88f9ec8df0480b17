"""Splat rows of files: bytes and linear sizes to raw parameters, invalid rows dropped."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..splats import PARAMETERS, SH_REST_BY_DEGREE, Splats

_log = logging.getLogger(__name__)

_ALPHAS = np.clip(np.arange(256) / 255, 0.25 / 255, 1 - 0.25 / 255)
LOGIT_OF_BYTE = np.log(_ALPHAS / (1 - _ALPHAS)).astype(np.float32)
"""[256] opacity of a byte; 0 and 255 stand for the quarter of a step beside them, because a logit
has to stay finite."""
_FLAT = 1e-12
"""World units, for a size of zero, of which there is no finite logarithm."""

_MOST_LOGIT = 20.0
"""Of opacities of 0 and 1, which have none that is finite."""


def opacities_of(raw: np.ndarray) -> np.ndarray:
    """Opacities from 0 to 1 of logits, float32."""
    with np.errstate(over="ignore"):
        return (1 / (1 + np.exp(-raw.astype(np.float32)))).astype(np.float32)


def opacity_bytes(raw: np.ndarray) -> np.ndarray:
    """Opacities of logits [N] as bytes, 0 to 255."""
    return np.rint(255 * opacities_of(raw)).astype(np.uint8)


def logits(opacities: np.ndarray) -> np.ndarray:
    """Logits of opacities, float32; NaN outside of 0 to 1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.log(opacities) - np.log1p(-opacities)
    return np.clip(found, -_MOST_LOGIT, _MOST_LOGIT).astype(np.float32)


def log_scales(linear: np.ndarray) -> np.ndarray:
    """Logarithms of sizes, float32; of zero that of 1e-12, of what is below zero NaN."""
    with np.errstate(invalid="ignore"):
        return np.log(np.where(linear == 0, np.float32(_FLAT), linear)).astype(np.float32)


def linear_scales(logs: np.ndarray) -> np.ndarray:
    """Sizes of logarithms, float32; the largest are those that float32 still holds."""
    return np.exp(np.minimum(logs, 88.0)).astype(np.float32)


def whole_bands(path: Path, rest: np.ndarray) -> np.ndarray:
    """The coefficients [N, K'-1, 3] that make whole bands of degree 4 at most; others are cut, and
    a warning says so."""
    each = rest.shape[1]
    keep = max(kept for kept in SH_REST_BY_DEGREE.values() if kept <= each)
    if keep < each:
        _log.warning(
            "%s has %d SH coefficients a channel beyond the constant one; only the first %d "
            "(whole bands, degree 4 at most) are used.",
            path,
            each,
            keep,
        )
    return rest[:, :keep]


def drawable(
    path: Path,
    *,
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    opacities: np.ndarray,
    sh0: np.ndarray,
    shN: np.ndarray,
) -> Splats:
    """The splats that can be drawn: those with a number that is not finite, or a zero quaternion,
    are left out, and a warning says how many.

    Args:
        path: Named in the warning.
        means: [N, 3] float32.
        quats: [N, 4] float32, wxyz.
        scales: [N, 3] float32, log.
        opacities: [N] float32, logit.
        sh0: [N, 3] float32.
        shN: [N, K-1, 3] float32, of degree 0 to 4.
    """
    splats = Splats(
        means=means, quats=quats, scales=scales, opacities=opacities, sh0=sh0[:, None], shN=shN
    )
    kept = drawable_rows(splats)
    warn_dropped_rows(path, len(splats) - len(kept), len(splats))
    return kept


def drawable_rows(splats: Splats) -> Splats:
    """As `drawable`, without a warning; itself where all of them can be drawn as they are."""
    # Programs that store opacity as a byte write +inf for 255; that splat is opaque, not broken.
    # The logarithm of a size of zero is -inf; that splat is flat.
    opaque, flat = np.isposinf(splats.opacities), np.isneginf(splats.scales)
    if opaque.any() or flat.any():
        splats = replace(
            splats,
            opacities=np.where(opaque, np.float32(_MOST_LOGIT), splats.opacities),
            scales=np.where(flat, np.float32(np.log(_FLAT)), splats.scales),
        )
    good = np.abs(splats.quats).max(axis=1, initial=0) > 0
    for name in PARAMETERS:
        values = getattr(splats, name)
        good &= np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
    return splats if good.all() else splats.subset(np.flatnonzero(good))


def warn_dropped_rows(path: Path, left_out: int, count: int) -> None:
    """Log how many of a file's splats cannot be drawn, if any."""
    if left_out:
        _log.warning(
            "%s: %d of %d splats have numbers that are not finite or a zero quaternion; left out.",
            path,
            left_out,
            count,
        )
