"""Depth priors of a capture: maps aligned with the SfM points, at training resolution."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..config import DataConfig
from ..datasets import Dataset
from ..datasets.dataset import map_threads
from ..datasets.decode import fit_map
from ..errors import DatasetError, FormatError
from ..io.images.read_image import read_mask
from ..text_format import count_text
from .confidence import confidence, shown_by
from .fit import NO_FIT, Fit
from .fitting import Alignment, align_views
from .maps import CONFIDENCE, DepthKind, MapFolder, read_map, to_inverse
from .observations import observations
from .origin import held_out_maps_warning
from .params import DEPTH_FOLDER
from .samples import unusable, view_samples

_TOLERABLE = 1.0
"""Expected relative error of an aligned inverse depth that halves the confidence."""


@dataclass(frozen=True, kw_only=True)
class DepthPrior:
    """Prior of one view at training resolution."""

    inverse_depth: np.ndarray
    """[H, W] float32, 1/world unit of the capture if `aligned`, else in the map's own unit; 0 where
    unknown."""
    confidence: np.ndarray
    """[H, W] float32 in [0, 1]; 0 where unknown (mask, edges, invalid)."""
    aligned: bool
    """Whether scale and offset are known; else only losses invariant to both are valid."""
    fit: Fit | None
    """Alignment with the SfM points; None: not aligned."""


@dataclass(frozen=True, kw_only=True)
class Priors:
    """The priors of a capture."""

    views: list[DepthPrior | None]
    """Priors by index of the dataset's views; None: there is no usable map."""
    kind: DepthKind
    """Kind of the maps."""
    folder: Path
    """Folder of the maps."""
    warnings: tuple[str, ...] = ()
    """Messages for the user."""
    table: list[dict[str, Any]] = field(default_factory=list)
    """One row per view, JSON values: view, map, points, scale, offset, inliers, error, accepted,
    reason."""


def load_priors(
    data: DataConfig,
    dataset: Dataset,
    *,
    joint: bool = True,
    on_progress: Callable[[int, int], None] | None = None,
) -> Priors:
    """Read the depth maps of a capture and align them with its world.

    Args:
        data: Options `depths` (empty: `depths`) and `depth_align`.
        dataset: The capture at training resolution.
        joint: Align maps to each other too, not to points only; takes seconds, for maps that
            supervise a training. Maps of held-out views are excluded from it.
        on_progress: Called with (done, total) while the maps are read.

    Raises:
        DatasetError: the folder is missing or has no usable map of any view, or, with `official`,
            there is no depth_params.json.
        FormatError: depth_params.json is damaged.
    """
    folder = MapFolder(dataset.source / (data.depths or DEPTH_FOLDER))
    maps = [folder.find(name) for name in dataset.names]
    warnings = [
        *_missing(folder, maps, dataset.names),
        *held_out_maps_warning(folder.root, [dataset.names[i] for i in dataset.test]),
    ]
    seen = observations(data, dataset)
    samples = view_samples(maps, seen, dataset)
    alignment = align_views(data, dataset, folder.root, samples, joint=joint)
    total = len(dataset)
    views: list[DepthPrior | None] = []

    def prior(index: int) -> DepthPrior | None:
        path, fit, part = maps[index], alignment.fits[index], samples[index]
        if path is None or part is None or part.problem:
            return None
        values = to_inverse(read_map(path), alignment.kind)
        return _prior(dataset, index, values, _stated_confidence(path, values), fit)

    for done, view in enumerate(map_threads(prior, list(range(total))), start=1):
        views.append(view)
        if on_progress is not None:
            on_progress(done, total)
    return Priors(
        views=views,
        kind=alignment.kind,
        folder=folder.root,
        warnings=(*warnings, *unusable(samples), *alignment.warnings),
        table=fit_table(dataset.names, maps, alignment),
    )


def fit_table(
    names: tuple[str, ...], maps: list[Path | None], alignment: Alignment
) -> list[dict[str, Any]]:
    """One row per view as in `Priors.table`; NaN becomes None."""
    rows = []
    for name, path, fit in zip(names, maps, alignment.fits, strict=True):
        stated = fit or NO_FIT.refused("there is no depth map of it")
        rows.append(
            {
                "view": name,
                "map": path.name if path is not None else None,
                "points": stated.points,
                "scale": stated.scale,
                "offset": stated.offset,
                "inliers": stated.inliers,
                "error": stated.error if np.isfinite(stated.error) else None,
                "accepted": stated.accepted,
                "reason": stated.reason,
            }
        )
    return rows


def _missing(folder: MapFolder, maps: list[Path | None], names: tuple[str, ...]) -> list[str]:
    missing = [name for name, path in zip(names, maps, strict=True) if path is None]
    if len(missing) == len(maps):
        raise DatasetError(
            f"{folder.root} has no depth map of any view (it contains "
            f"{count_text(len(folder), 'map')}); expected "
            f"names like {Path(names[0]).stem}.png. Make them with `gscore depth`, or name another "
            f"folder with `--depths`."
        )
    if not missing:
        return []
    listed = ", ".join(missing[:5]) + (", ..." if len(missing) > 5 else "")
    return [
        f"{len(missing)} of {count_text(len(maps), 'view')} have no depth map in {folder.root}: "
        f"{listed}."
    ]


def _stated_confidence(path: Path, values: np.ndarray) -> np.ndarray | None:
    """Confidence [H, W] float32 from the file of a map; None: there is no file.

    Raises:
        FormatError: it has another size than the map.
    """
    file = path.with_name(path.stem + CONFIDENCE)
    if not file.is_file():
        return None
    sure = read_mask(file).astype(np.float32) / 255
    if sure.shape != values.shape:
        raise FormatError(
            f"{file} is {sure.shape[1]} x {sure.shape[0]} pixels, its map {values.shape[1]} x "
            f"{values.shape[0]}. Remove it, or make both again: gscore depth SOURCE"
        )
    return np.where(np.isfinite(values), sure, np.float32(np.nan))


def _prior(
    dataset: Dataset, index: int, values: np.ndarray, stated: np.ndarray | None, fit: Fit | None
) -> DepthPrior:
    """Prior of a view at training resolution, aligned if the fit is accepted.

    `stated` is the confidence from the file; if None, it is computed from the map's edges.
    """
    file = dataset.files[index]
    values = fit_map(file, values)
    mask = dataset.mask(index) if dataset.mask_mode != "none" else None
    if stated is None:
        weight = confidence(values, mask)
    else:
        weight = np.nan_to_num(fit_map(file, stated), nan=0.0) * np.isfinite(values)
        weight = weight.astype(np.float32) if mask is None else shown_by(mask, weight)
    aligned = fit is not None and fit.accepted
    if fit is not None and fit.accepted:
        if fit.deviation > 0:
            weight /= 1 + (fit.relative_error(values) / np.float32(_TOLERABLE)) ** 2
            weight[np.isnan(weight)] = 0
        values = np.float32(fit.scale) * values + np.float32(fit.offset)
        with np.errstate(invalid="ignore"):
            weight[~(values > 0)] = 0  # behind infinity
    return DepthPrior(
        inverse_depth=np.nan_to_num(values, nan=0.0).astype(np.float32, copy=False),
        confidence=weight,
        aligned=aligned,
        fit=fit,
    )
