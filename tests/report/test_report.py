"""report.html: self-contained, well-formed, bounded, and showing the numbers it was given."""

import base64
import io
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from gscore.config import DataConfig, TrainConfig
from gscore.errors import GsError
from gscore.events import Decision
from gscore.metrics import headline
from gscore.report import (
    MaskedPhoto,
    PictureCollector,
    Report,
    cameras_section,
    splat_histograms,
)
from gscore.report.colormap import colorize
from gscore.report.curves import (
    Series,
    clean_points,
    line_chart,
    log_ticks,
    nice_ticks,
    short_number,
)
from gscore.report.html_parts import PAGE, link_page, write_html
from gscore.report.page import report_html, shown_options
from gscore.report.pictures import BYTES_IN_ALL, ERROR_GAIN, MAX_VIEWS
from gscore.scene import Cameras, PointCloud, Scene
from gscore.splats import Splats
from gscore.text_format import size_text, time_text
from tests.browser import page_after
from tests.light_changes import decode

VOID = {"meta", "img", "br", "link", "hr", "input"}


class Page(HTMLParser):
    """Checks that tags nest and collects links, classes and texts."""

    def __init__(self, text):
        super().__init__()
        self.stack, self.links, self.tags, self.words = [], [], [], []
        self.shown = ""
        self.feed(text)
        assert self.stack == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.links += [v for k, v in attrs if k in ("src", "href", "data", "action") and v]
        if tag not in VOID:
            self.stack.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.stack.pop() == tag

    def handle_data(self, data):
        self.words.append(data)
        if not {"style", "script"} & set(self.stack):
            self.shown += data


@pytest.fixture
def run(metrics_dict):
    def make(**changes):
        metrics, views = metrics_dict(**changes)
        steps = range(0, 500, 5)
        history = [
            {"step": s, "elapsed_s": s / 7, "loss": 1 / (s + 3), "psnr": 10 + s / 50, "splats": s}
            for s in steps
        ]
        evals = [
            {"step": 100, "elapsed_s": 14.0, "psnr": 12.0},
            {"step": 500, "elapsed_s": 71.0, "psnr": 19.0},
        ]
        return Report(
            title="a <script>alert(1)</script> capture",
            metrics=metrics | {"history": history, "evals": evals},
            views=views,
            warnings=["3 photos & no camera"],
            config={"train": {"iterations": 500, "lpips": None}},
        )

    return make


def test_page_is_whole_and_alone(run, tmp_path):
    """Oracle: an HTML parser; nothing but data URIs is referred to."""
    path = tmp_path / "report.html"
    write_html(path, report_html(run()))
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert len(page.links) == 3 and all(x.startswith("data:image/jpeg;base64,") for x in page.links)
    assert not re.search(r"https?://|url\(|@import", text)
    assert "<script>alert" not in text and "a <script>alert(1)</script> capture" in page.words
    assert "3 photos & no camera" in page.words


def test_splat_page_next_to_the_report_is_linked(run, tmp_path):
    """Oracle: an HTML parser; once, however often it is asked for; a foreign report stays."""
    report = tmp_path / "report.html"
    write_html(report, report_html(run()))
    before = report.read_text()
    assert not link_page(tmp_path) and report.read_text() == before
    (tmp_path / PAGE).write_text("x")
    assert link_page(tmp_path) and link_page(tmp_path)
    page = Page(report.read_text())
    assert [link for link in page.links if not link.startswith("data:")] == [PAGE, PAGE]
    assert "Look around in 3D" in page.words
    report.write_text("<p>mine</p>")
    assert not link_page(tmp_path) and report.read_text() == "<p>mine</p>"


def test_the_head_says_what_was_done(run):
    """Oracle: preset, command, date, photos and their size, as given."""
    content = run()
    content.metrics["trained_at"] = "2031-02-03T04:05:06+01:00"
    command = "gscore train 'a <b>' -o run"
    content = replace(content, preset="preset draft, changed", command=command)
    shown = Page(report_html(content)).shown
    head = shown[: shown.index("Warnings")]
    for words in ("Preset draft, changed", "2031-02-03 04:05", "3 photos, 64 \u00d7 48 px"):
        assert words in head
    assert "gscore train 'a <b>' -o run" in head


