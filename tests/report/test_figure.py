"""Oracle: places on the axes by hand, read out of the SVG."""

import re
import xml.etree.ElementTree as ET

import pytest

from gscore.report.curves import Series
from gscore.report.figure import figure

_SVG = "{http://www.w3.org/2000/svg}"


def _circles(svg: str) -> list[tuple[float, float]]:
    return [
        (float(c.attrib["cx"]), float(c.attrib["cy"]))
        for c in ET.fromstring(svg).iter(_SVG + "circle")
    ]


def test_a_logarithmic_axis_spreads_factors_evenly() -> None:
    line = Series(label="a <b>", points=[(1, 10), (10, 20), (100, 30), (0, 40)], dots=True)
    svg = figure([line], title="T & t", x_label="s", y_label="dB", log_x=True)
    (x0, y0), (x1, y1), (x2, y2) = _circles(svg)
    assert x1 - x0 == pytest.approx(x2 - x1, abs=0.2)
    assert y0 - y1 == pytest.approx(y1 - y2, abs=0.2) and y0 > y1
    texts = [t.text for t in ET.fromstring(svg).iter(_SVG + "text")]
    assert {"T & t", "a <b>", "s", "dB", "1", "10", "100"} <= set(texts)


def test_one_point_and_both_axes_logarithmic() -> None:
    svg = figure(
        [Series(label="p", points=[(3.0, 1e-6)], dots=True)],
        title="x",
        x_label="ns",
        y_label="error",
        log_x=True,
        log_y=True,
    )
    assert len(_circles(svg)) == 1
    assert not re.search(r"nan|inf", svg)


def test_empty_figure_is_an_error() -> None:
    with pytest.raises(ValueError, match="has no points"):
        figure(
            [Series(label="p", points=[(0.0, 1.0)])], title="x", x_label="", y_label="", log_x=True
        )
