"""Output paths: refusal of outputs inside their inputs or in system folders."""

import contextlib
from pathlib import Path

from ..config import DataConfig
from ..errors import ConfigError
from ..quoting import brief
from .system_folders import is_shared, system_tree


def check_output_path(folder: Path, data: DataConfig | None = None, *, depths: bool = True) -> None:
    """Raise unless results may be written into a folder; links count as what they lead to.

    Args:
        folder: Of the results; need not exist.
        data: The capture they are made from.
        depths: Whether its folder of depth maps is part of it.

    Raises:
        ConfigError: the root, the home folder, one of the system or of all users, the capture or a
            folder of its photos or maps.
    """
    place = _real(folder)
    if place == Path(place.anchor):
        raise _mixed(folder, "the root folder", "everything")
    if place == _home():
        raise _mixed(folder, "your home folder", "everything")
    if data is not None and place == _real(_root(data)):
        raise _mixed(folder, "the capture itself", "photos")
    check_separate(folder, data, depths=depths)
    if is_shared(place):
        raise ConfigError(
            f"{brief(folder)} is where the folders of many programs lie. Choose a folder of the "
            f"results' own in it, such as {brief(folder / 'gscore')}."
        )


def check_separate(folder: Path, data: DataConfig | None = None, *, depths: bool = True) -> None:
    """As `check_output_path`, for single files: the folder must be neither the system's nor that
    of the photos or maps."""
    if what := system_tree(_real(folder)):
        raise ConfigError(
            f"{brief(folder)} {what}, which is no place for results. Choose a folder of your own."
        )
    if data is None:
        return
    parts = {"photos": data.images or "images", "masks": data.masks or "masks"}
    if depths and data.depths:
        parts["depth maps"] = data.depths
    for what, name in parts.items():
        if _real(folder) == _real(_root(data) / name):
            raise _mixed(folder, f"the folder of the {what}", "them")


def _mixed(folder: Path, what: str, others: str) -> ConfigError:
    return ConfigError(
        f"{brief(folder)} is {what}, where results would mix with {others}. Choose a folder of "
        "their own."
    )


def _root(data: DataConfig) -> Path:
    return data.source.parent if data.source.is_file() else data.source


def _home() -> Path | None:
    """The user's home folder; None for users without one, as containers have them."""
    with contextlib.suppress(RuntimeError):
        return _real(Path("~").expanduser())
    return None


def _real(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError):  # whoever writes there says what is wrong
        return path.absolute()
