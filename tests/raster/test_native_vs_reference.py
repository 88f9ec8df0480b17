"""Oracle: the float64 reference, for pictures and gradients of every instruction set."""

from functools import cache
from typing import NamedTuple

import pytest
import torch

from gscore.raster import reference
from gscore.raster.autograd import RasterAux, rasterize
from gscore.stress.truth import request_of

PARAMETERS = ("means", "quats", "scales", "opacities", "sh0", "shN", "viewmat")
PICTURES = ("rgb", "alpha", "inverse_depth", "depth")
BACKGROUND = torch.tensor([0.25, 0.5, 0.125])  # exact in float32

IMAGE_ERROR = 1e-5
"""Largest error of a pixel outside the boundary band, relative to the picture's largest value."""
FLIPPED = 1e-3
"""A pixel inside the band counts as flipped above this error."""
FLIP_RATE = 1e-3
"""Largest share of the pixels that may be flipped."""
GRADIENT_MEDIAN, GRADIENT_TAIL = 1e-5, 1e-3
"""Median and 99.9th percentile of |error| / |row of the true gradient|."""
ROW_FLOOR, NUMBER_FLOOR = 0.01, 0.1
"""Rows shorter than this share of the median row are given that length, rows of a single number
(the opacities) the second share. Their remaining error measures the cancellation in sums: plain
torch in float32 has the same tails on these rows."""

SCENES = {
    "plain": {"count": 600, "width": 64, "height": 48, "overscan": 0.1},
    "one pixel": {"count": 40, "width": 1, "height": 1, "overscan": 1.0},
    "one column": {"count": 60, "width": 1, "height": 37, "overscan": 0.3},
    "odd size, oblique camera": {
        "count": 200,
        "width": 17,
        "height": 33,
        "focal": (21.0, 33.0),
        "center": (3.25, 24.5),
        "sh_degree": 2,
    },
    "crowded": {
        "count": 2000,
        "width": 96,
        "height": 80,
        "focal": (90.0, 85.0),
        "sigma_px": (0.7, 4.0),
        "overscan": 0.05,
        "sh_degree": 1,
    },
    "needles": {
        "count": 300,
        "width": 64,
        "height": 48,
        "sigma_px": (0.02, 1.0),
        "elongation": 3.5,
        "logits": (0.0, 4.0),
        "sh_degree": 0,
    },
    "close by and off screen": {
        "count": 150,
        "width": 64,
        "height": 48,
        "depths": (0.03, 2.0),
        "overscan": 0.8,
        "sigma_px": (2.0, 25.0),
        "sh_degree": 1,
    },
    "opaque": {
        "count": 300,
        "width": 64,
        "height": 48,
        "logits": (2.0, 8.0),
        "sigma_px": (2.0, 8.0),
        "sh_degree": 0,
    },
    "dots": {
        "count": 1000,
        "width": 64,
        "height": 48,
        "sigma_px": (0.05, 0.7),
        "logits": (0.0, 4.0),
        "sh_degree": 1,
    },
    "degree 4": {"count": 300, "width": 64, "height": 48, "overscan": 0.1, "sh_degree": 4},
}
CASES = [
    (name, antialias)
    for name in SCENES
    for antialias in (False, True)
    if (name, antialias) != ("crowded", True)  # the slowest of all
]


class Truth(NamedTuple):
    """The reference's results for a scene."""

    pictures: dict[str, torch.Tensor]
    band: torch.Tensor
    weights: dict[str, torch.Tensor]
    gradients: dict[str, torch.Tensor]


def loss_of(pictures, weights):
    """The same random linear functional of all pictures, zero for pixels in the band."""
    return sum((pictures[name] * weights[name].to(pictures[name].dtype)).sum() for name in PICTURES)


def ask_reference(scene, *, antialias=False, near=0.01, far=1e10, far_depths=None, **options):
    """Pictures, band, loss weights and gradients of a scene in float64."""
    inputs = scene.inputs()
    asked = request_of(inputs, near=near, far=far, antialias=antialias, **{"raw": False, **options})
    splats = reference.project(*asked)
    splats.means2d.retain_grad()
    out = reference.composite(
        splats,
        scene.width,
        scene.height,
        background=BACKGROUND,
        far_depths=far_depths,
        inverse_depth=True,
        depth=True,
    )
    band = reference.boundary_band(*asked)
    rng = torch.Generator().manual_seed(5)
    pictures = {name: getattr(out, name) for name in PICTURES}
    weights = {}
    for name, picture in pictures.items():
        weights[name] = torch.randn(picture.shape, generator=rng)
        weights[name][band] = 0
    loss_of(pictures, weights).backward()
    v_means2d = torch.zeros(len(scene.means), 2, dtype=torch.float64)
    v_means2d[splats.index] = splats.means2d.grad
    gradients = {name: inputs[name].grad for name in PARAMETERS}
    return Truth(
        {name: picture.detach() for name, picture in pictures.items()},
        band,
        weights,
        {**gradients, "v_means2d": v_means2d},
    )


def ask_native(scene, truth, **options):
    """Pictures and gradients of the native kernels under the same loss."""
    inputs, aux = scene.inputs(torch.float32), RasterAux()
    out = rasterize(
        **inputs, background=BACKGROUND, inverse_depth=True, depth=True, aux=aux, **options
    )
    pictures = {name: getattr(out, name) for name in PICTURES}
    loss_of(pictures, truth.weights).backward()
    gradients = {name: inputs[name].grad for name in PARAMETERS}
    return (
        {name: picture.detach() for name, picture in pictures.items()},
        {**gradients, "v_means2d": aux.v_means2d},
        aux,
    )


