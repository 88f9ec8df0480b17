"""report.html: one file that shows what a run reached, with nothing loaded from elsewhere."""

import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..events import CONVERGED, FINISHED, TARGET, judged_psnr
from ..io.files import atomic_write
from .colormap import colorize
from .curves import Series, chart, clean_points, legend
from .depth import depth_html
from .pictures import ERROR_GAIN, ViewPictures
from .words import count_words, psnr_name, size_words, time_words

TIMES = "\u00d7"


def write_report(path: Path, run: dict[str, Any]) -> None:
    """Write the report of a run completely or not at all.

    Args:
        path: The HTML file.
        run: What to show:
            title: str, usually the capture's name.
            metrics: the content of metrics.json, see `summarize`.
            views: list of ViewPictures, from a `PictureCollector` given to `evaluate`.
            history, evals: curves as in `summarize`; without them those in metrics are drawn.
            warnings: list of sentences; may be missing or empty.
            depth: a DepthSection; may be missing or None.
            config: {section: {option: value}}; may be missing or empty.

    Raises:
        GsError: The file cannot be written.
    """
    # Names of files may hold bytes that are no UTF-8.
    atomic_write(path, report_html(run).encode("utf-8", "backslashreplace"))


def report_html(run: dict[str, Any]) -> str:
    """The page itself; see `write_report`."""
    metrics, views = run["metrics"], run.get("views") or []
    title = str(run["title"])
    body = "".join(
        (
            _header(title, metrics),
            _warnings(run.get("warnings") or []),
            _tiles(metrics),
            _curves(
                run.get("history") or metrics.get("history") or [],
                run.get("evals") or metrics.get("evals") or [],
                metrics,
            ),
            _view_cards(views, metrics),
            _view_table(views),
            depth_html(run["depth"]) if run.get("depth") else "",
            _details(metrics, run.get("config") or {}),
        )
    )
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}: gscore report</title>\n"
        f"<style>\n{_asset('report.css')}</style>\n</head>\n<body>\n<main>\n{body}</main>\n"
        f"<script>\n{_asset('report.js')}</script>\n</body>\n</html>\n"
    )


