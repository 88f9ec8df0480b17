"""Search request: photos, output folder and options of a camera search; the attempts it makes."""

from dataclasses import dataclass, replace
from pathlib import Path

from ..config import checked_threads
from ..errors import ConfigError
from ..io.colmap.lenses import CAMERA_MODELS
from ..quoting import quoted

MATCHERS = ("auto", "exhaustive", "sequential")
"""Values of `SearchRequest.matching`."""
MAPPERS = ("auto", "incremental", "global")
"""Values of `SearchRequest.mapper`."""

USUAL_LENS = "SIMPLE_RADIAL"
"""One focal length and one coefficient: few photos constrain no more."""

_LONGEST_FOCAL = 1e6


@dataclass(frozen=True, kw_only=True)
class SearchRequest:
    """Options of a camera search.

    Raises:
        ConfigError: an option has an invalid value.
    """

    photos: Path
    """Folder of photos, sub-folders too."""
    video: Path | None = None
    """Source video of the photos; None: they are photos."""
    output: Path
    """The capture to make: a new folder, an empty one, or the one whose `images` the photos are."""
    excluded: Path | None = None
    """Folder that is not searched for photos: that of the results."""
    masks: Path | None = None
    """Folder of masks; None: `masks` among the photos or next to their folder `images`."""
    use_masks: bool = True
    """False: masks are ignored."""
    invert_masks: bool = False
    """Masks are white at ignored pixels."""
    matching: str = "auto"
    """Choice of the image pairs: one of `MATCHERS`."""
    mapper: str = "auto"
    """COLMAP mapper: one of `MAPPERS`."""
    camera_model: str = USUAL_LENS
    """COLMAP lens model; the default may become OPENCV if it fits badly."""
    focal_length: float = 0.0
    """Focal length of all photos, px; 0: from EXIF, else that of a typical lens."""
    threads: int = 0
    """CPU threads; 0: one per core."""

    def __post_init__(self) -> None:
        checked_threads(self.threads)
        if not 0 <= self.focal_length < _LONGEST_FOCAL:  # False for NaN too
            raise ConfigError(
                f"focal_length is {self.focal_length:g}, expected more than 0 and less than "
                f"{_LONGEST_FOCAL:g} px."
            )
        known = [model.name for model in CAMERA_MODELS]
        for name, value, choices in (
            ("matching", self.matching, MATCHERS),
            ("mapper", self.mapper, MAPPERS),
            ("camera_model", self.camera_model, known),
        ):
            if value not in choices:
                raise ConfigError(
                    f"{name} is {quoted(value)}, expected one of {', '.join(choices)}."
                )


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
