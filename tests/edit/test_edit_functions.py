"""Joining, narrowing, ranking, limits and similarities, by hand and against scipy and renders."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gscore.edit import (
    at_least_opaque,
    importance_of,
    most_important,
    of_size,
    similarity_matrix,
)
from gscore.formats.joined import joined
from gscore.raster.api import render
from gscore.scene import Cameras
from gscore.splats import Splats, cut_degree

Make = Callable[..., Splats]


def test_join_keeps_order(make_splats: Make) -> None:
    """Oracle: concatenation by hand."""
    a, b = make_splats(5, 0), make_splats(6, 15, seed=1)
    both = joined([a, b])
    np.testing.assert_array_equal(both.opacities, [*a.opacities, *b.opacities])
    np.testing.assert_array_equal(both.means[5:], b.means)
    assert not both.shN[:5].any()
    np.testing.assert_array_equal(both.shN[5:], b.shN)
    assert joined([a]) is a


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_fewer_harmonics(degree: int, make_splats: Make, cameras: Cameras) -> None:
    """Oracle: a render of the whole model with the higher bands left out."""
    splats = make_splats(60, 24)
    view = cameras.Ks[0], cameras.viewmats[0], 40, 40
    narrow = cut_degree(splats, degree)
    assert narrow.sh_degree == degree
    got, wanted = render(narrow, *view).rgb, render(splats, *view, sh_degree=degree).rgb
    np.testing.assert_array_equal(got, wanted)
    assert cut_degree(narrow, 3) is narrow and cut_degree(splats, 4) is splats


def test_most_important_takes_the_first_of_equals() -> None:
    """Oracle: by hand."""
    importance = np.array([1.0, 3.0, 1.0, 0.0, 1.0])
    kept = [np.flatnonzero(most_important(importance, n)).tolist() for n in range(7)]
    assert kept[:4] == [[], [1], [0, 1], [0, 1, 2]]
    assert kept[5] == kept[6] == [0, 1, 2, 3, 4]


def test_importance_is_opacity_times_largest_side(make_splats: Make) -> None:
    """Oracle: the formula splat by splat; numbers at the end of float32 stay finite."""
    splats = make_splats(50)
    for row, found in enumerate(importance_of(splats)):
        a, b, c = sorted(np.exp(splats.scales[row].astype(float)))
        wanted = b * c / (1 + np.exp(-float(splats.opacities[row])))
        assert found == pytest.approx(wanted) and a <= b
    wide = replace(splats, scales=np.full((50, 3), 3e38, np.float32))
    assert np.isfinite(importance_of(wide)).all()


def test_limits_belong_to_what_stays() -> None:
    """Oracle: by hand; 0 means no upper limit."""
    opacities = np.array([0.1, 0.7, 0.9], np.float32)
    assert at_least_opaque(opacities, 0.7).tolist() == [False, True, True]
    scales = np.array([[0.1, 0.02, 0.01], [0.2, 0.3, 0.1], [1, 2, 0.5]], np.float32)
    assert of_size(scales, 0.1, 0.3).tolist() == [True, True, False]
    assert of_size(scales, 0.3).tolist() == [False, True, True]
    assert of_size(np.zeros((0, 3), np.float32), 0.1, 0.3).tolist() == []


def test_similarity_equals_scipy() -> None:
    """Oracle: scipy's turns about fixed axes, x first; a quarter turn is exact."""
    matrix = similarity_matrix(scale=2.5, degrees=(20, -35, 100), move=(1, 2, 3))
    turn = Rotation.from_euler("xyz", [20, -35, 100], degrees=True).as_matrix()
    np.testing.assert_allclose(matrix[:3, :3], 2.5 * turn, atol=1e-12)
    assert matrix[:3, 3].tolist() == [1, 2, 3] and matrix[3].tolist() == [0, 0, 0, 1]
    quarter = similarity_matrix(degrees=(90, 0, 0))
    assert quarter[:3, :3].tolist() == [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    assert similarity_matrix().tolist() == np.eye(4).tolist()
