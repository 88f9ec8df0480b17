"""Two runs compared: pairs, means and refusals by hand; the page in Chromium."""

import re
from typing import Any

import numpy as np
import pytest

from gscore.errors import ConfigError
from gscore.metrics.comparison import ComparedRun, compare_runs
from gscore.report.compare_page import PairPictures, comparison_html
from gscore.report.html_parts import write_html
from gscore.report.pictures import data_uri
from tests.browser import page_after


def view(name: str, psnr: float | None, ssim: float, **more: Any) -> dict[str, Any]:
    return {"name": name, "width": 40, "height": 30, "psnr": psnr, "ssim": ssim, **more}


def run(label: str, views: list[dict[str, Any]], **changes: Any) -> ComparedRun:
    history = [
        {"step": s, "elapsed_s": s / 5, "loss": 1 / s, "psnr": 10 + s / 9, "splats": s}
        for s in range(1, 80)
    ]
    metrics = {
        "views": views,
        "test_views": [v["name"] for v in views],
        "mask_mode": "none",
        "lpips_net": None,
        "splats": 1000,
        "train_seconds": 60.0,
        "history": history,
        "evals": [],
    }
    options = changes.pop("options", {"iterations": 100, "seed": 1})
    return ComparedRun(label=label, folder=label, metrics=metrics | changes, options=options)


@pytest.fixture
def pair() -> tuple[ComparedRun, ComparedRun]:
    """Two runs with two views in common."""
    first = run("a", [view("1.png", 20.0, 0.5), view("2.png", 30.0, 0.75), view("3.png", 9.0, 0.1)])
    second = run(
        "b <x>",
        [view("4.png", 99.0, 1.0), view("2.png", 29.0, 0.85), view("1.png", 24.0, 0.5)],
        options={"iterations": 200, "seed": 1},
    )
    return first, second


def test_views_are_paired_by_name(pair: tuple[ComparedRun, ComparedRun]) -> None:
    """Oracle: by hand; means are over the pairs alone."""
    found = compare_runs(*pair)
    assert [p.name for p in found.pairs] == ["1.png", "2.png"]
    assert found.pairs[0].numbers == {"psnr": (20.0, 24.0), "ssim": (0.5, 0.5)}
    assert found.means == {"psnr": (25.0, 26.5), "ssim": (0.625, pytest.approx(0.675))}
    assert found.only_in == (("3.png",), ("4.png",))
    assert found.options == {"iterations": (100, 200)}
    assert found.warnings == ()
    content = found.content()
    assert content["views"][1] == {"name": "2.png", "psnr": [30.0, 29.0], "ssim": [0.75, 0.85]}


def test_numbers_that_one_lacks_are_left_out() -> None:
    """Oracle: by hand; LPIPS counts where the network is the same, which is told otherwise."""
    views = [view("1", None, 0.5, lpips=0.1), view("2", 20.0, 0.5, lpips=0.3)]
    same = compare_runs(run("a", views, lpips_net="vgg"), run("b", views, lpips_net="vgg"))
    assert same.means == {"ssim": (0.5, 0.5), "lpips": (pytest.approx(0.2), pytest.approx(0.2))}
    assert same.pairs[0].numbers.keys() == {"ssim", "lpips"}
    other = compare_runs(run("a", views, lpips_net="vgg"), run("b", views, lpips_net="alex"))
    assert "lpips" not in other.means and "vgg and with alex" in other.warnings[0]


def test_masked_runs_are_compared_inside_the_masks() -> None:
    """Oracle: the PSNR that such runs are judged by."""
    first, second = (
        run(label, [view("1", 30.0, 0.5, psnr_masked=worth)], mask_mode="ignore")
        for label, worth in (("a", 21.0), ("b", 22.0))
    )
    found = compare_runs(first, second)
    assert found.means["psnr"] == (21.0, 22.0) and found.psnr_name == "PSNR inside the masks"
    assert "PSNR inside the masks" in comparison_html(found, [], title="x")


