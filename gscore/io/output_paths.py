"""Output paths: refusal of outputs among their inputs or the files of others."""

import contextlib
import stat
import tempfile
from pathlib import Path

from ..config import DataConfig
from ..errors import ConfigError
from ..quoting import brief


def check_output_path(folder: Path, data: DataConfig | None = None, *, depths: bool = True) -> None:
    """Raise unless results may be written into a folder; links are resolved.

    Args:
        folder: Folder of the results; need not exist.
        data: The capture they are made from.
        depths: Whether its folder of depth maps is an input.

    Raises:
        ConfigError: it is the root, the home folder, a folder of temporary files, the capture or
            its folder of photos, masks or maps.
    """
    real = _real(folder)
    if real == Path(real.anchor):
        raise _mixed(folder, "the root folder", "everything")
    if real == _home():
        raise _mixed(folder, "your home folder", "everything")
    if data is not None and real == _real(_root(data)):
        raise _mixed(folder, "the capture itself", "photos")
    check_separate(folder, data, depths=depths)
    if _is_shared(real):
        raise ConfigError(
            f"{brief(folder)} is shared by many programs. Choose a new folder in it, such as "
            f"{brief(folder / 'gscore')}."
        )


def check_separate(folder: Path, data: DataConfig | None = None, *, depths: bool = True) -> None:
    """Like `check_output_path`, for single files: the folder must not be that of the photos, masks
    or maps."""
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
        f"{brief(folder)} is {what}, where results would mix with {others}. Choose a separate "
        "folder."
    )


def _is_shared(real: Path) -> bool:
    """True for a folder in which all users and programs create files, as /tmp."""
    with contextlib.suppress(OSError):
        if real.stat().st_mode & stat.S_ISVTX:
            return True
    return real == _real(Path(tempfile.gettempdir()))


def _root(data: DataConfig) -> Path:
    return data.source.parent if data.source.is_file() else data.source


def _home() -> Path | None:
    """The user's home folder; None for users without one, as in containers."""
    with contextlib.suppress(RuntimeError):
        return _real(Path("~").expanduser())
    return None


def _real(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError):  # writing there reports the error
        return path.absolute()
