"""Quality results of `gscore bench quality`: results.json and results.md, written per training."""

import argparse
import shlex
from collections.abc import Collection, Iterable, Iterator
from dataclasses import asdict, replace
from typing import Any

from ..._version import __version__
from ...bench.paired import CaptureChange
from ...bench.quality import (
    Comparison,
    Summary,
    Training,
    compare,
    read_training,
    summarize,
    training_json,
)
from ...bench.training import first_size
from ...config_file import to_dict
from ...errors import ConfigError, FormatError
from ...events import finite
from ...io.files import read_bytes
from ...json_text import parse_json
from ...raster import native_library
from ...raster.gpu.choice import Chosen
from ...text_format import markdown_table, number, number_text
from .shared import Cell, ResultsFile

Report = tuple[dict[str, dict[str, Summary]], list[Comparison]]
"""Metrics by capture and variant; comparisons of the other variants with the first."""
_SEPARATOR = ("source", "test_offset", "max_width")
"""Options of a capture that are recorded elsewhere or differ by training."""


class QualityResults(ResultsFile):
    """The results so far; docs/quality.md describes the file."""

    def __init__(
        self, args: argparse.Namespace, device: Chosen, cells: Collection[Cell], net: str | None
    ) -> None:
        """Read the results of an earlier call, unless `args.overwrite`.

        Raises:
            ConfigError: that call had other settings, or the file is damaged.
        """
        self._setting = _setting(args, device, cells, net)
        super().__init__(args.output, device, command=command_text(args), setting=self._setting)
        self._requested = [
            (cell.capture, variant.label, seed, cell.offset)
            for cell in cells
            for variant in cell.variants
            for seed in args.seeds
        ]
        self._trainings: dict[tuple[str, str, int, int], Training] = {}
        if self.path.is_file() and not args.overwrite:
            self._read()

    def has(self, capture: str, variant: str, seed: int, offset: int) -> bool:
        """Whether this training is done already."""
        return (capture, variant, seed, offset) in self._trainings

    def add(self, training: Training) -> None:
        """Add a training and write the file."""
        self._trainings[training.key] = training
        self.write_report()

    def report(self) -> Report:
        """The tables of the requested results, as far as they exist."""
        done = [self._trainings[key] for key in self._requested if key in self._trainings]
        variants = list(dict.fromkeys(key[1] for key in self._requested))
        captures: dict[str, dict[str, list[Training]]] = {}
        for training in done:
            captures.setdefault(training.capture, {}).setdefault(training.variant, []).append(
                training
            )
        summaries = {
            name: {label: summarize(found) for label, found in of_variants.items()}
            for name, of_variants in captures.items()
        }
        compared = [compare(done, variants[0], label) for label in variants[1:]]
        return summaries, [found for found in compared if found is not None]

    def write_report(self, *, finished: bool = False) -> None:
        """Write the files with the tables so far."""
        summaries, compared = report = self.report()
        self.write(
            f"```\n{self.content['command']}\n```\n\n{tables(report)}",
            finished=finished,
            captures={
                name: {label: asdict(summary) for label, summary in variants.items()}
                for name, variants in summaries.items()
            },
            comparisons=[asdict(comparison) for comparison in compared],
            trainings=[training_json(training) for training in self._trainings.values()],
        )

    def _read(self) -> None:
        try:
            content = parse_json(read_bytes(self.path))
            setting, trainings = content["setting"], content["trainings"]
            differing = list(_differing(setting, self._setting))
            found = [read_training(training) for training in trainings]
        except (AttributeError, KeyError, TypeError, ValueError, FormatError) as error:
            raise ConfigError(
                f"{self.path} is not a results.json of this bench, or damaged ({error}); move it "
                "away or choose another output."
            ) from error
        if differing:
            raise ConfigError(
                f"{self.path} has other settings: {'; '.join(differing[:5])}. Give the same "
                "options to continue, or choose another output."
            )
        self._trainings = {training.key: training for training in found}
        for part in ("variants", "captures"):
            self._setting[part] = setting[part] | self._setting[part]


def command_text(args: argparse.Namespace) -> str:
    """The shell command of the arguments that differ from their defaults."""
    words = ["gscore", "bench", args.what]
    for action in args.parser._actions:
        value = getattr(args, action.dest, action.default)
        if value == action.default or action.dest == "json":
            continue
        flags = [flag for flag in action.option_strings if flag.startswith("--")]
        words += flags[1:2] if value is False else flags[:1]
        values = value if isinstance(value, list | tuple) else [value]
        words += [str(one) for one in values if not isinstance(one, bool)]
    return shlex.join(words)


def _setting(
    args: argparse.Namespace, device: Chosen, cells: Iterable[Cell], net: str | None
) -> dict[str, Any]:
    """Settings that must be equal for comparable trainings."""
    variants: dict[str, Any] = {}
    captures: dict[str, Any] = {}
    for cell in cells:
        for variant in cell.variants:
            options = to_dict(replace(variant.config, seed=0))
            variants[variant.label] = options | {"max_width": variant.data.max_width}
        first = cell.variants[0]
        data = {k: v for k, v in to_dict(first.data).items() if k not in _SEPARATOR}
        size, source = list(first_size(first.eval_views)), str(first.data.source.resolve())
        captures[cell.capture] = data | {"source": source, "judged_on": size}
    return finite(
        {
            "gscore": __version__,
            "isa": device.identity,
            "threads": args.threads or native_library.default_threads(),
            "lpips_net": net,
            "variants": variants,
            "captures": captures,
        }
    )


