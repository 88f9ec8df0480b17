"""Damaged copies of a file drawn by a generator, for attacks by the million."""

import random

_NUMBERS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0x7FFFFFFF, 0xFFFFFFFF, 2**40, 2**63 - 1, 2**64 - 1)
_TEXTS = (b"nan", b"-1", b"1e999", b"9" * 400, b"[", b"{", b'"', b"../", b"\0", b"null", b"true")


def damaged(good: bytes, rng: random.Random) -> bytes:
    """Several changes one after the other, most of them at sizes."""
    raw = bytearray(good)
    for _ in range(rng.randint(1, 4)):
        if not raw:
            break
        at = rng.randrange(len(raw))
        at = rng.choice((at, at, at % 64, at % 16))
        kind = rng.randrange(8)
        if kind < 2:
            raw[at] ^= 1 << rng.randrange(8)
        elif kind == 2:
            raw[at] = rng.randrange(256)
        elif kind == 3:
            size = rng.choice((2, 4, 8))
            raw[at : at + size] = (rng.choice(_NUMBERS) % 256**size).to_bytes(size, "little")
        elif kind == 4:
            raw[at:at] = rng.choice(_TEXTS)
        elif kind == 5:
            del raw[at:]
        elif kind == 6:
            del raw[at : at + rng.randint(1, 40)]
        else:
            raw[at : at + 16] = rng.randbytes(16)
    return bytes(raw)