def test_decisions_are_listed(run):
    """Oracle: labels and sentences; one that has a section of its own is there once, one without
    a known topic has no label, and none make no section."""
    found = [Decision("enough", "5 of <9> steps."), Decision("poses", "Cameras moved.")]
    report = run(decisions=[*found, Decision("", "By hand.")])
    report.metrics["poses"] = {"why": "Cameras moved.", "cameras": {}}
    words = Page(report_html(report)).words
    assert "Decisions Caps: 5 of <9> steps. By hand." in " ".join(word.strip() for word in words)
    assert words.count("Cameras moved.") == 1
    assert 'class="decisions"' in report_html(report)
    assert 'class="decisions"' not in report_html(run())


def test_blurred_photos_have_a_table(run):
    """Oracle: names and numbers in falling order, the first 20 of them; the decision is not listed
    a second time."""
    report = run(decisions=[Decision("blur", "Two are blurred.")])
    report.metrics["blurs"] = {f"<{i}>.jpg": 1 + i / 10 for i in range(22)}
    shown = Page(report_html(report)).shown
    assert "Blurred photos" in shown and "Two are blurred." not in shown
    assert "Largest 20 of 22." in shown
    assert shown.index("<21>.jpg") < shown.index("3.1") < shown.index("<2>.jpg")
    assert "<1>.jpg" not in shown
    report.metrics["blurs"] = {"a.jpg": 2.0}
    assert "Largest" not in Page(report_html(report)).shown


def test_transients_have_pictures_and_a_table(run):
    """Oracle: shares in falling order; red where a mask is 0; the decision is not listed twice."""
    report = run(decisions=[Decision("transients", "People were found.")])
    report.metrics["transients"] = {"<a>.jpg": 0.031, "b.jpg": 0.12}
    shown = Page(report_html(report)).shown
    assert "Transients" in shown and "People were found." not in shown
    assert shown.index("b.jpg") < shown.index("12.0 %") < shown.index("<a>.jpg")
    assert "<img" not in re.findall('id="transients".*?</section>', report_html(report))[0]
    photo, mask = np.full((600, 800, 3), 100, np.uint8), np.full((600, 800), 255, np.uint8)
    mask[:, :400] = 0
    masked = MaskedPhoto.of("<a>.jpg", photo, mask)
    assert (masked.width, masked.height) == (320, 240)
    page = report_html(replace(report, masked=[masked]))
    part = re.findall('id="transients".*?</section>', page)[0]
    assert part.count("<img") == 1 and 'alt="&lt;a&gt;.jpg, transients in red"' in part
    stream = io.BytesIO(base64.b64decode(masked.uri.partition(",")[2]))
    picture = np.asarray(Image.open(stream), int)
    assert abs(picture[:, 300] - 100).max() < 6
    assert abs(picture[:, 20] - [165, 65, 65]).max() < 12


def test_exposed_and_neutral_figures_are_labelled(run):
    """Oracle: whether the training learnt exposures, in metrics.json; once by the curves, and where
    training views are compared with held-out ones."""
    content = run(split="test")
    content.metrics["history"][-1]["psnr"] = 60.0
    content.metrics["exposure"] = {"learnt": False}
    assert "New views have the mean exposure" not in report_html(content)
    content.metrics["exposure"]["learnt"] = True
    assert report_html(content).count("New views have the mean exposure") == 2


def test_gap_due_to_exposure_is_explained(run):
    """Oracle: matched colours are within the limit of the training views, or are not; and are not
    asked where photos were taken as they are."""
    content = run(split="test")
    content.metrics["history"][-1]["psnr"] = 30.0
    for learnt, matched, reported in (
        (True, 27.5, True),
        (True, 20.0, False),
        (False, 27.5, False),
    ):
        numbers = {"psnr": 19.0, "psnr_cc": matched, "exposure": {"learnt": learnt}}
        content.metrics.update(numbers)
        shown = Page(report_html(content)).shown
        assert ("and 27.5 dB after colour correction" in shown) is reported
        assert ("overfit the training photos" in shown) is not reported


