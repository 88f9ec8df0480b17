"""TIFF files of kinds that Pillow cannot write: any byte order, sample format and meaning of 0."""

import struct

import numpy as np


def tiff(values: np.ndarray, *, photometric: int = 1, stated_bytes: int | None = None) -> bytes:
    """An uncompressed TIFF of one strip (TIFF 6.0).

    Args:
        values: [H, W] grey or [H, W, 3] numbers, in the byte order of their dtype.
        photometric: 0: zero is white, 1: zero is black, 2: RGB.
        stated_bytes: Size of the strip stated in the file; None: the true one.
    """
    order = ">" if values.dtype.byteorder == ">" else "<"
    height, width = values.shape[:2]
    samples = 1 if values.ndim == 2 else values.shape[2]
    data = values.tobytes()
    kind = {"u": 1, "i": 2, "f": 3}[values.dtype.kind]
    per_sample_at = 8 + len(data)
    more = b"".join(
        struct.pack(f"{order}{samples}H", *[number] * samples)
        for number in (8 * values.dtype.itemsize, kind)
    )
    at = per_sample_at + len(more)

    def entry(tag: int, type_: int, count: int, value: int) -> bytes:
        short = type_ == 3 and count == 1
        return struct.pack(
            order + ("HHIHH" if short else "HHII"), tag, type_, count, value, *([0] * short)
        )

    def each(tag: int, value: int, place: int) -> bytes:
        return entry(tag, 3, samples, value if samples == 1 else per_sample_at + place)

    entries = [
        entry(256, 4, 1, width),
        entry(257, 4, 1, height),
        each(258, 8 * values.dtype.itemsize, 0),
        entry(259, 3, 1, 1),
        entry(262, 3, 1, photometric),
        entry(273, 4, 1, 8),
        entry(277, 3, 1, samples),
        entry(278, 4, 1, height),
        entry(279, 4, 1, len(data) if stated_bytes is None else stated_bytes),
        each(339, kind, 2 * samples),
    ]
    head = (b"MM\0*" if order == ">" else b"II*\0") + struct.pack(order + "I", at)
    directory = struct.pack(order + "H", len(entries)) + b"".join(entries) + bytes(4)
    return head + data + more + directory
