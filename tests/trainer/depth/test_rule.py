"""The rule that decides on depth; oracles: cameras with known frames, and the sentences."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gscore.config import Switch
from gscore.scene import PointCloud
from gscore.trainer.depth.rule import DENSE_POINTS, DENSE_VIEWS, Coverage, coverage, decide

DENSE = Coverage(views=50, views_of_point=DENSE_VIEWS, points_in_view=DENSE_POINTS)


def cloud(points: np.ndarray) -> PointCloud:
    return PointCloud(points=points, colors=np.zeros((len(points), 3), np.uint8))


def test_coverage_counts_frames(make_photos: Callable[..., Any]) -> None:
    """Oracle: the toy cameras, which all face the origin; no camera shows points far behind
    them."""
    scene = make_photos().scene
    middle = replace(scene, points=cloud(np.zeros((10, 3)) + 0.01))
    assert coverage(middle, range(8)) == Coverage(views=8, views_of_point=8, points_in_view=10)
    assert coverage(middle, [0, 5]) == Coverage(views=2, views_of_point=2, points_in_view=10)
    away = replace(scene, points=cloud(np.array([[0.0, 90.0, 0.0]] * 4)))
    assert coverage(away, range(8)) == Coverage(views=8, views_of_point=0, points_in_view=0)
    nan = replace(scene, points=cloud(np.array([[np.nan] * 3, [0.0] * 3])))
    assert coverage(nan, range(8)).points_in_view == 1
    none = replace(scene, points=cloud(np.zeros((0, 3))))
    assert coverage(none, range(8)) == Coverage(views=8, views_of_point=0, points_in_view=0)


def test_a_sample_stands_for_many_points(make_photos: Callable[..., Any]) -> None:
    """Oracle: the number of all points, which are all in every frame."""
    scene = make_photos().scene
    rng = np.random.default_rng(0)
    many = replace(scene, points=cloud(rng.uniform(-0.1, 0.1, (20_000, 3))))
    assert coverage(many, range(8)).points_in_view == pytest.approx(20_000)


@pytest.mark.parametrize(
    ("mode", "facts", "usable", "used", "word"),
    [
        (Switch.AUTO, DENSE, 50, False, "dense"),
        (Switch.ON, DENSE, 50, True, "supervises 50"),
        (Switch.OFF, replace(DENSE, views_of_point=3), 9, False, "report only"),
        (Switch.AUTO, replace(DENSE, views_of_point=DENSE_VIEWS - 1), 29, True, "supervises 29"),
        (Switch.AUTO, replace(DENSE, points_in_view=DENSE_POINTS - 1), 9, True, "supervises"),
        (Switch.ON, replace(DENSE, views_of_point=3), 0, False, "No training view"),
    ],
)
def test_the_rule(mode: Switch, facts: Coverage, usable: int, used: bool, word: str) -> None:
    """Oracle: both sides of each threshold, and the option."""
    found, sentence = decide(mode, facts, usable=usable)
    assert found is used
    assert word in sentence
    assert sentence.endswith(".")
