"""Requests and their steps: what each removes, their order, and refusals."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gscore.edit import contributions, importance_of, most_important
from gscore.edit.pipeline import EditViews, apply_edits
from gscore.edit.request import USUAL, EditRequest
from gscore.errors import ConfigError
from gscore.scene import Cameras
from gscore.splats import Splats

Make = Callable[..., Splats]


@pytest.fixture
def views(cameras: Cameras) -> EditViews:
    """All cameras."""
    return EditViews(cameras=cameras)


def test_steps_come_in_their_order(make_splats: Make, views: EditViews) -> None:
    """Oracle: the order in the help of `gscore convert`; counts that add up."""
    parts = [make_splats(200, 8), make_splats(150, 3, seed=1)]
    request = EditRequest(
        box=(-2, -2, -2, 2, 2, 2),
        min_opacity=0.2,
        max_size=0.4,
        min_contribution=0.2,
        max_isolation=5,
        min_cluster=2,
        sh_degree=1,
        count=60,
        scale=2,
    )
    reported: list[str] = []
    edited = apply_edits(parts, request, views=views, on_step=reported.append)
    names = [step.name for step in edited.steps]
    cleaning = ["opacity", "size", "contribution", "isolation", "clusters"]
    assert names == ["crop", *cleaning, "sh degree", "count", "place"]
    assert [name for name in reported if "view" not in name] == names
    assert len(edited.joined) == 350 and len(edited.splats) == len(edited.kept) == 60
    left = 350
    for step in edited.steps:
        left -= step.removed
        assert step.left == left and step.removed >= 0
    assert edited.splats.sh_degree == 1
    np.testing.assert_allclose(edited.splats.means, edited.kept.means * 2, rtol=1e-6)


@pytest.mark.parametrize("outside", [False, True])
def test_crop_is_what_lies_in_all_shapes(
    outside: bool, make_splats: Make, views: EditViews
) -> None:
    """Oracle: comparisons by hand; the view of a camera along z is its pyramid."""
    splats = make_splats(500)
    request = EditRequest(
        box=(-1, -1, -1, 3, 3, 3), sphere=(0, 0, 0, 1.5), frustum=(0,), outside=outside
    )
    x, y, z = splats.means.astype(np.float64).T
    seen = (z > -6) & (np.abs(50 * x / (z + 6)) <= 20) & (np.abs(50 * y / (z + 6)) <= 20)
    inside = (splats.means >= -1).all(1) & (x * x + y * y + z * z <= 1.5**2) & seen
    edited = apply_edits([splats], request, views=views)
    assert 20 < inside.sum() < 480
    np.testing.assert_array_equal(edited.splats.means, splats.means[inside != outside])
    assert edited.cropped is edited.splats


def test_count_keeps_what_adds_most(make_splats: Make, views: EditViews) -> None:
    """Oracle: the ranks of contributions at the time of the request, for any later removal; without
    cameras opacity and area, with a message."""
    splats = make_splats(300)
    added = contributions(splats, views.cameras)
    request = EditRequest(min_contribution=0.5, max_isolation=1.5, count=50)
    edited = apply_edits([splats], request, views=views)
    alone = EditRequest(min_contribution=0.5, max_isolation=1.5)
    stays = apply_edits([splats], alone, views=views).splats.opacities
    rows = np.flatnonzero(np.isin(splats.opacities, stays))
    wanted = rows[most_important(added[rows], 50)]
    assert 50 < len(rows) < 280
    np.testing.assert_array_equal(edited.splats.means, splats.means[wanted])
    assert edited.notes == []

    blind = apply_edits([splats], EditRequest(count=50))
    wanted = most_important(importance_of(splats), 50)
    np.testing.assert_array_equal(blind.splats.means, splats.means[wanted])
    assert "Without cameras" in blind.notes[0]


@pytest.mark.parametrize("coding", [lambda n: 1000 + 50 * n, lambda n: 300 + 8 * n**1.2])
def test_size_is_met_from_below(
    coding: Callable[[int], float], make_splats: Make, views: EditViews
) -> None:
    """Oracle: the size of the result: within the limit and not far below it."""
    splats = make_splats(3000)

    def bytes_of(some: Splats) -> int:
        return int(coding(len(some)))

    edited = apply_edits([splats], EditRequest(size=0.02), views=views, bytes_of=bytes_of)
    assert 19_000 < bytes_of(edited.splats) <= 20_000
    whole = apply_edits([splats], EditRequest(size=1), views=views, bytes_of=bytes_of)
    assert whole.splats is splats


@pytest.mark.parametrize("seen_share", [None, 0.01])
def test_well_visible_splats_are_kept(
    make_splats: Make, views: EditViews, monkeypatch: pytest.MonkeyPatch, seen_share: float | None
) -> None:
    """Oracle: two splats far from the others and from each other: one adds a hundredth of the
    smallest picture to a view, the other a pixel less."""
    splats = make_splats(300, 0)
    splats.means[:2] = [[100, 0, 0], [0, 100, 0]]
    pixels = int((views.cameras.widths * views.cameras.heights).min())
    added = np.ones(300, np.float32)
    added[:2] = 0.01 * pixels + 0.5, 0.01 * pixels - 0.5
    monkeypatch.setattr("gscore.edit.pipeline.contributions", lambda *_, **__: added)
    request = EditRequest(max_isolation=8, min_cluster=20, seen_share=seen_share)
    kept = apply_edits([splats], request, views=views).kept.means
    assert 100 not in kept[:, 1]
    assert (100 in kept[:, 0]) == (seen_share is not None)


def test_usual_cleaning_leaves_what_was_given() -> None:
    """Oracle: the usual values; contributions need cameras, and clusters many splats."""
    request = EditRequest(min_opacity=0.1)
    seen, blind = (request.cleaned(10**6, with_cameras=there) for there in (True, False))
    assert seen == replace(USUAL, min_opacity=0.1)
    assert blind == replace(USUAL, min_opacity=0.1, min_contribution=None, seen_share=None)
    small = request.cleaned(900, with_cameras=True)
    assert small == replace(USUAL, min_opacity=0.1, min_cluster=None)
    assert EditRequest(min_cluster=7).cleaned(900, with_cameras=True).min_cluster == 7


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"box": (50, 50, 50, 60, 60, 60)}, "'crop' would leave none of 100 splats"),
        ({"min_opacity": 1.0}, "'opacity' would leave none"),
        ({"size": 1e-5}, "'file size' would leave none"),
        ({"frustum": (0,)}, "The content of a view is only known with cameras"),
        ({"min_contribution": 1.0}, "only known with cameras"),
    ],
)
def test_empty_results_and_missing_cameras_are_refused(
    request_: dict[str, Any], words: str, make_splats: Make
) -> None:
    """Oracle: the sentence."""
    with pytest.raises(ConfigError, match=words):
        apply_edits(
            [make_splats(100)], EditRequest(**request_), bytes_of=lambda s: 100 + 50 * len(s)
        )


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"box": (1, 0, 0, 0, 1, 1)}, "lower corner first"),
        ({"sphere": (0, 0, 0, 0)}, "radius"),
        ({"outside": True}, "needs a shape"),
        ({"sphere": (0, 0, 0, 1), "heal": (0, 0, 0, 1)}, "add `--outside`"),
        ({"sphere": (0.5, 0, 0, 1), "heal": (0, 0, 0, 1.5)}, "add `--outside`"),
        ({"box": (-1, -1, -1, 1, 1, 1), "heal": (0, 0, 0, 1.8)}, "add `--outside`"),
        ({"gap": 0.1}, "gap"),
        ({"count": 5, "size": 5.0}, "not both"),
        ({"matrix": np.eye(4), "scale": 2.0, "move": (1, 2, 3)}, "leave out scale, move"),
    ],
)
def test_requests_that_cannot_be(given: dict[str, Any], words: str) -> None:
    """Oracle: the sentence."""
    with pytest.raises(ConfigError, match=words):
        EditRequest(**given)


@pytest.mark.parametrize(
    "crop",
    [
        {"sphere": (0.5, 0, 0, 1.1)},
        {"box": (-1, -1, -1, 1, 1, 1.2)},
        {"sphere": (0, 0, 0, 1), "outside": True},
    ],
)
def test_a_hole_may_be_part_of_the_crop(crop: dict[str, Any]) -> None:
    """Oracle: no error, as something around the hole stays."""
    EditRequest(heal=(0, 0, 0, 1.5 if "sphere" in crop else 1.74), **crop)


@pytest.mark.filterwarnings("error")
def test_numbers_at_the_ends_of_float32(make_splats: Make, views: EditViews) -> None:
    """Oracle: no numpy warning, and valid splats that stay."""
    splats = make_splats(200)
    means, scales, opacities = splats.means.copy(), splats.scales.copy(), splats.opacities.copy()
    means[:3] = 3e38, -3e38, 1e-38
    scales[3:6] = 3e38, -3e38, 88.7
    opacities[6:8] = 3e38, -3e38
    wild = replace(splats, means=means, scales=scales, opacities=opacities)
    request = EditRequest(
        sphere=(0, 0, 0, 1e39),
        min_opacity=0.001,
        max_size=1e30,
        min_contribution=1e-6,
        max_isolation=1e3,
        min_cluster=1,
        sh_degree=0,
        count=150,
    )
    edited = apply_edits([wild], request, views=views)
    assert 100 < len(edited.splats) <= 150
    blind = apply_edits([wild], EditRequest(max_isolation=1e6, min_cluster=1, count=150))
    assert len(blind.splats) == 150
