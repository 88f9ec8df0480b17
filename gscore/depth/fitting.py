"""Fitting of all depth maps of a capture: samples, choice of the fit, rejections."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..config import DataConfig
from ..datasets import Dataset
from ..text_format import count_text
from .align import align_robust, reliable
from .consensus import agreed, with_errors
from .fit import NO_FIT, Fit, fit_of, median_scale
from .maps import DepthKind, stem
from .params import Params, key_of, params_path, read_params, refusal
from .samples import Samples

_LEAST_SHARE = 0.3
"""Minimum share of points that agree with a scale from depth_params.json."""
_MOST_ERROR = 0.1
"""Median relative error up to which a scale with fewer is used: maps are distorted, and points at
similar depths may all be off by that."""
_LEAST_CORRELATION = 0.1
"""Mean rank correlation below which the points do not show the kind of the maps."""


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """The fits of a capture's maps."""

    fits: list[Fit | None]
    """Fit of each view; None: it has no map."""
    kind: DepthKind
    """Kind of the maps; never AUTO."""
    warnings: tuple[str, ...] = ()
    """Messages for the user."""


def align_views(
    data: DataConfig,
    dataset: Dataset,
    folder: Path,
    samples: list[Samples | None],
    *,
    kind: DepthKind = DepthKind.AUTO,
    joint: bool = True,
) -> Alignment:
    """Scale and offset of every map in `folder` by the method `data.depth_align`.

    The median scale, the kind and the joint alignment use the maps of training views only; maps of
    held-out views are fitted to their own points, so held-out photos do not influence a training.

    Args:
        data: Its `depth_align` selects the method.
        dataset: The capture.
        folder: Folder of the maps.
        samples: Samples of the maps by view.
        kind: Kind of the maps; AUTO: detected from the points.
        joint: Align maps to each other too and estimate the errors; False: to the points only,
            which is much faster.

    Raises:
        DatasetError: `official`, and there is no depth_params.json.
        FormatError: depth_params.json is damaged.
    """
    path = params_path(dataset.source, folder)
    if data.depth_align == "official" or (data.depth_align == "auto" and path.is_file()):
        stated = _stated(path, read_params(path), dataset, samples)
        if joint:
            stated = _with_errors(stated, samples, dataset)
        if data.depth_align == "official":
            return stated
        return _checked(stated, path, samples, dataset, joint=joint)
    found, warnings = resolved_kind(kind, samples, dataset)
    if data.depth_align == "none":
        fits = [None if part is None else _evaluated(1.0, 0.0, part, found) for part in samples]
        alignment = Alignment(fits=fits, kind=found, warnings=warnings)
        return _with_errors(alignment, samples, dataset) if joint else alignment
    return robust(samples, found, dataset, warnings, joint=joint)


def robust(
    samples: list[Samples | None],
    kind: DepthKind,
    dataset: Dataset,
    warnings: tuple[str, ...] = (),
    *,
    joint: bool = True,
) -> Alignment:
    """Robust fits to the points, then to each other; refused if their scale is an outlier.

    Args:
        samples: Samples of the maps by view.
        kind: Kind of the maps.
        dataset: The capture, at the size of its photos in training.
        warnings: Earlier warnings, copied to the result.
        joint: As for `align_views`.
    """
    parts = [None if part is None else part.inverse(kind) for part in samples]
    fits = [None if part is None else _robust(part) for part in parts]
    if joint:
        fits = agreed(fits, _of_training(parts, dataset), dataset.scene.cameras)
    trained = (fits[i] for i in dataset.train)
    median = median_scale([fit.scale for fit in trained if fit is not None and fit.accepted])
    return Alignment(
        fits=reliable(fits, median),
        kind=kind,
        warnings=(*warnings, *_refusals(fits, samples, median)),
    )


def resolved_kind(
    kind: DepthKind, samples: list[Samples | None], dataset: Dataset
) -> tuple[DepthKind, tuple[str, ...]]:
    """Kind of the maps, AUTO resolved from the training views, and messages for the user."""
    return find_kind(_of_training(samples, dataset)) if kind is DepthKind.AUTO else (kind, ())


def _of_training(samples: list[Samples | None], dataset: Dataset) -> list[Samples | None]:
    """The samples of training views; None for held-out views."""
    train = set(dataset.train)
    return [part if i in train else None for i, part in enumerate(samples)]


def _with_errors(
    alignment: Alignment, samples: list[Samples | None], dataset: Dataset
) -> Alignment:
    """The same scales and offsets with their expected errors."""
    parts = [None if part is None else part.inverse(alignment.kind) for part in samples]
    parts = _of_training(parts, dataset)
    return replace(alignment, fits=with_errors(alignment.fits, parts, dataset.scene.cameras))


