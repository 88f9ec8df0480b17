"""The header comment of a splat PLY that states the near plane of its training."""

import math
from collections.abc import Iterable

from ...errors import FormatError
from ...quoting import quoted

_NEAR = "gscore near "


def near_comment(near: float) -> str:
    """The comment that states a near plane, world units, to the bit."""
    return f"{_NEAR}{near!r}"


def stated_near(comments: Iterable[str]) -> float | None:
    """The near plane that header comments state, world units; None: none.

    Raises:
        FormatError: one states no positive number.
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
