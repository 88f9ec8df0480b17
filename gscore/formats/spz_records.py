"""SPZ vendor records: a type, a length and that number of bytes.

Source: extensions/ of github.com/nianticlabs/spz. Only the record of the axes is used, because it
changes the meaning of the numbers; the default is right-up-back. Others are skipped.
"""

import logging
import struct
from pathlib import Path

import numpy as np

_RECORD = struct.Struct("<II")
_AXES = 0xADBE0003
"""Type of the record of the axes: one number, see `_axes_matrix`."""
_MOST_AXES, _USUAL = 16, 4

_log = logging.getLogger(__name__)


def placement(path: Path, records: memoryview) -> np.ndarray | None:
    """[4, 4] from a file's axes to right-down-front; None for the default axes. Skipped records are
    logged as warnings."""
    matrix = None
    while len(records) >= _RECORD.size:
        kind, size = _RECORD.unpack_from(records)
        content, records = records[_RECORD.size :][:size], records[_RECORD.size + size :]
        code = int.from_bytes(content, "little") if len(content) == 4 else 0
        if kind == _AXES and 0 < code <= _MOST_AXES:
            matrix = None if code == _USUAL else _axes_matrix(code)
            continue
        _log.warning("%s: its extension %#010x of %d bytes is not read.", path, kind, size)
    return matrix


def _axes_matrix(code: int) -> np.ndarray:
    """[4, 4] to right-down-front from the axes with this number. Bits of the number less one: 0: x
    is right, not left; 1: up, not down; 2: front, not back; 3: z is vertical, not y."""
    bits = code - 1
    vertical, forward = (2, 1) if bits & 8 else (1, 2)
    out = np.zeros((4, 4))
    out[0, 0] = 1 if bits & 1 else -1
    out[1, vertical] = -1 if bits & 2 else 1
    out[2, forward] = 1 if bits & 4 else -1
    out[3, 3] = 1
    return out
