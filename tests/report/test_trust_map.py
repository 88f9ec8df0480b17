"""The trust map of the report; oracle: a scene whose places were chosen by hand."""

import re
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from gscore.metrics.trust import trust_figures
from gscore.report.trust_map import trust_html
from gscore.scene import Cameras, PointCloud, Scene

NAMES = ("a.jpg", "b.jpg", "c.jpg", "d & e.jpg")


def scene() -> Scene:
    """Four cameras on a level line at 0, 1, 2 and 9 that look along +z with y down."""
    viewmats = np.tile(np.eye(4), (4, 1, 1))
    viewmats[:, 0, 3] = [0, -1, -2, -9]
    cameras = Cameras(
        viewmats=viewmats,
        Ks=np.tile(np.eye(3), (4, 1, 1)),
        widths=np.full(4, 10),
        heights=np.full(4, 10),
        names=NAMES,
    )
    return Scene(cameras=cameras, points=PointCloud.none())


def metrics(*shares: float) -> dict[str, Any]:
    """Trust between successive cameras."""
    pairs = zip(NAMES[:-1], NAMES[1:], shares, strict=True)
    return trust_figures([{"between": [a, b], "trust": share} for a, b, share in pairs])


def lines(page: str) -> list[ElementTree.Element]:
    """The segments of the map."""
    (svg,) = re.findall(r"<svg.*?</svg>", page, re.S)
    return ElementTree.fromstring(svg).findall("line")


def test_segments_join_the_photos_in_the_colour_of_their_trust() -> None:
    """Oracle: lengths of 1, 1 and 7; the lowest trust is drawn last, in the colour of the worst,
    the highest in that of the best; the mouse shows names and share."""
    found = lines(trust_html(scene(), metrics(0.8, 0.04, 0.5)))
    ends = np.array(
        [[float(line.get(key, "")) for key in ("x1", "y1", "x2", "y2")] for line in found]
    )
    lengths = np.hypot(*(ends[:, 2:] - ends[:, :2]).T)
    assert np.divide(lengths, lengths[0]) == pytest.approx([1, 7, 1], rel=0.01)
    assert [line.findtext("title") for line in found] == [
        "between a.jpg and b.jpg: 80%",
        "between c.jpg and d & e.jpg: 50%",
        "between b.jpg and c.jpg: 4%",
    ]
    styles = [line.get("style") for line in found]
    assert styles[0] == "stroke:#1f5fb0" and styles[-1] == "stroke:#b2182b"


def test_the_lowest_places_are_named_with_what_to_do() -> None:
    """Oracle: one below half of the median is named, none is not."""
    page = trust_html(scene(), metrics(0.8, 0.04, 0.5))
    assert "median, lowest 4%, between b.jpg and c.jpg: less than half of it." in page
    assert "Below half of the median: between b.jpg and c.jpg (4%): take more photos" in page
    even = trust_html(scene(), metrics(0.8, 0.6, 0.5))
    assert "take more photos" not in even and "no view is below half of it" in even


def test_names_of_photos_are_text() -> None:
    """Oracle: the page has them escaped only."""
    page = trust_html(scene(), metrics(0.8, 0.5, 0.04))
    assert "c.jpg and d &amp; e.jpg (4%)" in page and "d & e" not in page


def test_without_trust_or_its_cameras_there_is_no_section() -> None:
    """Oracle: metrics of an earlier version, of one photo, and of another capture."""
    assert trust_html(scene(), {"psnr": 30.0}) == ""
    assert trust_html(scene(), trust_figures([])) == ""
    other = trust_figures([{"between": ["x.jpg", "a.jpg"], "trust": 0.5}])
    assert trust_html(scene(), other) == ""
