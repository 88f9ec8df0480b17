"""Random numbers, the definition: Philox 4x32-10 (Salmon et al. 2011) and Box and Muller (1958)."""

import math

import numpy as np

from ...shared_constants import PHILOX_M0, PHILOX_M1, PHILOX_ROUNDS, PHILOX_W0, PHILOX_W1

_WORD = 0xFFFFFFFF


def philox(counter: np.ndarray, key: np.ndarray) -> np.ndarray:
    """Return the words, [..., 4] uint32, of counters [..., 4] and keys [..., 2], uint32."""
    a, b, c, d = np.moveaxis(counter.astype(np.uint64), -1, 0)
    first, second = np.moveaxis(key.astype(np.uint64), -1, 0)
    for _ in range(PHILOX_ROUNDS):
        left, right = PHILOX_M0 * a, PHILOX_M1 * c
        a, b = (right >> 32) ^ b ^ first, right & _WORD
        c, d = (left >> 32) ^ d ^ second, left & _WORD
        first, second = (first + PHILOX_W0) & _WORD, (second + PHILOX_W1) & _WORD
    return np.stack([a, b, c, d], axis=-1).astype(np.uint32)


def row_words(rows: np.ndarray, *, seed: int, step: int, stream: int) -> np.ndarray:
    """Return the words, [M, 4] uint32, of rows [M]: their counters are (row, step, stream, 0), the
    key is the low and the high half of the seed."""
    counter = np.zeros((len(rows), 4), np.uint32)
    counter[:, 0], counter[:, 1], counter[:, 2] = rows, step, stream
    return philox(counter, np.array([seed & _WORD, seed >> 32], np.uint32))


def uniform(words: np.ndarray) -> np.ndarray:
    """Return [M] float32 in [0, 1) of words [M, 4]: the upper 24 bits of word 0; exact."""
    return (words[:, 0] >> 8).astype(np.float32) * np.float32(2**-24)


def normal(words: tuple[int, ...]) -> tuple[float, float, float]:
    """Return three normal numbers of the four words of a row, in double precision."""
    (x, y), (z, _) = (_pair(*words[k : k + 2]) for k in (0, 2))
    return x, y, z


def _pair(length: int, angle: int) -> tuple[float, float]:
    radius = math.sqrt(-2 * math.log(((length >> 8) + 1) / 2**24))
    fraction = ((angle >> 6) % 2**24) / 2**24 - 0.5
    turned = math.pi / 2 * ((angle >> 30) + fraction)
    return radius * math.cos(turned), radius * math.sin(turned)
