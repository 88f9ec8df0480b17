"""Oracle: closed forms by hand, and round trips in float64."""

import numpy as np
import pytest

from addon.cameras.camera_math import (
    Frame,
    Lens,
    frame_size,
    intrinsics,
    lens_from_intrinsics,
    matrix_world_from_viewmat,
    project,
    viewmat_from_matrix_world,
)

SIZES = ((1920, 1080), (1080, 1920), (640, 640), (801, 533), (533, 801), (7, 4000))
PERCENTAGES = (100, 50, 37)
FITS = ("AUTO", "HORIZONTAL", "VERTICAL")
ASPECTS = ((1.0, 1.0), (1.5, 1.0), (1.0, 1.25))
SHIFTS = ((0.0, 0.0), (0.13, -0.07), (-0.4, 0.9))
TOLERANCE = 1e-6
"""Pixels."""


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """[3, 3] proper rotation."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.linalg.det(q)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("fit", FITS)
@pytest.mark.parametrize("size", SIZES)
def test_back_and_forth(size, fit, kind) -> None:
    """Oracle: K of the lens made from K is K; compared where it matters, on pixels."""
    rng = np.random.default_rng(0)
    for percentage in PERCENTAGES:
        width, height = frame_size(*size, percentage)
        for aspect in ASPECTS:
            for shift in SHIFTS:
                lens = Lens(
                    type=kind,
                    lens=rng.uniform(8, 400),
                    sensor_width=rng.uniform(5, 60),
                    sensor_height=rng.uniform(5, 60),
                    sensor_fit=fit,
                    shift_x=shift[0],
                    shift_y=shift[1],
                    ortho_scale=rng.uniform(0.1, 50),
                )
                frame = Frame(
                    width=width,
                    height=height,
                    pixel_aspect_x=aspect[0],
                    pixel_aspect_y=aspect[1],
                )
                K = intrinsics(lens, frame)
                ortho = kind == "ORTHO"
                again, raster = lens_from_intrinsics(K, width, height, orthographic=ortho)
                assert raster.pixel_aspect_x >= 1 and raster.pixel_aspect_y >= 1
                back = intrinsics(again, raster)
                corners = rng.uniform([-1, -1, 2], [1, 1, 4], (20, 3))
                a, _ = project(corners, K, np.eye(4), orthographic=ortho)
                b, _ = project(corners, back, np.eye(4), orthographic=ortho)
                assert np.abs(a - b).max() < TOLERANCE


def test_landscape_by_hand() -> None:
    """Oracle: 36 mm over 1920 px at 50 mm; the shift is in widths, up is positive."""
    lens = Lens(lens=50.0, sensor_width=36.0, shift_x=0.1, shift_y=0.05)
    K = intrinsics(lens, Frame(width=1920, height=1080))
    f = 50 / 36 * 1920
    np.testing.assert_allclose(
        K, [[f, 0, 960 - 192], [0, f, 540 + 96], [0, 0, 1]], rtol=0, atol=1e-9
    )


def test_portrait_by_hand() -> None:
    """Oracle: AUTO uses the sensor's width for the longer side, VERTICAL the sensor's height."""
    frame = Frame(width=1080, height=1920)
    auto = intrinsics(Lens(lens=50.0, sensor_width=36.0, sensor_height=24.0), frame)
    assert auto[0, 0] == pytest.approx(50 / 36 * 1920)
    vertical = Lens(lens=50.0, sensor_width=36.0, sensor_height=24.0, sensor_fit="VERTICAL")
    assert intrinsics(vertical, frame)[0, 0] == pytest.approx(50 / 24 * 1920)


def test_pixel_aspect_decides_the_fit() -> None:
    """Oracle: 100 x 120 pixels twice as wide as high are a landscape picture of 200 x 120."""
    wide = Frame(width=100, height=120, pixel_aspect_x=2.0)
    K = intrinsics(Lens(lens=36.0, sensor_width=36.0), wide)
    assert K[0, 0] == pytest.approx(100)
    assert K[1, 1] == pytest.approx(200)


def test_orthographic_by_hand() -> None:
    """Oracle: 4 world units across 400 px are 100 px a unit, whatever the depth."""
    K = intrinsics(Lens(type="ORTHO", ortho_scale=4.0), Frame(width=400, height=300))
    pixels, depths = project(
        np.array([[1.0, 0.5, 3.0], [1.0, 0.5, 9.0]]), K, np.eye(4), orthographic=True
    )
    np.testing.assert_allclose(pixels, [[300, 200], [300, 200]])
    np.testing.assert_allclose(depths, [3, 9])


def test_frame_size_cuts_in_integers() -> None:
    """Oracle: integer division; 100 * 0.29 in floating point would give 28."""
    assert frame_size(100, 801, 29) == (29, 232)


def test_poses_by_hand() -> None:
    """Oracle: Blender's camera at rest looks down -z with +y up; OpenCV's y then points down."""
    moved = np.eye(4)
    moved[:3, 3] = [1.0, 2.0, 5.0]
    viewmat = viewmat_from_matrix_world(moved)
    point = viewmat @ [1.0, 3.0, 1.0, 1.0]
    np.testing.assert_allclose(point, [0, -1, 4, 1], atol=1e-15)


def test_poses_back_and_forth() -> None:
    """Oracle: the inverse computed by numpy; the object's scale is ignored."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        matrix = np.eye(4)
        matrix[:3, :3] = random_rotation(rng)
        matrix[:3, 3] = rng.uniform(-10, 10, 3)
        viewmat = viewmat_from_matrix_world(matrix)
        np.testing.assert_allclose(
            viewmat, np.diag([1.0, -1, -1, 1]) @ np.linalg.inv(matrix), atol=1e-13
        )
        np.testing.assert_allclose(matrix_world_from_viewmat(viewmat), matrix, atol=1e-13)
        scaled = matrix @ np.diag([0.5, 3.0, 7.0, 1.0])
        np.testing.assert_allclose(viewmat_from_matrix_world(scaled), viewmat, atol=1e-13)


