"""Search attempts: settings tried in turn while many photos have no camera pose."""

from dataclasses import dataclass, replace

from .search_request import SearchRequest

ENOUGH = 0.9
"""Share of the photos in the largest model from which no further attempt is made."""


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """Settings of one reconstruction."""

    name: str
    """Part of the message after "Trying again "."""
    mapper: str
    """incremental or global."""
    lenient: bool = False
    """The incremental mapper accepts initial pairs of low parallax and photos with few points."""
    more_features: bool = False
    """More features, with a lower threshold; exhaustive matching."""

    @property
    def database(self) -> str:
        """File name of the features and matches, which attempts may share."""
        return "rich.db" if self.more_features else "usual.db"


_FIRST = Attempt(name="", mapper="global")
_SECOND = Attempt(
    name="photo by photo, from pairs with little parallax too", mapper="incremental", lenient=True
)
_THIRD = Attempt(name="with more and weaker features", mapper="global", more_features=True)


def attempts(request: SearchRequest) -> tuple[Attempt, ...]:
    """Attempts in order, until one registers `ENOUGH` photos."""
    if request.mapper == "auto":
        return _FIRST, _SECOND, _THIRD
    first = Attempt(name="", mapper=request.mapper)
    second = replace(first, name=_THIRD.name, more_features=True, lenient=True)
    return first, second
