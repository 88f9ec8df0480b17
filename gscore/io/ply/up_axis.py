"""Up axis of a splat PLY, from a comment in its header."""

import re
from collections.abc import Iterable

UP_NOTE = "gscore up "
"""Begins gscore's own comment, which an axis follows: X, Y, Z, or one of them after a minus."""
_VERTICAL = re.compile(r"vertical axis:\s*([+-]?)([xyz])\b", re.IGNORECASE)
"""Of nerfstudio and Brush. Brush writes y whatever its axes are, and -Y, the usual axis, is one
along y too: without a sign y states nothing."""


def stated_up(comments: Iterable[str]) -> str:
    """The axis, as X or -Y, that the comments state to point up; empty: none."""
    lines = list(comments)
    for line in lines:
        if line.startswith(UP_NOTE):
            return line.removeprefix(UP_NOTE)
    found = next(filter(None, map(_VERTICAL.match, lines)), None)
    if found is None:
        return ""
    sign, axis = found[1], found[2].upper()
    return "" if axis == "Y" and not sign else sign.replace("+", "") + axis
