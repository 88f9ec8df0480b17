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
"""Endings of formats that hold no comment."""


def print_json(content: Any) -> None:
    """One line of strict JSON on stdout."""
    print(strict_json(content), flush=True)


def check_replaced(paths: Iterable[Path], *, overwrite: bool) -> None:
    """Raise unless files may be written under these names, of which some may be taken.

    Args:
        paths: Where files are going to be written.
        overwrite: Files that do not bear gscore's mark may be replaced too. Others always may; its
            own SPZ, .splat, USD and buffers of .gltf, without a name in them, count as anybody's.

    Raises:
        ConfigError: something else than a file has such a name, or somebody else's file.
    """
    there = [path for path in paths if path.exists()]
    for path in there:
        if not path.is_file():
            what = "a folder" if path.is_dir() else "no regular file"
            raise ConfigError(f"{brief(path)} is {what}, so no file can be written there.")
    foreign = [] if overwrite else [path for path in there if not is_ours(path)]
    if foreign:
        raise ConfigError(
            f"{first_few([str(path) for path in foreign])} is there already. Nothing in it "
            f"says that gscore wrote it{_never(foreign)}, so it stays. Choose another output, or "
            "give --overwrite."
        )


def _never(paths: list[Path]) -> str:
    """Words for formats whose files have no room for a mark, even if gscore wrote them."""
    if any(path.suffix.lower() in _NAMELESS for path in paths):
        return " (SPZ, .splat, USD and .bin files never do)"
    return ""


def check_folder(folder: Path) -> None:
    """Raise unless files could be written into `folder`, which may not exist yet.

    Raises:
        ConfigError: A part of the path is a file, or the nearest folder that exists is read-only.
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
        raise ConfigError(f"{existing} is a file; a folder is needed to write into.")
    if not os.access(existing, os.W_OK | os.X_OK):
        why = "the disk is read-only" if _is_read_only(existing) else "permission denied"
        raise ConfigError(f"Cannot write into {existing}: {why}; choose another output.")


def _is_read_only(folder: Path) -> bool:
    """Whether the file system of a folder is read-only; False if unknown."""
    return hasattr(os, "statvfs") and bool(os.statvfs(folder).f_flag & os.ST_RDONLY)


def others_in(folder: Path, known: Collection[str]) -> str:
    """The first few names in a folder, without those that are `known`, for a message; or nothing.

    Hidden files are left out.
    """
    names: list[str] = []
    with contextlib.suppress(OSError, ValueError):  # whoever writes there says why it cannot be
        names = sorted(p.name for p in folder.iterdir() if not p.name.startswith("."))
    return first_few([name for name in names if name not in known])


def first_few(names: Sequence[str], most: int = 3) -> str:
    """Some names for a message, and the count of the others; empty if there are none."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(brief(name) for name in names[:most]) + more
