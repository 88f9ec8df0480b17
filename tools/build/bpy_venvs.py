"""Virtual environments with the bpy module, one per Blender version, in .venv-blender/.

`python tools/build/bpy_venvs.py newest` makes the one for the newest Blender that a Python of this
machine can run and prints its interpreter; `oldest`, `all` and a version work alike.
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
"""The Blender versions that are tested, oldest first, and the only Python each runs on."""
PACKAGES = ("plyfile>=1.0", "pytest>=8")
NO_PYTHON = 3
"""Exit status: this machine has no Python for the wanted Blender."""


class NoPythonError(Exception):
    """No interpreter of the wanted version; the message names it."""


def _interpreters(wanted: str) -> Iterator[Path]:
    """Where a Python of version `wanted` may lie: this one, PATH, pyenv's folders."""
    if f"{sys.version_info[0]}.{sys.version_info[1]}" == wanted:
        yield Path(sys.executable)
    for name in (f"python{wanted}", "python3", "python"):
        if found := shutil.which(name):
            yield Path(found)
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    yield from sorted(pyenv.glob(f"versions/{wanted}*/bin/python{wanted}"), reverse=True)


def _runs(python: Path, wanted: str) -> bool:
    """Whether it starts, has that version and can make environments."""
    code = "import sys, venv, ensurepip; print('%d.%d' % sys.version_info[:2])"
    try:
        done = subprocess.run(
            [python, "-c", code], capture_output=True, text=True, timeout=30, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0 and done.stdout.strip() == wanted


def find_python(version: str) -> Path:
    """A Python that Blender `version` runs on.

    Raises:
        NoPythonError: none is installed.
    """
    wanted = PYTHONS[version]
    for python in _interpreters(wanted):
        if _runs(python, wanted):
            return python
    raise NoPythonError(
        f"Blender {version} needs Python {wanted} with venv, which is not installed"
    )


def interpreter(version: str) -> Path:
    """The interpreter of a version's environment, whether or not that has been made."""
    scripts, name = ("Scripts", "python.exe") if os.name == "nt" else ("bin", "python")
    return FOLDER / version / scripts / name


def ensure(version: str) -> Path:
    """The interpreter of a version's environment, made if it is not there.

    Raises:
        NoPythonError: its Python is not installed.
        subprocess.CalledProcessError: the packages do not install.
    """
    python, ready = interpreter(version), FOLDER / version / ".installed"
    if ready.exists():
        return python
    base = find_python(version)
    print(f"Making .venv-blender/{version} (downloads 350 MB)", file=sys.stderr)
    shutil.rmtree(FOLDER / version, ignore_errors=True)
    subprocess.run([base, "-m", "venv", FOLDER / version], check=True)
    pip = [python, "-m", "pip", "install", "-qq", "--disable-pip-version-check"]
    subprocess.run([*pip, f"bpy=={version}", *PACKAGES], check=True)
    ready.touch()
    return python


def installed() -> list[str]:
    """Versions whose environments are there, oldest first."""
    return [version for version in PYTHONS if (FOLDER / version / ".installed").exists()]


def choose(which: str) -> list[str]:
    """Versions by name: `all`, `newest`, `oldest` (of those this machine can run), or one version.

    Raises:
        NoPythonError: none of them can run here.
        ValueError: an unknown version.
    """
    if which == "all":
        return list(PYTHONS)
    if which in PYTHONS:
        return [which]
    if which not in {"newest", "oldest"}:
        known = ", ".join(PYTHONS)
        raise ValueError(f"{which}: not a version known here; choose of all, newest, {known}")
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
    """Make what the arguments name and print the interpreters."""
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
        print("The packages did not install; what pip says stands above.", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
