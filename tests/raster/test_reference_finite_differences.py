"""Oracle: central differences in float64 of the reference's own pictures, every gradient class."""

from dataclasses import replace

import pytest
import torch

from gscore.raster.reference import (
    boundary_band,
    gaussian_alpha,
    means_to_camera,
    pixel_centers,
    project,
    projection_jacobian,
    rasterize_reference,
)
from gscore.raster.request import Settings
from gscore.stress.truth import request_of

OUTPUTS = ("rgb", "alpha", "inverse_depth", "depth")
BACKGROUND = torch.tensor([0.3, 0.6, 0.1], dtype=torch.float64)


def weighted_losses(scene, inputs, **options):
    """[4] losses, one per output: the picture times fixed random weights; and the mean alpha."""
    out = rasterize_reference(
        **inputs, background=BACKGROUND, inverse_depth=True, depth=True, **options
    )
    rng = torch.Generator().manual_seed(99)
    losses = []
    for name in OUTPUTS:
        picture = getattr(out, name)
        weights = torch.randn(picture.shape, generator=rng, dtype=torch.float64)
        losses.append((picture * weights).sum())
    return torch.stack(losses), out.alpha.mean()


def check_gradients(scene, names, central_difference, assert_grad_close, **options):
    """Compare autograd with central differences for each named input and each output."""
    inputs = scene.inputs()
    camera_options = {key: value for key, value in options.items() if key != "sh_degree"}
    asked = request_of(inputs, **{"raw": False, **camera_options})
    assert not boundary_band(*asked).any()  # no jump within reach of a step
    losses, coverage = weighted_losses(scene, inputs, **options)
    assert coverage > 0.1  # an empty picture has perfect gradients

    for name in names:

        def moved(value, name=name):
            return weighted_losses(scene, {**inputs, name: value}, **options)[0]

        numerical = central_difference(moved, inputs[name])
        for row, output in enumerate(OUTPUTS):
            (analytic,) = torch.autograd.grad(
                losses[row], inputs[name], retain_graph=True, allow_unused=True
            )
            if analytic is None or not analytic.any():
                # Colour affects only the rgb picture; everything else affects all of them.
                assert name in ("sh0", "shN") and output != "rgb"
                assert numerical[row].abs().max() < 1e-9
                continue
            assert_grad_close(analytic, numerical[row], name=f"d {output} / d {name}")


def opaque_front(scene):
    """Stack three big, nearly opaque splats, which use both the cap and the early stop."""
    cam = means_to_camera(scene.means, scene.viewmat)
    front = cam[:, 2].argsort()[:3]
    scales, opacities = scene.scales.clone(), scene.opacities.clone()
    cam[front, :2] *= 0.2  # towards the middle of the image, so that they overlap
    scales[front] += 0.5
    opacities[front] = torch.tensor([7.0, 4.0, 4.0], dtype=torch.float64)  # only one is capped
    means = (cam - scene.viewmat[:3, 3]) @ scene.viewmat[:3, :3]
    return replace(scene, means=means, scales=scales, opacities=opacities)


def light_through_all(scene):
    """[P, M] alpha before the cap, and [P] transmittance if no pixel ever stopped."""
    splats = project(*scene.tensors(), Settings())
    pixels = pixel_centers(scene.width, scene.height, like=scene.means)
    uncapped = gaussian_alpha(pixels, splats.means2d, splats.conics, splats.opacities)
    return uncapped, (1 - uncapped.clamp(max=0.99)).prod(1)


def test_every_raw_parameter_at_degree_3(smooth_scene, central_difference, assert_grad_close):
    scene = smooth_scene(100, count=6)
    names = ["means", "quats", "scales", "opacities", "sh0", "shN", "viewmat"]
    check_gradients(scene, names, central_difference, assert_grad_close, raw=True)


def test_every_raw_parameter_antialiased(smooth_scene, central_difference, assert_grad_close):
    scene = smooth_scene(160, count=7, sh_degree=1, sigma_px=(0.5, 3.0))
    names = ["means", "quats", "scales", "opacities", "sh0", "shN", "viewmat"]
    check_gradients(scene, names, central_difference, assert_grad_close, raw=True, antialias=True)


