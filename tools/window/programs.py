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
"""ImageMagick, for screenshots."""


def find(*tools: str) -> tuple[str, str]:
    """A usable Blender, or an empty string, and the reason why there is none.

    Args:
        tools: Other required programs.
    """
    found = os.environ.get("GSCORE_BLENDER") or shutil.which("blender")
    missing = [name for name in ("Xvfb", *tools) if shutil.which(name) is None]
    if found is None or missing:
        return "", f"there is no {'Blender' if found is None else ', '.join(missing)}"
    text = subprocess.run([found, "--version"], capture_output=True, text=True, check=False).stdout
    version = re.search(r"Blender (\d+)\.(\d+)", text)
    if version is None or tuple(map(int, version.groups())) < (4, 2):
        return "", f"{found} is not Blender 4.2 or later"
    return found, ""


@contextmanager
def screen(width: int, height: int) -> Iterator[str]:
    """Context with the name of a virtual display of this size, pixels."""
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{width}x{height}x24"],
        pass_fds=[write],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    with os.fdopen(read) as pipe:
        number = pipe.readline().strip()
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
    """Run a script in a window with its own profile and software rendering.

    Args:
        blender: The program.
        script: Called with `folder` and a folder of packages that Blender's Python lacks.
        folder: Folder for results and the profile.
        display: Display of `screen`.
        size: Width and height of the window, pixels.
        seconds: Time limit.
        options: Additional options of Blender's command line.

    Returns:
        Its terminal output.

    Raises:
        subprocess.TimeoutExpired: it took longer.
    """
    (folder / "profile").mkdir()
    packages = folder / "packages"
    packages.mkdir()
    shutil.copy(plyfile.__file__, packages)  # without numpy, which is for another Python
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
