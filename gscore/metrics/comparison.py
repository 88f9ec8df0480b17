"""Comparison of two runs: common views, and the differences of their metrics."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import ConfigError
from ..events import headline_psnr
from ..io.metrics_file import is_number
from ..quoting import as_typed, brief
from ..text_format import psnr_name, stopped_text

HIGHER_IS_BETTER = {"psnr": True, "ssim": True, "lpips": False}
"""Compared metrics, in the order of tables."""
_HELD_OUT = "a held-out view"
_TRAINED_ON = "a training view"


@dataclass(frozen=True, kw_only=True)
class ComparedRun:
    """One of the two runs."""

    label: str
    """Name of its folder, with as many parents as make both labels unique."""
    folder: str
    """Path as given."""
    metrics: Mapping[str, Any]
    """Contents of its metrics.json."""
    options: Mapping[str, Any]
    """Contents of its config.json, value by option."""
    command: str = ""
    """Shell command that trains it again; empty: unknown."""


@dataclass(frozen=True, kw_only=True)
class ViewPair:
    """A view that both runs scored."""

    name: str
    numbers: Mapping[str, tuple[float, float]]
    """Values of the first and second run by the keys of `HIGHER_IS_BETTER`; keys that either lacks
    are left out. `psnr` is the headline PSNR."""


@dataclass(frozen=True, kw_only=True)
class RunComparison:
    """Comparison of two runs, view by view."""

    runs: tuple[ComparedRun, ComparedRun]
    pairs: tuple[ViewPair, ...]
    """Pairs in the order of the first run's views."""
    psnr_name: str
    """Name of the PSNR: of all pixels, or of those inside the masks."""
    only_in: tuple[tuple[str, ...], tuple[str, ...]]
    """Names of the views scored by one run only, for each run."""
    means: Mapping[str, tuple[float, float]]
    """Means of the numbers of all pairs; keys that any pair lacks are left out."""
    options: Mapping[str, tuple[Any, Any]]
    """Both values of the options in which the runs differ."""
    warnings: tuple[str, ...]
    """Messages on limits of the comparison."""

    def content(self) -> dict[str, Any]:
        """Comparison for JSON; values of both runs are lists of two."""
        return {
            "runs": [run.label for run in self.runs],
            "means": {key: list(values) for key, values in self.means.items()},
            "views": [
                {"name": pair.name} | {key: list(v) for key, v in pair.numbers.items()}
                for pair in self.pairs
            ],
            "only_in": [list(names) for names in self.only_in],
            "options": {key: list(values) for key, values in self.options.items()},
            "warnings": list(self.warnings),
        }


def compare_runs(first: ComparedRun, second: ComparedRun) -> RunComparison:
    """Pair the views of two runs of one capture by name.

    Raises:
        ConfigError: the runs have no views in common, or other sizes or mask modes.
    """
    runs = (first, second)
    scored = [_views(run) for run in runs]
    _check_masks(runs)
    names = [name for name in scored[0] if name in scored[1]]
    if not names:
        raise ConfigError(
            f"{brief(first.label)} and {brief(second.label)} have no scored view in common; "
            "measure one of them on views of the other with gscore eval --hold-out."
        )
    for name in names:
        _check_sizes(runs, name, [views[name] for views in scored])
    nets = [run.metrics.get("lpips_net") for run in runs]
    lpips = nets[0] is not None and nets[0] == nets[1]
    pairs = tuple(_pair(name, scored[0][name], scored[1][name], lpips=lpips) for name in names)
    keys = [key for key in HIGHER_IS_BETTER if all(key in pair.numbers for pair in pairs)]
    means = {key: _means([pair.numbers[key] for pair in pairs]) for key in keys}
    only = [tuple(n for n in a if n not in b) for a, b in (scored, scored[::-1])]
    return RunComparison(
        runs=runs,
        pairs=pairs,
        psnr_name=psnr_name(scored[0][names[0]]),
        only_in=(only[0], only[1]),
        means=means,
        options=_different(first.options, second.options),
        warnings=tuple(_warnings(runs, names, lpips=lpips)),
    )


def _views(run: ComparedRun) -> dict[str, dict[str, Any]]:
    """The scored views of a run by name."""
    views = run.metrics.get("views") or []
    found = {view["name"]: view for view in views if isinstance(view.get("name"), str)}
    if not found:
        raise ConfigError(
            f"{brief(run.folder)} has no metrics of views; measure it first: "
            f"{as_typed('eval', run.folder)}"
        )
    return found