def test_activated_scales_and_opacities(smooth_scene, central_difference, assert_grad_close):
    scene = smooth_scene(200, count=9).activated()
    names = ["means", "quats", "scales", "opacities", "viewmat"]
    check_gradients(scene, names, central_difference, assert_grad_close, raw=False)


@pytest.mark.parametrize("sh_degree", [0, 1, 2])
def test_lower_sh_degrees(smooth_scene, central_difference, assert_grad_close, sh_degree):
    scene = smooth_scene(300 + sh_degree, count=6, sh_degree=sh_degree)
    names = ["means", "sh0", "viewmat"] + (["shN"] if sh_degree else [])
    check_gradients(scene, names, central_difference, assert_grad_close, raw=True)


def test_degree_below_the_stored_one_leaves_the_rest_without_gradient(
    smooth_scene, central_difference, assert_grad_close
):
    scene = smooth_scene(350, count=6, sh_degree=3)
    inputs = scene.inputs()
    losses, coverage = weighted_losses(scene, inputs, raw=True, sh_degree=1)
    assert coverage > 0.1
    (gradient,) = torch.autograd.grad(losses[0], inputs["shN"])
    assert gradient[:, :3].abs().max() > 0.01
    assert not gradient[:, 3:].any()
    check_gradients(scene, ["means"], central_difference, assert_grad_close, raw=True, sh_degree=1)


def test_off_centre_principal_point_and_unequal_focal_lengths(
    smooth_scene, central_difference, assert_grad_close
):
    scene = smooth_scene(400, count=7, focal=(23.0, 37.0), center=(5.5, 16.25), sh_degree=1)
    names = ["means", "quats", "scales", "opacities", "viewmat"]
    check_gradients(scene, names, central_difference, assert_grad_close, raw=True, antialias=True)


def test_splats_beyond_the_jacobian_clamp(smooth_scene, central_difference, assert_grad_close):
    scene = smooth_scene(
        500, count=9, overscan=0.7, sigma_px=(4.0, 12.0), center=(9.0, 12.0), sh_degree=1
    )
    cam = means_to_camera(scene.means, scene.viewmat)
    free = scene.K[0, 0] * -cam[:, 0] / cam[:, 2] ** 2
    jacobian = projection_jacobian(cam, scene.K, scene.width, scene.height)
    clamped = (jacobian[:, 0, 2] - free).abs() > 1e-6
    inputs = scene.inputs()
    rasterize_reference(**inputs, raw=True).rgb.sum().backward()
    assert (clamped & inputs["means"].grad.any(1)).sum() >= 2  # clamped, and visible
    names = ["means", "quats", "scales", "opacities", "viewmat"]
    check_gradients(scene, names, central_difference, assert_grad_close, raw=True)


def test_capped_alpha_and_early_stop(smooth_scene, central_difference, assert_grad_close):
    scene = smooth_scene(700, count=9, sh_degree=1, edit=opaque_front)
    uncapped, through_all = light_through_all(scene)
    assert (uncapped > 0.99).any()
    assert (through_all < 0.5e-4).any()  # the rest after the stop
    names = ["means", "quats", "scales", "opacities", "sh0", "viewmat"]
    check_gradients(scene, names, central_difference, assert_grad_close, raw=True)


def test_background_enters_with_the_final_transmittance_and_nowhere_else(smooth_scene):
    inputs = smooth_scene(700).inputs()
    black, lit = (
        rasterize_reference(**inputs, raw=True, background=b, inverse_depth=True, depth=True)
        for b in (None, BACKGROUND)
    )
    assert black.alpha.mean() > 0.1
    expected = black.rgb + (1 - black.alpha)[..., None] * BACKGROUND
    assert (lit.rgb - expected).abs().max() < 1e-15
    for name in OUTPUTS[1:]:
        assert torch.equal(getattr(black, name), getattr(lit, name))

    background = BACKGROUND.clone().requires_grad_()
    out = rasterize_reference(**inputs, raw=True, background=background)
    (gradient,) = torch.autograd.grad(out.rgb.sum(), background, allow_unused=True)
    assert gradient is None  # a constant, as documented
