"""Report header: capture, options and metrics at the top of report.html, with their meaning."""

import html
from collections.abc import Iterator
from datetime import datetime
from typing import Any

from ..events import CONVERGED, FINISHED, TARGET, headline_psnr
from ..metrics.named import NAMED_METRICS, NamedMetric
from ..text_format import (
    count_text,
    has_exposure_correction,
    number,
    size_text,
    time_text,
    worst_view_text,
)

TIMES = "\u00d7"
_MASKED = "psnr_masked"
FAR_ABOVE = 4.0
"""Gap of training and held-out PSNR, dB, above which splats overfit the photos. Previews of
examples/studio: 0.9 with 50 training views, 2.9 with 20, 16.1 with 6."""
EXPOSED = (
    "Pictures have the exposure of their photo: that of a held-out photo is predicted from its "
    "neighbours and EXIF, not from its pixels. New views have the mean exposure."
)
"""HTML, for a run with exposure compensation."""
_HOW_ENDED = {
    FINISHED: "",
    TARGET: "to the target PSNR",
    CONVERGED: "until it converged",
    None: "",
}


def head_html(title: str, metrics: dict[str, Any], *, preset: str, command: str) -> str:
    """Title, photos, machine and date; the command of the training.

    Args:
        title: Usually the name of the capture.
        metrics: Content of metrics.json.
        preset: Preset as text; may be empty.
        command: Shell command; may be empty.
    """
    machine = metrics["machine"]
    ran = f"{machine['cpu']}, {count_text(machine['threads'], 'thread')}, {machine['isa']}"
    lines = [
        _join(_photos(metrics), _split_text(metrics)),
        _join(preset, _date(metrics), ran, f"gscore {metrics['gscore']}"),
    ]
    shown = "".join(f'<p class="sub">{html.escape(line)}</p>' for line in lines)
    if command:
        shown += f'<pre class="command">{html.escape(command)}</pre>'
    return f"<header><h1>{html.escape(title)}</h1>{shown}</header>\n"


def _join(*parts: str) -> str:
    sentence = " \u00b7 ".join(filter(None, parts))
    return sentence[:1].upper() + sentence[1:]


def _date(metrics: dict[str, Any]) -> str:
    """Date and time of the training's end; empty if unknown."""
    try:
        return f"{datetime.fromisoformat(metrics['trained_at']):%Y-%m-%d %H:%M}"
    except (KeyError, TypeError, ValueError):
        return ""


def _photos(metrics: dict[str, Any]) -> str:
    count = len(metrics["train_views"]) + len(metrics["test_views"])
    size = _picture_size(metrics)
    return _comma(count_text(count, "photo"), size)


def _split_text(metrics: dict[str, Any]) -> str:
    count, split = len(metrics["views"]), metrics["split"]
    if not count:
        return "no views measured: " + metrics.get("psnr_reason", "")
    if split == "test":
        return f"measured on {count_text(count, 'held-out view')}"
    if split == "all":
        held_out = len(metrics["test_views"])
        return f"measured on all {count_text(count, 'view')}, {held_out} of them held out"
    return f"measured on {count_text(count, 'training view')} (not held out, so not a test)"


def _picture_size(metrics: dict[str, Any]) -> str:
    sizes = {(v["width"], v["height"]) for v in metrics["views"]}
    if len(sizes) != 1:
        return "several sizes" if sizes else ""
    width, height = sizes.pop()
    return f"{width} {TIMES} {height} px"


def tiles_html(metrics: dict[str, Any]) -> str:
    """Tiles of the metrics, and a line on those that could not be measured."""
    cells = "".join(
        f'<div class="tile"><dt>{name}</dt><dd>{value}<small>{f" {unit}" if unit else ""}</small>'
        f"</dd><p>{html.escape(note)}</p></div>"
        for name, value, unit, note in (*_quality_tiles(metrics), *_work_tiles(metrics))
    )
    absent = [
        f"{metric.title} ({metrics[f'{metric.key}_reason']})"
        for metric in _quality(metrics)
        if metrics.get(metric.key) is None
        and metrics.get(f"{metric.key}_reason")
        and metrics["views"]
    ]
    lines = [f"Not measured: {'; '.join(absent)}."] if absent else []
    lines += [text] if (text := worst_view_text(metrics)) else []
    line = "".join(f'<p class="hint">{html.escape(text)}</p>' for text in lines)
    return f'<section><dl class="tiles">{cells}</dl>{line}</section>\n'


