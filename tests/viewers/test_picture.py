"""Pictures by viewers' rules. Oracle: the reference rasterizer, formulas for one splat, and finite
differences."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from gscore.raster.reference.rasterize import SplatTensors, rasterize_reference
from gscore.raster.request import Frustum
from gscore.shared_constants import ALPHA_MIN, SH_C0
from gscore.viewers import picture
from gscore.viewers.light import to_linear, to_srgb
from gscore.viewers.picture import drawn_picture, modelled_picture
from gscore.viewers.rules import VIEWERS, ViewerRules, rules_of
from tests.light_changes import decode, encode

BACKGROUND = (0.25, 0.5, 0.125)
PLAIN = ViewerRules(name="plain", label="", source="", reach=math.inf, alpha_min=ALPHA_MIN)
"""The rules of gscore itself."""
STEP = 1e-7
"""Of the central differences."""
UNCODED = {"means": None, "scales": None, "opacities": None, "sh0": None, "shN": ()}


def exact_ends(rules):
    """The rules with the ends of the native rasterizer."""
    ends = {"reach": math.inf, "square": False, "shifted": False, "alpha_min": ALPHA_MIN}
    return replace(rules, **ends)


def one(sigma_px, opacity, color):
    """A round splat at the middle of pixel (20, 15) of a camera of 41 x 31 px."""
    depth, focal = 4.0, 50.0
    fields = (
        [[0.0, 0.0, depth]],
        [[1.0, 0, 0, 0]],
        [[math.log(sigma_px * depth / focal)] * 3],
        [math.log(opacity / (1 - opacity))],
        [[[(c - 0.5) / SH_C0 for c in color]]],
        np.zeros((1, 0, 3)),
    )
    tensors = SplatTensors(*(torch.tensor(np.array(f), dtype=torch.float32) for f in fields))
    K = np.array([[focal, 0, 20.5], [0, focal, 15.5], [0, 0, 1]])
    return tensors, Frustum(np.eye(4), K, 41, 31)


def test_the_model_with_the_rules_of_gscore(splats, view):
    """Oracle: `rasterize_reference`, for eps2d with and without compensation."""
    splats = splats._replace(sh0=splats.sh0 + 2)
    for compensated in (False, True):
        rules = replace(PLAIN, compensated=compensated)
        expected = rasterize_reference(
            *(f.double() for f in splats),
            torch.from_numpy(view.viewmat),
            torch.from_numpy(view.K),
            view.width,
            view.height,
            raw=True,
            background=torch.tensor(BACKGROUND),
            antialias=compensated,
        ).rgb
        assert expected.max() > 1  # clamped by the viewer
        found = modelled_picture(splats, view, rules, BACKGROUND)
        np.testing.assert_allclose(found, expected.clamp(0, 1), atol=1e-9)


def test_bands_do_not_change_the_picture(splats, view, monkeypatch):
    """Oracle: the picture in one band."""
    whole = modelled_picture(splats, view, rules_of("spark"), BACKGROUND)
    monkeypatch.setattr(picture, "_BAND", 500)
    np.testing.assert_allclose(
        modelled_picture(splats, view, rules_of("spark"), BACKGROUND), whole, atol=1e-12
    )


def test_blender_blends_linear_light():
    """Oracle: the sRGB formula by hand, at the centre of a splat of 5 px."""
    splats, view = one(5.0, 0.5, (0.8, 0.5, 0.2))
    rules = replace(rules_of("blender"), **UNCODED)
    found = modelled_picture(splats, view, rules, (1.0, 1.0, 1.0))[15, 20].numpy()
    variance = 25 * 9 / 8
    alpha = 0.5 * variance / (variance + rules.eps2d) * 256 / 255
    linear = alpha * decode([0.8, 0.5, 0.2]) + 1 - alpha
    np.testing.assert_allclose(found, encode(linear), atol=1e-5)


def test_splats_end_where_viewers_end_them():
    """Oracle: exp(-r^2 / 2) along a row through the centre, by hand: Spark's end at sqrt(8)
    standard deviations, SuperSplat's shifted falloff, and Blender's square."""
    splats, view = one(2.0, 0.9, (1.0, 1.0, 1.0))
    away = np.abs(np.arange(41) - 20)
    sigma = math.sqrt(4 + 0.3)
    full = np.exp(-((away / sigma) ** 2) / 2)
    spark = modelled_picture(splats, view, replace(rules_of("spark"), **UNCODED))[15, :, 0]
    compensated = 0.9 * 4 / 4.3
    inside = away <= math.sqrt(8) * sigma
    np.testing.assert_allclose(
        spark, np.round(255 * 1.0) / 255 * np.where(inside, compensated * full, 0), atol=1e-6
    )
    supersplat = modelled_picture(splats, view, rules_of("supersplat"))[15, :, 0]
    shifted = (full - math.exp(-4)) / (1 - math.exp(-4))
    np.testing.assert_allclose(supersplat, 0.9 * np.where(inside, shifted, 0), atol=1e-6)
    blender = modelled_picture(splats, view, replace(rules_of("blender"), **UNCODED))
    sigma = math.sqrt(4 * 9 / 8 + rules_of("blender").eps2d)
    corner = int(math.sqrt(8) * sigma)  # inside the square, outside the circle
    assert blender[15 + corner, 20 + corner, 0] > 0
    assert blender[15, 20 + corner + 1, 0] == 0


def test_spark_orders_by_distance():
    """Oracle: of two opaque splats, the nearer to the camera, although its z is larger."""
    left, view = one(3.0, 0.999, (1.0, 0.0, 0.0))
    right, _ = one(3.0, 0.999, (0.0, 0.0, 1.0))
    moved = right._replace(means=torch.tensor([[1.5, 0.0, 3.9]]))
    tilted = replace(view, viewmat=np.eye(4), K=view.K)
    both = SplatTensors(*(torch.cat(pair) for pair in zip(left, moved, strict=True)))
    # At equal pixels: the wide second splat lies 1.5 to the right, nearer by z, farther away.
    wide = both._replace(scales=both.scales + torch.tensor([[0.0], [1.5]]))
    by_z = modelled_picture(wide, tilted, replace(rules_of("spark"), radial=False))[15, 20]
    radial = modelled_picture(wide, tilted, rules_of("spark"))[15, 20]
    assert radial[0] > by_z[0] and radial[2] < by_z[2]


@pytest.mark.parametrize("name", VIEWERS)
def test_the_fast_picture_equals_the_model(name, splats, view):
    """Oracle: the float64 model with the ends of the native rasterizer; with the viewer's own ends
    within the opacity at which they cut."""
    rules = rules_of(name)
    found = drawn_picture(splats, view, exact_ends(rules), BACKGROUND, threads=1).clamp(0, 1)
    exact = modelled_picture(splats, view, exact_ends(rules), BACKGROUND)
    np.testing.assert_allclose(found, exact, atol=2e-4)
    found = drawn_picture(splats, view, rules, BACKGROUND, threads=1).clamp(0, 1)
    exact = modelled_picture(splats, view, rules, BACKGROUND)
    assert (found - exact).abs().mean() < 2 / 255


@pytest.mark.parametrize("name", VIEWERS)
def test_gradients_of_the_fast_picture(name, splats, view):
    """Oracle: central differences of the float64 model without codings, along random directions of
    each parameter."""
    rules = replace(exact_ends(rules_of(name)), **UNCODED, color_steps=0.0, half_means=False)
    rng = np.random.default_rng(1)
    dark = splats._replace(sh0=splats.sh0 * 0.5 - 0.4)  # below the clamp of the model at 1
    weights = torch.from_numpy(rng.normal(size=(view.height, view.width, 3)))
    names = ("scales", "opacities", "sh0", "shN")
    leaves = {n: getattr(dark, n).clone().requires_grad_() for n in names}
    drawn = drawn_picture(dark._replace(**leaves), view, rules, BACKGROUND, threads=1)
    (drawn * weights.float()).sum().backward()
    for n in names:
        value = getattr(dark, n).double()
        direction = torch.from_numpy(rng.normal(size=tuple(value.shape)))
        exact = SplatTensors(*(f.double() for f in dark))
        above, below = (
            modelled_picture(
                exact._replace(**{n: value + step * direction}), view, rules, BACKGROUND
            )
            for step in (STEP, -STEP)
        )
        slope = float(((above - below) * weights).sum()) / (2 * STEP)
        assert float((leaves[n].grad * direction).sum()) == pytest.approx(slope, rel=0.02), n


def test_light_is_converted_there_and_back():
    """Oracle: IEC 61966-2-1 at known values, and the identity."""
    srgb = torch.tensor([0.0, 0.02, 0.04045, 0.5, 1.0, 1.3], dtype=torch.float64)
    linear = to_linear(srgb)
    np.testing.assert_allclose(linear[[0, 3, 4]], [0, 0.21404114, 1], atol=1e-8)
    np.testing.assert_allclose(to_srgb(linear), srgb, atol=1e-6)
