"""Where results may go: not among what they are made from, and not where everything lies."""

from pathlib import Path

from ..config import DataConfig
from ..errors import ConfigError
from ..shown import shown


def check_place(folder: Path, data: DataConfig | None = None, *, depths: bool = True) -> None:
    """Raise unless results may be written into a folder; links count as what they lead to.

    Args:
        folder: Of the results; need not exist.
        data: The capture they are made from.
        depths: Whether its folder of depth maps is part of it.

    Raises:
        ConfigError: the root, the home folder, the capture or a folder of its photos or maps.
    """
    place = _real(folder)
    if place == Path(place.anchor):
        raise _mixed(folder, "the root folder", "everything")
    if place == _real(Path("~").expanduser()):
        raise _mixed(folder, "your home folder", "everything")
    if data is not None:
        if place == _real(_root(data)):
            raise _mixed(folder, "the capture itself", "photos")
        check_apart(folder, data, depths=depths)


def check_apart(folder: Path, data: DataConfig, *, depths: bool = True) -> None:
    """As `check_place`, for single files: the folder must not be that of the photos or maps."""
    parts = {"photos": data.images or "images", "masks": data.masks or "masks"}
    if depths and data.depths:
        parts["depth maps"] = data.depths
    for what, name in parts.items():
        if _real(folder) == _real(_root(data) / name):
            raise _mixed(folder, f"the folder of the {what}", "them")


def _mixed(folder: Path, what: str, others: str) -> ConfigError:
    return ConfigError(
        f"{shown(folder)} is {what}, where results would mix with {others}. Choose a folder of "
        "their own."
    )


def _root(data: DataConfig) -> Path:
    return data.source.parent if data.source.is_file() else data.source


def _real(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError):  # whoever writes there says what is wrong
        return path.absolute()