_Tile = tuple[str, str, str, str]
"""Name, value, unit, note."""


def _quality(metrics: dict[str, Any]) -> list[NamedMetric]:
    """Metrics in tiles, the headline PSNR first."""
    shown = [m for m in NAMED_METRICS if m.note and (m.key != _MASKED or _MASKED in metrics)]
    return sorted(shown, key=lambda metric: metric.key != _MASKED)


def _quality_tiles(metrics: dict[str, Any]) -> Iterator[_Tile]:
    for key, title, digits, unit, note, *_ in _quality(metrics):
        if metrics.get(key) is None:
            continue
        if key == "psnr" and _MASKED in metrics:
            note = "masked pixels count as equal"
        if key == "psnr" and metrics["mask_mode"] == "composite":
            note = "of whole pictures, with background"
        yield title, f"{metrics[key]:.{digits}f}", unit, note.format(net=metrics.get("lpips_net"))


def _work_tiles(metrics: dict[str, Any]) -> Iterator[_Tile]:
    models = f"{metrics['models']} merged models" if "models" in metrics else ""
    note = _comma(f"SH degree {metrics['sh_degree']}", models)
    yield "Splats", number(metrics["splats"]), "", note
    if metrics["train_seconds"] is not None:
        yield "Training", time_text(metrics["train_seconds"]), "", _steps(metrics)
    if metrics.get("fps") is not None:
        note = "median of the views"
        yield "Rendering", f"{metrics['fps']:.1f}", "fps", note
    yield "Storage", size_text(metrics["storage_bytes"]), "", "PLY file"
    if metrics["peak_memory_bytes"] is not None:
        yield "Peak memory", size_text(metrics["peak_memory_bytes"]), "", "resident"
    if metrics.get("device_peak_bytes"):
        yield "Device memory", size_text(metrics["device_peak_bytes"]), "", "at most"


def _steps(metrics: dict[str, Any]) -> str:
    if metrics["steps"] is None:
        return ""
    reason = metrics.get("reason")
    return _comma(
        count_text(metrics["steps"], "step"), _HOW_ENDED.get(reason, f"stopped: {reason}")
    )


def _comma(*parts: str) -> str:
    return ", ".join(filter(None, parts))


def meaning_html(metrics: dict[str, Any], depth_command: str = "") -> str:
    """Explanation of a large gap between training and held-out views; else empty.

    Args:
        metrics: Content of metrics.json.
        depth_command: Shell command that makes depth maps; may be empty.
    """
    rows = metrics.get("history") or []
    trained, held_out = (rows[-1].get("psnr") if rows else None), headline_psnr(metrics)
    if metrics["split"] != "test" or trained is None or held_out is None:
        return ""
    gap = trained - held_out
    if gap < FAR_ABOVE:
        return ""
    matched = metrics.get("psnr_cc") if has_exposure_correction(metrics) else None
    if matched is not None and trained - matched < FAR_ABOVE:
        return (
            '<section class="meaning"><h2>What this means</h2>'
            f"<p>Training views reach {trained:.1f} dB, held-out views {held_out:.1f} dB, and "
            f"{matched:.1f} dB after colour correction: most of the gap is due to different "
            f"exposures of the photos.</p><p>{EXPOSED}</p></section>\n"
        )
    maps = html.escape(depth_command or "gscore depth")
    return (
        '<section class="meaning"><h2>What this means</h2>'
        f"<p>Training views reach {trained:.1f} dB, held-out views {held_out:.1f} dB: "
        f"{gap:.1f} dB less. The splats overfit the training photos, so views between the photos "
        "are worse than the training views.</p>"
        f"{f'<p>{EXPOSED}</p>' if has_exposure_correction(metrics) else ''}"
        "<p>Photos from more positions help most. With few photos, depth maps help "
        f"(<code>{maps}</code>, then train with <code>--depths depths</code>), and fewer splats "
        "(<code>--max-splats</code>). If single views below are far worse than the others, check "
        "their cameras and photos first.</p></section>\n"
    )