def test_few_photos_get_advice_on_maps(run):
    """Oracle: the command given, as HTML."""
    content = replace(run(split="test"), depth_command="gscore depth 'run/<capture>' --hold-out 8")
    content.metrics["history"][-1]["psnr"] = 60.0
    assert "gscore depth 'run/<capture>' --hold-out 8" in Page(report_html(content)).shown


def test_old_metrics_make_a_page(run):
    """Oracle: a metrics.json without what later ones have, and rows of a history without sizes."""
    content = run()
    metrics = json.loads(json.dumps(content.metrics))
    del metrics["trained_at"], metrics["reason"]
    page = Page(report_html(Report(title="x", metrics=metrics)))
    assert "None" not in page.shown and "Dashed lines" not in page.shown
    assert "500 steps" in page.shown


@pytest.mark.parametrize("missing", ["lpips", "ms_ssim", "fps", "train_seconds"])
def test_no_tile_says_only_that_nothing_is_known(run, missing):
    """Oracle: the tiles of a page whose metrics lack a number; its reason stands elsewhere."""
    content = run()
    content.metrics.update({missing: None})
    if missing in ("lpips", "ms_ssim"):
        content.metrics[f"{missing}_reason"] = "there was no time"
    text = report_html(content)
    tiles = re.findall(r'<div class="tile"><dt>(.*?)</dt><dd>(.*?)<small>', text)
    assert len(tiles) >= 6 and all(re.fullmatch(r"[\d ]+.*", value) for _, value in tiles)
    if missing in ("lpips", "ms_ssim"):
        name = {"lpips": "LPIPS", "ms_ssim": "MS-SSIM"}[missing]
        assert f"{name} (there was no time)" in Page(text).shown
        assert name not in dict(tiles)


def test_sizes_of_photos_are_marked(run):
    """Oracle: the steps at which the history's sizes change, to scale; none where none change."""
    content = run()
    assert 'class="mark"' not in report_html(content)
    for row in content.metrics["history"]:
        row["photo_factor"] = 4.0 if row["step"] < 100 else 2.0 if row["step"] < 300 else 1.0
    text = report_html(content)
    assert "Dashed lines: photos became larger" in text
    svg = ElementTree.fromstring(re.search(r"<svg.*?</svg>", text, re.S)[0])
    lines = [line for line in svg.iter("line") if line.get("class") == "mark"]
    assert [line[0].text for line in lines] == ["1/2", "full size"]
    first, last = (
        next(float(t.get("x")) for t in svg.iter("text") if t.text == label)
        for label in ("0", "400")
    )
    found = [float(line.get("x1")) for line in lines]
    assert found == pytest.approx([first + (last - first) * s / 400 for s in (100, 300)], abs=0.1)


@pytest.mark.parametrize(
    ("trained", "split", "reported"),
    [(30.0, "test", True), (16.0, "test", False), (30.0, "train", False), (None, "test", False)],
)
def test_splats_that_fit_only_the_photos_are_explained(run, trained, split, reported):
    """Oracle: the difference of both numbers, where views were held out."""
    content = run(split=split)
    content.metrics.update({"psnr": 15.25, "history": [{"step": 1, "psnr": trained}]})
    shown = Page(report_html(content)).shown
    assert ("What this means" in shown) is reported
    if reported:
        assert "Training views reach 30.0 dB, held-out views 15.2 dB: 14.8 dB less" in shown
        assert "gscore depth" in shown


def test_reason_of_the_end_is_stated(run):
    """Oracle: the reason in metrics.json."""
    content = run()
    reported = {}
    for reason in ("finished", "target", "converged", "interrupted"):
        content.metrics["reason"] = reason
        reported[reason] = " ".join(Page(report_html(content)).words)
    assert "500 steps, " not in reported["finished"]
    assert "500 steps, to the target PSNR" in reported["target"]
    assert "500 steps, until it converged" in reported["converged"]
    assert "500 steps, stopped: interrupted" in reported["interrupted"]


