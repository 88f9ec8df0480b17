"""Moving, turning, mirroring and scaling splats: against their pictures afterwards."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gscore import render
from gscore.errors import ShapeError
from gscore.sh import sh_basis, sh_rotation
from gscore.splats import Splats
from gscore.transforms import quat_to_rotmat, transform_splats


def _splats(rng: np.random.Generator, rest: int = 15, count: int = 200) -> Splats:
    def normal(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape, dtype=np.float32)

    return Splats(
        means=normal(count, 3),
        quats=normal(count, 4) * 3,
        scales=normal(count, 3) * np.float32(0.5) - 3,
        opacities=normal(count),
        sh0=normal(count, 1, 3) * np.float32(0.5),
        shN=normal(count, rest, 3) * np.float32(0.3),
    )


def _matrix(rng: np.random.Generator, *, mirrored: bool) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = 1.7 * Rotation.random(rng=rng).as_matrix()
    matrix[:3, 3] = rng.normal(0, 2, 3)
    return matrix @ np.diag([-1.0, 1, 1, 1]) if mirrored else matrix


@pytest.fixture(params=[False, True], ids=["turned", "mirrored"])
def matrix(request: pytest.FixtureRequest, rng: np.random.Generator) -> np.ndarray:
    """A similarity with a random rotation, with and without a mirror."""
    return _matrix(rng, mirrored=request.param)


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 4])
def test_harmonics_turn(degree: int, matrix: np.ndarray, rng: np.random.Generator) -> None:
    """Oracle: sh_basis evaluated at directions turned back."""
    orthogonal = matrix[:3, :3] / 1.7
    dirs = rng.standard_normal((100, 3))
    dirs /= np.linalg.norm(dirs, axis=1, keepdims=True)
    coefficients = rng.standard_normal(2 * degree + 1)
    band = slice(degree**2, (degree + 1) ** 2)
    turned = sh_rotation(degree, orthogonal) @ coefficients
    got = sh_basis(degree, dirs)[:, band] @ turned
    expected = sh_basis(degree, dirs @ orthogonal)[:, band] @ coefficients
    np.testing.assert_allclose(got, expected, atol=1e-12)


def test_harmonics_rotation_is_orthogonal(rng: np.random.Generator) -> None:
    """Oracle: the energy of a function, which a rotation keeps."""
    for degree in range(5):
        turn = sh_rotation(degree, Rotation.random(rng=rng).as_matrix())
        np.testing.assert_allclose(turn @ turn.T, np.eye(2 * degree + 1), atol=1e-13)


def test_harmonics_rotation_refuses() -> None:
    """Oracle: the documented limits."""
    with pytest.raises(ShapeError, match="degree"):
        sh_rotation(5, np.eye(3))
    with pytest.raises(ShapeError, match="rotation"):
        sh_rotation(1, np.eye(4))


def _covariances(splats: Splats) -> np.ndarray:
    turns = quat_to_rotmat(splats.quats.astype(np.float64))
    halves = turns * np.exp(splats.scales.astype(np.float64))[:, None, :]
    return halves @ np.swapaxes(halves, 1, 2)


def test_ellipsoids_follow(matrix: np.ndarray, rng: np.random.Generator) -> None:
    """Oracle: A S A^T for a covariance S; means as points; opacity and base colour unchanged."""
    before = _splats(rng)
    after = transform_splats(before, matrix)
    linear = matrix[:3, :3]
    expected = linear @ _covariances(before) @ linear.T
    sizes = np.trace(expected, axis1=1, axis2=2)[:, None, None]
    np.testing.assert_allclose(_covariances(after) / sizes, expected / sizes, atol=2e-6)
    np.testing.assert_allclose(after.means, before.means @ linear.T + matrix[:3, 3], atol=1e-5)
    np.testing.assert_array_equal(after.opacities, before.opacities)
    np.testing.assert_array_equal(after.sh0, before.sh0)
    lengths = np.linalg.norm(before.quats, axis=1)
    np.testing.assert_allclose(np.linalg.norm(after.quats, axis=1), lengths, rtol=1e-6)


@pytest.mark.parametrize("rest", [0, 3, 8, 15])
@pytest.mark.parametrize("mirrored", [False, True])
def test_pictures_do_not_change(rest: int, mirrored: bool, rng: np.random.Generator) -> None:
    """Oracle: the picture of the original splats, from the original camera.

    A mirror image is rendered by a mirrored camera, whose picture is flipped.
    """
    splats = _splats(rng, rest)
    matrix = _matrix(rng, mirrored=mirrored)
    K = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    viewmat = np.eye(4)
    viewmat[2, 3] = 6
    before = render(splats, K, viewmat, 64, 48)
    flip = np.diag([-1.0, 1, 1, 1]) if mirrored else np.eye(4)
    moved = flip @ viewmat @ np.linalg.inv(matrix)
    moved[:3, :3] *= 1.7  # a camera does not scale: distances do
    moved[:3, 3] *= 1.7
    after = render(transform_splats(splats, matrix), K, moved, 64, 48)
    rgb = after.rgb[:, ::-1] if mirrored else after.rgb
    assert before.rgb.std() > 0.05
    np.testing.assert_allclose(rgb, before.rgb, atol=2e-4)


def test_identity_and_way_back(matrix: np.ndarray, rng: np.random.Generator) -> None:
    """Oracle: identity, to the rounding of float32."""
    splats = _splats(rng)
    back = transform_splats(transform_splats(splats, matrix), np.linalg.inv(matrix))
    np.testing.assert_allclose(back.means, splats.means, atol=2e-6)
    np.testing.assert_allclose(back.scales, splats.scales, atol=1e-6)
    np.testing.assert_allclose(back.shN, splats.shN, atol=1e-6)
    np.testing.assert_allclose(_covariances(back), _covariances(splats), rtol=1e-4, atol=1e-8)
    same = transform_splats(splats, np.eye(4))
    np.testing.assert_array_equal(same.means, splats.means)
    np.testing.assert_array_equal(same.quats, splats.quats)
    np.testing.assert_allclose(same.shN, splats.shN, atol=1e-7)


def _with(entries: dict[tuple[int, int], float]) -> np.ndarray:
    matrix = np.eye(4)
    for at, value in entries.items():
        matrix[at] = value
    return matrix


@pytest.mark.parametrize(
    ("matrix", "word"),
    [
        (np.diag([1.0, 1, 1.001, 1]), "unevenly"),
        (_with({(0, 1): 0.01}), "unevenly"),
        (np.diag([0.0, 0, 0, 1]), "scale of 0"),
        (_with({(3, 0): 0.1}), "row"),
        (_with({(0, 3): np.nan}), "finite"),
        (np.eye(3), r"\[4, 4\]"),
    ],
)
def test_refuses(matrix: np.ndarray, word: str, rng: np.random.Generator) -> None:
    """Oracle: the documented limits; the sentence with the reason."""
    with pytest.raises(ShapeError, match=word):
        transform_splats(_splats(rng, 0, 3), matrix)