_LONGEST = 20
"""Most letters of a value of metrics.json that are repeated."""


def _check_masks(runs: Sequence[ComparedRun]) -> None:
    modes = [str(run.metrics.get("mask_mode"))[:_LONGEST] for run in runs]
    if modes[0] != modes[1]:
        if "composite" in modes:
            advice = (
                "With composite masks splats show the subject only, else its surroundings too, so "
                "they cannot be compared: train one with the other's `--mask-mode`."
            )
        else:  # a run with masked pixels to ignore shows nothing true there
            ordered = runs if modes[1] == "none" else runs[::-1]
            advice = _measure_again(ordered, ("--mask-mode", "ignore"), "masks-ignore")
        raise ConfigError(
            f"{brief(runs[0].label)} was scored with `--mask-mode {modes[0]}`, "
            f"{brief(runs[1].label)} with {modes[1]}: their numbers are of different pixels. "
            f"{advice}"
        )


def _check_sizes(
    runs: Sequence[ComparedRun], name: str, views: Sequence[Mapping[str, Any]]
) -> None:
    sides = [[str(view.get(key))[:_LONGEST] for key in ("width", "height")] for view in views]
    if sides[0] != sides[1]:
        sizes, width = [f"{w} x {h} px" for w, h in sides], sides[0][0]
        raise ConfigError(
            f"{brief(runs[0].label)} was scored at {sizes[0]}, {brief(runs[1].label)} at "
            f"{sizes[1]} (view {brief(name)}): their numbers cannot be compared. "
            + _measure_again(runs, ("-r", width), f"{width}px")
        )


def _measure_again(runs: Sequence[ComparedRun], options: Sequence[str], mark: str) -> str:
    """Commands that measure the second of `runs` like the first, in another folder, and compare
    it."""
    first, second = (run.folder.rstrip("/") for run in runs)
    apart = f"{second}-{mark}"
    again = as_typed("eval", second, *options, "-o", apart)
    return (
        f"Measure {brief(second)} like {brief(first)}: {again}, and compare that: "
        f"{as_typed('compare', first, apart)}"
    )


def _pair(
    name: str, first: Mapping[str, Any], second: Mapping[str, Any], *, lpips: bool
) -> ViewPair:
    numbers: dict[str, tuple[float, float]] = {}
    for key in HIGHER_IS_BETTER:
        a, b = _number(first, key), _number(second, key)
        if a is not None and b is not None and (lpips or key != "lpips"):
            numbers[key] = (a, b)
    return ViewPair(name=name, numbers=numbers)


def _number(view: Mapping[str, Any], key: str) -> float | None:
    value = headline_psnr(view) if key == "psnr" else view.get(key)
    return float(value) if value is not None and is_number(value) else None


def _means(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    first, second = zip(*values, strict=True)
    return math.fsum(first) / len(first), math.fsum(second) / len(second)


def _different(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    names = list(dict.fromkeys((*first, *second)))
    both = {name: (first.get(name), second.get(name)) for name in names}
    return {name: values for name, values in both.items() if values[0] != values[1]}


def _warnings(runs: Sequence[ComparedRun], names: Sequence[str], *, lpips: bool) -> list[str]:
    found = []
    unlike = [name for name in names if _role(runs[0], name) != _role(runs[1], name)]
    if unlike:
        roles = [_role(run, unlike[0]) for run in runs]
        found.append(
            f"{unlike[0]} is {roles[0]} of {runs[0].label} and {roles[1]} of {runs[1].label}"
            + (f", and {len(unlike) - 1} more likewise" if len(unlike) > 1 else "")
            + ": a run that was trained on a photo has the advantage there."
        )
    for run in runs:
        requested = 0 if run.options.get("time_budget") else run.options.get("iterations") or 0
        if stopped := stopped_text(run.metrics, requested):
            found.append(f"{run.label} was {stopped}: its metrics are of an incomplete training.")
    nets = [run.metrics.get("lpips_net") for run in runs]
    if not lpips and all(nets):
        found.append(
            f"LPIPS was measured with {nets[0]} and with {nets[1]}, which cannot be compared."
        )
    return found


def _role(run: ComparedRun, name: str) -> str:
    return _HELD_OUT if name in (run.metrics.get("test_views") or ()) else _TRAINED_ON