def test_numbers_are_shown(run):
    """Oracle: the metrics the page was made from."""
    content = run()
    words = Page(report_html(content)).words
    metrics = content.metrics
    shown = " ".join(words)
    for piece in (f"{metrics['psnr']:.2f}", f"{metrics['ssim']:.4f}", "1,234", "1 min 15 s"):
        assert piece in shown
    assert "306 kB" in shown and "500 steps" in shown and "iterations" in shown
    assert "needs 161 x 161 pixels" in shown  # why MS-SSIM is missing
    assert "1 held-out view " in shown


def test_where_pixels_are_ignored_those_that_count_come_first(run):
    """Oracle: both numbers with their names, in the order of the page."""
    content = run()
    content.metrics.update({"psnr_masked": 25.4321, "mask_mode": "ignore"})
    content.views[0].numbers["psnr_masked"] = 25.25
    words = Page(report_html(content)).words
    first = words.index("PSNR inside the masks")
    assert words[first + 1] == "25.43" and first < words.index("PSNR")
    assert "25.25" in words and "masked pixels count as equal" in words


def test_note_on_the_background_under_photos(run):
    """Oracle: the note below PSNR, where photos are laid over the background, and only there."""
    content = run()
    for mode, is_said in (("composite", True), ("none", False)):
        content.metrics["mask_mode"] = mode
        words = Page(report_html(content)).words
        assert ("of whole pictures, with background" in words) == is_said


def test_scores_on_training_views_say_so(run):
    """Oracle: the sentence under the title."""
    shown = " ".join(Page(report_html(run(split="train", test_views=[]))).words)
    assert "not a test" in shown


def test_a_run_without_history_or_pictures_still_has_a_page(run):
    """Oracle: no curves, no cards, but the numbers of the views."""
    content = run()
    bare = Report(title="x", metrics=content.metrics | {"history": [], "evals": []})
    page = Page(report_html(bare))
    assert not any(tag == "svg" for tag, _ in page.tags)
    assert f"{content.metrics['psnr']:.2f}" in page.words


def test_curves_kept_in_the_metrics_are_drawn(metrics_dict):
    """Oracle: the page of a metrics.json that was read again has the charts of the run."""
    history = [
        {"step": s, "elapsed_s": s / 9, "loss": 1 / s, "psnr": float("nan"), "splats": 7}
        for s in range(1, 50)
    ]
    metrics, _ = metrics_dict(history=history, evals=[{"step": 49, "elapsed_s": 6, "psnr": 9.0}])
    page = Page(report_html(Report(title="x", metrics=json.loads(json.dumps(metrics)))))
    assert sum(tag == "svg" for tag, _ in page.tags) == 4  # loss and splats, by step and seconds
    assert metrics["history"][2]["psnr"] is None and "history" not in headline(metrics)


def test_a_run_stopped_before_its_evaluation_has_a_page(metrics_dict):
    """Oracle: the reason in place of the numbers."""
    metrics, _ = metrics_dict()
    for key in ("psnr", "ssim", "lpips"):
        metrics |= {key: None, f"{key}_reason": "training was stopped"}
    for key in ("d_ssim", "ms_ssim", "ssim_valid", "psnr_u8", "fps", "lpips_net"):
        del metrics[key]
    page = Page(report_html(Report(title="x", metrics=metrics | {"views": []})))
    shown = page.shown
    assert "no views measured: training was stopped" in shown and "n/a" not in shown


def test_pictures_are_what_they_claim():
    """Oracle: a render that is wrong by a ramp from 0 to 1 / ERROR_GAIN shows the colour map."""
    target = np.full((64, 256, 3), 0.5)
    target[:16] = (0.1, 0.9, 0.4)
    ramp = np.broadcast_to(np.linspace(0, 1, 256)[None, :, None], target.shape)
    collector = PictureCollector(count=1)
    counted = np.full(target.shape[:2], 255, np.uint8)
    counted[40:] = 0
    collector(0, target, target - ramp / ERROR_GAIN, counted, {"name": "a"})
    decoded = {}
    for kind in ("photo", "render", "error"):
        data = base64.b64decode(getattr(collector.views[0], kind).partition(",")[2])
        decoded[kind] = np.asarray(Image.open(io.BytesIO(data))).astype(float)
        assert decoded[kind].shape == (64, 256, 3)
    assert np.abs(decoded["photo"] - target * 255).mean() < 2
    assert np.abs(decoded["render"] - (target - ramp / ERROR_GAIN).clip(0) * 255).mean() < 2
    assert np.abs(decoded["error"][20:38] - colorize(ramp[20:38, :, 0])).mean() < 4
    assert np.abs(decoded["error"][44:] - colorize(np.zeros((20, 256)))).mean() < 4


