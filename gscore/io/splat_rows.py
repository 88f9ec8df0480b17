"""Splat rows of files: bytes and linear sizes to raw parameters, invalid rows dropped."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..splats import PARAMETERS, SH_REST_BY_DEGREE, Splats

_log = logging.getLogger(__name__)

_ALPHAS = np.clip(np.arange(256) / 255, 0.25 / 255, 1 - 0.25 / 255)
LOGIT_OF_BYTE = np.log(_ALPHAS / (1 - _ALPHAS)).astype(np.float32)
"""[256] float32, opacity logit of a byte; 0 and 255 are moved inwards by a quarter of a step, so
that the logit is finite."""
_FLAT = 1e-12
"""Size in world units that replaces zero, whose logarithm is infinite."""

_MOST_LOGIT = 20.0
"""Largest absolute logit, of opacities 0 and 1."""


def opacities_of(raw: np.ndarray) -> np.ndarray:
    """Opacities from 0 to 1 from logits, float32."""
    with np.errstate(over="ignore"):
        return (1 / (1 + np.exp(-raw.astype(np.float32)))).astype(np.float32)


def opacity_bytes(raw: np.ndarray) -> np.ndarray:
    """Opacities as bytes, 0 to 255, from logits [N]."""
    return np.rint(255 * opacities_of(raw)).astype(np.uint8)


def logits(opacities: np.ndarray) -> np.ndarray:
    """Logits of opacities, float32; NaN outside 0 to 1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.log(opacities) - np.log1p(-opacities)
    return np.clip(values, -_MOST_LOGIT, _MOST_LOGIT).astype(np.float32)


def log_scales(linear: np.ndarray) -> np.ndarray:
    """Log scales of sizes, float32; zero becomes 1e-12, negative sizes NaN."""
    with np.errstate(invalid="ignore"):
        return np.log(np.where(linear == 0, np.float32(_FLAT), linear)).astype(np.float32)


def linear_scales(logs: np.ndarray) -> np.ndarray:
    """Sizes from log scales, float32, limited to its range."""
    return np.exp(np.minimum(logs, 88.0)).astype(np.float32)


def whole_bands(path: Path, rest: np.ndarray) -> np.ndarray:
    """SH coefficients [N, K'-1, 3] cut to whole bands up to degree 4, with a warning if any are
    lost."""
    each = rest.shape[1]
    keep = max(kept for kept in SH_REST_BY_DEGREE.values() if kept <= each)
    if keep < each:
        _log.warning(
            "%s has %d SH coefficients per channel beyond degree 0; only the first %d "
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
    """Valid splats of a file: those with non-finite numbers or a zero quaternion are dropped, with
    a warning.

    Args:
        path: File, for the warning.
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
    """Like `drawable`, without a warning; returns `splats` itself if all are valid."""
    # Programs that store opacity as a byte write a logit of +inf for 255: the splat is opaque.
    # A size of zero has a log scale of -inf: the splat is flat.
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
    """Log the number of dropped splats of a file, if any."""
    if left_out:
        _log.warning(
            "%s: %d of %d splats have numbers that are not finite or a zero quaternion; left out.",
            path,
            left_out,
            count,
        )
