"""Blender tests: the add-on's tests in real Blenders, with OpenGL and Vulkan, one line each.

`python tools/build/test_blender.py all` tests every version of `bpy_venvs.py` and a `blender`
program on PATH; `newest`, `oldest` or versions test fewer. Arguments after `--` go to pytest.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from itertools import pairwise, product
from pathlib import Path

import bpy_venvs

ROOT = bpy_venvs.ROOT
LIMIT = 1200
"""Time limit of a version, s: bpy 4.5 hangs at exit if a class stays registered."""
_BACKENDS = (None,) if sys.platform == "darwin" else ("opengl", "vulkan")
"""Blender's graphics backends; None: its default, which is Metal."""
_WORKERS = shlex.split(os.environ.get("WORKERS", ""))
"""Pytest's arguments in the bpy module, for pytest-xdist; each process has a Blender."""
_NOTHING_CHOSEN = 5
"""Pytest's exit status if no test was selected, such as with `-k`."""
_TAIL = re.compile(r"\d+ (?:passed|failed|error|skipped|deselected).* in [\d.]+s")


def run(command: Sequence[str | Path], backend: str | None) -> tuple[bool, str]:
    """Run pytest with an empty Blender profile and print its output.

    Args:
        command: The command line.
        backend: One of `_BACKENDS`; tests that draw are skipped without a driver for it.

    Returns:
        Whether all tests passed, and pytest's last line.
    """
    with (
        tempfile.TemporaryDirectory(prefix="blender-user-") as profile,
        tempfile.TemporaryFile("w+", errors="replace") as output,
    ):
        # The current Python has the packages of trainings.
        trainer = {"GSCORE_TRAINER_PYTHON": sys.executable}
        environment = {**trainer, **os.environ, "BLENDER_USER_RESOURCES": profile}
        if backend is not None:
            environment["GSCORE_GPU_BACKEND"] = backend
        if backend == "opengl":
            # The bpy module has no option --gpu-backend and selects before it reads preferences:
            # Vulkan, if Vulkan's loader finds a driver.
            environment["VK_LOADER_DRIVERS_DISABLE"] = "*"
        try:
            code = subprocess.run(
                command,
                cwd=ROOT,
                env=environment,
                stdout=output,
                stderr=subprocess.STDOUT,
                timeout=LIMIT,
                check=False,
            ).returncode
        except subprocess.TimeoutExpired:
            code = None
        output.seek(0)
        text = output.read()
    print(text, flush=True)
    found = _TAIL.findall(text)
    last = found[-1] if found else "no tests ran"
    if code is None:
        return False, f"{last}; no end within {LIMIT} s"
    good = code == 0 or (code == _NOTHING_CHOSEN and backend != _BACKENDS[0])
    return good, last if code in (0, 1) else f"{last}; exit status {code}"


def program_packages() -> Path:
    """A folder with pytest and plyfile, which a Blender program lacks."""
    folder = ROOT / "build" / "blender-packages"
    if not folder.exists():
        python = bpy_venvs.interpreter(bpy_venvs.installed()[-1])
        pip = [python, "-m", "pip", "install", "-q", "--no-deps", "--target", folder]
        names = [*bpy_venvs.PACKAGES, "pluggy", "iniconfig", "packaging", "pygments"]
        subprocess.run([*pip, *names], check=True)
    return folder


def chosen(backend: str | None, arguments: Sequence[str]) -> list[str]:
    """Pytest's arguments: all tests for the first backend, only drawing tests for the others."""
    if backend == _BACKENDS[0]:
        return ["-q", "tests/addon", *arguments]
    marks = [f"({given})" for flag, given in pairwise(arguments) if flag == "-m"]
    # The last -m counts.
    return ["-q", "tests/addon", *arguments, "-m", " and ".join([*marks[-1:], "graphics"])]


def test_version(version: str, backend: str | None, arguments: Sequence[str]) -> tuple[bool, str]:
    """Test in the bpy module; reports versions that are skipped for lack of a Python."""
    try:
        python = bpy_venvs.ensure(version)
    except bpy_venvs.NoPythonError as error:
        return True, f"skipped: {error}"
    return run([python, "-m", "pytest", *_WORKERS, *chosen(backend, arguments)], backend)


def test_program(program: str, backend: str | None, arguments: Sequence[str]) -> tuple[bool, str]:
    """Test in a Blender program."""
    options = ["-b", "--factory-startup", "--python-exit-code", "1", "-P", "tests/blender_run.py"]
    paths = ["--packages", str(program_packages())]
    return run([program, *options, "--", *paths, *chosen(backend, arguments)], backend)


def main(arguments: list[str]) -> int:
    """Run the requested tests and print the summary."""
    split = arguments.index("--") if "--" in arguments else len(arguments)
    names, extra = arguments[:split] or ["newest"], arguments[split + 1 :]
    results = {}
    try:
        versions = dict.fromkeys(v for name in names for v in bpy_venvs.choose(name))
        for version, backend in product(versions, _BACKENDS):
            title = " ".join(filter(None, (f"bpy {version}", backend)))
            print(f"== {title}", flush=True)
            results[title] = test_version(version, backend, extra)
    except bpy_venvs.NoPythonError as error:
        results["bpy"] = (True, f"skipped: {error}")
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    program = shutil.which("blender") if "all" in names else None
    if program and bpy_venvs.installed():
        for backend in _BACKENDS:
            title = " ".join(filter(None, (program, backend)))
            print(f"== {title}", flush=True)
            results[title] = test_program(program, backend, extra)
    for name, (good, line) in results.items():
        print(f"{name}: {'ok' if good else 'FAILED'}: {line}")
    return 0 if all(good for good, _ in results.values()) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
