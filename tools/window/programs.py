"""Blender programs with a window on a virtual screen, for tests and measurements."""

import os
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import plyfile

PICTURES = ("import", "convert")
"""ImageMagick, for pictures of the screen."""


def find(*tools: str) -> tuple[str, str]:
    """A Blender that can be used, else an empty string; and why there is none.

    Args:
        tools: Programs that are needed besides the screen.
    """
    found = os.environ.get("GSCORE_BLENDER") or shutil.which("blender")
    missing = [name for name in ("Xvfb", *tools) if shutil.which(name) is None]
    if found is None or missing:
        return "", f"there is no {'Blender' if found is None else ', '.join(missing)}"
    told = subprocess.run([found, "--version"], capture_output=True, text=True, check=False).stdout
    version = re.search(r"Blender (\d+)\.(\d+)", told)
    if version is None or tuple(map(int, version.groups())) < (4, 2):
        return "", f"{found} is no Blender of 4.2 or later"
    return found, ""


@contextmanager
def screen(width: int, height: int) -> Iterator[str]:
    """The name of a display of that many pixels that is not there."""
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{width}x{height}x24"],
        pass_fds=[write],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    with os.fdopen(read) as told:
        number = told.readline().strip()
    time.sleep(0.5)
    try:
        yield f":{number}"
    finally:
        server.terminate()
        server.wait(10)


def run(
    blender: str,
    script: Path,
    folder: Path,
    display: str,
    size: tuple[int, int],
    seconds: float,
    *options: str,
) -> str:
    """Run a script in a window, with a profile of its own, drawn by the processor.

    Args:
        blender: The program.
        script: Called with `folder`, and with a folder of what Blender's Python lacks.
        folder: For what the script leaves, and the profile.
        display: Of `screen`.
        size: Width and height of the window, pixels.
        seconds: Longest it may take.
        options: Of Blender's command line, besides.

    Returns:
        All that it wrote to the terminal.

    Raises:
        subprocess.TimeoutExpired: it took longer.
    """
    (folder / "profile").mkdir()
    packages = folder / "packages"
    packages.mkdir()
    shutil.copy(plyfile.__file__, packages)  # alone: numpy beside it is for another Python
    environment = {
        **os.environ,
        "DISPLAY": display,
        "LIBGL_ALWAYS_SOFTWARE": "1",
        "BLENDER_USER_RESOURCES": str(folder / "profile"),
    }
    place = ["-p", "0", "0", *map(str, size)]
    done = subprocess.run(
        [blender, "--factory-startup", *options, *place, "-P", script, "--", folder, packages],
        env=environment,
        capture_output=True,
        text=True,
        timeout=seconds,
        check=False,
    )
    return done.stdout + done.stderr
