"""Install lock: one Blender at a time installs, and removes leftovers of a killed one; no bpy."""

import os
import re
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..core import FolderLock, GsError

_NEW, _OLD = "new", "old"
_RENAME_TRIES = 5


@contextmanager
def turn(target: Path) -> Iterator[None]:
    """Lock the folder of an environment, and remove leftovers of earlier installations.

    An earlier environment that was moved aside, with none in its place, is restored. The
    operating system releases the lock when the process ends, so no process works on leftovers
    while the lock is taken.

    Raises:
        GsError: another process has the lock, or the folder cannot be written or cleaned up.
    """
    lock = FolderLock(target.parent, f"{target.name}.lock", "Make Environment")
    try:
        lock.take()
    except GsError as error:
        if (process := lock.holder()) is None:
            raise
        number = f" (process {process})" if process else ""
        raise GsError(
            f"Another Blender{number} is making the environment in {target.parent}; wait until it "
            "is done, then press Check."
        ) from error
    try:
        _clean_up(target)
        yield
    finally:
        lock.release()


def partial(target: Path) -> Path:
    """A name for an incomplete environment."""
    return target.with_name(f"{target.name}.{secrets.token_hex(4)}.{_NEW}")


def rename_away(target: Path) -> Path:
    """A name for the earlier environment until the new one is in its place."""
    return target.with_name(f"{target.name}.{secrets.token_hex(4)}.{_OLD}")


def rename(old: Path, new: Path) -> None:
    """Rename with retries, because virus scanners of Windows lock new files for a moment."""
    for left in range(_RENAME_TRIES - 1, -1, -1):
        try:
            os.replace(old, new)  # noqa: PTH105 - also of folders
            return
        except PermissionError:
            if not left:
                raise
            time.sleep(0.5)


def _clean_up(target: Path) -> None:
    name = re.compile(rf"{re.escape(target.name)}\.[0-9a-f]{{8}}\.({_NEW}|{_OLD})")
    left = [path for path in target.parent.iterdir() if name.fullmatch(path.name)]
    earlier = [path for path in left if path.suffix == f".{_OLD}"]
    if earlier and not target.exists():
        try:
            rename(max(earlier, key=_age), target)
        except OSError as error:
            raise GsError(
                f"The earlier environment in {target.parent} cannot be restored "
                f"({error.strerror}); rename its folder to {target.name}, then press Make "
                "Environment again."
            ) from error
    for path in left:
        shutil.rmtree(path, ignore_errors=True)


def _age(path: Path) -> float:
    return path.stat().st_mtime
