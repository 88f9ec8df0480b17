"""Header comment of a splat PLY with the near plane of its training."""

import math
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