def _asset(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def _number(value: Any, digits: int) -> str:
    return "n/a" if value is None else f"{value:.{digits}f}"


def _count(value: int | None) -> str:
    return "n/a" if value is None else f"{value:,}".replace(",", " ")


def _split_words(metrics: dict[str, Any]) -> str:
    count, split = len(metrics["views"]), metrics["split"]
    if not count:
        return "no views: " + metrics.get("psnr_reason", "")
    if split == "test":
        return count_words(count, "held-out view")
    if split == "all":
        return f"all {count_words(count, 'view')}, {len(metrics['test_views'])} of them held out"
    return f"{count_words(count, 'training view')} (not held out, so this is no test)"


def _header(title: str, metrics: dict[str, Any]) -> str:
    machine = metrics["machine"]
    ran = f"{machine['cpu']}, {machine['threads']} threads, {machine['isa']}"
    return (
        f"<header><h1>{html.escape(title)}</h1>"
        f'<p class="sub">Scored on {_split_words(metrics)} · {html.escape(ran)} · '
        f"gscore {html.escape(metrics['gscore'])}</p></header>\n"
    )


def _warnings(sentences: Sequence[str]) -> str:
    if not sentences:
        return ""
    items = "".join(f"<li>{html.escape(s)}</li>" for s in sentences)
    return f'<section class="warnings"><h2>Warnings</h2><ul>{items}</ul></section>\n'


def _tiles(metrics: dict[str, Any]) -> str:
    net = metrics.get("lpips_net")
    lpips_note = f"net: {net}, lower is better" if net else metrics.get("lpips_reason", "")
    masked = "psnr_masked" in metrics
    meaning = "masked-out pixels as equal" if masked else "higher is better"
    tiles = [
        (
            "PSNR",
            _number(metrics.get("psnr"), 2),
            "dB",
            _reason(metrics, "psnr", meaning),
        ),
        ("SSIM", _number(metrics.get("ssim"), 4), "", "1 is identical"),
        ("D-SSIM", _number(metrics.get("d_ssim"), 4), "", "(1 - SSIM) / 2"),
        (
            "MS-SSIM",
            _number(metrics.get("ms_ssim"), 4),
            "",
            _reason(metrics, "ms_ssim", "five scales"),
        ),
        ("LPIPS", _number(metrics.get("lpips"), 4), "", lpips_note),
        ("Splats", _count(metrics["splats"]), "", f"SH degree {metrics['sh_degree']}"),
        ("Training", time_words(metrics["train_seconds"]), "", _steps(metrics)),
        ("Rendering", _number(metrics.get("fps"), 1), "fps", _picture_size(metrics)),
        ("Storage", size_words(metrics["storage_bytes"]), "", "PLY file"),
        ("Peak memory", size_words(metrics["peak_memory_bytes"]), "", "resident"),
    ]
    if masked:
        value = _number(metrics["psnr_masked"], 2)
        note = _reason(metrics, "psnr_masked", "of the pixels that count")
        tiles.insert(0, (psnr_name(metrics), value, "dB", note))
    cells = "".join(
        f'<div class="tile"><dt>{name}</dt><dd>{value}<small>{f" {unit}" if unit else ""}</small>'
        f'</dd><p title="{html.escape(note, quote=True)}">{html.escape(note)}</p></div>'
        for name, value, unit, note in tiles
    )
    return f'<section><dl class="tiles">{cells}</dl></section>\n'


def _reason(metrics: dict[str, Any], key: str, otherwise: str) -> str:
    return otherwise if metrics.get(key) is not None else metrics.get(f"{key}_reason", "")


_HOW_ENDED = {FINISHED: "", TARGET: "to the PSNR asked for", CONVERGED: "until it converged"}


def _steps(metrics: dict[str, Any]) -> str:
    if metrics["steps"] is None:
        return "time not known"
    how = _HOW_ENDED.get(metrics["reason"], f"stopped: {metrics['reason']}")
    return ", ".join(filter(None, (f"{_count(metrics['steps'])} steps", how)))


def _picture_size(metrics: dict[str, Any]) -> str:
    sizes = {(v["width"], v["height"]) for v in metrics["views"]}
    if len(sizes) != 1:
        return "pictures of several sizes" if sizes else ""
    width, height = sizes.pop()
    return f"{width} {TIMES} {height} px, median"


def _curves(history: list[dict[str, Any]], evals: list[dict[str, Any]], metrics: Any) -> str:
    if not history and len(evals) < 2:
        return ""
    held_out = "held-out views" if metrics["split"] == "test" else "scored views"
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
            svg = chart(series, label=name, x_unit=unit, log=log, from_zero=from_zero)
            charts.append(f'<div class="by-{axis}">{svg}</div>')
            keys = keys or legend(series)
        scale = " <small>log scale</small>" if log else ""
        boxes.append(f'<figure class="plot"><h3>{name}{scale}</h3>{keys}{"".join(charts)}</figure>')
    switch = (
        '<div class="switch" role="group" aria-label="Horizontal axis">'
        '<button data-axis="step" aria-pressed="true">steps</button>'
        '<button data-axis="elapsed_s" aria-pressed="false">seconds</button></div>'
    )
    return (
        '<section id="curves" data-axis="step"><div class="bar"><h2>Training</h2>'
        f'{switch}</div><div class="plots">{"".join(boxes)}</div></section>\n'
    )


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
    note = f" Pictures of {len(pictured)} of {len(views)} views." if left_out else ""
    photo = "photo"
    if metrics["mask_mode"] == "composite":
        photo = "photo over the background"
    cards = "".join(_card(v, number, photo) for number, v in enumerate(pictured))
    return (
        '<section><div class="bar"><h2>Views</h2><div class="switch" role="group" '
        'aria-label="Order"><button data-order="name" aria-pressed="true">by name</button>'
        '<button data-order="psnr" aria-pressed="false">worst first</button></div></div>'
        f'<p class="hint">Hold the mouse on a render to see the photo; click a picture to enlarge '
        f'it.{note}</p>{scale}<div id="cards">{cards}</div></section>\n'
        '<div id="viewer" hidden><div><button data-show="photo">photo</button>'
        '<button data-show="render">render</button><button data-show="error">error</button>'
        '<b></b><button data-show="close" aria-label="Close">&times;</button></div>'
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
    worth = judged_psnr(view.numbers)
    return (
        f'<article data-number="{number}" data-psnr="{"" if worth is None else f"{worth:.6f}"}" '
        f'data-name="{name}"><h3>{name}</h3><p>{_numbers_words(view.numbers)}</p>'
        f'<div class="triple">{figures}</div></article>'
    )


def _numbers_words(numbers: dict[str, Any]) -> str:
    parts = [
        f"{psnr_name(numbers)} <b>{_number(judged_psnr(numbers), 2)}</b>",
        f"SSIM <b>{_number(numbers.get('ssim'), 4)}</b>",
    ]
    if numbers.get("lpips") is not None:
        parts.append(f"LPIPS <b>{_number(numbers['lpips'], 4)}</b>")
    return " · ".join(parts)


_COLUMNS: tuple[tuple[str, str, int], ...] = (
    ("psnr", "PSNR", 2),
    ("psnr_u8", "PSNR 8 bit", 2),
    ("psnr_masked", "PSNR inside the masks", 2),
    ("ssim", "SSIM", 4),
    ("ssim_valid", "SSIM valid", 4),
    ("d_ssim", "D-SSIM", 4),
    ("ms_ssim", "MS-SSIM", 4),
    ("lpips", "LPIPS", 4),
)


def _view_table(views: Sequence[ViewPictures]) -> str:
    if not views:
        return ""
    columns = [c for c in _COLUMNS if any(v.numbers.get(c[0]) is not None for v in views)]
    head = "".join(f"<th>{label}</th>" for _, label, _ in columns)
    rows = "".join(
        f"<tr><th>{html.escape(view.name)}</th>"
        + "".join(_cell(view.numbers, key, digits) for key, _, digits in columns)
        + f"<td>{view.numbers['render_seconds'] * 1000:.1f}</td></tr>"
        for view in views
    )
    return (
        '<details><summary>Numbers of every view</summary><div class="wide"><table>'
        f"<thead><tr><th>view</th>{head}<th>ms to render</th></tr></thead>"
        f"<tbody>{rows}</tbody></table></div></details>\n"
    )


def _cell(numbers: dict[str, Any], key: str, digits: int) -> str:
    reason = html.escape(str(numbers.get(f"{key}_reason", "")), quote=True)
    hint = f' title="{reason}"' if reason else ""
    return f"<td{hint}>{_number(numbers.get(key), digits)}</td>"


def _details(metrics: dict[str, Any], config: dict[str, dict[str, Any]]) -> str:
    parts = [_definitions(metrics)]
    machine = {k: _machine_value(k, v) for k, v in metrics["machine"].items()}
    parts.append(_table("Machine", machine))
    names = metrics["test_views"]
    listed = "\n".join(names) if names else "none"
    parts.append(
        f"<details><summary>Split: {len(metrics['train_views'])} training views, {len(names)} "
        f"held out</summary><pre>{html.escape(listed)}</pre></details>"
    )
    parts += [_table(f"Options: {section}", values) for section, values in config.items()]
    return f'<section class="details">{"".join(parts)}</section>\n'


def _machine_value(key: str, value: Any) -> Any:
    return size_words(value) if key.endswith("_bytes") else value


def _table(title: str, values: dict[str, Any]) -> str:
    rows = "".join(
        f"<tr><th>{html.escape(k)}</th><td>{html.escape('n/a' if v is None else str(v))}</td></tr>"
        for k, v in values.items()
    )
    return f"<details><summary>{html.escape(title)}</summary><table>{rows}</table></details>"


_DEFINITIONS = (
    ("psnr", "PSNR", 3, "dB, mean over the views of -10 log10 MSE of floats clamped to [0, 1]"),
    ("psnr_u8", "PSNR 8 bit", 3, "both pictures rounded to 8 bit first, as scoring files does"),
    (
        "psnr_masked",
        "PSNR inside the masks",
        3,
        "only pixels the mask keeps; the other numbers count masked-out pixels as equal, as the "
        "loss does",
    ),
    (
        "ssim",
        "SSIM",
        5,
        f"11 {TIMES} 11 window, sigma 1.5, zero padding: the convention of the 3DGS code",
    ),
    ("ssim_valid", "SSIM valid", 5, "the same window, only where it lies inside the picture"),
    ("ms_ssim", "MS-SSIM", 5, "five scales, valid windows (Wang et al. 2003)"),
)


def _definitions(metrics: dict[str, Any]) -> str:
    rows = {
        f"{label} {_number(metrics.get(key), digits)}": words
        for key, label, digits, words in _DEFINITIONS
        if key != "psnr_masked" or key in metrics
    }
    rows[f"LPIPS {_number(metrics.get('lpips'), 5)}"] = (
        f"network {metrics['lpips_net']}, inputs in [-1, 1]; numbers of other networks cannot be "
        "compared"
        if metrics.get("lpips_net")
        else metrics.get("lpips_reason", "")
    )
    return _table("How the numbers are defined", rows)