def test_wide_lens_stays_above_blenders_minimum() -> None:
    """Oracle: Blender clamps `lens` at 1 mm."""
    K = np.array([[10.0, 0, 500], [0, 10, 400], [0, 0, 1]])
    lens, frame = lens_from_intrinsics(K, 1000, 800)
    assert lens.lens >= 1.0
    np.testing.assert_allclose(intrinsics(lens, frame), K, atol=1e-9)


@pytest.mark.parametrize(
    ("K", "size", "word"),
    [
        ([[1, 0.2, 5], [0, 1, 5], [0, 0, 1]], (10, 10), "skew"),
        ([[1, 0, 5], [0, -1, 5], [0, 0, 1]], (10, 10), "positive"),
        ([[np.nan, 0, 5], [0, 1, 5], [0, 0, 1]], (10, 10), "finite"),
        ([[1, 0, 5], [0, 1, 5], [0, 0, 1]], (10, 0), "size"),
        ([[1, 0, 5], [0, 1, 5], [0, 0, 2]], (10, 10), "skew"),
    ],
)
def test_bad_intrinsics(K, size, word) -> None:
    """Oracle: the sentence names what is wrong."""
    with pytest.raises(ValueError, match=word):
        lens_from_intrinsics(np.array(K, float), *size)


def test_bad_cameras() -> None:
    """Oracle: the sentence names what is wrong."""
    with pytest.raises(ValueError, match="PANO"):
        intrinsics(Lens(type="PANO"), Frame(width=10, height=10))
    with pytest.raises(ValueError, match="size"):
        intrinsics(Lens(), Frame(width=0, height=10))
    with pytest.raises(ValueError, match="flat"):
        viewmat_from_matrix_world(np.diag([1.0, 0.0, 1.0, 1.0]))
