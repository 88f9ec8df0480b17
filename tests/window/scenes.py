"""Scripts that run inside a Blender with a window, and their results."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tools.window import programs

SCREEN = (1000, 700)
"""Width and height of the virtual screen, unless a test has another."""


def run_scene(
    name: str,
    tmp_path_factory: pytest.TempPathFactory,
    *options: str,
    longest: int,
    size: tuple[int, int] = SCREEN,
    prepare: Callable[[Path], None] | None = None,
) -> tuple[dict, Path, str]:
    """Results of a script, the folder of its pictures, and Blender's output.

    Args:
        name: The script `NAME_scene.py` next to this file.
        tmp_path_factory: Makes the folder.
        options: Additional options of Blender.
        longest: Timeout, seconds.
        size: Width and height of the screen.
        prepare: Puts the script's input into the folder.
    """
    blender, problem = programs.find(*programs.PICTURES)
    if not blender:
        pytest.skip(problem)
    script = Path(__file__).with_name(f"{name}_scene.py")
    folder = tmp_path_factory.mktemp(name)
    if prepare is not None:
        prepare(folder)
    with programs.screen(*size) as display:
        output = programs.run(blender, script, folder, display, size, longest, *options)
    file = folder / "seen.json"
    assert file.is_file(), output
    found = json.loads(file.read_text())
    assert not found["log"], found["log"]
    return found, folder, output


def pixels(folder: Path, name: str, size: tuple[int, int] = SCREEN) -> np.ndarray:
    """[H, W, 3] 8 bit of a picture of the given width and height, else of the screen."""
    command = ["convert", str(folder / f"{name}.png"), "-depth", "8", "rgb:-"]
    raw = subprocess.run(command, capture_output=True, check=True).stdout
    return np.frombuffer(raw, np.uint8).reshape(*size[::-1], 3).astype(int)
