"""Where a verb may write, asked before the work and not after it."""

import os
from pathlib import Path

from ..errors import ConfigError


def check_folder(folder: Path) -> None:
    """Raise unless files could be written into `folder`, which may not exist yet.

    Raises:
        ConfigError: A part of the path is a file, or the nearest folder that exists is read-only.
    """
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise ConfigError(f"{existing} is a file; a folder is needed to write into.")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise ConfigError(
            f"Cannot write into {existing}: permission denied; choose another output."
        )