@pytest.mark.parametrize("shape", [(600, 800, 3), (1000, 300, 3)])
def test_sixty_noisy_views_stay_within_the_budget(shape):
    """Oracle: the worst case for JPEG, white noise; four views stand for sixty."""
    rng = np.random.default_rng(0)
    collector = PictureCollector(count=60)
    for place in range(4):
        pair = rng.random(shape), rng.random(shape)
        collector(place, *pair, None, {"name": str(place), "psnr": 8.0})
    sizes = [len(v.photo) + len(v.render) + len(v.error) for v in collector.views]
    assert max(sizes) * 60 <= BYTES_IN_ALL * 1.01
    assert all(max(v.width, v.height) <= 640 and v.width > 0 for v in collector.views)
    aspect = collector.views[0].width / collector.views[0].height
    assert aspect == pytest.approx(shape[1] / shape[0], rel=0.02)


def test_of_many_views_some_get_pictures():
    """Oracle: at most MAX_VIEWS, evenly spread, the first among them; all keep their numbers."""
    collector = PictureCollector(count=150)
    for place in range(150):
        collector(place, *[np.zeros((8, 9, 3))] * 2, None, {"name": str(place)})
    pictured = [i for i, v in enumerate(collector.views) if v.width]
    assert len(collector.views) == 150 and len(pictured) == MAX_VIEWS and pictured[0] == 0
    assert max(np.diff(pictured)) <= 3


def test_colour_map_reads_in_grey():
    """Oracle: lightness (CIE L*) rises at every step, from black to nearly white."""
    y = decode(colorize(np.linspace(0, 1, 256)) / 255.0) @ [0.2126, 0.7152, 0.0722]
    lightness = np.where(y > 0.008856, 116 * np.cbrt(y) - 16, 903.3 * y)
    assert lightness[0] < 1 and lightness[-1] > 95 and (np.diff(lightness) > 0).all()


def test_chart_puts_points_where_the_axes_say():
    """Oracle: a straight line from the first to the last point; ticks at known heights."""
    points = [(float(x), 2.0 * x) for x in range(101)]
    svg = ElementTree.fromstring(
        line_chart([Series(label="a", points=points, dots=True)], label="up", x_unit="steps")
    )
    dots = [(float(c.get("cx")), float(c.get("cy"))) for c in svg.iter("circle") if c.get("cx")]
    assert len(dots) == 101
    xs, ys = np.array(dots).T
    assert np.allclose(np.diff(xs), np.diff(xs).mean(), atol=0.11) and xs[0] < xs[-1]
    assert np.allclose(np.diff(ys), np.diff(ys).mean(), atol=0.11) and ys[0] > ys[-1]
    labels = {t.text: float(t.get("y")) for t in svg.iter("text") if t.get("text-anchor") == "end"}
    assert labels["100"] == pytest.approx(ys[50], abs=0.1)


def test_chart_keeps_means_of_noisy_points_and_ignores_spikes():
    """Oracle: 20 000 points of mean 5 with one spike; the drawn line is short and near 5."""
    rng = np.random.default_rng(0)
    points = [(float(i), 5 + float(n)) for i, n in enumerate(rng.normal(0, 0.5, 20_000))]
    points[9000] = (9000.0, 1e6)
    text = line_chart([Series(label="a", points=points)], label="n", x_unit="steps")
    assert len(text) < 40_000
    ticks = [float(t) for t in re.findall(r'text-anchor="end">([\d.]+)</text>', text)]
    assert ticks and max(ticks) < 10


def test_chart_needs_two_points():
    """Oracle: a sentence instead of an empty drawing; values that are not numbers are left out."""
    nothing = clean_points([(1, None), (2, float("nan")), (3, 4.0)])
    assert nothing == [(3.0, 4.0)]
    assert "Not enough" in line_chart([Series(label="a", points=nothing)], label="x", x_unit="s")
    same = line_chart([Series(label="a", points=[(0, 7.0), (9, 7.0)])], label="x", x_unit="s")
    assert "svg" in same and "nan" not in same


