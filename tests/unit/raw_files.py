"""TIFFs of several directories, and raw photos, by the tags of TIFF 6.0, TIFF/EP, DNG."""

import struct

import numpy as np

Tag = tuple[int, int, tuple[int, ...] | bytes]
"""Number, type and value: 1 bytes, 2 text, 3 short, 4 long, 5 ratio, 10 signed ratio."""
_LETTERS = {3: "H", 4: "I", 5: "I", 10: "i"}
_CHILDREN = 330
XYZ_TO_SRGB = (32405, -15371, -4985, -9693, 18760, 416, 556, -2040, 10572)
"""Ten-thousandths (IEC 61966-2-1): a camera with linear sRGB as its colour space."""


def directories(
    pages: list[tuple[list[Tag], np.ndarray, list[Tag], np.ndarray | None]],
    order: str,
    *,
    big: bool = False,
) -> bytes:
    """A TIFF, or a BigTIFF.

    Args:
        pages: For each its tags and pixels, and those of its sub-directory, or None.
        order: `<` or `>`.
        big: BigTIFF, with offsets of 8 bytes.
    """
    magic = struct.pack(order + "HHH", 43, 8, 0) if big else struct.pack(order + "H", 42)
    out = bytearray((b"II" if order == "<" else b"MM") + magic)
    link = len(out)
    out += bytes(8 if big else 4)
    for tags, pixels, below, inner in pages:
        more: list[Tag] = []
        if inner is not None:
            more = [(_CHILDREN, 4, (_directory(out, below, inner, order, big)[0],))]
        at, following = _directory(out, [*tags, *more], pixels, order, big)
        struct.pack_into(order + ("Q" if big else "I"), out, link, at)
        link = following
    return bytes(out)


def _directory(
    out: bytearray, tags: list[Tag], pixels: np.ndarray, order: str, big: bool
) -> tuple[int, int]:
    """Append pixels and their directory; return the offsets of it and of its link."""
    height, width = pixels.shape[:2]
    samples = 1 if pixels.ndim == 2 else 3
    data = pixels.astype(pixels.dtype.newbyteorder(order)).tobytes()
    strip = _put(out, data)
    whole = [
        *tags,
        (256, 4, (width,)),
        (257, 4, (height,)),
        (258, 3, (8 * pixels.dtype.itemsize,) * samples),
        (259, 3, (1,)),
        (273, 4, (strip,)),
        (277, 3, (samples,)),
        (278, 4, (height,)),
        (279, 4, (len(data),)),
    ]
    offset = order + ("Q" if big else "I")
    wide = struct.calcsize(offset)
    entries = []
    for number, kind, value in sorted(whole, key=lambda tag: tag[0]):
        if isinstance(value, bytes):
            raw, count = value, len(value)
        else:
            raw = struct.pack(f"{order}{len(value)}{_LETTERS[kind]}", *value)
            count = len(value) // (2 if kind in (5, 10) else 1)
        fits = len(raw) <= wide
        field = raw.ljust(wide, b"\0") if fits else struct.pack(offset, _put(out, raw))
        entries.append(struct.pack(f"{order}HH{offset[1]}", number, kind, count) + field)
    size = struct.pack(order + ("Q" if big else "H"), len(entries))
    at = _put(out, size + b"".join(entries) + bytes(wide))
    return at, len(out) - wide


def _put(out: bytearray, data: bytes) -> int:
    out += bytes(len(out) % 2)
    at = len(out)
    out += data
    return at


def page(
    pixels: np.ndarray, *, reduced: bool | None = None, old: bool = False
) -> tuple[list[Tag], np.ndarray, list[Tag], None]:
    """A colour picture; `reduced`: its NewSubfileType flag, None: no tag."""
    tags: list[Tag] = [(262, 3, (2,))]
    if reduced is not None:
        tags.append((255, 3, (2 if reduced else 1,)) if old else (254, 4, (int(reduced),)))
    return tags, pixels, [], None


def dng(
    mosaic: np.ndarray, preview: np.ndarray, *, order: str = "<", turn: int = 1, big: bool = False
) -> bytes:
    """A DNG as cameras write them: a preview, below it the mosaic (red, green, green, blue) of
    linear sRGB.

    Args:
        mosaic: [H, W] uint16.
        preview: [h, w, 3] uint8.
        order: `<` or `>`.
        turn: EXIF's orientation.
        big: A BigTIFF.
    """
    first: list[Tag] = [
        (254, 4, (1,)),
        (262, 3, (2,)),
        (271, 2, b"Maker\0"),
        (272, 2, b"Camera 1\0"),
        (274, 3, (turn,)),
        (50706, 1, bytes((1, 4, 0, 0))),
        (50707, 1, bytes((1, 1, 0, 0))),
        (50708, 2, b"Maker Camera 1\0"),
        (50721, 10, tuple(n for entry in XYZ_TO_SRGB for n in (entry, 10000))),
        (50728, 5, (1, 1, 1, 1, 1, 1)),
        (50778, 3, (21,)),
    ]
    raw: list[Tag] = [
        (254, 4, (0,)),
        (262, 3, (32803,)),
        (33421, 3, (2, 2)),
        (33422, 1, bytes((0, 1, 1, 2))),
        (50714, 3, (0,)),
        (50717, 4, (65535,)),
    ]
    return directories([(first, preview, raw, mosaic)], order, big=big)
