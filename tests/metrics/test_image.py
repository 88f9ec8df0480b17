"""PSNR, SSIM and MS-SSIM against scipy and torch in float64, closed forms and other programs."""

import math

import numpy as np
import pytest
import torch
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import convolve2d

from gscore.errors import ShapeError
from gscore.metrics import d_ssim, image_metrics, ms_ssim, psnr, psnr_u8, ssim
from gscore.metrics.image import MS_WEIGHTS
from gscore.metrics.named import NAMED_METRICS


def window_2d():
    """The 11 x 11 window as one array, not as two passes."""
    y, x = np.mgrid[-5:6, -5:6]
    window = np.exp(-(x**2 + y**2) / (2 * 1.5**2))
    return window / window.sum()


def ssim_by_convolution(a, b, mode):
    """Oracle: the formula of Wang et al. 2004 a channel at a time with scipy's 2D convolution."""
    window, means = window_2d(), []
    for c in range(3):
        x, y = a[..., c], b[..., c]
        mx, my, xx, yy, xy = (
            convolve2d(v, window, mode=mode, boundary="fill") for v in (x, y, x * x, y * y, x * y)
        )
        vx, vy, cov = xx - mx * mx, yy - my * my, xy - mx * my
        top = (2 * mx * my + 0.01**2) * (2 * cov + 0.03**2)
        means.append(np.mean(top / ((mx**2 + my**2 + 0.01**2) * (vx + vy + 0.03**2))))
    return np.mean(means)


def ms_ssim_by_windows(a, b):
    """Oracle: every window's weighted moments one by one, no filtering, no shared code."""
    window, channels = window_2d(), []
    for c in range(3):
        x, y, value = a[..., c], b[..., c], 1.0
        for scale in range(5):
            wx, wy = (sliding_window_view(v, (11, 11)) for v in (x, y))
            mx, my = (np.einsum("ijkl,kl->ij", w, window) for w in (wx, wy))
            dx, dy = wx - mx[..., None, None], wy - my[..., None, None]
            vx = np.einsum("ijkl,kl->ij", dx * dx, window)
            vy = np.einsum("ijkl,kl->ij", dy * dy, window)
            cov = np.einsum("ijkl,kl->ij", dx * dy, window)
            term = (2 * cov + 0.03**2) / (vx + vy + 0.03**2)
            if scale == 4:
                term = term * (2 * mx * my + 0.01**2) / (mx**2 + my**2 + 0.01**2)
            value *= max(0.0, term.mean()) ** MS_WEIGHTS[scale]
            x, y = (halved_pixel_by_pixel(v) for v in (x, y))
        channels.append(value)
    return np.mean(channels)


