"""Oracles for the native kernels: golden values, closed forms, damaged rows that leave no trace."""

from pathlib import Path

import numpy as np
import pytest
import torch

from gscore.engine.rotation import undirected
from gscore.errors import GsError
from gscore.raster import _native, reference
from gscore.raster.api import render
from gscore.raster.autograd import RasterAux, rasterize
from gscore.splats import Splats
from tests.raster.damage import assert_row_without_gradient

GOLDEN = Path(__file__).parent / "golden" / "gsplat_formulas.npz"
FIELDS = ("means", "quats", "scales", "opacities", "sh0", "shN")
OPTIONS = {"inverse_depth": True, "depth": True}
K = torch.tensor([[20.0, 0, 8.5], [0, 20.0, 6.5], [0, 0, 1]])
"""The optical axis meets the image at the centre of pixel row 6, column 8."""

pytestmark = pytest.mark.usefixtures("isa")


def draw(*splats, **options):
    """Activated splats from `one_splat`, drawn into 16 x 12 pixels."""
    merged = {name: torch.cat([splat[name] for splat in splats]).float() for name in splats[0]}
    merged = {name: tensor.detach().requires_grad_() for name, tensor in merged.items()}
    out = rasterize(**merged, viewmat=torch.eye(4), K=K, width=16, height=12, **OPTIONS, **options)
    return out, merged


@pytest.fixture(scope="module")
def golden():
    with np.load(GOLDEN) as stored:
        return {name: stored[name] for name in stored}


def render_golden(golden, antialias, monkeypatch):
    """The golden scene by the numpy API, and the screen-space values of that call."""
    pool = _native.RasterPool()  # keeps the one workspace that renders
    monkeypatch.setattr(_native, "pool", pool)
    splats = Splats(**{name: golden[f"in_{name}"].astype(np.float32) for name in FIELDS})
    height, width = golden["alpha"].shape
    rendered = render(
        splats,
        golden["in_K"],
        golden["in_viewmat"],
        width,
        height,
        background=tuple(golden["in_background"].tolist()),
        antialias=antialias,
    )
    with pool.lend() as raster:
        return rendered, raster.projected(len(splats))


@pytest.mark.parametrize("antialias", [False, True])
def test_golden_values(golden, antialias, monkeypatch):
    rendered, projected = render_golden(golden, antialias, monkeypatch)
    suffix = "_antialiased" if antialias else ""
    for name, picture in (
        ("image", rendered.rgb),
        ("alpha", rendered.alpha),
        ("inverse_depth", rendered.inverse_depth),
    ):
        assert np.abs(picture - golden[name + suffix]).max() < 1e-5, name
    drawn = projected["depths"] > 0
    assert drawn.sum() >= 20
    for name in ("means2d", "conics", "depths"):
        wanted = golden[name][drawn]
        # Relative to the row: an off-diagonal near zero has no relative accuracy of its own.
        size = np.abs(wanted).reshape(len(wanted), -1).max(1)
        error = np.abs(projected[name][drawn] - wanted).reshape(len(wanted), -1).max(1)
        assert (error / size).max() < 1e-5, name
    assert np.abs(projected["colors"][drawn] - golden["colors"][drawn]).max() < 2e-6
    opacities = 1 / (1 + np.exp(-golden["in_opacities"]))
    opacities = opacities * golden["compensations"] if antialias else opacities
    assert np.allclose(projected["opacities"][drawn], opacities[drawn], rtol=2e-6)


def test_one_splat_has_its_closed_form(one_splat):
    out, _ = draw(one_splat(sigma=0.2, opacity=0.8, color=(0.2, 0.5, 0.7), position=(0, 0, 2)))
    row, column = torch.meshgrid(torch.arange(12), torch.arange(16), indexing="ij")
    distance2 = ((row - 6) ** 2 + (column - 8) ** 2).double()
    alpha = 0.8 * torch.exp(-distance2 / (2 * ((20 * 0.2 / 2) ** 2 + 0.3)))
    alpha = torch.where(alpha >= 1 / 255, alpha, 0.0)
    assert alpha.mean() > 0.05
    assert (alpha == 0).any()
    assert torch.allclose(out.alpha.double(), alpha, atol=1e-6)
    color = torch.tensor([0.2, 0.5, 0.7], dtype=torch.float64)
    assert torch.allclose(out.rgb.double(), alpha[..., None] * color, atol=1e-6)
    assert torch.allclose(out.inverse_depth.double(), alpha / 2, atol=1e-6)


def test_one_faint_layer_lies_at_its_own_depth(one_splat):
    """The mean of one value is that value, independent of the weight."""
    z = 3.0
    out, inputs = draw(one_splat(sigma=0.4, opacity=0.006, position=(0, 0, z)))
    drawn = out.alpha > 0
    assert 10 < drawn.sum() < drawn.numel()
    assert (out.depth[drawn] / z - 1).abs().max() < 1e-6
    assert not out.depth[~drawn].any()
    out.depth.sum().backward()
    assert abs(float(inputs["opacities"].grad)) < 0.005  # ulps of z / alpha, over all pixels


