"""Histograms of splats: against numpy's counts, and as they are drawn."""

import re
from xml.etree import ElementTree

import numpy as np

from gscore.report.histograms import histograms_html, splat_histograms
from gscore.splats import Splats


def model(scales: np.ndarray, opacities: np.ndarray) -> Splats:
    n = len(scales)
    return Splats(
        means=np.zeros((n, 3), np.float32),
        quats=np.ones((n, 4), np.float32),
        scales=scales.astype(np.float32),
        opacities=opacities.astype(np.float32),
        sh0=np.zeros((n, 1, 3), np.float32),
        shN=np.zeros((n, 0, 3), np.float32),
    )


def test_counts_equal_numpy() -> None:
    """Oracle: numpy.histogram of the activated values, in parts or whole; what lies beyond the
    bins counts at their ends."""
    rng = np.random.default_rng(0)
    splats = model(rng.normal(-4, 1, (5000, 3)), rng.normal(0, 3, 5000))
    found = splat_histograms(splats.subset(slice(i, i + 1000)) for i in range(0, 5000, 1000))
    scales = np.exp(splats.scales.astype(np.float64))
    values = {
        "Opacity": 1 / (1 + np.exp(-splats.opacities.astype(np.float64))),
        "Size": scales.max(axis=1),
        "Anisotropy": scales.max(axis=1) / scales.min(axis=1),
    }
    assert [h.name for h in found] == list(values)
    for histogram in found:
        of = values[histogram.name]
        inner = np.clip(of, histogram.edges[0], np.nextafter(histogram.edges[-1], 0))
        np.testing.assert_array_equal(
            histogram.counts, np.histogram(inner, histogram.edges)[0], histogram.name
        )
        assert histogram.counts.sum() == 5000 and histogram.median == np.median(of)


def test_bars_stand_where_the_counts_are() -> None:
    """Oracle: the highest bar, of a model of which two thirds are half opaque."""
    logits = np.concatenate([np.full(200, 0.01), np.full(100, 2.2)])
    page = histograms_html(splat_histograms([model(np.full((300, 3), -3.0), logits)]))
    pictures = [ElementTree.fromstring(svg) for svg in re.findall(r"<svg.*?</svg>", page, re.S)]
    assert len(pictures) == 3
    (bars,) = (p for p in pictures[0].findall("path") if p.get("class") == "bars")
    tops = [float(y) for y in re.findall(r"V([\d.]+)H", bars.get("d", ""))]
    order = np.argsort(tops)
    assert order[0] == 24 and order[1] == 43 and len(tops) == 48
    floor = max(tops)
    assert (floor - tops[24]) / (floor - tops[43]) == np.float64(2).round(1)
    assert "median 0.502" in page and "200 splats: 0.5 to 0.521" in page


def test_numbers_at_the_ends_are_drawn() -> None:
    """Oracle: well-formed pictures without NaN; an empty model has no section."""
    ends = model(np.array([[3e38, 3e38, -3e38], [0, 0, 0]]), np.array([3e38, -3e38]))
    page = histograms_html(splat_histograms([ends]))
    for svg in re.findall(r"<svg.*?</svg>", page, re.S):
        ElementTree.fromstring(svg)
    assert "nan" not in page and "inf" not in page
    assert histograms_html(splat_histograms([])) == ""
