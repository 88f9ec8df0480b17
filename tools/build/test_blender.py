"""Runs the add-on's tests in real Blenders and prints one line for each.

`python tools/build/test_blender.py all` takes every version of `bpy_venvs.py` and a `blender`
program on PATH; `newest`, `oldest` or versions take fewer. What follows `--` goes to pytest.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import bpy_venvs

ROOT = bpy_venvs.ROOT
LIMIT = 1200
"""Seconds a version may take: bpy 4.5 hangs at exit when a class is left registered."""
_TAIL = re.compile(r"\d+ (?:passed|failed|error|skipped|deselected).* in [\d.]+s")


def run(command: Sequence[str | Path]) -> tuple[bool, str]:
    """Run pytest with an empty Blender profile and show what it prints.

    Returns:
        Whether all went well, and pytest's last line.
    """
    with (
        tempfile.TemporaryDirectory(prefix="blender-user-") as profile,
        tempfile.TemporaryFile("w+", errors="replace") as output,
    ):
        # The Python that runs this is the one that has what trainings need.
        trainer = {"GSCORE_TRAINER_PYTHON": sys.executable}
        environment = {**trainer, **os.environ, "BLENDER_USER_RESOURCES": profile}
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
    return code == 0, last if code in (0, 1) else f"{last}; exit status {code}"


def program_packages() -> Path:
    """A folder with pytest and plyfile for a Blender program, which has neither."""
    folder = ROOT / "build" / "blender-packages"
    if not folder.exists():
        python = bpy_venvs.interpreter(bpy_venvs.installed()[-1])
        pip = [python, "-m", "pip", "install", "-q", "--no-deps", "--target", folder]
        names = [*bpy_venvs.PACKAGES, "pluggy", "iniconfig", "packaging", "pygments"]
        subprocess.run([*pip, *names], check=True)
    return folder


def test_version(version: str, arguments: Sequence[str]) -> tuple[bool, str]:
    """Test in the bpy module; a version whose Python is missing is skipped, and that is said."""
    try:
        python = bpy_venvs.ensure(version)
    except bpy_venvs.NoPythonError as error:
        return True, f"skipped: {error}"
    return run([python, "-m", "pytest", "-q", "tests/addon", *arguments])


def test_program(program: str, arguments: Sequence[str]) -> tuple[bool, str]:
    """Test in a Blender program."""
    options = ["-b", "--factory-startup", "--python-exit-code", "1", "-P", "tests/blender_run.py"]
    paths = ["--packages", str(program_packages())]
    return run([program, *options, "--", *paths, "-q", "tests/addon", *arguments])


def main(arguments: list[str]) -> int:
    """Test what is named and print the summary."""
    split = arguments.index("--") if "--" in arguments else len(arguments)
    names, extra = arguments[:split] or ["newest"], arguments[split + 1 :]
    results = {}
    try:
        for version in dict.fromkeys(v for name in names for v in bpy_venvs.choose(name)):
            print(f"== Blender {version}", flush=True)
            results[f"bpy {version}"] = test_version(version, extra)
    except bpy_venvs.NoPythonError as error:
        results["bpy"] = (True, f"skipped: {error}")
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    program = shutil.which("blender") if "all" in names else None
    if program and bpy_venvs.installed():
        print(f"== {program}", flush=True)
        results[program] = test_program(program, extra)
    for name, (good, line) in results.items():
        print(f"{name}: {'ok' if good else 'FAILED'}: {line}")
    return 0 if all(good for good, _ in results.values()) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
