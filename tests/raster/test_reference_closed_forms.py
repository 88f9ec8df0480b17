"""Oracle: closed forms, worked out by hand in each test."""

from math import exp, sqrt

import pytest
import torch

from gscore.raster.reference import rasterize_reference

WIDTH, HEIGHT, FOCAL = 16, 12, 20.0
K = torch.tensor([[FOCAL, 0, 8.5], [0, FOCAL, 6.5], [0, 0, 1]], dtype=torch.float64)
"""The optical axis meets the image at the centre of pixel (8, 6)."""
VIEWMAT = torch.eye(4, dtype=torch.float64)
CENTER = (6, 8)
"""Row and column of that pixel."""


def draw(*splats, **options):
    """Rasterize splats from `one_splat` in the given order."""
    merged = {name: torch.cat([splat[name] for splat in splats]) for name in splats[0]}
    return rasterize_reference(
        **merged,
        viewmat=VIEWMAT,
        K=K,
        width=WIDTH,
        height=HEIGHT,
        inverse_depth=True,
        depth=True,
        **options,
    )


def close(actual, expected):
    expected = torch.as_tensor(expected, dtype=torch.float64)
    assert torch.allclose(actual.detach(), expected, rtol=1e-13, atol=1e-15), (actual, expected)


def test_one_round_splat_on_the_axis(one_splat):
    """Variance (f sigma / z)^2 + 0.3 in both directions; alpha = o exp(-r^2 / (2 variance))."""
    out = draw(one_splat(sigma=0.2, opacity=0.8, color=(0.2, 0.5, 0.7), position=(0, 0, 2)))
    variance = (FOCAL * 0.2 / 2) ** 2 + 0.3
    for row, column in [(6, 8), (6, 11), (4, 8), (9, 5)]:
        alpha = 0.8 * exp(-((column - 8) ** 2 + (row - 6) ** 2) / (2 * variance))
        close(out.alpha[row, column], alpha)
        close(out.rgb[row, column], [0.2 * alpha, 0.5 * alpha, 0.7 * alpha])
        close(out.inverse_depth[row, column], alpha / 2)
        close(out.depth[row, column], 2.0)
    assert out.alpha.mean() > 0.05


def test_one_ellipsoid_on_the_axis(one_splat):
    """Scales 0.3, 0.1, turned by 90 degrees about z: the long axis is vertical."""
    splat = one_splat(position=(0, 0, 2))
    splat["scales"] = torch.tensor([[0.3, 0.1, 0.05]], dtype=torch.float64)
    splat["quats"] = torch.tensor([[sqrt(0.5), 0, 0, sqrt(0.5)]], dtype=torch.float64)
    out = draw(splat)
    close(out.alpha[6, 9], 0.8 * exp(-1 / (2 * ((FOCAL * 0.1 / 2) ** 2 + 0.3))))
    close(out.alpha[3, 8], 0.8 * exp(-9 / (2 * ((FOCAL * 0.3 / 2) ** 2 + 0.3))))


def test_one_round_splat_off_the_axis(one_splat):
    """J of a ray with slope t = x/z stretches a ball by sqrt(1 + t^2) along x."""
    slope = 0.2
    out = draw(one_splat(sigma=0.2, opacity=0.8, position=(2 * slope, 0, 2)))
    column = 8 + round(FOCAL * slope)  # lands on a pixel centre: 4 px to the right
    base = (FOCAL * 0.2 / 2) ** 2
    close(out.alpha[6, column], 0.8)
    close(out.alpha[6, column + 2], 0.8 * exp(-4 / (2 * (base * (1 + slope**2) + 0.3))))
    close(out.alpha[8, column], 0.8 * exp(-4 / (2 * (base + 0.3))))


def test_viewmat_moves_the_world_into_the_camera(one_splat):
    """A camera turned by 90 degrees about y faces +x; up stays up."""
    splat = one_splat(sigma=0.1, position=(5.0, 0.0, 0.0))
    viewmat = torch.tensor(
        [[0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, -2], [0, 0, 0, 1]], dtype=torch.float64
    )
    out = rasterize_reference(**splat, viewmat=viewmat, K=K, width=WIDTH, height=HEIGHT, depth=True)
    close(out.depth[CENTER], 3.0)
    close(out.alpha[CENTER], 0.8)