def _differing(old: Any, new: Any, where: str = "") -> Iterator[str]:
    """Sentences on differences of two settings; variants and captures may be added or removed."""
    if not (isinstance(old, dict) and isinstance(new, dict)):
        if old != new:
            yield f"{where} was {old}, is {new}"
        return
    may_come = where in ("variants", "captures")
    for key in new if may_come else old.keys() | new.keys():
        if may_come and key not in old:
            continue
        yield from _differing(old.get(key), new.get(key), f"{where} {key}".strip())


def tables(report: Report) -> str:
    """A table per capture, one of the differences, and a verdict per variant."""
    captures, compared = report
    parts = [_of_capture(name, variants) for name, variants in captures.items()]
    if compared:
        base = next(iter(next(iter(captures.values()))))
        parts += [_of_differences(compared, base), "\n".join(map(_verdict, compared))]
        parts += [_of_cases(compared, base), "\n".join(map(_leave_out, compared))]
    if left_out := _not_covered(captures):
        parts.append(left_out)
    return "\n\n".join(parts)


def _of_capture(name: str, variants: dict[str, Summary]) -> str:
    with_lpips = any(summary.median["lpips"] is not None for summary in variants.values())
    heads = [name, "PSNR", "trimmed", "colour-corrected", "trimmed", "SSIM"]
    heads += ["LPIPS"] * with_lpips
    heads += ["gap", "splats", "seconds", "worst view, colour-corrected"]
    rows = []
    for label, summary in variants.items():
        median, trimmed = summary.median, summary.trimmed
        cells = [label]
        for key in ("psnr", "psnr_cc"):
            cells += [number_text(median[key], 2), number_text(trimmed[key], 2)]
        cells.append(number_text(median["ssim"], 4))
        cells += [number_text(median["lpips"], 4)] * with_lpips
        cells += [number_text(summary.gap, 2), number(summary.splats), f"{summary.seconds:.1f}"]
        cells.append(_worst(summary))
        rows.append(cells)
    return markdown_table(heads, rows)


def _worst(summary: Summary) -> str:
    worst = summary.worst
    if worst is None:
        return "n/a"
    return f"{worst.psnr_cc:.2f}: {worst.view}, seed {worst.seed}, offset {worst.offset}"


def _of_differences(compared: list[Comparison], base: str) -> str:
    heads = [f"against {base}", "capture", "pairs", "colour-corrected", "95 %", "PSNR", "SSIM"]
    with_lpips = any(c.lpips is not None for one in compared for c in one.captures.values())
    heads += ["LPIPS"] * with_lpips + ["relative time"]
    rows = []
    for one in compared:
        for name, change in one.captures.items():
            rows.append(_change_cells(one.variant, name, change, with_lpips))
        overall = one.psnr_cc
        cells = [one.variant, "all", number(overall.pairs), f"{overall.median:+.2f}"]
        cells += [_interval(overall.low, overall.high), *[""] * (2 + with_lpips)]
        rows.append([*cells, f"{one.seconds:.2f}"])
    return markdown_table(heads, rows)


def _change_cells(variant: str, capture: str, change: CaptureChange, with_lpips: bool) -> list[str]:
    psnr = change.psnr_cc
    cells = [variant, capture, number(psnr.pairs), f"{psnr.median:+.2f}"]
    cells += [_interval(psnr.low, psnr.high), _signed(change.psnr, 2), _signed(change.ssim, 4)]
    cells += [_signed(change.lpips, 4)] * with_lpips
    return [*cells, f"{change.seconds:.2f}"]


def _of_cases(compared: list[Comparison], base: str) -> str:
    heads = [f"means against {base}", "case", "trainings", "colour-corrected PSNR", "SSIM", "LPIPS"]
    heads += ["worst view", "worst SSIM", "relative time", "relative splats"]
    rows = []
    digits = {"psnr_cc": 2, "ssim_cc": 4, "lpips_cc": 4, "worst_psnr_cc": 2, "worst_ssim_cc": 4}
    for one in compared:
        for name, case in one.cases.items():
            cells = [one.variant, name, number(case.trainings)]
            cells += [_signed(getattr(case, key), digits[key]) for key in digits]
            rows.append([*cells, f"{case.seconds:.2f}", f"{case.splats:.2f}"])
    return markdown_table(heads, rows)


def _leave_out(one: Comparison) -> str:
    outcome = "kept" if one.leave_out.kept else "not kept"
    return f"{one.variant}: {outcome} ({one.leave_out.why})."


def _not_covered(captures: dict[str, dict[str, Summary]]) -> str:
    """The views that do not count as worst views, as lines; empty: none."""
    found = {
        name: sorted({view for summary in variants.values() for view in summary.not_covered})
        for name, variants in captures.items()
    }
    return "\n".join(
        f"{name}: not covered by training photos: {', '.join(views)}."
        for name, views in found.items()
        if views
    )


def _signed(value: float | None, digits: int) -> str:
    return "n/a" if value is None else f"{value:+.{digits}f}"


def _interval(low: float, high: float) -> str:
    return f"{low:+.2f} to {high:+.2f}"


def _verdict(one: Comparison) -> str:
    outcome = "becomes the default" if one.verdict.accepted else "stays out"
    return f"{one.variant}: {outcome} ({one.verdict.why})."
