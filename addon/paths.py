"""Folder paths: the form in a .blend file and the form of the file system."""

import contextlib
import itertools
import os
from pathlib import Path

import bpy

from .capture.folders import means_capture
from .core import find_capture

ROOT = __package__.removesuffix(".addon")
"""Name under which Blender knows the add-on."""


def own_folder() -> Path:
    """The folder that Blender gives the add-on for what it makes for itself."""
    try:
        return Path(bpy.utils.extension_path_user(ROOT))
    except ValueError:  # run from a checkout, not installed as an extension
        return Path(bpy.utils.user_resource("DATAFILES", path="gscore"))


def absolute(text: str, what: str) -> Path:
    """The folder or file meant by a property; `//` is the folder of the .blend file.

    Args:
        text: As the user wrote it.
        what: Name of the property, for messages.

    Raises:
        ValueError: nothing is given, or it is relative to a file that is not saved.
    """
    if not text.strip():
        raise ValueError(f"{what} is empty; choose a folder.")
    if text.startswith("//") and not bpy.data.filepath:
        raise ValueError(
            f"{what} {text} lies beside the .blend file, which is not saved; save it, or choose a "
            "folder with its whole path."
        )
    return Path(os.path.abspath(bpy.path.abspath(text)))  # noqa: PTH100 - keeps symbolic links


def relative(path: Path, folder: Path | None = None) -> str:
    """A path to keep in the .blend file: relative to it where that is possible.

    Args:
        path: Absolute.
        folder: Where the file will lie; None: where it lies.
    """
    if folder is None and not bpy.data.filepath:
        return str(path)
    try:
        text = bpy.path.relpath(str(path), start=None if folder is None else str(folder))
    except ValueError:  # another drive
        return str(path)
    # Far away from the .blend file a relative path only breaks sooner.
    return str(path) if text.startswith("//../../") else text


def capture_folder(scene: bpy.types.Scene) -> Path:
    """The scene's capture.

    Raises:
        ValueError: none is chosen, or it is not there.
    """
    folder = absolute(scene.gscore.capture_path, "Capture")
    if not folder.exists():
        raise ValueError(
            f"There is no capture {folder}; choose the folder with the photos and the COLMAP model."
        )
    return find_capture(folder)


def output_folder(scene: bpy.types.Scene, default: str = "") -> Path:
    """The folder of the scene's results, whether it is there or not.

    Args:
        scene: With a capture, if it names no folder.
        default: Folder in which one is made up for scenes that name none.

    Raises:
        ValueError: it cannot be told.
    """
    if scene.gscore.output_path.strip():
        return absolute(scene.gscore.output_path, "Output")
    capture = find_capture(absolute(scene.gscore.capture_path, "Capture"))
    if default.strip():
        wanted = absolute(default, "Default Output Folder") / capture.name
    elif bpy.data.filepath:
        wanted = Path(bpy.data.filepath).parent / "splats" / capture.name
    else:
        wanted = capture.with_name(f"{capture.name}_splats")
    return _untaken(wanted, capture)


def _untaken(wanted: Path, capture: Path) -> Path:
    """The folder, or one with a number where another capture of this file has its results there.

    Captures in different folders may have the same name.
    """
    taken = set()
    for scene in bpy.data.scenes:
        for holder in (scene.gscore, *scene.gscore.outcomes):
            with contextlib.suppress(ValueError):  # it has no capture, or no output folder yet
                own = absolute(holder.capture_path, "Capture")
                output = absolute(holder.output_path, "Output")
                if not means_capture(own, capture):
                    taken.add(output)
    numbered = (wanted.with_name(f"{wanted.name}-{n}") for n in itertools.count(2))
    return next(path for path in itertools.chain([wanted], numbered) if path not in taken)
