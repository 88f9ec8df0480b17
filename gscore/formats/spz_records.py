"""SPZ vendor records: a type, a length and that number of bytes.

Source: extensions/ of github.com/nianticlabs/spz. One of them changes what the numbers mean: the
axes in which a file stands, right-up-back unless it says otherwise. Others are passed over.
"""

import logging
import struct
from pathlib import Path

import numpy as np

_RECORD = struct.Struct("<II")
_AXES = 0xADBE0003
"""The record of the axes: one number, of `_axes_matrix`."""
_MOST_AXES, _USUAL = 16, 4

_log = logging.getLogger(__name__)


def placement(path: Path, records: memoryview) -> np.ndarray | None:
    """[4, 4] from a file's axes to right-down-front, None where they are the usual ones; a record
    that is not taken is logged as a warning."""
    found = None
    while len(records) >= _RECORD.size:
        kind, size = _RECORD.unpack_from(records)
        content, records = records[_RECORD.size :][:size], records[_RECORD.size + size :]
        code = int.from_bytes(content, "little") if len(content) == 4 else 0
        if kind == _AXES and 0 < code <= _MOST_AXES:
            found = None if code == _USUAL else _axes_matrix(code)
            continue
        _log.warning("%s: its extension %#010x of %d bytes is not read.", path, kind, size)
    return found


def _axes_matrix(code: int) -> np.ndarray:
    """[4, 4] to right-down-front from the axes with this number, less one: bit 0 says that x is
    right and not left, 1 up and not down, 2 front and not back, 3 that z is vertical and not y."""
    bits = code - 1
    vertical, forward = (2, 1) if bits & 8 else (1, 2)
    out = np.zeros((4, 4))
    out[0, 0] = 1 if bits & 1 else -1
    out[1, vertical] = -1 if bits & 2 else 1
    out[2, forward] = 1 if bits & 4 else -1
    out[3, 3] = 1
    return out