def test_view_trained_on_by_one_run_is_named() -> None:
    """Oracle: the sentence names the view and both roles."""
    views = [view("1", 30.0, 0.5), view("2", 30.0, 0.5)]
    found = compare_runs(run("a", views), run("b", views, test_views=[]))
    assert "1 is a held-out view of a and a training view of b, and 1 more" in found.warnings[0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"views": []}, "gscore eval b"),
        ({"views": [view("other", 1.0, 1.0)]}, "no scored view in common"),
        ({"views": [view("1.png", 1.0, 1.0) | {"width": 80}]}, "40 x 30 px.*80 x 30 px"),
        ({"mask_mode": "ignore"}, "Measure a like b: gscore eval a --mask-mode ignore -o"),
        ({"mask_mode": "composite"}, "different pixels.*train one with the other's `--mask-mode`"),
    ],
)
def test_incomparable_runs_are_refused(
    pair: tuple[ComparedRun, ComparedRun], changes: dict[str, Any], words: str
) -> None:
    """Oracle: the sentence."""
    other = run(
        "b", [view("1.png", 20.0, 0.5)], **{k: v for k, v in changes.items() if k != "views"}
    )
    if "views" in changes:
        other = run("b", changes["views"])
    with pytest.raises(ConfigError, match=words):
        compare_runs(pair[0], other)


def pictures() -> list[PairPictures]:
    colors = ((200, 0, 0), (0, 0, 200), (0, 200, 0))
    uris = [data_uri(np.full((30, 40, 3), color, np.uint8)) for color in colors]
    return [
        PairPictures(name=name, width=40, height=30, first=uris[0], second=uris[1], photo=uris[2])
        for name in ("1.png", "2.png")
    ]


def test_the_page_stands_alone(pair: tuple[ComparedRun, ComparedRun]) -> None:
    """Oracle: nothing but data URIs is referred to, names are escaped, differences coloured."""
    page = comparison_html(compare_runs(*pair), pictures(), title="a <b>")
    assert not re.search(r"https?://|url\(|@import", page)
    assert "<x>" not in page and "b &lt;x&gt;" in page and "a &lt;b&gt;" in page
    assert '<td class="gain">+1.50</td>' in page and '<td class="loss">-1.00</td>' in page
    assert "3.png" in page and "4.png" in page and "iterations" in page and "seed" not in page
    charts = re.findall(r"<h3>([^<]*)", page)
    assert charts[:3] == ["PSNR of the training views (dB)", "Loss ", "Splats"]


def test_the_slider_moves_and_sides_change(
    pair: tuple[ComparedRun, ComparedRun], tmp_path: Any
) -> None:
    """Oracle: Chromium, in a wide and in a narrow window; nothing is wider than the window."""
    path = tmp_path / "compare.html"
    write_html(path, comparison_html(compare_runs(*pair), pictures(), title="x"))
    act = """
      const range = document.querySelector(".slider input");
      range.value = 25;
      range.dispatchEvent(new Event("input"));
      document.querySelector('button[data-sides="photo second"]').click();
      document.querySelector('button[data-order="loss"]').click();
      const shown = [...document.querySelectorAll("article:first-child img")]
        .filter((img) => getComputedStyle(img).display !== "none").map((img) => img.className);
      document.body.dataset.shown = shown.join(" ");
      document.body.dataset.wide = document.documentElement.scrollWidth > innerWidth;
    """
    for width in (1200, 500):
        page = page_after(path, act=act, width=width)
        assert 'data-shown="second photo"' in page and 'data-wide="false"' in page
        assert (
            page.count("--at: 25%") == 1 and 'data-sides="photo second" aria-pressed="true"' in page
        )
        assert re.findall(r"<article[^>]*><h3>([^<]*)", page) == ["2.png", "1.png"]
