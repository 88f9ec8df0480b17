"""Photo mismatch: detects splats evaluated on photos of another scene."""

MISMATCH_PSNR = 12.0
"""PSNR in dB below which splats and photos are considered to be of different scenes. Previews of
two
captures reach 8.3 to 11.1 dB on photos of three others each, and at least 16 dB on their own
held-out photos."""


def photo_mismatch_warnings(psnr: float | None, which: str) -> list[str]:
    """Warning if splats do not match the photos; else empty.

    Args:
        psnr: PSNR on the photos, dB; None: not measured.
        which: Subject of the sentence, naming the splats, in the plural.
    """
    if psnr is None or psnr >= MISMATCH_PSNR:
        return []
    return [
        f"{which} reach {psnr:.1f} dB on these photos, no more than pictures of another scene. Are "
        "they of this capture, in its own coordinates?"
    ]
