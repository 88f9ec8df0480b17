"""Text format of counts, sizes, durations and quality figures in messages."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from .events import ENDED, MASKED_OF, headline_psnr
from .quoting import brief, first_few

_LOW_PSNR = 20.0
"""PSNR, dB, below which differences are obvious: shapes are blurred or doubled."""


LOW_TRUST = 0.5
"""Trust, relative to the median, below which more photos of the place are recommended."""


def number_text(value: float | None, digits: int) -> str:
    """A number with this many decimals; n/a for None."""
    return "n/a" if value is None else f"{value:.{digits}f}"


def point_text(point: Iterable[float]) -> str:
    """A point with three digits: (1.23, -4.5, 678)."""
    return f"({', '.join(f'{value:.3g}' for value in point)})"


def number(count: int | None) -> str:
    """42,691; n/a for None."""
    return "n/a" if count is None else f"{count:,}"


def count_text(count: int, one: str, many: str = "") -> str:
    """1 view, 42,691 views; with `many` any other plural: 1 photo is, 2 photos are."""
    return f"{number(count)} {one if count == 1 else many or one + 's'}"


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown, without a line end after it."""
    lines = (f"| {' | '.join(row)} |" for row in rows)
    return "\n".join([f"| {' | '.join(heads)} |", "|---" * len(heads) + "|", *lines])


def size_text(count: int | None) -> str:
    """Bytes in decimal units: 12.3 MB."""
    if count is None:
        return "n/a"
    for factor, unit in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if count >= factor:
            return f"{count / factor:.3g} {unit}"
    return f"{count} B"


def time_text(seconds: float | None) -> str:
    """A duration: 42 s, 3 min 05 s, 1 h 02 min."""
    if seconds is None:
        return "n/a"
    if seconds < 60:
        return f"{seconds:.3g} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def quality_text(metrics: Mapping[str, Any]) -> str:
    """PSNR, SSIM and LPIPS of a metrics.json, headline figure first; empty: no PSNR."""
    if (worth := headline_psnr(metrics)) is None:
        return ""
    parts = [f"{psnr_name(metrics)} {worth:.2f} dB"]
    if "psnr_masked" in metrics and metrics.get("psnr") is not None:
        parts[0] += f" ({metrics['psnr']:.2f} dB with the pixels outside counted as equal)"
    if metrics.get("ssim") is not None:
        parts.append(f"SSIM {metrics['ssim']:.4f}")
    if metrics.get("lpips") is not None:
        parts.append(f"LPIPS ({metrics.get('lpips_net') or 'network'}) {metrics['lpips']:.4f}")
    return ", ".join(parts)


def colour_text(metrics: Mapping[str, Any]) -> str:
    """Colour-corrected metrics, to append to `quality_text`; empty: not measured."""
    digits = {"psnr_cc": "PSNR {:.2f} dB", "ssim_cc": "SSIM {:.4f}", "lpips_cc": "LPIPS {:.4f}"}
    parts = [form.format(metrics[k]) for k, form in digits.items() if metrics.get(k) is not None]
    plain, corrected = metrics.get("psnr"), metrics.get("psnr_cc")
    if plain is not None and corrected is not None and corrected <= plain - 0.1:
        parts[0] += " (lower: halves of a picture correct each other)"
    return f"; colour-corrected {', '.join(parts)}" if parts else ""


def views_text(metrics: Mapping[str, Any]) -> str:
    """Number and kind of the measured views: 8 training views, a sample of 59."""
    split, measured = metrics["split"], len(metrics["views"])
    train = len(metrics.get("train_views") or ()) if split == "train" else 0
    kind = {"test": "test view", "train": "training view"}.get(split, "view")
    sample = f", a sample of {number(train)}" if measured < train else ""
    return count_text(measured, kind) + sample


def verdict_text(metrics: Mapping[str, Any]) -> str:
    """A sentence on a low headline figure; empty: it is not low."""
    worth = headline_psnr(metrics)
    if worth is None or worth >= _LOW_PSNR or stopped_text(metrics):
        return ""
    return (
        f"Below {_LOW_PSNR:g} dB pictures differ strongly from the photos. Usual causes: a short "
        "training, inaccurate cameras, few photos, changing light, something that moved; "
        "report.html shows where."
    )


def worst_view_text(metrics: Mapping[str, Any]) -> str:
    """The worst covered view and the views that are not covered, as sentences; empty: not measured.

    Args:
        metrics: Content of a metrics.json.
    """
    found = metrics.get("worst_view") or {}
    forms = {"psnr_cc": "PSNR {:.2f} dB", "ssim_cc": "SSIM {:.4f}"}
    parts = [
        f"{form.format(worst['value'])} ({brief(worst['view'])})"
        for key, form in forms.items()
        if (worst := found.get(key))
    ]
    text = f"Worst view, colour-corrected: {', '.join(parts)}." if parts else ""
    if left_out := metrics.get("not_covered"):
        count = count_text(len(left_out), "view is", "views are")
        text += f" {count} not counted here, as training photos show less than 90 %: "
        text += f"{first_few(left_out)}."
    return text.strip()


def trust_text(metrics: Mapping[str, Any]) -> str:
    """The trust in views between training photos, as a sentence; empty: not measured.

    Args:
        metrics: Content of a metrics.json.
    """
    lowest, middle = metrics.get("trust_lowest"), metrics.get("trust_median")
    if not lowest or middle is None:
        return ""
    a, b = map(brief, lowest["between"])
    low = lowest["trust"] < LOW_TRUST * middle
    verdict = "less than half of it" if low else "no view is below half of it"
    return (
        f"Trust in views between photos: {middle:.0%} in the median, lowest "
        f"{lowest['trust']:.0%}, between {a} and {b}: {verdict}."
    )


def stopped_text(metrics: Mapping[str, Any], iterations: int = 0) -> str:
    """Step at which a training was stopped: "stopped after 500 of 1,500 steps"; empty: it was not
    stopped, or this is unknown.

    Args:
        metrics: Content of its metrics.json.
        iterations: Requested steps; 0: a time budget was requested.
    """
    reason, steps = metrics.get("reason"), metrics.get("steps")
    if not reason or reason in ENDED or steps is None or 0 < iterations <= steps:
        return ""
    return f"stopped after {step_text(steps, iterations)}"


def step_text(steps: int, iterations: int) -> str:
    """Progress of a training: 500 of 1,500 steps; without a total if `iterations` is 0."""
    of = f"{number(steps)} of " if iterations else ""
    return f"{of}{count_text(iterations or steps, 'step')}"


def has_exposure_correction(metrics: Mapping[str, Any]) -> bool:
    """Whether the training of a metrics.json optimised the exposure of each photo."""
    return bool((metrics.get("exposure") or {}).get("learnt"))


def psnr_name(metrics: Mapping[str, Any]) -> str:
    """Name of `headline_psnr`: with masks, or in the training of a region, it is that of the pixels
    inside."""
    if "psnr_masked" not in metrics:
        return "PSNR"
    return f"PSNR inside the {metrics.get(MASKED_OF, 'masks')}"
