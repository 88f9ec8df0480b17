"""Colour-corrected PSNR; oracles: numpy's least squares per channel and half, and exact cases."""

import math

import numpy as np
import pytest

from gscore.metrics import evaluate, image_metrics, psnr, psnr_cc, ssim
from gscore.metrics.colour_fit import fit_colours
from gscore.metrics.image import colour_corrected


def twin(image, target, weight):
    """The definition, slowly: halves by a search, fits by `lstsq`, errors pixel by pixel."""
    width = image.shape[1]
    columns = weight.sum(axis=0)
    middle = min(range(1, width), key=lambda m: abs(columns[:m].sum() - columns[m:].sum()))
    halves, total = (range(middle), range(middle, width)), 0.0
    for fitted, evaluated in (halves, halves[::-1]):
        root = np.sqrt(weight[:, fitted].ravel())
        for c in range(3):
            known = image[:, fitted, c].ravel()
            design = np.stack([known, np.ones_like(known)], axis=1) * root[:, None]
            (gain, offset), *_ = np.linalg.lstsq(
                design, target[:, fitted, c].ravel() * root, rcond=None
            )
            for x in evaluated:
                for y in range(image.shape[0]):
                    value = min(max(image[y, x, c] * gain + offset, 0.0), 1.0)
                    total += weight[y, x] * (value - target[y, x, c]) ** 2
    return -10 * math.log10(total / (3 * weight.sum()))