@pytest.mark.parametrize("flipped", [False, True])
def test_two_layers_blend_front_to_back_whatever_their_order(one_splat, flipped):
    front = one_splat(opacity=0.6, color=(1.0, 0.1, 0.3), position=(0, 0, 2))
    back = one_splat(opacity=0.9, color=(0.2, 0.8, 0.4), position=(0, 0, 4))
    layers = [back, front] if flipped else [front, back]
    out = draw(*layers, background=torch.tensor([0.5, 0.0, 1.0]).double())
    w1, w2 = 0.6, 0.4 * 0.9
    light = 0.4 * 0.1
    close(
        out.rgb[CENTER],
        [
            w1 * 1.0 + w2 * 0.2 + light * 0.5,
            w1 * 0.1 + w2 * 0.8,
            w1 * 0.3 + w2 * 0.4 + light * 1.0,
        ],
    )
    close(out.alpha[CENTER], 1 - light)
    close(out.inverse_depth[CENTER], w1 / 2 + w2 / 4)
    close(out.depth[CENTER], (w1 * 2 + w2 * 4) / (w1 + w2))


def test_layers_at_the_same_depth_blend_in_the_order_given(one_splat):
    red = one_splat(opacity=0.5, color=(1.0, 0.0, 0.0))
    blue = one_splat(opacity=0.5, color=(0.0, 0.0, 1.0))
    close(draw(red, blue).rgb[CENTER], [0.5, 0.0, 0.25])
    close(draw(blue, red).rgb[CENTER], [0.25, 0.0, 0.5])


def test_median_depth_is_where_half_the_light_is_gone(one_splat):
    layers = [one_splat(opacity=0.3, position=(0, 0, z)) for z in (2, 3, 4)]
    assert float(draw(layers[0]).median_depth[CENTER]) == 0.0  # 0.7 left: never
    close(draw(layers[0], layers[2]).median_depth[CENTER], 4.0)  # 0.49 left
    out = draw(*layers)
    close(out.median_depth[CENTER], 3.0)
    assert not out.median_depth.requires_grad
    half = one_splat(opacity=0.5, position=(0, 0, 2))
    close(draw(half).median_depth[CENTER], 2.0)  # exactly half counts


def test_empty_pixels_have_zero_depth_and_the_background(one_splat):
    background = torch.tensor([0.1, 0.2, 0.3]).double()
    out = draw(one_splat(sigma=0.02), background=background)
    assert float(out.alpha[CENTER]) > 0.1
    for corner in [(0, 0), (11, 15)]:
        assert float(out.alpha[corner]) == 0.0
        assert float(out.depth[corner]) == 0.0
        assert float(out.inverse_depth[corner]) == 0.0
        assert torch.equal(out.rgb[corner], background)


def test_alpha_is_capped_and_the_cap_passes_no_gradient_but_color(one_splat):
    splat = one_splat(sigma=0.3, opacity=0.999, color=(0.5, 0.5, 0.5))
    for tensor in splat.values():
        tensor.requires_grad_()
    out = draw(splat, background=torch.ones(3).double())
    close(out.alpha[CENTER], 0.99)
    close(out.rgb[CENTER], [0.99 * 0.5 + 0.01] * 3)
    out.rgb[CENTER].sum().backward()
    for name in ("means", "quats", "scales", "opacities"):
        assert not splat[name].grad.any(), name
    close(splat["sh0"].grad.flatten(), [0.99 * 0.5 / sqrt(torch.pi)] * 3)


def test_alpha_below_one_255th_is_nothing(one_splat):
    """Along a row the profile is cut exactly where it falls below 1/255."""
    out = draw(one_splat(sigma=0.12, opacity=0.8))
    variance = (FOCAL * 0.12 / 2) ** 2 + 0.3
    profile = [0.8 * exp(-((c - 8) ** 2) / (2 * variance)) for c in range(WIDTH)]
    expected = [value if value >= 1 / 255 else 0.0 for value in profile]
    assert 0.0 in expected
    assert min(value for value in expected if value) < 0.01  # faint, yet drawn
    close(out.alpha[6], expected)


@pytest.mark.parametrize("opacity", [0.0039, 0.00393])
def test_opacity_decides_on_the_threshold_of_1_255(one_splat, opacity):
    out = draw(one_splat(opacity=opacity))
    close(out.alpha[CENTER], opacity if opacity >= 1 / 255 else 0.0)


