"""Named metrics: one declaration each, for tables, tiles and definitions."""

from typing import NamedTuple


class NamedMetric(NamedTuple):
    """A metric of metrics.json and its presentation in the report."""

    key: str
    """Key in metrics.json."""
    title: str
    digits: int
    """Decimals in tables and tiles; definitions show one more."""
    unit: str = ""
    note: str = ""
    """Text below the value at the top of the report; empty: not shown there."""
    definition: str = ""
    """Text in the report's definitions; empty: not listed there."""
    averaged: bool = True
    """Whether there is a mean over the views."""


NAMED_METRICS = (
    NamedMetric(
        "psnr",
        "PSNR",
        2,
        unit="dB",
        note="higher is better",
        definition="dB, mean over the views of -10 log10 MSE of floats clamped to [0, 1]",
    ),
    NamedMetric(
        "psnr_u8",
        "PSNR 8 bit",
        2,
        definition="both pictures rounded to 8 bit first, equal to that of saved files",
    ),
    NamedMetric(
        "psnr_masked",
        "PSNR inside the masks",
        2,
        unit="dB",
        note="unmasked pixels only",
        definition="unmasked pixels only; the other metrics count masked pixels as equal, as the "
        "loss does",
    ),
    NamedMetric(
        "psnr_cc",
        "PSNR colour-corrected",
        2,
        unit="dB",
        note="without gain and offset of the colours",
        definition="after gain and offset per channel, fitted on one half of the picture and "
        "measured on the other, left and right in turn; unmasked pixels only. If it is far above "
        "the plain PSNR, exposure or white balance differs from photo to photo",
    ),
    NamedMetric("psnr_aligned", "PSNR from an aligned camera", 2, averaged=False),
    NamedMetric(
        "ssim",
        "SSIM",
        4,
        note="1 is identical",
        definition="11 \u00d7 11 window, sigma 1.5, zero padding: the convention of the 3DGS code",
    ),
    NamedMetric(
        "ssim_cc",
        "SSIM colour-corrected",
        4,
        definition="after gain and offset per channel, fitted to the whole picture; decides where "
        "exposure or white balance differs from photo to photo",
    ),
    NamedMetric(
        "ssim_valid",
        "SSIM valid",
        4,
        definition="the same window, only where it is inside the picture",
    ),
    NamedMetric("d_ssim", "D-SSIM", 4, note="(1 - SSIM) / 2"),
    NamedMetric(
        "ms_ssim",
        "MS-SSIM",
        4,
        note="five scales",
        definition="five scales, valid windows (Wang et al. 2003)",
    ),
    NamedMetric(
        "lpips",
        "LPIPS",
        4,
        note="net: {net}, lower is better",
        definition="network {net}, inputs in [-1, 1]; values of other networks cannot be compared",
    ),
    NamedMetric(
        "lpips_cc",
        "LPIPS colour-corrected",
        4,
        definition="network {net}, of the pictures of the colour-corrected SSIM",
    ),
    NamedMetric("coverage", "shown by two photos", 2, averaged=False),
)
"""All metrics in the order of tables. `{net}` is replaced by the network of LPIPS."""