@pytest.fixture(scope="module")
def draw(random_scene):
    """A scene of the table above."""
    return lambda name: random_scene(list(SCENES).index(name) + 1, **SCENES[name])


@pytest.fixture(scope="module")
def true_of(draw):
    """The reference's answer for a scene of the table, computed once for all instruction sets."""
    return cache(lambda name, **options: ask_reference(draw(name), **{"raw": True, **options}))


@pytest.fixture(scope="module")
def activated_truth(draw):
    """The reference's answer for activated parameters."""
    return ask_reference(draw("plain").activated(), raw=False)


@pytest.fixture(scope="module")
def slope(draw):
    """Far depths of a slope through the splats, and the reference's answer for them."""
    scene = draw("plain")
    far_depths = torch.linspace(2, 6, scene.width).expand(scene.height, -1).clone()
    far_depths[:, ::7] = torch.nan
    return far_depths, ask_reference(scene, raw=True, far_depths=far_depths)


def check_pictures(pictures, truth):
    """To rounding outside the band; inside, few pixels may flip."""
    assert truth.pictures["alpha"].mean() > 0.1
    assert truth.band.double().mean() < 0.1  # almost all pixels are compared closely
    for name, true in truth.pictures.items():
        error = (pictures[name].double() - true).abs() / true.abs().max().clamp(min=1)
        error = error.reshape(*truth.band.shape, -1).amax(2)
        assert error[~truth.band].max() <= IMAGE_ERROR, name
        assert (error > FLIPPED).sum() <= max(1, FLIP_RATE * error.numel()), name


def relative_to_rows(actual, true):
    """|error| / |row|, flat; rows that are zero in the truth must be zero, and are left out."""
    actual, true = (tensor.double().reshape(len(tensor), -1) for tensor in (actual, true))
    length = true.norm(dim=1)
    seen = length > 0
    assert not actual[~seen].any()
    floor = NUMBER_FLOOR if true.shape[1] == 1 else ROW_FLOOR
    length = length[seen].clamp(min=floor * float(length[seen].median()))
    return ((actual - true)[seen].abs() / length[:, None]).flatten()


def check_gradients(gradients, truth):
    """Median and tail of each class. The camera counts as one row."""
    for name, true in truth.gradients.items():
        if true.numel() == 0:
            continue  # no shN at degree 0
        assert true.any(), name
        actual = gradients[name]
        if name == "viewmat":
            actual, true = actual.reshape(1, 16), true.reshape(1, 16)
        error = relative_to_rows(actual, true)
        assert error.median() <= GRADIENT_MEDIAN, name
        assert error.quantile(0.999) <= GRADIENT_TAIL, name


@pytest.mark.parametrize(("name", "antialias"), CASES)
def test_pictures_and_gradients(draw, true_of, isa, name, antialias):
    truth = true_of(name, antialias=antialias)
    pictures, gradients, aux = ask_native(draw(name), truth, raw=True, antialias=antialias)
    check_pictures(pictures, truth)
    check_gradients(gradients, truth)
    drawn = truth.gradients["v_means2d"].any(1)
    assert (aux.radii[drawn] > 0).all()


def test_activated_parameters(draw, activated_truth, isa):
    scene, truth = draw("plain").activated(), activated_truth
    pictures, gradients, _ = ask_native(scene, truth, raw=False)
    check_pictures(pictures, truth)
    check_gradients(gradients, truth)


@pytest.mark.parametrize("sh_degree", [0, 1, 2])
def test_sh_degree_below_the_stored_one(draw, true_of, isa, sh_degree):
    truth = true_of("plain", sh_degree=sh_degree)
    if sh_degree == 0:
        truth = truth._replace(gradients=dict(truth.gradients))
        assert not truth.gradients.pop("shN").any()
    pictures, gradients, _ = ask_native(draw("plain"), truth, raw=True, sh_degree=sh_degree)
    check_pictures(pictures, truth)
    check_gradients(gradients, truth)
    assert not gradients["shN"][:, (sh_degree + 1) ** 2 - 1 :].any()


def test_clip_planes_and_low_pass(draw, true_of, isa):
    options = {"near": 2.5, "far": 4.75, "eps2d": 1.25}
    truth = true_of("plain", **options)
    culled = ~truth.gradients["v_means2d"].any(1)
    assert 0.2 < culled.double().mean() < 0.8
    pictures, gradients, _ = ask_native(draw("plain"), truth, raw=True, **options)
    check_pictures(pictures, truth)
    check_gradients(gradients, truth)


def test_pixels_that_end_at_depths_of_their_own(draw, true_of, slope, isa):
    """Pictures and gradients, for a slope through the splats, and for pixels without."""
    far_depths, truth = slope
    whole = true_of("plain", antialias=False).pictures["alpha"]
    hidden = (whole - truth.pictures["alpha"])[:, 1:4]
    assert (hidden > 0.1).double().mean() > 0.5
    assert torch.equal(truth.pictures["alpha"][:, ::7], whole[:, ::7])
    pictures, gradients, _ = ask_native(draw("plain"), truth, raw=True, far_depths=far_depths)
    check_pictures(pictures, truth)
    check_gradients(gradients, truth)