def test_two_capped_layers_leave_the_limit_and_stop(one_splat):
    front = one_splat(opacity=1.0, color=(1.0, 0.5, 0.25), position=(0, 0, 2))
    back = one_splat(opacity=1.0, color=(0.5, 1.0, 0.5), position=(0, 0, 3))
    out, inputs = draw(front, back)
    assert abs(float(out.rgb[6, 8, 1].detach()) - 0.99 * 0.5) < 1e-6
    assert abs(float(out.alpha[6, 8].detach()) - 0.99) < 1e-6
    out.rgb[6, 8].sum().backward()
    for name in ("means", "quats", "scales", "opacities"):
        assert not inputs[name].grad.any(), name  # the cap passes no gradient
    assert inputs["sh0"].grad[0].abs().min() > 0.1
    assert not inputs["sh0"].grad[1].any()


def test_layers_at_the_same_depth_blend_in_the_order_given(one_splat):
    red = one_splat(opacity=0.5, color=(1.0, 0.0, 0.0))
    blue = one_splat(opacity=0.5, color=(0.0, 0.0, 1.0))
    for first, second, expected in [(red, blue, [0.5, 0, 0.25]), (blue, red, [0.25, 0, 0.5])]:
        out, _ = draw(first, second)
        assert torch.allclose(out.rgb[6, 8], torch.tensor(expected), atol=1e-6)


@pytest.mark.parametrize("antialias", [False, True])
def test_median_depth_is_the_references(random_scene, antialias):
    scene = random_scene(21, count=500, width=48, height=40)
    true = reference.rasterize_reference(
        **scene.inputs(), raw=True, antialias=antialias, depth=True
    ).median_depth
    splats = Splats(**{name: getattr(scene, name).float().numpy() for name in FIELDS})
    rendered = render(splats, scene.K.numpy(), scene.viewmat.numpy(), 48, 40, antialias=antialias)
    assert (true > 0).double().mean() > 0.5
    same = np.abs(rendered.median_depth - true.numpy()) < 1e-5 * true.numpy() + 1e-9
    assert same.mean() > 0.998  # a transmittance within rounding of 0.5 may choose a neighbour


def test_damaged_rows_vanish_and_touch_nothing_else(random_scene, hostile_rows):
    """Pictures and gradients equal, bit for bit, those of the scene without the row."""
    scene = random_scene(22, count=60, width=40, height=33)
    row = 7
    others = torch.arange(60) != row

    def run(some):
        inputs, aux = some.inputs(torch.float32), RasterAux()
        out = rasterize(**inputs, raw=True, aux=aux, **OPTIONS)
        pictures = torch.cat(
            [picture.flatten() for picture in (out.rgb, out.alpha, out.inverse_depth, out.depth)]
        )
        pictures.square().sum().backward()
        return pictures.detach(), inputs, aux

    pictures, inputs, _ = run(scene.rows(others))
    assert pictures.mean() > 0.1
    for name, damage in hostile_rows.items():
        damaged_pictures, damaged, aux = run(scene.with_row(row, **damage))
        assert torch.equal(damaged_pictures, pictures), name
        assert int(aux.radii[row]) == 0, name
        assert not aux.v_means2d[row].any(), name
        assert_row_without_gradient(damaged, inputs, row, name)


@pytest.mark.parametrize("count", [0, 3])
def test_empty_scenes_show_the_background(random_scene, count):
    """No splats at all, and splats that are all behind the camera."""
    scene = random_scene(8, count=3, depths=(-6.0, -1.0)).rows(torch.arange(count))
    inputs = scene.inputs(torch.float32)
    background = torch.tensor([0.25, 0.5, 0.75])
    out = rasterize(**inputs, raw=True, background=background, **OPTIONS)
    assert torch.equal(out.rgb, background.expand(20, 24, 3))
    for picture in (out.alpha, out.inverse_depth, out.depth):
        assert not picture.any()
    out.rgb.sum().backward()
    for name in (*FIELDS, "viewmat"):
        assert not inputs[name].grad.any(), name


def test_skew_and_missing_degrees_are_refused(random_scene):
    inputs = random_scene(9, sh_degree=1).inputs(torch.float32)
    skewed = inputs["K"].clone()
    skewed[0, 1] = 0.1
    with pytest.raises(GsError, match="skew"):
        rasterize(**{**inputs, "K": skewed})
    with pytest.raises(GsError, match="degree"):
        rasterize(**inputs, sh_degree=2)


@pytest.mark.parametrize(
    ("quat", "drawn"),
    [
        ((0.0, 0.0, 1.001e-8, 0.0), True),
        ((0.0, -1.001e-8, 0.0, 0.0), True),
        ((0.0, 0.0, 0.999e-8, 0.0), False),
        ((0.9e-8, 0.9e-8, -0.9e-8, 0.9e-8), False),  # of length 1.8e-8
        ((0.0, 0.0, 0.0, 0.0), False),
    ],
)
def test_quaternions_are_long_enough_by_one_rule(one_splat, quat, drawn):
    """Oracle: the header (GS_QUAT_MIN: the largest component) for kernel, reference, strategies."""
    splat = one_splat() | {"quats": torch.tensor([quat], dtype=torch.float64)}
    out, _ = draw(splat)
    twin = reference.rasterize_reference(**splat, viewmat=torch.eye(4), K=K, width=16, height=12)
    found = [bool(picture.alpha.max() > 0) for picture in (out, twin)]
    assert [*found, not undirected(splat["quats"].float())[0]] == [drawn, drawn, drawn]