@pytest.mark.parametrize(
    ("got", "want"),
    [
        (nice_ticks(0, 10), [0, 2, 4, 6, 8, 10]),
        (nice_ticks(0.12, 0.31), [0.15, 0.2, 0.25, 0.3]),
        (nice_ticks(3, 3), [3]),
        (log_ticks(0.04, 0.3), [0.05, 0.1, 0.2]),
    ],
)
def test_ticks(got, want):
    """Oracle: the round numbers a person would choose."""
    assert got == pytest.approx(want)


@pytest.mark.parametrize(
    ("got", "want"),
    [
        (size_text(306_032), "306 kB"),
        (size_text(None), "n/a"),
        (size_text(46_460_816), "46.5 MB"),
        (time_text(59.96), "60 s"),
        (time_text(75), "1 min 15 s"),
        (time_text(7265), "2 h 01 min"),
        (short_number(187_342), "187 k"),
        (short_number(0.0512), "0.0512"),
        (short_number(1_234_567), "1.23 M"),
        (short_number(2500), "2500"),
    ],
)
def test_words_for_numbers(got, want):
    """Oracle: how people write them."""
    assert got == want


def test_automatic_options_are_shown_as_such() -> None:
    """Oracle: `auto` for the numbers that stand for it, in the options of a report."""
    config = TrainConfig(start_opacity=0.5, coarse_factor=0.0, depth_points=-1)
    values = shown_options(config)
    assert values["coarse_factor"] == "auto" and values["depth_points"] == "auto"
    assert values["start_opacity"] == 0.5 and values["start_splats"] is None
    assert shown_options(DataConfig(source=Path("a")))["resolution"] == "auto"


def test_a_folder_that_cannot_be_written_is_an_error(run, tmp_path):
    """Oracle: the path in the message, no file left behind."""
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(GsError, match="report"):
        write_html(tmp_path / "file" / "report.html", report_html(run()))


def test_colour_corrected_psnr_is_shown_and_explained(run):
    """Oracle: the number given, in a tile, in the table of views and among the definitions."""
    content = run()
    content.metrics["psnr_cc"] = 31.4159
    content.views[0].numbers["psnr_cc"] = 32.71
    shown = Page(report_html(content)).shown
    assert "PSNR colour-corrected31.42 dB" in shown and "32.71" in shown
    assert "PSNR colour-corrected 31.416after gain and offset per channel" in shown


def test_scripts_of_a_page_with_plans_run_to_their_end(run, tmp_path):
    """Oracle: Chromium; a choice of a picture enlarges it, after plans and histograms were passed
    over by what follows the mouse."""
    rng = np.random.default_rng(0)
    cameras = Cameras(
        viewmats=np.tile(np.eye(4), (3, 1, 1)),
        Ks=np.tile(np.eye(3), (3, 1, 1)),
        widths=np.full(3, 10),
        heights=np.full(3, 10),
        names=("a.png", "b.png", "view_0.png"),
    )
    points = PointCloud(points=rng.normal(size=(20, 3)), colors=np.zeros((20, 3), np.uint8))
    splats = Splats(
        means=rng.normal(size=(20, 3)).astype(np.float32),
        quats=np.ones((20, 4), np.float32),
        scales=rng.normal(size=(20, 3)).astype(np.float32),
        opacities=np.zeros(20, np.float32),
        sh0=np.zeros((20, 1, 3), np.float32),
        shN=np.zeros((20, 0, 3), np.float32),
    )
    report = replace(
        run(),
        cameras=cameras_section(tmp_path, Scene(cameras=cameras, points=points)),
        histograms=splat_histograms([splats]),
    )
    path = tmp_path / "report.html"
    write_html(path, report_html(report))
    assert "wedge scored" in path.read_text() and "Anisotropy" in path.read_text()
    act = 'document.querySelector("img.photo").click();'
    viewer = page_after(path, act=act).partition('<div id="viewer"')[2]
    assert viewer.startswith(">") and 'data-show="photo" aria-pressed="true"' in viewer
