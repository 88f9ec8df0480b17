"""Output of a verb: JSON on stdout, and checks of output paths before the work."""

import contextlib
import os
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

from ...errors import ConfigError
from ...events import strict_json
from ...io.files import reason
from ...quoting import brief
from .marks import is_ours

_NAMELESS = (".spz", ".splat", ".usd", ".usda", ".usdc", ".usdz", ".bin")
"""Endings of formats without comments."""


def print_json(content: Any) -> None:
    """One line of strict JSON on stdout."""
    print(strict_json(content), flush=True)


def check_replaced(paths: Iterable[Path], *, overwrite: bool) -> None:
    """Raise unless files may be written at these paths, replacing existing ones.

    Args:
        paths: Output files.
        overwrite: Replace files without gscore's mark too. Files with the mark are always
            replaced; SPZ, .splat, USD and .gltf buffers cannot have one.

    Raises:
        ConfigError: a path is not a regular file, or is a file without the mark.
    """
    existing = [path for path in paths if path.exists()]
    for path in existing:
        if not path.is_file():
            what = "a folder" if path.is_dir() else "not a regular file"
            raise ConfigError(f"{brief(path)} is {what}, so no file can be written there.")
    foreign = [] if overwrite else [path for path in existing if not is_ours(path)]
    if foreign:
        raise ConfigError(
            f"{first_few([str(path) for path in foreign])} exists already, without a mark of "
            f"gscore{_never(foreign)}, so it is kept. Choose another output, or give `--overwrite`."
        )


def _never(paths: list[Path]) -> str:
    """Note on formats whose files cannot have a mark."""
    if any(path.suffix.lower() in _NAMELESS for path in paths):
        return " (SPZ, .splat, USD and .bin files never have one)"
    return ""


def check_folder(folder: Path) -> None:
    """Raise unless files can be written into `folder`, which may not exist yet.

    Raises:
        ConfigError: A part of the path is a file, or the nearest existing folder is read-only.
    """
    try:
        folder.stat()
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        pass
    except (OSError, ValueError) as error:
        raise ConfigError(f"Cannot use {brief(folder)}: {reason(error)}") from error
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise ConfigError(f"{existing} is a file; a folder is needed.")
    if not os.access(existing, os.W_OK | os.X_OK):
        why = "the disk is read-only" if _is_read_only(existing) else "permission denied"
        raise ConfigError(f"Cannot write into {existing}: {why}; choose another output.")


def _is_read_only(folder: Path) -> bool:
    """Whether the file system of a folder is read-only; False if unknown."""
    return hasattr(os, "statvfs") and bool(os.statvfs(folder).f_flag & os.ST_RDONLY)


def other_files(folder: Path, known: Collection[str]) -> str:
    """The first few names in a folder for a message, without `known` names and hidden files; empty
    if there are none."""
    names: list[str] = []
    with contextlib.suppress(OSError, ValueError):  # writing there reports the error
        names = sorted(p.name for p in folder.iterdir() if not p.name.startswith("."))
    return first_few([name for name in names if name not in known])


def first_few(names: Sequence[str], most: int = 3) -> str:
    """The first names for a message, and the count of the others; empty if there are none."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(brief(name) for name in names[:most]) + more