def halved_pixel_by_pixel(plane):
    height, width = plane.shape
    out = np.zeros(((height + 1) // 2, (width + 1) // 2))
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            rows = [2 * i, min(2 * i + 1, height - 1)]
            columns = [2 * j, min(2 * j + 1, width - 1)]
            out[i, j] = np.mean([plane[r, k] for r in rows for k in columns])
    return out


def checker(height, width):
    return np.repeat((np.indices((height, width)).sum(axis=0) % 2)[..., None], 3, axis=2) * 1.0


@pytest.fixture
def random_pair():
    rng = np.random.default_rng(7)
    a = rng.random((40, 53, 3))
    return a, np.clip(a + rng.normal(0, 0.2, a.shape), 0, 1)


@pytest.mark.parametrize("size", [(40, 53), (11, 11), (8, 8), (1, 30), (12, 400)])
def test_ssim_zero_padded_equals_scipy_2d(size):
    """Oracle: scipy.signal.convolve2d in float64."""
    rng = np.random.default_rng(1)
    a, b = rng.random((*size, 3)), rng.random((*size, 3))
    assert ssim(a, b) == pytest.approx(ssim_by_convolution(a, b, "same"), abs=1e-12)


def test_ssim_valid_equals_scipy_2d(random_pair):
    """Oracle: scipy.signal.convolve2d in float64."""
    want = ssim_by_convolution(*random_pair, "valid")
    assert ssim(*random_pair, padding="valid") == pytest.approx(want, abs=1e-12)


@pytest.mark.parametrize("other", ["random", "constant", "checker", "inverse"])
def test_ssim_equals_the_torch_form_of_the_3dgs_code(random_pair, other):
    """Oracle: torch's grouped convolution with padding 5 in float64, as 3DGS trainers write it."""
    a = random_pair[0]
    b = {
        "random": random_pair[1],
        "constant": np.full_like(a, 0.3),
        "checker": checker(*a.shape[:2]),
        "inverse": 1 - a,
    }[other]
    x, y = (torch.from_numpy(v).permute(2, 0, 1)[None] for v in (a, b))
    kernel = torch.from_numpy(window_2d())[None, None].repeat(3, 1, 1, 1)

    def blur(v):
        return torch.nn.functional.conv2d(v, kernel, padding=5, groups=3)

    mx, my = blur(x), blur(y)
    vx, vy, cov = blur(x * x) - mx * mx, blur(y * y) - my * my, blur(x * y) - mx * my
    top = (2 * mx * my + 0.01**2) * (2 * cov + 0.03**2)
    want = (top / ((mx**2 + my**2 + 0.01**2) * (vx + vy + 0.03**2))).mean().item()
    assert ssim(a, b) == pytest.approx(want, abs=1e-12)
    assert d_ssim(a, b) == pytest.approx((1 - want) / 2, abs=1e-12)


def test_constant_pictures_have_the_closed_form():
    """Oracle: SSIM of constants c, d is (2cd + C1) / (c^2 + d^2 + C1) where no window is cut."""
    a, b = np.full((170, 180, 3), 0.25), np.full((170, 180, 3), 0.75)
    want = (2 * 0.25 * 0.75 + 1e-4) / (0.25**2 + 0.75**2 + 1e-4)
    assert ssim(a, b, padding="valid") == pytest.approx(want, abs=1e-12)
    assert ms_ssim(a, b) == pytest.approx(want ** MS_WEIGHTS[-1], abs=1e-12)
    assert psnr(a, b) == pytest.approx(-10 * math.log10(0.25), abs=1e-12)


def test_identical_pictures_are_exactly_one_and_infinite(wave_pair):
    """Oracle: the definitions."""
    a = wave_pair(170, 171)[0]
    assert ssim(a, a) == pytest.approx(1.0, abs=1e-12)
    assert ssim(a, a, padding="valid") == pytest.approx(1.0, abs=1e-12)
    assert ms_ssim(a, a) == pytest.approx(1.0, abs=1e-12)
    assert psnr(a, a) == math.inf and psnr_u8(a, a) == math.inf
    values = image_metrics(a, a)
    assert values["psnr"] is None and "identical" in values["psnr_reason"]


@pytest.mark.parametrize("size", [(161, 161), (187, 202)])
def test_ms_ssim_equals_window_by_window(wave_pair, size):
    """Oracle: brute force over all windows at all scales, odd sizes included."""
    a, b = wave_pair(*size)
    assert ms_ssim(a, b) == pytest.approx(ms_ssim_by_windows(a, b), abs=1e-11)


def test_ms_ssim_of_an_inverted_picture_is_zero_not_complex():
    """Oracle: the negative mean of a negative correlation, which counts as 0."""
    a = np.random.default_rng(3).random((164, 170, 3))
    assert ms_ssim(a, 1 - a) == 0.0


def test_other_programs_agree(wave_pair):
    """Oracle: scikit-image 0.26.0 (SSIM), pytorch-msssim 1.0.0, torchmetrics 1.9.0 (PSNR)."""
    a, b = wave_pair(192, 224)
    assert ssim(a, b, padding="valid") == pytest.approx(0.7803804919944625, abs=1e-12)
    # pytorch-msssim stores its window in float32.
    assert ms_ssim(a, b) == pytest.approx(0.949907687050, abs=1e-6)
    assert psnr(a, b) == pytest.approx(24.1710, abs=5e-5)


def test_documented_example_of_torchmetrics():
    """Oracle: the values printed in torchmetrics' documentation: MS-SSIM 0.9627, SSIM 0.9219."""
    batch = torch.rand([3, 3, 256, 256], generator=torch.manual_seed(42)).permute(0, 2, 3, 1)
    assert np.mean([ms_ssim(x, 0.75 * x) for x in batch]) == pytest.approx(0.9627, abs=1e-4)
    values = [ssim(x, 0.75 * x, padding="valid") for x in batch]
    assert np.mean(values) == pytest.approx(0.9219, abs=1e-4)


def test_8_bit_rounding():
    """Oracle: 100.4 rounds to 100, 100.6 to 101 of 255 levels."""
    target = np.full((4, 5, 3), 100, np.uint8)
    assert psnr_u8(np.full((4, 5, 3), 100.4 / 255), target) == math.inf
    assert psnr(np.full((4, 5, 3), 100.4 / 255), target) == pytest.approx(
        20 * math.log10(255 / 0.4), abs=1e-9
    )
    assert psnr_u8(np.full((4, 5, 3), 100.6 / 255), target) == pytest.approx(
        20 * math.log10(255), abs=1e-9
    )


def test_values_outside_are_clamped_and_types_agree(random_pair):
    """Oracle: the same picture in another form."""
    a, b = random_pair
    wild = np.where(b >= 1, 7.5, np.where(b <= 0, -2.0, b))
    assert psnr(wild, a) == psnr(b, a)
    as_bytes = np.round(b * 255).astype(np.uint8)
    assert ssim(as_bytes, a) == ssim(as_bytes / 255.0, a)
    assert ssim(torch.from_numpy(b).float().requires_grad_(), a) == pytest.approx(
        ssim(b, a), abs=1e-6
    )


def test_one_filtering_gives_the_same_as_the_single_metrics(wave_pair):
    """Oracle: the single functions, each checked above."""
    a, b = wave_pair(165, 190)
    values = image_metrics(a, b)
    assert values["psnr"] == psnr(a, b) and values["psnr_u8"] == psnr_u8(a, b)
    assert values["ssim"] == ssim(a, b) and values["d_ssim"] == d_ssim(a, b)
    assert values["ssim_valid"] == ssim(a, b, padding="valid")
    assert values["ms_ssim"] == ms_ssim(a, b)


def test_mask_counts_as_in_the_loss(random_pair):
    """Oracle: both pictures multiplied by hand; the masked PSNR over the kept pixels alone."""
    a, b = random_pair
    mask = np.zeros((40, 53), np.uint8)
    mask[:, :20] = 255
    values = image_metrics(a, b, mask=mask)
    keep = (mask / 255)[..., None]
    assert values["psnr"] == pytest.approx(psnr(a * keep, b * keep), abs=1e-12)
    assert values["ssim"] == pytest.approx(ssim(a * keep, b * keep), abs=1e-12)
    assert values["psnr_masked"] == pytest.approx(psnr(a[:, :20], b[:, :20]), abs=1e-9)
    changed = b.copy()
    changed[:, 20:] = 0.5
    assert image_metrics(a, changed, mask=mask) == values


def test_soft_and_empty_masks(random_pair):
    """Oracle: a mask of one grey scales both errors and weights, which cancels in psnr_masked."""
    a, b = random_pair
    values = image_metrics(a, b, mask=np.full((40, 53), 0.5))
    assert values["psnr_masked"] == pytest.approx(psnr(a, b), abs=1e-9)
    assert values["psnr"] == pytest.approx(psnr(a, b) + 20 * math.log10(2), abs=1e-9)
    empty = image_metrics(a, b, mask=np.zeros((40, 53), np.uint8))
    assert empty["psnr_masked"] is None and "no pixel" in empty["psnr_masked_reason"]


def test_small_images_give_null_with_a_reason(random_pair):
    """Oracle: 5 scales of an 11-pixel window need 161 pixels."""
    values = image_metrics(*random_pair)
    assert values["ms_ssim"] is None
    assert values["ms_ssim_reason"] == "needs 161 x 161 pixels, the picture is 53 x 40 pixels"
    tiny = image_metrics(random_pair[0][:8], random_pair[1][:8])
    assert tiny["ssim_valid"] is None and "11 x 11" in tiny["ssim_valid_reason"]
    assert tiny["ssim"] is not None


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        (np.zeros((40, 53)), r"image must be \[H, W, 3\], got \[40, 53\]"),
        (np.zeros((0, 53, 3)), r"got \[0, 53, 3\]"),
        (np.zeros((40, 53, 3), np.int64), "floating point or uint8, got int64"),
        (np.zeros((41, 53, 3)), "the same size"),
        (np.full((40, 53, 3), np.nan), "6360 values that are not finite"),
    ],
)
def test_bad_pictures_are_refused(random_pair, bad, says):
    """Oracle: the error, with the fault."""
    for metric in (psnr, psnr_u8, ssim, image_metrics):
        with pytest.raises(ShapeError, match=says):
            metric(bad, random_pair[1])


def test_sizes_and_masks_that_cannot_work_are_refused(random_pair):
    """Oracle: the error, with the requirement."""
    with pytest.raises(ShapeError, match="at least 161 x 161 pixels, got 53 x 40"):
        ms_ssim(*random_pair)
    with pytest.raises(ShapeError, match="at least 11 x 11"):
        ssim(random_pair[0][:10], random_pair[1][:10], padding="valid")
    with pytest.raises(ShapeError, match=r"mask must be \[40, 53\], got \[53, 40\]"):
        image_metrics(*random_pair, mask=np.ones((53, 40)))


def test_every_metric_is_declared(wave_pair):
    """Oracle: the keys of `image_metrics`; tables would omit an undeclared one."""
    pair = wave_pair(180, 200)
    mask = np.full((180, 200), 255, np.uint8)
    mask[:20] = 0
    found = {key for key in image_metrics(*pair, mask=mask) if "_reason" not in key}
    assert found == {m.key for m in NAMED_METRICS if m.averaged} - {"lpips", "lpips_cc"}