def test_stop_is_tested_before_blending(one_splat):
    """T: 1, 0.1, 0.001; the third would leave 2e-5 and is not blended, nor is the fourth."""
    layers = [
        one_splat(opacity=opacity, color=color, position=(0, 0, z))
        for opacity, color, z in [
            (0.9, (1.0, 0.0, 0.0), 2),
            (0.98, (0.0, 1.0, 0.0), 3),
            (0.98, (0.0, 0.0, 1.0), 4),
            (0.01, (1.0, 1.0, 1.0), 5),
        ]
    ]
    out = draw(*layers)
    close(out.rgb[CENTER], [0.9, 0.1 * 0.98, 0.0])
    assert abs(float(out.alpha[CENTER]) - (1 - 0.002)) < 1e-14


def test_two_capped_layers_leave_exactly_the_limit_and_stop(one_splat):
    """0.01 * 0.01 = 1e-4 is not above 1e-4: the second capped layer is not blended."""
    front = one_splat(opacity=1.0, color=(1.0, 0.0, 0.0), position=(0, 0, 2))
    back = one_splat(opacity=1.0, color=(0.0, 1.0, 0.0), position=(0, 0, 3))
    for dtype in (torch.float64, torch.float32):
        out = draw(front, back, dtype=dtype)
        assert float(out.rgb[(*CENTER, 1)]) == 0.0
        assert abs(float(out.alpha[CENTER]) - 0.99) < 1e-6


@pytest.mark.parametrize(
    ("z", "drawn"), [(0.5, False), (0.5 + 1e-9, True), (8.0, True), (8.0 + 1e-9, False)]
)
def test_near_is_excluded_and_far_included(one_splat, z, drawn):
    out = draw(one_splat(position=(0, 0, z)), near=0.5, far=8.0)
    assert bool(out.alpha[CENTER] > 0) == drawn


def test_behind_the_camera_is_nothing(one_splat):
    out = draw(one_splat(position=(0, 0, -2)), one_splat(position=(0, 0, 0)))
    assert not out.alpha.any()


def test_antialias_scales_the_opacity_by_the_root_of_the_determinants(one_splat):
    variance = (FOCAL * 0.04 / 2) ** 2
    out = draw(one_splat(sigma=0.04, opacity=0.8), antialias=True)
    factor = variance / (variance + 0.3)  # isotropic: the root of the ratio of squares
    close(out.alpha[CENTER], 0.8 * factor)
    close(out.alpha[6, 9], 0.8 * factor * exp(-1 / (2 * (variance + 0.3))))


def test_antialias_floor(one_splat):
    """A splat of 0.01 px keeps 0.005 of its opacity, and its size does not enter that factor."""
    splat = one_splat(sigma=0.001, opacity=0.9)
    splat["opacities"].requires_grad_()
    splat["scales"].requires_grad_()
    out = draw(splat, antialias=True)
    close(out.alpha[CENTER], 0.9 * 0.005)
    out.alpha[CENTER].backward()
    close(splat["opacities"].grad, [0.005])
    assert not splat["scales"].grad.any()


def test_eps2d_is_the_variance_added(one_splat):
    out = draw(one_splat(sigma=0.1, opacity=0.8), eps2d=1.5)
    close(out.alpha[6, 10], 0.8 * exp(-4 / (2 * ((FOCAL * 0.1 / 2) ** 2 + 1.5))))


def test_raw_parameters_are_activated(one_splat):
    splat = one_splat(sigma=0.2, opacity=0.8)
    raw = {**splat, "scales": splat["scales"].log(), "opacities": splat["opacities"].logit()}
    close(draw(raw, raw=True).rgb, draw(splat).rgb)


def test_degree_one_color_follows_the_direction_from_the_camera(one_splat):
    """Degree 1 is c (-y, z, -x) of the unit direction, c = sqrt(3 / 4 pi)."""
    splat = one_splat(color=(0.5, 0.5, 0.5), position=(0.4, 0.0, 2.0))
    splat["shN"] = torch.tensor([[[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]], dtype=torch.float64)
    length = sqrt(0.4**2 + 2**2)
    c = sqrt(3 / (4 * torch.pi))
    out = draw(splat)
    expected = [0.5, 0.5 + 0.1 * c * 2.0 / length, 0.5 - 0.1 * c * 0.4 / length]
    pixel = (6, 8 + 4)
    close(out.rgb[pixel] / out.alpha[pixel], expected)
    close(draw(splat, sh_degree=0).rgb[pixel] / out.alpha[pixel], [0.5, 0.5, 0.5])