def _robust(part: Samples) -> Fit:
    if part.problem:
        return NO_FIT.refused(part.problem)
    return align_robust(part.values, part.inverse_depth, part.weights)


def find_kind(samples: list[Samples | None]) -> tuple[DepthKind, tuple[str, ...]]:
    """Kind of the maps from the rank correlation with the points, and messages for the user."""
    found = [c for part in samples if part is not None and (c := _correlation(part)) is not None]
    mean = float(np.mean(found)) if found else 0.0
    if abs(mean) < _LEAST_CORRELATION:
        return DepthKind.INVERSE, (
            "The points do not show whether the depth maps contain depth or inverse depth; inverse "
            "depth is assumed. Set it with `--kind` when making depth_params.json.",
        )
    return (DepthKind.INVERSE if mean > 0 else DepthKind.DEPTH), ()


def _correlation(part: Samples) -> float | None:
    """Spearman's rank correlation of map and inverse depth; None for few points or a constant
    map."""
    use = np.isfinite(part.values)
    values, depth = part.values[use], part.inverse_depth[use]
    if len(values) < 10 or np.ptp(values) == 0 or np.ptp(depth) == 0:
        return None
    ranks = np.stack([np.argsort(np.argsort(v)).astype(np.float64) for v in (values, depth)])
    return float(np.corrcoef(ranks[0], ranks[1])[0, 1])


def _stated(
    path: Path,
    params: dict[str, Params],
    dataset: Dataset,
    samples: list[Samples | None],
) -> Alignment:
    """Fits from depth_params.json; those that official tools would ignore are refused."""
    median = median_scale([entry.scale for entry in params.values()])
    kinds = {entry.kind for entry in params.values()}
    kind = DepthKind.DEPTH if kinds == {DepthKind.DEPTH} else DepthKind.INVERSE
    fits: list[Fit | None] = []
    for name, part in zip(dataset.names, samples, strict=True):
        if part is None:
            fits.append(None)
            continue
        if part.problem:
            fits.append(NO_FIT.refused(part.problem))
            continue
        entry = params.get(key_of(name))
        reason = refusal(path, stem(name), entry, median)
        if entry is None:
            fit = Fit(scale=0.0, offset=0.0, points=len(part.values))
        else:
            fit = _evaluated(entry.scale, entry.offset, part, entry.kind)
        fits.append(fit.refused(reason) if reason else fit)
    return Alignment(fits=fits, kind=kind, warnings=_refusals(fits, samples, median))


def _checked(
    stated: Alignment,
    path: Path,
    samples: list[Samples | None],
    dataset: Dataset,
    *,
    joint: bool,
) -> Alignment:
    """The fits of a file, replaced by robust ones in views whose points contradict it."""
    fits = list(stated.fits)
    wrong = [
        i
        for i, fit in enumerate(fits)
        if fit is not None
        and fit.accepted
        and fit.inliers < _LEAST_SHARE
        and fit.error > _MOST_ERROR
    ]
    if not wrong:
        return stated
    ours = robust(samples, stated.kind, dataset, joint=joint).fits
    for i in wrong:
        fits[i] = ours[i]
    sentence = (
        f"{path} contradicts the points of {count_text(len(wrong), 'view')}, as if it belonged "
        "to other maps; these are aligned again. Make it again: gscore depth SOURCE"
    )
    return replace(stated, fits=fits, warnings=(*stated.warnings, sentence))


def _evaluated(scale: float, offset: float, part: Samples, kind: DepthKind) -> Fit:
    """Fit of a given scale and offset with its quality at the points."""
    if part.problem:
        return NO_FIT.refused(part.problem)
    values = part.inverse(kind).values
    use = np.isfinite(values)
    return fit_of(scale, offset, values[use], part.inverse_depth[use], part.weights[use])


def _refusals(
    fits: list[Fit | None], samples: list[Samples | None], median: float
) -> tuple[str, ...]:
    """Message on all maps that are readable but refused; `unusable` reports unreadable ones."""
    usable = [
        fit
        for fit, part in zip(reliable(fits, median), samples, strict=True)
        if fit is not None and part is not None and not part.problem
    ]
    refused = [fit for fit in usable if not fit.accepted]
    if not refused:
        return ()
    return (
        f"{len(refused)} of {count_text(len(usable), 'depth map')} were not aligned, the first "
        f"because {refused[0].reason}.",
    )
