"""Virtual environments with the bpy module, one per Blender version, in .venv-blender/.

`python tools/build/bpy_venvs.py newest` creates that of the newest Blender for which this machine
has a Python, and prints its interpreter; `oldest`, `all` and a version work too.
The wheels come from the package registry: 350 MB to download and 1 GB on disk for each version.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / ".venv-blender"
PYTHONS = {"4.2.23": "3.11", "4.5.15": "3.11", "5.0.1": "3.11", "5.2.3": "3.13", "5.3.0": "3.13"}
"""Tested Blender versions, oldest first, with the Python version of each."""
PACKAGES = ("plyfile>=1.0", "pytest>=8")
_ALSO = ("pytest-xdist>=3.6",)
"""Further packages of the bpy module; a Blender program runs its tests in one process."""
NO_PYTHON = 3
"""Exit status: this machine has no Python for the requested Blender."""


class NoPythonError(Exception):
    """No interpreter of the required version; the message names it."""


def _interpreters(required: str) -> Iterator[Path]:
    """Possible interpreters of a Python version: this one, PATH, pyenv's folders."""
    if f"{sys.version_info[0]}.{sys.version_info[1]}" == required:
        yield Path(sys.executable)
    for name in (f"python{required}", "python3", "python"):
        if found := shutil.which(name):
            yield Path(found)
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    yield from sorted(pyenv.glob(f"versions/{required}*/bin/python{required}"), reverse=True)


def _runs(python: Path, required: str) -> bool:
    """Whether it starts, has this version and can create environments."""
    code = "import sys, venv, ensurepip; print('%d.%d' % sys.version_info[:2])"
    try:
        done = subprocess.run(
            [python, "-c", code], capture_output=True, text=True, timeout=30, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0 and done.stdout.strip() == required


def find_python(version: str) -> Path:
    """A Python for Blender `version`.

    Raises:
        NoPythonError: none is installed.
    """
    required = PYTHONS[version]
    for python in _interpreters(required):
        if _runs(python, required):
            return python
    raise NoPythonError(
        f"Blender {version} needs Python {required} with venv, which is not installed"
    )


def interpreter(version: str) -> Path:
    """The interpreter of a version's environment, which may not exist yet."""
    scripts, name = ("Scripts", "python.exe") if os.name == "nt" else ("bin", "python")
    return FOLDER / version / scripts / name


def ensure(version: str) -> Path:
    """The interpreter of a version's environment, created if missing.

    Raises:
        NoPythonError: its Python is not installed.
        subprocess.CalledProcessError: the packages do not install.
    """
    python, ready = interpreter(version), FOLDER / version / ".installed"
    packages = [f"bpy=={version}", *PACKAGES, *_ALSO]
    wanted = "\n".join(packages)
    if not ready.exists():
        base = find_python(version)
        print(f"Making .venv-blender/{version} (downloads 350 MB)", file=sys.stderr)
        shutil.rmtree(FOLDER / version, ignore_errors=True)
        subprocess.run([base, "-m", "venv", FOLDER / version], check=True)
    elif ready.read_text(encoding="utf-8") == wanted:
        return python
    pip = [python, "-m", "pip", "install", "-qq", "--disable-pip-version-check"]
    subprocess.run([*pip, *packages], check=True)
    ready.write_text(wanted, encoding="utf-8")
    return python


def installed() -> list[str]:
    """Versions with an environment, oldest first."""
    return [version for version in PYTHONS if (FOLDER / version / ".installed").exists()]


def choose(which: str) -> list[str]:
    """Versions by name: `all`, `newest` or `oldest` with a Python on this machine, or one version.

    Raises:
        NoPythonError: there is no Python for any of them.
        ValueError: an unknown version.
    """
    if which == "all":
        return list(PYTHONS)
    if which in PYTHONS:
        return [which]
    if which not in {"newest", "oldest"}:
        known = ", ".join(PYTHONS)
        raise ValueError(f"{which}: unknown version; choose all, newest, or one of {known}")
    for version in sorted(PYTHONS, key=_number, reverse=which == "newest"):
        try:
            find_python(version)
        except NoPythonError:
            continue
        return [version]
    raise NoPythonError("bpy needs Python 3.11 or 3.13 with venv, and neither is installed")


def _number(version: str) -> tuple[int, ...]:
    return tuple(map(int, version.split(".")))


def main(arguments: list[str]) -> int:
    """Create the requested environments and print their interpreters."""
    try:
        for version in [v for which in arguments or ["newest"] for v in choose(which)]:
            print(ensure(version))
    except NoPythonError as error:
        print(error, file=sys.stderr)
        return NO_PYTHON
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    except subprocess.CalledProcessError:
        print("The packages did not install; see the output of pip above.", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
