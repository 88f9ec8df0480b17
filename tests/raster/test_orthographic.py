"""Parallel rays. Oracles: a closed form for the reference, the reference for the native kernels."""

from math import exp

import numpy as np
import pytest
import torch

import gscore
from gscore.errors import BackendError
from gscore.raster import _native, reference
from gscore.raster.request import Frustum, Settings
from gscore.splats import Splats
from gscore.stress.truth import request_of

BACKGROUND = (0.25, 0.5, 0.125)
PARAMETERS = ("means", "quats", "scales", "opacities", "sh0", "shN")


@pytest.fixture
def parallel(random_scene):
    """A scene at any pose, and the K of parallel rays that fills its picture."""
    scene = random_scene(3, count=400, width=64, height=48, overscan=0.2, elongation=1.0)
    K = scene.K.clone()
    K[0, 0], K[1, 1], K[0, 2], K[1, 2] = 9.0, 11.5, 30.25, 26.75
    return scene, K


def draw_reference(scene, K, **options):
    """The reference's pictures of a scene through parallel rays."""
    inputs = {**scene.inputs(), "K": K}
    background = torch.tensor(BACKGROUND).double()
    with torch.no_grad():
        out = reference.rasterize_reference(
            **inputs,
            raw=True,
            orthographic=True,
            background=background,
            inverse_depth=True,
            depth=True,
            **options,
        )
        band = reference.boundary_band(*request_of(inputs, orthographic=True, **options))
    return out, band


def draw_native(scene, K, **options):
    """gscore.render of the same."""
    splats = Splats(**{name: getattr(scene, name).float().numpy() for name in PARAMETERS})
    return gscore.render(
        splats,
        K.numpy(),
        scene.viewmat.numpy(),
        scene.width,
        scene.height,
        background=BACKGROUND,
        orthographic=True,
        **options,
    )


@pytest.mark.parametrize("z", [1.0, 7.5])
def test_size_does_not_depend_on_depth(one_splat, z):
    """Oracle: variance (f sigma)^2 + 0.3 and alpha = o exp(-r^2 / (2 variance)) at any z."""
    splat = one_splat(sigma=0.2, opacity=0.8, color=(0.2, 0.5, 0.7), position=(0.3, -0.2, z))
    K = torch.tensor([[10.0, 0, 5.5], [0, 10.0, 8.5], [0, 0, 1]], dtype=torch.float64)
    out = reference.rasterize_reference(
        **splat, viewmat=torch.eye(4).double(), K=K, width=16, height=12, orthographic=True
    )
    variance = (10 * 0.2) ** 2 + 0.3
    for row, column in [(6, 8), (6, 11), (4, 8), (9, 5)]:  # the centre projects to (8.5, 6.5) px
        alpha = 0.8 * exp(-((column - 8) ** 2 + (row - 6) ** 2) / (2 * variance))
        assert float(out.alpha[row, column]) == pytest.approx(alpha, rel=1e-12)
        assert float(out.rgb[row, column, 2]) == pytest.approx(0.7 * alpha, rel=1e-12)


def test_colours_are_those_of_a_camera_far_away(parallel):
    """Oracle: a pinhole camera 1e5 times the scene's size away, with the matching focal length."""
    scene, K = parallel
    near_by, _ = draw_reference(scene, K)
    away = 1e6
    viewmat, far_K = scene.viewmat.clone(), K.clone()
    viewmat[2, 3] += away
    far_K[0, 0], far_K[1, 1] = K[0, 0] * away, K[1, 1] * away
    # With the middle of the scene's depths (1.5 to 6) at distance `away`.
    viewmat[2, 3] -= 3.75
    inputs = {**scene.inputs(), "K": far_K, "viewmat": viewmat}
    with torch.no_grad():
        distant = reference.rasterize_reference(
            **inputs, raw=True, background=torch.tensor(BACKGROUND).double()
        )
    assert near_by.alpha.mean() > 0.1
    assert (near_by.rgb - distant.rgb).abs().quantile(0.99) < 1e-3


@pytest.mark.parametrize("antialias", [False, True])
def test_native_agrees_with_the_reference(parallel, isa, antialias):
    """Oracle: the float64 reference, closely outside the band where rounding may flip a pixel."""
    scene, K = parallel
    truth, band = draw_reference(scene, K, antialias=antialias)
    view = draw_native(scene, K, antialias=antialias)
    assert truth.alpha.mean() > 0.1
    assert band.double().mean() < 0.1
    for name in ("rgb", "alpha", "inverse_depth", "depth", "median_depth"):
        true = getattr(truth, name).numpy()
        error = np.abs(getattr(view, name) - true).reshape(*band.shape, -1).max(axis=2)
        assert error[~band.numpy()].max() <= 1e-5 * max(1.0, np.abs(true).max()), name


def test_gradients_are_refused(parallel):
    """Oracle: the header: GS_UNSUPPORTED, with a sentence."""
    scene, K = parallel
    arrays = [np.ascontiguousarray(getattr(scene, name).float().numpy()) for name in PARAMETERS]
    view = Frustum(scene.viewmat, K, scene.width, scene.height, orthographic=True)
    settings = Settings(background=BACKGROUND, threads=1)
    size = (scene.height, scene.width)
    pictures = {"rgb": np.zeros((*size, 3), np.float32), "alpha": np.zeros(size, np.float32)}
    raster = _native.Raster()
    raster.forward(arrays, view, settings, pictures)
    grads = {name: np.zeros_like(a) for name, a in zip(PARAMETERS, arrays, strict=True)}
    with pytest.raises(BackendError, match="orthographic"):
        raster.backward(arrays, view, settings, {"rgb": pictures["rgb"]}, grads)