@pytest.mark.parametrize("width", [21, 30])
def test_equals_least_squares_of_numpy(wave_pair, width):
    """Oracle: `lstsq` in float64, with a soft mask, and without one."""
    image, target = wave_pair(24, width)
    mask = np.random.default_rng(3).uniform(0, 1, (24, width)) ** 3
    mask[:, : width // 3] = 0
    assert psnr_cc(image, target) == pytest.approx(twin(image, target, np.ones((24, width))))
    assert psnr_cc(image, target, mask=mask) == pytest.approx(twin(image, target, mask))
    values = image_metrics(image, target, mask=np.ones((24, width), np.uint8) * 255)
    assert values["psnr_cc"] == pytest.approx(psnr_cc(image, target))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_gain_and_offset_of_the_picture_do_not_count(wave_pair, dtype):
    """Oracle: the same picture before and after another gain and offset per channel, unclipped."""
    image, target = wave_pair(40, 53)
    changed = image * [0.7, 0.4, 0.9] + [0.2, 0.05, 0.0]
    assert changed.min() >= 0 and changed.max() <= 1
    found = psnr_cc(changed.astype(dtype), target)
    assert found == pytest.approx(psnr_cc(image, target), abs=1e-9 if dtype == np.float64 else 1e-4)
    assert psnr(changed, target) < psnr(image, target) - 3


def test_pure_gain_and_offset_gives_null(wave_pair):
    """Oracle: null with the reason of its kind, for an identical picture too."""
    _, target = wave_pair(40, 53)
    for image in (target, target * [0.7, 0.4, 0.9] + [0.2, 0.05, 0.0]):
        assert psnr_cc(image, target) == math.inf
        values = image_metrics(image, target)
        assert values["psnr_cc"] is None and values["psnr_cc_reason"].startswith("infinite: ")
    single = image_metrics(target * 0.9, target)  # float64: only rounding is left
    assert single["psnr"] is not None and single["psnr_cc"] is None


def test_the_corrected_picture_is_clamped_like_the_others():
    """Oracle: by hand. The fit gives 1.2 and -0.2 where the photo is white and black."""
    target = np.zeros((1, 4, 3))
    target[0, :, :] = np.array([0.4, 0.6, 1.0, 0.0])[:, None]
    image = np.zeros_like(target)
    image[0, :, :] = np.array([0.45, 0.55, 0.85, 0.15])[:, None]  # left: gain 2, offset -0.5
    # Right, corrected: 1.2 and -0.2, clamped to the photo's 1 and 0. Left, corrected by the right
    # half's gain 1 / 0.7: 0.5 -+ 0.05 / 0.7.
    wrong = 0.1 - 0.05 / 0.7
    assert psnr_cc(image, target) == pytest.approx(-10 * math.log10(2 * wrong**2 / 4))


def test_pixels_outside_the_mask_are_nothing(wave_pair):
    """Oracle: the picture cut to the mask, which is off the middle, for any content outside."""
    image, target = wave_pair(40, 60)
    mask = np.zeros((40, 60), np.uint8)
    mask[5:30, 41:] = 255
    image[mask == 0] = np.random.default_rng(1).uniform(0, 1, (int((mask == 0).sum()), 3))
    cut = psnr_cc(image[5:30, 41:], target[5:30, 41:])
    assert psnr_cc(image, target, mask=mask) == pytest.approx(cut, abs=1e-9)


def test_a_fit_never_loses_on_its_own_pixels():
    """Oracle: squared errors of random pictures before and after; flat and opposite ones too."""
    rng = np.random.default_rng(7)
    for kind in ("random", "flat", "opposite", "nearly flat"):
        for _ in range(20):
            target = rng.uniform(0, 1, (6, 7, 3))
            image = {
                "random": rng.uniform(0, 1, (6, 7, 3)),
                "flat": np.full((6, 7, 3), rng.uniform()),
                "opposite": 1 - target,
                "nearly flat": 0.5 + rng.uniform(-1e-3, 1e-3, (6, 7, 3)),
            }[kind]
            weight = rng.uniform(0, 1, (6, 7, 1))
            planes = [x.transpose(2, 0, 1) for x in (image, target)]
            gain, offset = fit_colours(*planes, weight[..., 0])
            before = (weight * (image - target) ** 2).sum(axis=(0, 1))
            after = (weight * (image * gain + offset - target) ** 2).sum(axis=(0, 1))
            assert (after <= before + 1e-12).all() and (gain >= 0).all(), kind
            assert ("flat" not in kind) or (gain == 1).all()


@pytest.mark.parametrize("masked", [False, True])
def test_structure_is_measured_of_the_corrected_picture(fake_dataset, wave_pair, masked):
    """Oracle: SSIM and a fake LPIPS of the picture corrected by numpy's `lstsq` over its unmasked
    pixels; another exposure of the render changes neither."""
    image, target = wave_pair(40, 60)
    mask = np.full((40, 60), 255, np.uint8)
    mask[:, :20] = 0 if masked else 255
    weight = mask[:, :, None] / 255
    corrected = np.empty_like(image)
    for c in range(3):
        known = image[..., c][mask > 0]
        design = np.stack([known, np.ones_like(known)], axis=1)
        (gain, offset), *_ = np.linalg.lstsq(design, target[..., c][mask > 0], rcond=None)
        corrected[..., c] = np.clip(gain * image[..., c] + offset, 0, 1)
    assert colour_corrected(image, target, mask=mask) == pytest.approx(corrected)
    want = ssim(corrected * weight, target * weight)
    assert image_metrics(image, target, mask=mask)["ssim_cc"] == pytest.approx(want)
    darker = image * [0.7, 0.4, 0.9] + [0.2, 0.05, 0.0]
    found = image_metrics(darker, target, mask=mask)
    assert found["ssim_cc"] == pytest.approx(want) and found["ssim"] < found["ssim_cc"] - 0.01

    def network(a, b):
        return float(np.abs(a - b).mean())

    network.key, network.net = "lpips_fake", "fake"
    data = fake_dataset([np.rint(target * 255).astype(np.uint8)], [mask], "ignore")
    mean = evaluate(lambda i: darker, data, [0], lpips=network).mean
    assert mean["lpips_cc"] == pytest.approx(network(corrected * weight, target * weight), abs=4e-3)
    assert mean["lpips"] == mean["lpips_fake"] > mean["lpips_cc"] + 0.01


def test_a_masked_view_keeps_its_colours():
    """Oracle: the picture itself, as no pixel counts."""
    image, target = np.random.default_rng(0).uniform(0, 1, (2, 12, 12, 3))
    empty = np.zeros((12, 12), np.uint8)
    np.testing.assert_array_equal(colour_corrected(image, target, mask=empty), image)
    assert image_metrics(image, target, mask=empty)["ssim_cc"] == pytest.approx(1)


def test_a_flat_half_does_not_spoil_the_other(wave_pair):
    """Oracle: a sky of noise below one 8-bit level next to a correct scene; the sky's own fit would
    multiply the scene's contrast by hundreds or by zero."""
    _, target = wave_pair(40, 60)
    rng = np.random.default_rng(2)
    target[:, :30] = 0.8
    image = target.copy()
    image[:, :30] += rng.normal(0, 2e-4, (40, 30, 1))
    target = target + rng.normal(0, 4e-3, target.shape)
    assert psnr_cc(image, target) == pytest.approx(psnr(image, target), abs=0.2)


def test_views_without_two_halves_give_null(fake_dataset):
    """Oracle: null with a reason; a mean without the view that a mask hides entirely."""
    rng = np.random.default_rng(0)
    image, target = rng.uniform(0, 1, (2, 9, 12, 3))
    narrow = np.zeros((9, 12), np.uint8)
    narrow[:, 4] = 255
    assert math.isnan(psnr_cc(image, target, mask=narrow))
    assert "one column" in image_metrics(image, target, mask=narrow)["psnr_cc_reason"]
    assert "one column" in image_metrics(image[:, :1], target[:, :1])["psnr_cc_reason"]
    empty = image_metrics(image, target, mask=np.zeros((9, 12), np.uint8))
    assert empty["psnr_cc"] is None and "no pixel" in empty["psnr_cc_reason"]
    uneven = np.zeros((9, 12), np.uint8)
    uneven[:, 2], uneven[:, 8] = 1, 255
    assert math.isfinite(psnr_cc(image, target, mask=uneven))
    photos = [(target * 255).astype(np.uint8)] * 2
    masks = [np.zeros((9, 12), np.uint8), None]
    mean = evaluate(lambda i: image, fake_dataset(photos, masks, "ignore"), range(2)).mean
    assert mean["psnr_cc"] == pytest.approx(psnr_cc(image, photos[1]))
