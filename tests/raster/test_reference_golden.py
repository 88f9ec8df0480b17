"""Oracle: golden values of gsplat's published formulas, computed in plain numpy."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

from gscore.raster import reference
from gscore.raster.request import Frustum, Settings
from gscore.stress.truth import request_of

FOLDER = Path(__file__).parent / "golden"
PARAMETERS = ("means", "quats", "scales", "opacities", "sh0", "shN", "viewmat", "K")


@pytest.fixture(scope="module")
def golden():
    with np.load(FOLDER / "gsplat_formulas.npz") as stored:
        return {name: stored[name] for name in stored}


@pytest.fixture(scope="module")
def inputs(golden):
    height, width = golden["alpha"].shape
    tensors = {name: torch.from_numpy(golden[f"in_{name}"]) for name in PARAMETERS}
    return {**tensors, "width": width, "height": height, "raw": True}


def test_the_stored_values_are_what_the_script_computes(golden):
    computed = runpy.run_path(str(FOLDER / "make_golden.py"))["compute"]()
    assert computed.keys() == golden.keys()
    for name, value in computed.items():
        assert np.allclose(value, golden[name], rtol=1e-12, atol=1e-13), name


def test_the_scene_is_worth_comparing(golden, inputs):
    """Covered, translucent, partly clamped, and without a pixel on a discontinuity."""
    assert 0.3 < golden["alpha"].mean() < 0.95
    assert golden["alpha"].max() < 0.999
    assert (golden["colors"] == 0).any()
    assert golden["compensations"].min() < 0.8
    slopes = (golden["means2d"] - golden["in_K"][:2, 2]) / golden["in_K"].diagonal()[:2]
    assert np.abs(slopes).max() > 0.65  # beyond the image plus 0.3 tan(fov/2)
    for antialias in (False, True):
        asked = request_of(inputs, antialias=antialias)
        assert not reference.boundary_band(*asked).any()


def test_projection_and_colors(golden, inputs):
    splats = reference.project(
        reference.SplatTensors(*(inputs[name] for name in PARAMETERS[:6])),
        Frustum(*(inputs[name] for name in ("viewmat", "K", "width", "height"))),
        Settings(antialias=True),
    )
    index = splats.index.numpy()
    assert sorted(index) == list(range(24))
    for name in ("means2d", "conics", "depths", "colors"):
        actual = getattr(splats, name).numpy()
        assert np.allclose(actual, golden[name][index], rtol=1e-9, atol=1e-12), name
    opacities = 1 / (1 + np.exp(-golden["in_opacities"])) * golden["compensations"]
    assert np.allclose(splats.opacities.numpy(), opacities[index], rtol=1e-9)


@pytest.mark.parametrize("suffix", ["", "_antialiased"])
def test_pictures(golden, inputs, suffix):
    out = reference.rasterize_reference(
        **inputs,
        background=torch.from_numpy(golden["in_background"]),
        antialias=bool(suffix),
        inverse_depth=True,
    )
    for name, picture in (
        ("image", out.rgb),
        ("alpha", out.alpha),
        ("inverse_depth", out.inverse_depth),
    ):
        assert np.abs(picture.numpy() - golden[name + suffix]).max() < 1e-9, name
