"""Folder paths: the form in a .blend file and the form of the file system."""

import contextlib
import itertools
import os
from pathlib import Path

import bpy

from .capture.folders import means_capture
from .core import find_capture

ROOT = __package__.removesuffix(".addon")
"""Package name of the add-on in Blender."""


def own_folder() -> Path:
    """The add-on's folder for its own files, assigned by Blender."""
    try:
        return Path(bpy.utils.extension_path_user(ROOT))
    except ValueError:  # run from a checkout, not installed as an extension
        return Path(bpy.utils.user_resource("DATAFILES", path="gscore"))


def absolute(text: str, what: str) -> Path:
    """Absolute path of a property; `//` is the folder of the .blend file.

    Args:
        text: The property's value.
        what: Name of the property, for messages.

    Raises:
        ValueError: the text is empty, or relative to an unsaved file.
    """
    if not text.strip():
        raise ValueError(f"{what} is empty; choose a folder.")
    if text.startswith("//") and not bpy.data.filepath:
        raise ValueError(
            f"{what} {text} is relative to the .blend file, which is not saved; save it, or choose "
            "a folder by its absolute path."
        )
    return Path(os.path.abspath(bpy.path.abspath(text)))  # noqa: PTH100 - keeps symbolic links


def chosen_file(text: str) -> Path:
    """Absolute path of a file from the file browser.

    Raises:
        ValueError: the text is empty or a folder, as without a chosen file, or as `absolute`.
    """
    if not text.strip() or Path(bpy.path.abspath(text)).is_dir():
        raise ValueError("No file is chosen: choose one in the file browser.")
    return absolute(text, "File")


def relative(path: Path, folder: Path | None = None) -> str:
    """A path for the .blend file: relative to it where possible.

    Args:
        path: Absolute.
        folder: Future folder of the .blend file; None: its current one.
    """
    if folder is None and not bpy.data.filepath:
        return str(path)
    try:
        text = bpy.path.relpath(str(path), start=None if folder is None else str(folder))
    except ValueError:  # another drive
        return str(path)
    # A relative path far from the .blend file breaks sooner than an absolute one.
    return str(path) if text.startswith("//../../") else text


def capture_folder(scene: bpy.types.Scene) -> Path:
    """The scene's capture.

    Raises:
        ValueError: no capture is chosen, or it does not exist.
    """
    folder = absolute(scene.gscore.capture_path, "Capture")
    if not folder.exists():
        raise ValueError(
            f"There is no capture {folder}; choose the folder with the photos and the COLMAP model."
        )
    return find_capture(folder)


def output_folder(scene: bpy.types.Scene, default: str = "") -> Path:
    """Output folder of the scene; it may not exist yet.

    Args:
        scene: Has an output folder or a capture.
        default: Parent of the output folders of scenes without one.

    Raises:
        ValueError: the scene has neither a folder nor a capture.
    """
    if scene.gscore.output_path.strip():
        return absolute(scene.gscore.output_path, "Output")
    capture = find_capture(absolute(scene.gscore.capture_path, "Capture"))
    if default.strip():
        proposed = absolute(default, "Default Output Folder") / capture.name
    elif bpy.data.filepath:
        proposed = Path(bpy.data.filepath).parent / "splats" / capture.name
    else:
        proposed = capture.with_name(f"{capture.name}_splats")
    return _untaken(proposed, capture)


def _untaken(proposed: Path, capture: Path) -> Path:
    """The folder, or a numbered one if another capture of this file uses it.

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
    numbered = (proposed.with_name(f"{proposed.name}-{n}") for n in itertools.count(2))
    return next(path for path in itertools.chain([proposed], numbered) if path not in taken)
