"""Quality bench: held-out metrics over captures x seeds x split offsets, in pairs."""

import math
import statistics
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from ..config import TrainConfig
from ..datasets import Dataset
from ..errors import FormatError
from ..events import finite, headline_psnr
from ..metrics import Lpips, LpipsNet, evaluate, psnr
from ..metrics.coverage import COVERED, WORST, coverage, lowest_view
from ..metrics.evaluate import target_picture
from ..metrics.photo_renders import PhotoRenders
from .paired import (
    CaptureChange,
    CaseChange,
    Difference,
    LeaveOut,
    Verdict,
    decide_default,
    leave_out,
    paired_difference,
    trimmed_mean,
)
from .training import Color, PictureOf, train_measured

COMPARED = ("psnr", "psnr_cc", "ssim", "lpips")
"""Metrics of a view with medians."""
CORRECTED = ("ssim_cc", "lpips_cc", "coverage")
"""Its other numbers."""


@dataclass(frozen=True, kw_only=True)
class ScoredView:
    """Metrics of a held-out view; None if undefined, as in metrics.json."""

    name: str
    psnr: float | None
    """Headline PSNR of a model: inside the masks if they hide pixels, dB."""
    psnr_cc: float | None
    """PSNR after colour correction, dB."""
    ssim: float | None
    lpips: float | None
    ssim_cc: float | None = None
    """SSIM and LPIPS after colour correction; None also in files of older versions."""
    lpips_cc: float | None = None
    coverage: float | None = None
    """Share that training photos show, as `metrics.coverage`."""


@dataclass(frozen=True, kw_only=True)
class Training:
    """Metrics of one training."""

    capture: str
    """Capture, or case: a capture with its thinning."""
    variant: str
    seed: int
    offset: int
    seconds: float
    """Time spent in steps, s."""
    splats: int
    gap: float | None
    """Median PSNR of the training views minus that of the held-out ones, dB."""
    views: tuple[ScoredView, ...]

    @property
    def key(self) -> tuple[str, str, int, int]:
        """Identifier of the training."""
        return self.capture, self.variant, self.seed, self.offset


@dataclass(frozen=True, kw_only=True)
class Worst:
    """The view with the lowest colour-corrected PSNR."""

    view: str
    seed: int
    offset: int
    psnr_cc: float
    psnr: float | None


