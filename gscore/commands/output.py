"""What a verb gives back: JSON on stdout, and where it may write, asked before the work."""

import contextlib
import os
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from ..errors import ConfigError
from ..events import strict_json
from ..io.files import reason
from ..shown import shown


def print_json(content: Any) -> None:
    """One line of strict JSON on stdout."""
    print(strict_json(content), flush=True)


def check_ours(path: Path) -> None:
    """Raise if a file that would be replaced is there and was written by another program.

    Raises:
        ConfigError: the word gscore is nowhere in it.
    """
    if path.is_file() and b"gscore" not in path.read_bytes():
        raise ConfigError(
            f"{path} was not written by gscore, so it is not replaced; choose another output."
        )


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
        raise ConfigError(f"Cannot use {shown(folder)}: {reason(error)}") from error
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise ConfigError(f"{existing} is a file; a folder is needed to write into.")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise ConfigError(
            f"Cannot write into {existing}: permission denied; choose another output."
        )


def others_in(folder: Path, known: Collection[str]) -> str:
    """The first few names in a folder, without those that are `known`, for a message; or nothing.

    Hidden files are left out.
    """
    names: list[str] = []
    with contextlib.suppress(OSError, ValueError):  # whoever writes there says why it cannot be
        names = sorted(p.name for p in folder.iterdir() if not p.name.startswith("."))
    return first_few([name for name in names if name not in known])


def first_few(names: Sequence[str], most: int = 3) -> str:
    """Some names for a message, and how many there are more; empty where there are none."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(shown(name) for name in names[:most]) + more
