"""Depth targets: priors at the resolution of a training step, compact in memory."""

import hashlib
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
import torch

_SURE = 0.5
"""Least confidence of a pixel in the median."""
_SAMPLES = 4096
"""About the most pixels of a view in the median."""


class Prior(Protocol):
    """Interface of a depth prior, see `gscore.depth.DepthPrior`."""

    @property
    def inverse_depth(self) -> np.ndarray:
        """[H, W] float32, 1/world unit if `aligned`, else of unknown scale and offset."""
        ...

    @property
    def confidence(self) -> np.ndarray:
        """[H, W] float32 in [0, 1], 0 = unknown."""
        ...

    @property
    def aligned(self) -> bool:
        """True if the values have the scale of the capture."""
        ...


class DepthTarget(NamedTuple):
    """Depth prior of one view at one size."""

    inverse_depth: torch.Tensor
    """[H, W] float16 in `DepthTargets.unit`; from 0 to 1 if not aligned."""
    confidence: torch.Tensor
    """[H, W] uint8, 255 = sure."""
    aligned: bool


class DepthTargets:
    """Depth priors of a capture, three bytes per pixel, plus copies at the last requested size."""

    def __init__(
        self, priors: Sequence[Prior | None], *, train: Sequence[int], views: float
    ) -> None:
        """Convert the priors to the compact form.

        Args:
            priors: By index of the view; None: it has none.
            train: Training views; only they determine the unit.
            views: Median number of training views of a point (`rule.Coverage`).
        """
        self.views = views
        """Median number of training views of a point."""
        self.unit = _median([priors[i] for i in train]) or 1.0
        """Median inverse depth of the aligned priors, 1/world unit."""
        self._full = [
            None if prior is None else _compact(prior, unit=self.unit) for prior in priors
        ]
        self._kept: dict[int, DepthTarget] = {}

    def __contains__(self, index: int) -> bool:
        return self._full[index] is not None

    def is_aligned(self, index: int) -> bool:
        """Return whether view `index` has a prior with the scale of the capture."""
        found = self._full[index]
        return found is not None and found.aligned

    def at(self, index: int, width: int, height: int) -> DepthTarget | None:
        """Prior of a view, area-averaged to this size by confidence; None: it has none."""
        full = self._full[index]
        if full is None or full.inverse_depth.shape == (height, width):
            return full
        kept = self._kept.get(index)
        if kept is None or kept.inverse_depth.shape != (height, width):
            kept = self._kept[index] = _scaled(full, width, height)
        return kept

    def content_hash(self) -> str:
        """Short hash of all values; changes with any map or its alignment."""
        digest = hashlib.sha256(np.float64(self.unit).tobytes())
        for target in self._full:
            if target is None:
                digest.update(b"-")
                continue
            digest.update(b"a" if target.aligned else b"r")
            digest.update(target.inverse_depth.numpy().tobytes())
            digest.update(target.confidence.numpy().tobytes())
        return digest.hexdigest()[:16]


def area_mean(values: np.ndarray, width: int, height: int) -> np.ndarray:
    """Downscale by exact area averaging to [height, width] float64.

    Pixel centres are at +0.5, consistent with `scale_intrinsics`.

    Args:
        values: [H, W].
        width: At most W.
        height: At most H.
    """
    return _means_of_rows(_means_of_rows(values, height).T, width).T


def _means_of_rows(values: np.ndarray, count: int) -> np.ndarray:
    total = np.zeros((len(values) + 1, values.shape[1]))
    np.cumsum(values, axis=0, dtype=np.float64, out=total[1:])
    edges = np.linspace(0.0, len(values), count + 1)
    low = np.minimum(edges.astype(np.int64), len(values) - 1)
    part = (edges - low)[:, None]
    at_edges = total[low] * (1 - part) + total[low + 1] * part
    return np.diff(at_edges, axis=0) * (count / len(values))


def _median(priors: Sequence[Prior | None]) -> float:
    """Median of the confident pixels of all aligned priors, 1/world unit; 0 without any."""
    found = []
    for prior in priors:
        if prior is not None and prior.aligned:
            values = prior.inverse_depth[(prior.confidence >= _SURE) & (prior.inverse_depth > 0)]
            found.append(values[:: max(1, values.size // _SAMPLES)])
    every = np.concatenate(found) if found else np.zeros(0)
    return float(np.median(every)) if every.size else 0.0


def _compact(prior: Prior, *, unit: float) -> DepthTarget:
    values, confidence = prior.inverse_depth, prior.confidence
    known = (confidence > 0) & np.isfinite(values)
    values = np.where(known, values, 0).astype(np.float32)
    if prior.aligned:
        values = values / np.float32(unit)
    elif known.any():
        low, high = float(values[known].min()), float(values[known].max())
        values = np.where(known, (values - low) / (high - low or 1.0), 0)
    # Half floats have 3 digits, more than any prior is accurate to.
    half = np.clip(values, 0, np.finfo(np.float16).max).astype(np.float16)
    weight = (np.where(known, np.clip(confidence, 0, 1), 0) * 255 + 0.5).astype(np.uint8)
    return DepthTarget(torch.from_numpy(half), torch.from_numpy(weight), prior.aligned)


def _scaled(full: DepthTarget, width: int, height: int) -> DepthTarget:
    weight = full.confidence.numpy().astype(np.float32)
    values = area_mean(full.inverse_depth.numpy().astype(np.float32) * weight, width, height)
    weight = area_mean(weight, width, height)
    values = values / np.where(weight > 0, weight, 1)
    return DepthTarget(
        torch.from_numpy(values.astype(np.float16)),
        torch.from_numpy((weight + 0.5).astype(np.uint8)),
        full.aligned,
    )
