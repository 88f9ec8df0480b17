"""Trust in views between photos; oracle: a wall of splats and cameras placed by hand."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from gscore.metrics.photo_renders import PhotoRenders
from gscore.metrics.trust import trust, trust_between, trust_figures
from gscore.scene import Cameras
from gscore.splats import Splats
from gscore.text_format import trust_text
from tests.metrics.test_coverage import ROOM, both, cameras, plane

SIZE = 64
VEIL = replace(plane(0.3, 0.4, 30), sh0=np.full((900, 1, 3), 1.0, np.float32))
"""Another colour than the wall, so near that only a camera between the photos sees it."""
BESIDE = ((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0))


def trust_of(
    splats: Splats, view: tuple[float, float, float], *photos: tuple[float, float, float]
) -> float:
    """Trust in a view by photos."""
    renders = PhotoRenders(splats, cameras(view, *photos), threads=1)
    return trust(renders, range(1, len(photos) + 1), renders.frustum(0, SIZE))


def between(splats: Splats, of: Cameras) -> list[float]:
    """Trust in the views halfway between photos."""
    found = trust_between(PhotoRenders(splats, of, threads=1), range(len(of)))
    return [each["trust"] for each in found]


def test_a_view_between_photos_of_a_wall_is_confirmed() -> None:
    """Oracle: all of it, from both sides, from one, and from farther away."""
    assert trust_of(ROOM, (0.0, 0.0, 0.0), *BESIDE) == 1.0
    assert trust_of(ROOM, (0.0, 0.0, 0.0), (0.0, -2.0, 0.0)) == 1.0


def test_a_view_past_the_photos_has_the_share_that_they_show() -> None:
    """Oracle: geometry. A photo at 5 sees the wall from x = 0 to 10 of the view's -5 to 5; one that
    looks the other way shows nothing of it."""
    assert trust_of(ROOM, (0.0, 0.0, 0.0), (5.0, 0.0, 0.0)) == pytest.approx(0.5, abs=0.03)
    assert trust_of(ROOM, (0.0, 0.0, 0.0), (0.0, 0.0, 180.0)) == 0.0


def test_a_floater_lowers_trust_by_its_share() -> None:
    """Oracle: a square of 0.2 at depth 0.3 in a field of view of 90 degrees, (0.1 / 0.3)^2 of the
    picture, that the photos do not see; one of the wall's colour is not to be seen."""
    square = plane(0.3, 0.1, 30)
    red = replace(square, sh0=np.full((900, 1, 3), 1.0, np.float32))
    assert trust_of(both(ROOM, square), (0.0, 0.0, 0.0), *BESIDE) >= 0.99
    found = trust_of(both(ROOM, red), (0.0, 0.0, 0.0), *BESIDE)
    assert 1 - found == pytest.approx(1 / 9, abs=0.03)


def test_a_veil_takes_all_trust() -> None:
    """Oracle: none where it covers the picture, but its full value in the views beside it."""
    assert trust_of(both(ROOM, VEIL), (0.0, 0.0, 0.0), *BESIDE) == 0.0
    assert trust_of(both(ROOM, VEIL), (2.0, 0.0, 0.0), (1.0, 0.0, 0.0), (3.0, 0.0, 0.0)) == 1.0


def test_what_is_hidden_from_the_view_does_not_count() -> None:
    """Oracle: a screen before the wall hides the wall in the view but not from a photo beside it;
    the photos that see the screen confirm it, and the wall's colour behind is not compared."""
    screen = replace(plane(2.0, 2.5, 60), sh0=np.full((3600, 1, 3), 1.0, np.float32))
    assert trust_of(both(ROOM, screen), (0.0, 0.0, 0.0), (0.2, 0.0, 0.0)) >= 0.95


def test_views_are_halfway_between_neighbours_that_look_alike() -> None:
    """Oracle: pairs by hand. Three photos in a row, of which the last is turned by 70 degrees."""
    of = cameras((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (3.0, 0.0, 70.0))
    renders = PhotoRenders(both(ROOM, VEIL), of, threads=1)
    assert trust_between(renders, range(3)) == [{"between": ["0.jpg", "1.jpg"], "trust": 0.0}]
    assert trust_between(renders, [1, 2]) == [] == trust_between(renders, [0])
    assert between(ROOM, cameras((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))) == []


def test_the_view_has_the_mean_direction() -> None:
    """Oracle: photos turned 25 degrees to both sides; halfway, between -45 and 45 degrees, all is
    in one of them, from -70 to 20 and -20 to 70, whatever the roll of the second photo."""
    of = cameras((-0.5, 0.0, -25.0), (0.5, 0.0, 25.0))
    assert between(ROOM, of)[0] >= 0.97
    of.viewmats[1, :2] *= -1.0  # on its head
    assert between(ROOM, of)[0] >= 0.97


def test_of_many_pairs_evenly_spaced_ones_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the first, the last and every fifth of the 21 pairs of 22 photos in a row."""
    monkeypatch.setattr("gscore.metrics.trust._MOST_VIEWS", 5)
    row = cameras(*((x, 0.0, 0.0) for x in np.linspace(-3, 3, 22)))
    row = replace(row, names=tuple(f"{i:02d}.jpg" for i in range(22)))
    renders = PhotoRenders(plane(5.0, 8.0, 4), row, threads=1)
    found = [each["between"] for each in trust_between(renders, range(22))]
    assert found == [[f"{i:02d}.jpg", f"{i + 1:02d}.jpg"] for i in (0, 5, 10, 15, 20)]


def test_figures_name_the_median_and_the_lowest() -> None:
    """Oracle: by hand; nothing without views."""
    views = [("a", "b", 0.5), ("b", "c", 0.25), ("c", "d", 0.9)]
    found = [{"between": [a, b], "trust": share} for a, b, share in views]
    figures = trust_figures(found)
    assert figures == {"trust": found, "trust_median": 0.5, "trust_lowest": found[1]}
    assert trust_text(figures) == (
        "Trust in views between photos: 50% in the median, lowest 25%, between b and c: "
        "no view is below half of it."
    )
    nothing: Sequence[dict[str, object]] = []
    assert trust_figures(nothing) == {} and trust_text({}) == ""
