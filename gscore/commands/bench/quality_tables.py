"""Quality tables of `gscore bench quality`, in Markdown."""

from ...bench.paired import CaptureChange
from ...bench.quality import Comparison, Summary
from ...text_format import number, number_words
from .quality_results import Report


def tables(report: Report) -> str:
    """A table per capture, one of the differences, and a verdict per variant."""
    captures, compared = report
    parts = [_of_capture(name, variants) for name, variants in captures.items()]
    if compared:
        parts.append(_of_differences(compared, base=next(iter(next(iter(captures.values()))))))
        parts.append("\n".join(map(_verdict, compared)))
    return "\n\n".join(parts)


def _of_capture(name: str, variants: dict[str, Summary]) -> str:
    with_lpips = any(summary.median["lpips"] is not None for summary in variants.values())
    heads = [name, "PSNR", "trimmed", "colour-corrected", "trimmed", "SSIM"]
    heads += ["LPIPS"] * with_lpips
    heads += ["gap", "splats", "seconds", "worst view, colour-corrected"]
    lines = [_row(heads), "|---" * len(heads) + "|"]
    for label, summary in variants.items():
        median, trimmed = summary.median, summary.trimmed
        cells = [label]
        for key in ("psnr", "psnr_cc"):
            cells += [number_words(median[key], 2), number_words(trimmed[key], 2)]
        cells.append(number_words(median["ssim"], 4))
        cells += [number_words(median["lpips"], 4)] * with_lpips
        cells += [number_words(summary.gap, 2), number(summary.splats), f"{summary.seconds:.1f}"]
        cells.append(_worst(summary))
        lines.append(_row(cells))
    return "\n".join(lines)


def _worst(summary: Summary) -> str:
    worst = summary.worst
    if worst is None:
        return "n/a"
    return f"{worst.psnr_cc:.2f}: {worst.view}, seed {worst.seed}, offset {worst.offset}"


def _of_differences(compared: list[Comparison], base: str) -> str:
    heads = [f"against {base}", "capture", "pairs", "colour-corrected", "95 %", "PSNR", "SSIM"]
    with_lpips = any(c.lpips is not None for one in compared for c in one.captures.values())
    heads += ["LPIPS"] * with_lpips + ["relative time"]
    lines = [_row(heads), "|---" * len(heads) + "|"]
    for one in compared:
        for name, change in one.captures.items():
            lines.append(_row(_change_cells(one.variant, name, change, with_lpips)))
        overall = one.psnr_cc
        cells = [one.variant, "all", number(overall.pairs), f"{overall.median:+.2f}"]
        cells += [_interval(overall.low, overall.high), *[""] * (2 + with_lpips)]
        lines.append(_row([*cells, f"{one.seconds:.2f}"]))
    return "\n".join(lines)


def _change_cells(variant: str, capture: str, change: CaptureChange, with_lpips: bool) -> list[str]:
    psnr = change.psnr_cc
    cells = [variant, capture, number(psnr.pairs), f"{psnr.median:+.2f}"]
    cells += [_interval(psnr.low, psnr.high), _signed(change.psnr, 2), _signed(change.ssim, 4)]
    cells += [_signed(change.lpips, 4)] * with_lpips
    return [*cells, f"{change.seconds:.2f}"]


def _signed(value: float | None, digits: int) -> str:
    return "n/a" if value is None else f"{value:+.{digits}f}"


def _interval(low: float, high: float) -> str:
    return f"{low:+.2f} to {high:+.2f}"


def _verdict(one: Comparison) -> str:
    outcome = "becomes the default" if one.verdict.accepted else "stays out"
    return f"{one.variant}: {outcome} ({one.verdict.why})."


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"
