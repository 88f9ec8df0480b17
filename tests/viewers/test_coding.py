"""Parameters as viewers store them. Oracle: decoders of the stored integers, written here."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from gscore.errors import ConfigError
from gscore.morton import morton_order
from gscore.shared_constants import SH_C0
from gscore.viewers.coding import rounded, stored
from gscore.viewers.rules import VIEWERS, rules_of


@pytest.fixture
def splats(splats):
    """The same in float64, so that no value is at a tie of float32."""
    return type(splats)(*(field.double() for field in splats))


def numbers(tensor):
    return tensor.double().numpy()


def test_spark_stores_bytes(splats):
    """Oracle: float_to_u8, encode_scale8 and encode_sh of Spark's encoder and their decoders."""
    found = stored(splats, rules_of("spark"))
    rgb = np.round(np.clip((0.5 + SH_C0 * numbers(splats.sh0)) * 255, 0, 255)) / 255
    np.testing.assert_allclose(0.5 + SH_C0 * numbers(found.sh0), rgb, atol=1e-5)
    code = 1 + np.round(np.clip((numbers(splats.scales) + 12) / 21, 0, 1) * 254)
    np.testing.assert_allclose(
        numbers(found.scales), np.exp(-12 + (code - 1) * 21 / 254), rtol=1e-4
    )
    alpha = np.round(255 / (1 + np.exp(-numbers(splats.opacities)))) / 255
    np.testing.assert_allclose(numbers(found.opacities), alpha, atol=1e-6)
    for band, most in ((slice(0, 3), 63), (slice(3, 8), 127), (slice(8, 15), 31)):
        code = np.round(np.clip(numbers(splats.shN)[:, band] * most, -most, most))
        np.testing.assert_allclose(numbers(found.shN)[:, band], code / most, atol=1e-6)
    np.testing.assert_array_equal(found.means, splats.means.half().double())


def test_blender_stores_bytes_over_the_range_of_the_model(splats):
    """Oracle: integers over the range of each channel; zero error at both ends."""
    found = stored(splats, rules_of("blender"))
    given, got = numbers(splats.shN), numbers(found.shN)
    for channel in range(3):
        low, high = given[..., channel].min(), given[..., channel].max()
        code = (got[..., channel] - low) / (high - low) * 255
        np.testing.assert_allclose(code, np.round(code), atol=1e-3)
        assert np.abs(got - given)[..., channel].max() <= (high - low) / 255 / 2 + 1e-6
        assert got[..., channel].min() == pytest.approx(low, abs=1e-6)
        assert got[..., channel].max() == pytest.approx(high, abs=1e-6)
    logs = np.log(numbers(found.scales))
    assert 0 < np.abs(logs - numbers(splats.scales)).max() <= np.ptp(logs) / 510 / 2 + 1e-5


def test_supersplat_stores_a_range_for_each_splat(splats):
    """Oracle: unpack111011s with the splat's largest coefficient."""
    given, found = numbers(splats.shN), numbers(stored(splats, rules_of("supersplat")).shN)
    largest = np.abs(given).max(axis=(1, 2), keepdims=True)
    steps = np.array([2047, 1023, 2047])
    code = np.round((given / largest * 0.5 + 0.5) * steps)
    np.testing.assert_allclose(found, (code / steps * 2 - 1) * largest, atol=1e-6)


def test_unity_stores_ranges_of_chunks(splats):
    """Oracle: the ranges of 256 splats in Morton order, an eighth root and InvSquareCentered01."""
    many = type(splats)(*(torch.cat([f] * 10) for f in splats))
    many = many._replace(scales=many.scales + torch.linspace(0, 1, 400).double()[:, None])
    found = stored(many, rules_of("unity"))
    order = morton_order(many.means.numpy())
    for chunk in (order[:256], order[256:]):
        roots = np.exp(numbers(many.scales)[chunk] / 8)
        low, high = roots.min(0), roots.max(0)
        steps = np.array([2047, 1023, 2047])
        decoded = low + np.round((roots - low) / (high - low) * steps) / steps * (high - low)
        np.testing.assert_allclose(numbers(found.scales)[chunk], decoded**8, rtol=1e-4)
        x = 1 / (1 + np.exp(-numbers(many.opacities)[chunk])) - 0.5
        squares = 0.5 + 2 * x * np.abs(x)
        low, high = squares.min(), squares.max()
        code = low + np.round((squares - low) / (high - low) * 255) / 255 * (high - low)
        back = (code - 0.5) / 2
        opacities = 0.5 + np.sign(back) * np.sqrt(np.abs(back))
        np.testing.assert_allclose(numbers(found.opacities)[chunk], opacities, atol=2e-4)


@pytest.mark.parametrize("name", VIEWERS)
def test_what_is_stored_is_stored_unchanged(name, splats):
    """Oracle: the decoded splats, stored again."""
    rules = replace(rules_of(name), means=None)
    once = stored(splats, rules)
    raw = once._replace(scales=once.scales.log(), opacities=torch.logit(once.opacities))
    for first, second in zip(once, stored(raw, rules), strict=True):
        torch.testing.assert_close(first, second, rtol=2e-4, atol=2e-4)


def test_rounding_passes_gradients():
    """Oracle: the gradient of the identity."""
    values = torch.tensor([0.2, 0.7], requires_grad=True)
    found = rounded(values, 2.0)
    np.testing.assert_array_equal(found.detach(), [0.0, 0.5])
    found.sum().backward()
    np.testing.assert_array_equal(values.grad, [1, 1])


def test_degrees_above_three_are_left_out(splats):
    """Oracle: the first 15 coefficients."""
    more = splats._replace(shN=torch.cat([splats.shN, splats.shN[:, :9] + 5], 1))
    for name in VIEWERS:
        torch.testing.assert_close(
            stored(more, rules_of(name)).shN, stored(splats, rules_of(name)).shN
        )


def test_an_unknown_viewer_is_a_sentence():
    """Oracle: the names of the table."""
    with pytest.raises(ConfigError, match=r"no viewer 'sibr'.*blender.*unreal"):
        rules_of("sibr")


def test_every_rule_has_a_source():
    """Oracle: a file name in each; finite numbers."""
    for rules in VIEWERS.values():
        assert any(end in rules.source for end in (".glsl", ".hh", ".ts", ".usf", ".h ", ".cs"))
        assert rules.eps2d > 0 and math.isfinite(rules.widening)
