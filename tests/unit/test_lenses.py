"""Lens distortion, with numpy alone. Oracle: pycolmap's cameras."""

import numpy as np
import pycolmap
import pytest

from gscore.io.colmap.lenses import (
    CAMERA_MODELS,
    DISTORTED_MODELS,
    MODELS_BY_NAME,
    NO_PINHOLE,
    distorted_pixels,
    undistorted_rays,
)

_KNOWN = {"f": 500.0, "fx": 500.0, "fy": 480.0, "cx": 310.0, "cy": 255.0}
_SHAPES = {"omega": 0.9, "alpha": 0.6, "beta": 1.1}


def _params(model: str, rng: np.random.Generator) -> list[float]:
    """Every parameter other than 0."""
    names = MODELS_BY_NAME[model].params
    return [(_KNOWN | _SHAPES).get(name) or rng.uniform(-0.05, 0.05) for name in names]


def test_all_models_are_known() -> None:
    """Oracle: the list of COLMAP's models, without undistorted ones and those without a focal
    length."""
    straight = {"PINHOLE", "SIMPLE_PINHOLE"}
    assert {model.name for model in CAMERA_MODELS} - straight - NO_PINHOLE == DISTORTED_MODELS


@pytest.mark.parametrize("model", sorted(DISTORTED_MODELS))
def test_rays_meet_the_pixels_of_pycolmap(model: str) -> None:
    """Rays up to 45 degrees off the axis, and the axis; both ways."""
    rng = np.random.default_rng(3)
    params = _params(model, rng)
    camera = pycolmap.Camera(model=model, width=640, height=480, params=params)
    rays = np.concatenate([rng.uniform(-0.7, 0.7, (200, 2)), np.zeros((1, 2))])
    wanted = camera.img_from_cam(np.concatenate([rays, np.ones((len(rays), 1))], axis=1))
    # FOV: near its axis pycolmap uses a series.
    np.testing.assert_allclose(distorted_pixels(model, params, rays), wanted, rtol=0, atol=1e-8)
    np.testing.assert_allclose(undistorted_rays(model, params, wanted), rays, rtol=0, atol=1e-8)


def test_lenses_of_no_bend_are_those_of_a_pinhole() -> None:
    """Oracle: f x / z, of models with a limit there."""
    rays = np.array([[0.0, 0.0], [0.3, -0.4]])
    for model, bend in (("FOV", [0.0]), ("EUCM", [0.0, 1.0]), ("DIVISION", [0.0])):
        params = [500.0, 480.0, 310.0, 255.0, *bend]
        wanted = rays * [500, 480] + [310, 255]
        np.testing.assert_allclose(distorted_pixels(model, params, rays), wanted)
        np.testing.assert_allclose(undistorted_rays(model, params, wanted), rays, atol=1e-12)


def test_pixels_outside_the_lens_have_no_ray() -> None:
    """Oracle: a maximum of 0.544 of r (1 - 0.5 r^2); a right angle at pi / 2 focal lengths for an
    equidistant fisheye."""
    pixels = np.array([[0.5, 0.0], [0.53, 0.0], [0.56, 0.0], [0.0, -5.0]])
    rays = undistorted_rays("SIMPLE_RADIAL", [1.0, 0.0, 0.0, -0.5], pixels)
    assert np.isfinite(rays[:2]).all() and np.isnan(rays[2:]).all()
    turns_back = (1 / 1.5) ** 0.5
    assert (np.linalg.norm(rays[:2], axis=1) < turns_back).all()
    wide = undistorted_rays("SIMPLE_FISHEYE", [1.0, 0.0, 0.0], np.array([[1.5, 0.0], [1.6, 0.0]]))
    assert wide[0, 0] == pytest.approx(np.tan(1.5)) and np.isnan(wide[1]).all()
