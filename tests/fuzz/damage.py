"""Damaged copies of a file, as hypothesis strategies: bits, cuts, repeats, false numbers, JSON."""

import copy
import json
import re
from typing import Any

from hypothesis import strategies as st

_NUMBERS = [0, 1, 2**15, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**60, 2**63 - 1, 2**64 - 1]
_TEXTS = [
    b"nan",
    b"inf",
    b"-1",
    b"1e999",
    b"99999999999999999999",
    b"9" * 400,
    b"9" * 5000,
    b"n" * 300,
    b"\xef\xbb\xbf",
    "\ncomment zu gro\u00df\n".encode(),
    b"\xff\xfe",
    b"\x00",
    b"../",
    b"e",
]
_VALUES: list[Any] = [
    None,
    True,
    False,
    0,
    -1,
    1e308,
    -1e-320,
    10**30,
    10**400,
    2**63,
    float("nan"),
    float("inf"),
    "",
    "..",
    "../../etc/passwd",
    "/etc/passwd",
    "C:\\windows\\x",
    "a\x00b",
    "\ud800",
    "n" * 300,
    "1",
    [],
    {},
    [[]],
    [None] * 3,
    {"a": {}},
    [[0.0] * 4] * 4,
]


@st.composite
def damaged(draw: st.DrawFn, good: bytes) -> bytes:
    """Some changes, one after the other."""
    raw = bytearray(good)
    for _ in range(draw(st.integers(1, 4))):
        if not raw:
            break
        at = draw(st.integers(0, len(raw) - 1))
        # The beginning has the sizes.
        at = draw(st.sampled_from([at, at % 64, at % 16]))
        kind = draw(
            st.sampled_from(["bit", "byte", "number", "text", "cut", "repeat", "drop", "noise"])
        )
        if kind == "bit":
            raw[at] ^= 1 << draw(st.integers(0, 7))
        elif kind == "byte":
            raw[at] = draw(st.integers(0, 255))
        elif kind == "number":
            size = draw(st.sampled_from([2, 4, 8]))
            order = draw(st.sampled_from(["little", "big"]))
            number = draw(st.sampled_from(_NUMBERS)) % 256**size
            raw[at : at + size] = number.to_bytes(size, order)
        elif kind == "text":
            raw[at:at] = draw(st.sampled_from(_TEXTS))
        elif kind == "cut":
            del raw[at:]
        elif kind == "repeat":
            raw[at:at] = raw[at : at + 64] * draw(st.integers(1, 30))
        elif kind == "drop":
            del raw[at : at + draw(st.integers(1, 40))]
        else:
            raw[at : at + 16] = draw(st.binary(min_size=1, max_size=16))
    return bytes(raw)


def _places(value: Any, path: tuple = ()) -> list[tuple]:
    found = [path]
    items = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    for key, child in items:
        found += _places(child, (*path, key))
    return found


@st.composite
def damaged_json(draw: st.DrawFn, good: bytes) -> bytes:
    """Values replaced, removed or buried deep; now and then plain damage."""
    if draw(st.integers(0, 3)) == 0:
        return draw(damaged(good))
    content = copy.deepcopy(json.loads(good))
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from(_places(content)))
        value = copy.deepcopy(draw(st.sampled_from(_VALUES)))
        if not path:
            content = value
            break
        parent = content
        for key in path[:-1]:
            parent = parent[key]
        if draw(st.integers(0, 4)) == 0:
            del parent[path[-1]]
        else:
            parent[path[-1]] = value
    text = json.dumps(content)
    kind = draw(st.integers(0, 20))
    if kind == 0:
        text = "[" * 100_000
    elif kind == 1:
        text = "\ufeff" + text
    elif kind == 2:
        text = re.sub(r"\d+", "9" * 5000, text, count=1)  # Python itself writes no such number
    return text.encode("utf-8", "surrogatepass")