@dataclass(frozen=True, kw_only=True)
class Summary:
    """One variant on one capture, over all views, seeds and offsets."""

    median: dict[str, float | None]
    """Median of the views by metric; None if no view has it."""
    trimmed: dict[str, float | None]
    """Mean without the lowest and the highest fifth."""
    worst: Worst | None
    worst_view: dict[str, dict[str, Any] | None]
    """The lowest view, each the mean over seeds, that training photos cover, by metric."""
    not_covered: list[str]
    """The other views."""
    gap: float | None
    """Median over the trainings, like the fields below; dB."""
    splats: int
    seconds: float


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Comparison of a variant with the first one."""

    variant: str
    captures: dict[str, CaptureChange]
    psnr_cc: Difference
    """Over all captures, dB."""
    seconds: float
    """Relative time, median over pairs of trainings."""
    verdict: Verdict
    cases: dict[str, CaseChange]
    """Mean differences by capture and thinning."""
    leave_out: LeaveOut
    """The rule over them."""


def train_scored(
    config: TrainConfig,
    photos: Dataset,
    eval_views: Dataset,
    *,
    capture: str,
    variant: str,
    offset: int,
    lpips: Lpips | LpipsNet | None = None,
    on_step: Callable[[int], None] | None = None,
) -> Training:
    """Train once and measure every held-out view, and the PSNR of the training views.

    Args:
        config: Options with the seed.
        photos: Training photos.
        eval_views: The same views at the size for measurements; may be `photos`.
        capture, variant, offset: Identifier of the training.
        lpips: Network of LPIPS, or None.
        on_step: Called after each step, outside the clock.
    """
    found: dict[str, Any] = {}

    def measure(picture_of: PictureOf, background: Color) -> None:
        found["views"] = evaluate(
            picture_of, eval_views, eval_views.test, lpips=lpips, background=background
        ).views
        found["train"] = [
            value
            for index in eval_views.train
            if not math.isnan(value := _view_psnr(picture_of, eval_views, index, background))
        ]

    trained = train_measured(
        config, photos, limited=True, eval_views=eval_views, on_step=on_step, at_end=measure
    )
    renders = PhotoRenders(
        trained.splats,
        eval_views.scene.cameras,
        near=trained.near,
        antialias=config.antialias,
        threads=config.threads,
    )
    shares = coverage(renders, eval_views)
    views = tuple(_scored_view(view, shares[view["name"]]) for view in found["views"])
    held_out = [view.psnr for view in views if view.psnr is not None]
    gap = None
    if held_out and found["train"]:
        gap = statistics.median(found["train"]) - statistics.median(held_out)
    return Training(
        capture=capture,
        variant=variant,
        seed=config.seed,
        offset=offset,
        seconds=trained.seconds,
        splats=len(trained.splats),
        gap=gap if gap is not None and math.isfinite(gap) else None,
        views=views,
    )


def _view_psnr(picture_of: PictureOf, photos: Dataset, index: int, background: Color) -> float:
    target, weights = target_picture(
        photos.image(index), photos.mask(index), photos.mask_mode, background
    )
    return psnr(picture_of(index), target, mask=weights)


def _scored_view(view: Mapping[str, Any], coverage: float) -> ScoredView:
    keys = ("name", "psnr_cc", "ssim", "lpips", "ssim_cc", "lpips_cc")
    values = {key: view[key] for key in keys}
    return ScoredView(psnr=headline_psnr(view), coverage=coverage, **values)


def training_json(training: Training) -> dict[str, Any]:
    """A training as JSON values; `read_training` reads them."""
    return finite(asdict(training))


def read_training(content: Any) -> Training:
    """Inverse of `training_json`.

    Raises:
        FormatError: a value is missing or has another type.
    """
    try:
        views = tuple(ScoredView(**view) for view in content["views"])
        training = Training(**content | {"views": views})
        texts = [training.capture, training.variant, *(view.name for view in views)]
        if not (all(isinstance(text, str) for text in texts) and training.seconds > 0):
            raise ValueError("names are not text, or the time is not positive")
        numbers = [training.seconds, training.splats, training.seed, training.offset]
        numbers += [getattr(view, key) for view in views for key in (*COMPARED, *CORRECTED)]
        math.fsum(0.0 if number is None else number for number in (*numbers, training.gap))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FormatError(f"not a training of this bench ({error})") from error
    return training


def summarize(trainings: Sequence[Training]) -> Summary:
    """One variant on one capture; at least one training."""
    covered = _covered(trainings)
    columns = {key: _column(trainings, key) for key in COMPARED}
    gaps = [training.gap for training in trainings if training.gap is not None]
    return Summary(
        median={key: statistics.median(c) if c else None for key, c in columns.items()},
        trimmed={key: trimmed_mean(c) if c else None for key, c in columns.items()},
        worst=_worst(trainings),
        worst_view=_worst_covered(trainings, covered),
        not_covered=sorted({v.name for t in trainings for v in t.views} - covered),
        gap=statistics.median(gaps) if gaps else None,
        splats=round(statistics.median(training.splats for training in trainings)),
        seconds=statistics.median(training.seconds for training in trainings),
    )


def _column(trainings: Iterable[Training], key: str) -> list[float]:
    values = (getattr(view, key) for training in trainings for view in training.views)
    return [value for value in values if value is not None]


def _worst(trainings: Iterable[Training]) -> Worst | None:
    known = [
        Worst(
            view=view.name,
            seed=training.seed,
            offset=training.offset,
            psnr_cc=view.psnr_cc,
            psnr=view.psnr,
        )
        for training in trainings
        for view in training.views
        if view.psnr_cc is not None
    ]
    return min(known, key=lambda worst: worst.psnr_cc, default=None)


def _covered(trainings: Sequence[Training]) -> set[str]:
    """Names of the views that training photos cover in the mean; all if it was not measured."""
    return {
        view
        for view, share in _view_means(trainings, "coverage", missing=1.0).items()
        if share >= COVERED
    }


def _view_means(
    trainings: Iterable[Training], key: str, *, missing: float | None = None
) -> dict[str, float]:
    """Mean of a metric over the trainings, by view; `missing`: value of a view without it."""
    values: dict[str, list[float]] = {}
    for training in trainings:
        for view in training.views:
            value = getattr(view, key)
            if (value := missing if value is None else value) is not None:
                values.setdefault(view.name, []).append(value)
    return {name: statistics.fmean(found) for name, found in values.items()}


def _worst_covered(
    trainings: Sequence[Training], covered: Container[str]
) -> dict[str, dict[str, Any] | None]:
    """`Summary.worst_view`."""
    found = {}
    for key in WORST:
        means = _view_means(trainings, key)
        views = [{"name": name, key: means[name]} for name in means if name in covered]
        found[key] = lowest_view(views, key)
    return found


def compare(trainings: Sequence[Training], base: str, variant: str) -> Comparison | None:
    """Compare a variant with `base` over their common trainings; None if they share no view.

    A view without a metric in one of them (an infinite PSNR) makes no pair.
    """
    mine = {training.key: training for training in trainings}
    pairs: dict[str, list[tuple[Training, Training]]] = {}
    for training in trainings:
        if training.variant == variant:
            other = mine.get((training.capture, base, training.seed, training.offset))
            if other is not None:
                pairs.setdefault(training.capture, []).append((other, training))
    changes = {name: groups for name, p in pairs.items() if (groups := _differences(p, "psnr_cc"))}
    if not changes:
        return None
    captures = {name: _change(pairs[name], groups) for name, groups in changes.items()}
    overall = paired_difference(list(changes.values()))
    cases = {name: _case_change(pairs[name]) for name in changes}
    seconds = _times_as_long([pair for name in changes for pair in pairs[name]])
    return Comparison(
        variant=variant,
        captures=captures,
        psnr_cc=overall,
        seconds=seconds,
        verdict=decide_default(overall, seconds, captures),
        cases=cases,
        leave_out=leave_out(cases),
    )


def _change(pairs: Sequence[tuple[Training, Training]], groups: list[list[float]]) -> CaptureChange:
    def median(key: str) -> float | None:
        values = [value for view in _differences(pairs, key) for value in view]
        return statistics.median(values) if values else None

    return CaptureChange(
        psnr_cc=paired_difference([groups]),
        psnr=median("psnr"),
        ssim=median("ssim"),
        lpips=median("lpips"),
        seconds=_times_as_long(pairs),
    )


def _case_change(pairs: Sequence[tuple[Training, Training]]) -> CaseChange:
    """Mean differences on one case; at least one view has a colour-corrected PSNR in both."""

    def mean(key: str) -> float | None:
        found = [_differences([pair], key) for pair in pairs]
        means = [statistics.fmean(value for (value,) in views) for views in found if views]
        return statistics.fmean(means) if means else None

    before, after = ([pair[side] for pair in pairs] for side in (0, 1))
    covered = _covered(before)
    old, new = (_worst_covered(trainings, covered) for trainings in (before, after))
    worst = {
        key: lowest["value"] - was["value"]
        for key in WORST
        if (was := old[key]) and (lowest := new[key])
    }
    return CaseChange(
        trainings=len(pairs),
        psnr_cc=mean("psnr_cc") or 0.0,
        ssim_cc=mean("ssim_cc"),
        lpips_cc=mean("lpips_cc"),
        worst_psnr_cc=worst.get("psnr_cc"),
        worst_ssim_cc=worst.get("ssim_cc"),
        seconds=math.fsum(t.seconds for t in after) / math.fsum(t.seconds for t in before),
        splats=sum(t.splats for t in after) / max(sum(t.splats for t in before), 1),
    )


def _differences(pairs: Iterable[tuple[Training, Training]], key: str) -> list[list[float]]:
    """Second minus first training of each pair, by held-out view."""
    views: dict[str, list[float]] = {}
    for before, after in pairs:
        known = {view.name: getattr(view, key) for view in before.views}
        for view in after.views:
            new, old = getattr(view, key), known.get(view.name)
            if new is not None and old is not None:
                views.setdefault(view.name, []).append(new - old)
    return list(views.values())


def _times_as_long(pairs: Iterable[tuple[Training, Training]]) -> float:
    return statistics.median(after.seconds / before.seconds for before, after in pairs)
