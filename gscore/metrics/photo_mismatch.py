"""Photo mismatch: detects splats evaluated on photos of another scene."""

STRANGERS_PSNR = 12.0
"""Decibels below which splats and photos are taken for those of different things. Previews of two
captures on the photos of three others each reach 8.3 to 11.1 dB, on their own held-out ones 16 and
more."""


def photo_mismatch_warnings(psnr: float | None, which: str) -> list[str]:
    """A sentence where splats hardly look like the photos; else nothing.

    Args:
        psnr: Of the photos, dB; None: it was not measured.
        which: Whose splats they are, to begin the sentence with.
    """
    if psnr is None or psnr >= STRANGERS_PSNR:
        return []
    return [
        f"{which} reach {psnr:.1f} dB on these photos, no more than pictures of something else do. "
        "Are they of this capture, in its own coordinates?"
    ]
