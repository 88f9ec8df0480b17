"""Folder comparison: equality of capture paths, without disk access; no bpy."""

import os
from pathlib import Path


def same_folder(a: Path, b: Path) -> bool:
    """True if two paths name the same folder, which need not exist."""
    return _plain(a) == _plain(b)


def means_capture(chosen: Path, source: Path) -> bool:
    """True if a chosen path is the folder of a capture or inside it, such as `sparse/0`."""
    inside, whole = _plain(chosen), _plain(source)
    return inside == whole or whole in inside.parents


def _plain(path: Path) -> Path:
    return Path(os.path.normcase(os.path.abspath(path)))  # noqa: PTH100 - keeps symbolic links
