"""Results of a run: metrics.json, and report.html, one self-contained file, with refined poses."""

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..config import DataConfig, TrainConfig
from ..config_command import depth_command, preset_text, train_command
from ..config_file import to_dict
from ..events import Decision, headline_psnr
from ..io.runs import CAPTURE
from ..metrics.named import NAMED_METRICS, NamedMetric
from ..metrics.summary import Metrics, write_metrics
from ..options import options_of
from ..text_format import count_text, has_exposure_correction, number_text, psnr_name, size_text
from .cameras_plan import CamerasSection, cameras_html, made_of
from .colormap import colorize
from .curves import Mark, Series, clean_points, legend, line_chart
from .depth import DepthSection, depth_html
from .histograms import Histogram, histograms_html
from .html_parts import (
    AXES,
    MOST_ROWS,
    SEAM,
    html_page,
    photo_table,
    switch,
    warnings_html,
    write_html,
)
from .pictures import ERROR_GAIN, ViewPictures
from .report_header import EXPOSED, TIMES, head_html, meaning_html, tiles_html
from .transients import MaskedPhoto, transients_html
from .trust_map import trust_html


@dataclass(frozen=True, kw_only=True)
class Report:
    """Contents of a report; empty parts are left out."""

    title: str
    """Usually the name of the capture."""
    metrics: dict[str, Any]
    """Content of metrics.json, of this or an older version."""
    views: Sequence[ViewPictures] = ()
    """Pictures of a `PictureCollector` given to `evaluate`."""
    warnings: Sequence[str] = ()
    """Sentences."""
    preset: str = ""
    """Preset of the training, as text."""
    command: str = ""
    """Shell command of the training."""
    depth_command: str = ""
    """Shell command that makes depth maps for the capture."""
    depth: DepthSection | None = None
    masked: Sequence[MaskedPhoto] = ()
    """Photos with transients."""
    cameras: CamerasSection | None = None
    histograms: Sequence[Histogram] = ()
    """Histograms of the splats."""
    config: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Option values by section."""


def report_html(report: Report) -> str:
    """The page as HTML."""
    metrics, views, title = report.metrics, report.views, report.title
    worths = {view["name"]: headline_psnr(view) for view in metrics["views"]}
    body = "".join(
        (
            head_html(title, metrics, preset=report.preset, command=report.command),
            warnings_html(report.warnings),
            tiles_html(metrics),
            meaning_html(metrics, report.depth_command),
            _decisions(report),
            SEAM,
            _curves(metrics.get("history") or [], metrics.get("evals") or [], metrics),
            _view_cards(views, metrics),
            _view_table(views),
            depth_html(report.depth) if report.depth else "",
            poses_html(metrics["poses"]) if metrics.get("poses") else "",
            blurs_html(metrics["blurs"]) if metrics.get("blurs") else "",
            transients_html(metrics["transients"], report.masked)
            if metrics.get("transients")
            else "",
            cameras_html(report.cameras, worths) if report.cameras else "",
            trust_html(report.cameras.scene, metrics) if report.cameras else "",
            histograms_html(report.histograms),
            _details(metrics, report.config),
        )
    )
    return html_page(f"{title}: gscore report", body, scripts=("report.js",))


def _decisions(report: Report) -> str:
    """Decisions of the run, without those that have a section of their own."""
    sections = {
        "depth": report.depth,
        "poses": report.metrics.get("poses"),
        "blur": report.metrics.get("blurs"),
        "transients": report.metrics.get("transients"),
    }
    found = [Decision(**one) for one in report.metrics.get("decisions") or ()]
    items = "".join(
        f"<li>{f'<b>{one.label}:</b> ' if one.label else ''}{html.escape(one.text)}</li>"
        for one in found
        if not sections.get(one.topic)
    )
    return (
        f'<section class="decisions"><h2>Decisions</h2><ul>{items}</ul></section>\n'
        if items
        else ""
    )


def _curves(history: list[dict[str, Any]], evals: list[dict[str, Any]], metrics: Any) -> str:
    if not history and len(evals) < 2:
        return ""
    held_out = "held-out views" if metrics["split"] == "test" else "measured views"
    boxes = []
    for name, key, log, from_zero in (
        (f"{psnr_name(metrics)} (dB)", "psnr", False, False),
        ("Loss", "loss", True, False),
        ("Splats", "splats", False, True),
    ):
        charts, keys = [], ""
        for axis, unit in (("step", "steps"), ("elapsed_s", "s")):
            series = []
            noisy = clean_points([(row.get(axis), row.get(key)) for row in history])
            if noisy:
                series.append(Series(label="training views, smoothed", points=noisy))
            exact = clean_points([(row.get(axis), row.get(key)) for row in evals])
            if exact and key == "psnr":
                series.append(Series(label=f"mean of the {held_out}", points=exact, dots=True))
            marks = photo_marks(history, axis)
            svg = line_chart(
                series, label=name, x_unit=unit, log=log, from_zero=from_zero, marks=marks
            )
            charts.append(f'<div class="by-{axis}">{svg}</div>')
            keys = keys or legend(series)
        scale = " <small>log scale</small>" if log else ""
        boxes.append(f'<figure class="plot"><h3>{name}{scale}</h3>{keys}{"".join(charts)}</figure>')
    axes = switch("axis", "Horizontal axis", AXES)
    hint = (
        '<p class="hint">Dashed lines: photos became larger, to this share of their size.</p>'
        if photo_marks(history, "step")
        else ""
    )
    if has_exposure_correction(metrics):
        hint += f'<p class="hint">{EXPOSED}</p>'
    return (
        '<section id="curves" data-axis="step"><div class="bar"><h2>Training</h2>'
        f'{axes}</div>{hint}<div class="plots">{"".join(boxes)}</div></section>\n'
    )


def photo_marks(history: Sequence[dict[str, Any]], axis: str) -> list[Mark]:
    """Marks of increases of the photo size, at the first step of the history with each size.

    Args:
        history: Rows of metrics.json; runs without photo sizes give no marks.
        axis: Key of the x axis.
    """
    marks = []
    for before, row in pairwise(history):
        factor, place = row.get("photo_factor"), row.get(axis)
        if factor and place is not None and factor != before.get("photo_factor"):
            label = "full size" if factor == 1 else f"1/{factor:.2g}"
            marks.append(Mark(x=place, label=label))
    return marks


def _view_cards(views: Sequence[ViewPictures], metrics: dict[str, Any]) -> str:
    pictured = [v for v in views if v.width]
    if not pictured:
        return ""
    stops = ", ".join("rgb({},{},{})".format(*c) for c in colorize(np.linspace(0, 1, 13)))
    scale = (
        f'<div class="scale"><span>0</span><i style="background:linear-gradient(90deg,{stops})">'
        "</i>"
        f"<span>{1 / ERROR_GAIN:g} or more</span> <em>error: mean absolute difference of the "
        f"channels in [0, 1], brightened {TIMES} {ERROR_GAIN:g}"
        f"{'; none outside the masks' if 'psnr_masked' in metrics else ''}</em></div>"
    )
    left_out = len(views) - len(pictured)
    note = f" Pictures of {len(pictured)} of {count_text(len(views), 'view')}." if left_out else ""
    photo = "photo"
    if metrics["mask_mode"] == "composite":
        photo = "photo over the background"
    order = switch("order", "Order", (("name", "by name"), ("psnr", "worst first")))
    cards = "".join(_card(v, number, photo) for number, v in enumerate(pictured))
    return (
        f'<section><div class="bar"><h2>Views</h2>{order}</div>'
        '<p class="hint"><span class="mouse">Hover over a render to show the photo. </span>'
        f'Click a picture to enlarge it.{note}</p>{scale}<div id="cards">{cards}</div></section>\n'
        '<div id="viewer" hidden><div><button data-show="photo">photo</button>'
        '<button data-show="render">render</button><button data-show="error">error</button>'
        '<button data-go="-1" aria-label="Previous view">&uarr;</button>'
        '<button data-go="1" aria-label="Next view">&darr;</button>'
        '<button data-show="close" aria-label="Close">&times;</button><b></b></div>'
        '<img alt=""></div>\n'
    )


def _card(view: ViewPictures, number: int, photo: str) -> str:
    name = html.escape(view.name, quote=True)
    figures = "".join(
        f'<figure><img class="{kind}" src="{uri}" width="{view.width}" height="{view.height}" '
        f'loading="lazy" alt="{words} of {name}"><figcaption>{words}</figcaption></figure>'
        for kind, words, uri in (
            ("photo", photo, view.photo),
            ("render", "render", view.render),
            ("error", "error", view.error),
        )
    )
    worth = headline_psnr(view.numbers)
    return (
        f'<article data-number="{number}" data-psnr="{"" if worth is None else f"{worth:.6f}"}" '
        f'data-name="{name}"><h3>{name}</h3><p>{_numbers_text(view.numbers)}</p>'
        f'<div class="triple">{figures}</div></article>'
    )


def _numbers_text(numbers: dict[str, Any]) -> str:
    parts = [
        f"{psnr_name(numbers)} <b>{number_text(headline_psnr(numbers), 2)}</b>",
        f"SSIM <b>{number_text(numbers.get('ssim'), 4)}</b>",
    ]
    if numbers.get("lpips") is not None:
        parts.append(f"LPIPS <b>{number_text(numbers['lpips'], 4)}</b>")
    return " · ".join(parts)


def _view_table(views: Sequence[ViewPictures]) -> str:
    if not views:
        return ""
    columns = [m for m in NAMED_METRICS if any(v.numbers.get(m.key) is not None for v in views)]
    head = "".join(f"<th>{metric.title}</th>" for metric in columns)
    rows = "".join(
        f"<tr><th>{html.escape(view.name)}</th>"
        + "".join(_cell(view.numbers, metric) for metric in columns)
        + f"<td>{view.numbers['render_seconds'] * 1000:.1f}</td></tr>"
        for view in views
    )
    return (
        '<details><summary>Numbers of every view</summary><div class="wide"><table>'
        f"<thead><tr><th>view</th>{head}<th>ms to render</th></tr></thead>"
        f"<tbody>{rows}</tbody></table></div></details>\n"
    )


def _cell(numbers: dict[str, Any], metric: NamedMetric) -> str:
    reason = html.escape(str(numbers.get(f"{metric.key}_reason", "")), quote=True)
    hint = f' title="{reason}"' if reason else ""
    return f"<td{hint}>{number_text(numbers.get(metric.key), metric.digits)}</td>"


def _details(metrics: dict[str, Any], config: dict[str, dict[str, Any]]) -> str:
    parts = [_definitions(metrics)]
    machine = metrics["machine"].items()
    machine = {k: size_text(v) if k.endswith("_bytes") else v for k, v in machine}
    parts.append(_table("Machine", machine))
    names = metrics["test_views"]
    listed = "\n".join(names) if names else "none"
    parts.append(
        f"<details><summary>Split: {count_text(len(metrics['train_views']), 'training view')}, "
        f"{len(names)} held out</summary><pre>{html.escape(listed)}</pre></details>"
    )
    parts += [_table(f"Options: {section}", values) for section, values in config.items()]
    return f'<section class="details">{"".join(parts)}</section>\n'


def _table(title: str, values: dict[str, Any]) -> str:
    rows = "".join(
        f"<tr><th>{html.escape(k)}</th><td>{html.escape('n/a' if v is None else str(v))}</td></tr>"
        for k, v in values.items()
    )
    return f"<details><summary>{html.escape(title)}</summary><table>{rows}</table></details>"


def _definitions(metrics: dict[str, Any]) -> str:
    rows = {}
    for metric in NAMED_METRICS:
        if metric.definition and metric.key in metrics:
            rows |= _definition(metrics, metric)
    return _table("How the numbers are defined", rows)


def _definition(metrics: dict[str, Any], metric: NamedMetric) -> dict[str, str]:
    title, value = metric.title, metrics[metric.key]
    if value is None:
        reason = metrics.get(f"{metric.key}_reason", "reason unknown")
        return {title: f"not measured: {reason}"}
    words = metric.definition.format(net=metrics.get("lpips_net"))
    return {f"{title} {value:.{metric.digits + 1}f}": words}


def poses_html(poses: Mapping[str, Any]) -> str:
    """The section.

    Args:
        poses: `why`; `cameras`, by name of the photo, with `degrees` and `extents`.
    """
    cameras = poses["cameras"]
    rows = {
        name: (one["degrees"], f"{one['degrees']:.3f}", f"{100 * one['extents']:.2f} %")
        for name, one in cameras.items()
    }
    more = f" Largest {MOST_ROWS} rotations of {len(cameras)}." if len(cameras) > MOST_ROWS else ""
    return (
        f'<section id="poses"><h2>Refined camera poses</h2><p class="hint">'
        f"{html.escape(poses['why'])}{more}</p>"
        f"{photo_table(('rotation, degrees', 'move, of the extent'), rows)}</section>\n"
    )


def blurs_html(blurs: Mapping[str, float]) -> str:
    """The section.

    Args:
        blurs: Standard deviations of blurred photos, px, by name.
    """
    rows = {name: (deviation, f"{deviation:.1f}") for name, deviation in blurs.items()}
    more = f" Largest {MOST_ROWS} of {len(blurs)}." if len(blurs) > MOST_ROWS else ""
    return (
        '<section id="blurs"><h2>Blurred photos</h2><p class="hint">More blurred than the others '
        "by a Gaussian of this standard deviation along its longer axis. Renders of them are "
        "blurred alike while training, so that splats stay sharp; `--no-photo-blur` compares sharp "
        f"ones.{more}</p>"
        f"{photo_table(('blur, px',), rows)}</section>\n"
    )


def shown_options(config: DataConfig | TrainConfig) -> dict[str, Any]:
    """The options as JSON values, `auto` for numbers that stand for it."""
    values = to_dict(config)
    for name, one in options_of(type(config)).items():
        if one.auto is not None and values.get(name) == one.auto:
            values[name] = "auto"
    return values


def write_results(
    folder: Path,
    metrics: Metrics,
    *,
    data: DataConfig,
    run: Path | None = None,
    trained: tuple[DataConfig, TrainConfig] | None = None,
    resolved: dict[str, Any] | None = None,
    views: Sequence[ViewPictures] = (),
    warnings: Sequence[str] = (),
    depth: DepthSection | None = None,
    masked: Sequence[MaskedPhoto] = (),
    cameras: CamerasSection | None = None,
    histograms: Sequence[Histogram] = (),
) -> dict[str, Any]:
    """Write both files, each completely or not at all.

    Args:
        folder: Folder of the files.
        metrics: The measurements.
        data: The measured capture.
        run: Folder of the training, for its command; None: not known.
        trained: Options of the training; None: not known.
        resolved: Values of automatic options; None: not known.
        views: Pictures for the report.
        warnings: Sentences for the report.
        depth: Depth section of the report.
        masked: Photos with transients.
        cameras: Camera section of the report.
        histograms: Histograms of the splats.

    Returns:
        Content of metrics.json.

    Raises:
        GsError: a file cannot be written.
    """
    content = metrics.content()
    config = {"data": shown_options(data)}
    if trained is not None:
        config["train"] = shown_options(trained[1])
    if resolved is not None:
        config["values of automatic options"] = resolved
    how = {}
    if trained is not None and run is not None:
        how = {"preset": preset_text(*trained)}
        how["command"] = train_command(*trained, run, requested=metrics.course.asked)
        how["depth_command"] = depth_command(trained[0])
    report = Report(
        title=_title(data.source, cameras),
        metrics=content,
        views=views,
        warnings=warnings,
        depth=depth,
        masked=masked,
        cameras=cameras,
        histograms=histograms,
        config=config,
        **how,
    )
    write_html(folder / "report.html", report_html(report))
    # The last file: its existence shows to a resumed run that all others exist.
    write_metrics(folder / "metrics.json", content)
    return content


def _title(source: Path, cameras: CamerasSection | None) -> str:
    """Name of the capture; for a capture made in a training, whose name is the same in every run,
    the name of its photos or video."""
    whole = source.resolve()
    if whole.name != CAPTURE or cameras is None:
        return whole.name
    origin = made_of(cameras)
    return whole.parent.name if origin is None else origin
