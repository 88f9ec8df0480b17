"""Header comments of a splat PLY: near plane of its training, and up axis."""

import math
import re
from collections.abc import Iterable

from ...errors import FormatError
from ...quoting import quoted

_NEAR = "gscore near "


def near_comment(near: float) -> str:
    """Comment that states a near plane, world units, exactly."""
    return f"{_NEAR}{near!r}"


def stated_near(comments: Iterable[str]) -> float | None:
    """Near plane from header comments, world units; None if they state none.

    Raises:
        FormatError: a near comment has no positive number.
    """
    for line in comments:
        if line.startswith(_NEAR):
            return _positive(line)
    return None


def _positive(line: str) -> float:
    try:
        near = float(line.removeprefix(_NEAR))
    except ValueError:
        near = math.nan
    if not 0 < near < math.inf:
        raise FormatError(
            f"The comment {quoted(line)} of the PLY states no near plane; expected a positive "
            "number. Remove the comment."
        )
    return near


UP_NOTE = "gscore up "
"""Start of gscore's own comment, followed by an axis: X, Y or Z, or one of them after a minus."""
UP_AXIS = "up axis: "
"""Start of a comment with the up axis of a capture's world. `UP_NOTE` with Z is that of Blender's
world, whose splats keep their place beside a capture."""
_STATED = re.compile(
    r"(?:^|[,;.|()\[\]-])\s*(vertical|up)[ _-]?axis\s*[:=]?\s*([+-]?)([xyz])\b", re.IGNORECASE
)
"""Comment of nerfstudio and Brush, `Vertical Axis: z`, and `up axis`, at the start of a line or of
a part of it. A vertical y without a sign is ignored, because Brush always writes it, and the usual
axis, -Y, is also one along y."""


def stated_up(comments: Iterable[str]) -> str:
    """Up axis from header comments, as X or -Y; empty if they state none."""
    lines = list(comments)
    for line in lines:
        if line.startswith(UP_NOTE):
            return line.removeprefix(UP_NOTE)
    found = next(filter(None, map(_STATED.search, lines)), None)
    if found is None:
        return ""
    kind, sign, axis = found[1].lower(), found[2], found[3].upper()
    if kind == "vertical" and axis == "Y" and not sign:
        return ""
    return sign.replace("+", "") + axis
