"""Makes the add-on's own environment for training; no bpy.

Only ever called because the user pressed a button. The environment is built under a temporary name
and takes its place when it is complete, so that a failure leaves an earlier one as it was.
"""

import os
import platform
import re
import secrets
import shutil
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

from .background import Task
from .environment import check, python_in
from .process import Process

CPU_INDEX = "https://download.pytorch.org/whl/cpu"
"""Where torch without CUDA lies for Linux; elsewhere the usual registry has no other."""
NEEDED_BYTES = 3_000_000_000
"""Free space wanted: torch and its company unpacked, and the downloads meanwhile."""
OFFLINE = (
    "Blender does not allow add-ons to go online; switch on Preferences > System > Network > Allow "
    "Online Access, then press Make Environment again."
)
_OLDEST = (3, 11)
_RENAME_TRIES = 5


class SetupError(Exception):
    """The environment cannot be made; the message says why and what to do."""


def make(
    target: Path,
    wheel: Path,
    task: Task,
    *,
    online: bool,
    base: Path | None = None,
    extra_index: str = "",
) -> Path:
    """Make the environment `target` with gscore from `wheel` and all that training needs.

    Args:
        target: Folder of the environment; replaced if it is there.
        wheel: gscore for this system.
        task: Told the progress; may cancel.
        online: Whether Blender allows add-ons to go online.
        base: The Python to build on; None: Blender's own, or one that is installed.
        extra_index: A package index to look into besides the usual one.

    Returns:
        The environment's Python.

    Raises:
        SetupError: no network, no space, no venv, a package that does not install.
        Cancelled: as the task was asked to.
    """
    if not online:
        raise SetupError(OFFLINE)
    _check_space(target)
    partial = target.with_name(f"{target.name}.{secrets.token_hex(4)}.new")
    try:
        _make_venv(partial, base or usable_base(), task)
        python = python_in(partial)
        task.tell("Updating pip")
        _run([python, *_PIP, "--upgrade", "pip"], task)
        index = ["--extra-index-url", extra_index] if extra_index else []
        task.tell("Downloading gscore's packages; torch is the largest of them")
        packages = [f"{wheel}[train,lpips]"]  # the latter brings onnxruntime, for depth too
        _run([python, *_PIP, "--progress-bar", "raw", *index, *packages], task)
        task.tell("Checking")
        verdict = check(python, task)
        if not verdict.good:
            raise SetupError(f"The new environment does not work: {verdict.sentence}")
        task.check()
        _put_in_place(partial, target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    task.tell("Done")
    return python_in(target)


def default_index() -> str:
    """The extra index that keeps gigabytes of CUDA away where no torch without it is usual."""
    return CPU_INDEX if sys.platform.startswith("linux") else ""


def find_wheel(folders: Iterable[Path], version: str) -> Path | None:
    """gscore's wheel for this system among the files of some folders."""
    names = {"x86_64": ("x86_64", "amd64"), "arm64": ("arm64", "aarch64", "universal2")}
    machine = platform.machine().lower()
    machines = next((n for n in names.values() if machine in n), (machine,))
    system = {"win32": "win", "darwin": "macosx"}.get(sys.platform, "linux")
    for folder in folders:
        for path in sorted(folder.glob(f"gscore-{version}[-+]*.whl")):
            tag = path.stem.rsplit("-", 1)[-1].lower()
            if system in tag and any(m in tag for m in machines):
                return path
    return None


def usable_base() -> Path:
    """A Python to build the environment on: the one that runs here, or an installed one.

    Raises:
        SetupError: none of version 3.11 or later is at hand.
    """
    if sys.version_info >= _OLDEST and "python" in Path(sys.executable).name.lower():
        return Path(sys.executable)
    for name in ("python3.13", "python3.12", "python3.11", "python3.14"):
        if found := shutil.which(name):
            return Path(found)
    raise SetupError(
        "No Python 3.11 or later was found to build on; install one from python.org, then press "
        "Make Environment again."
    )


_PIP = ("-m", "pip", "--no-input", "--disable-pip-version-check", "install")


def _make_venv(folder: Path, base: Path, task: Task) -> None:
    task.tell(f"Making an environment with {base}")
    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        _run([base, "-m", "venv", folder], task)
    except SetupError as error:
        text = str(error)
        if "ensurepip" in text or "No module named venv" in text:
            raise SetupError(
                f"{base} has no working venv module; on Debian and Ubuntu install the package "
                "python3-venv, then press Make Environment again."
            ) from error
        raise


def _check_space(target: Path) -> None:
    folder = next(p for p in (target, *target.parents) if p.exists())
    free = shutil.disk_usage(folder).free
    if free < NEEDED_BYTES:
        raise SetupError(
            f"The environment needs about {NEEDED_BYTES / 1e9:.0f} GB, but {folder} has only "
            f"{free / 1e9:.1f} GB free; free some space, then press Make Environment again."
        )


def _run(arguments: Sequence[str | Path], task: Task) -> None:
    """Run a program to its end, its lines told; SetupError with its reason if it fails."""
    try:
        process = Process([str(a) for a in arguments])
    except OSError as error:
        raise SetupError(f"{arguments[0]} cannot be run: {error.strerror or error}.") from error
    said: list[str] = []
    try:
        while not process.ended:
            task.check()
            for line in process.lines(0.05):
                said.append(line)
                if shown := _readable(line):
                    task.tell(shown)
            time.sleep(0.05)
    finally:
        process.kill(wait=5.0)
    if process.returncode:
        raise SetupError(_reason([*said, *process.stderr_tail]))


def _readable(line: str) -> str:
    """A line of pip as people want it; empty if there is nothing in it."""
    if match := re.fullmatch(r"Progress (\d+) of (\d+)", line.strip()):
        done, total = int(match[1]), int(match[2])
        return f"Downloading: {done / 1e6:.0f} of {total / 1e6:.0f} MB" if total > 5e6 else ""
    return line.strip()[:160]


def _reason(lines: list[str]) -> str:
    """The sentence for a failed pip or venv."""
    text = "\n".join(lines)
    if re.search(r"No space left on device|Errno 28|not enough space on the disk", text):
        return "The disk is full; free some space, then press Make Environment again."
    network = (
        r"NewConnectionError|ConnectionError|Temporary failure in name resolution|timed out"
        r"|getaddrinfo failed|Network is unreachable|Max retries exceeded|ProxyError|SSLError"
    )
    if re.search(network, text):
        return (
            "The package registry cannot be reached; check the network and proxy of this "
            "computer, then press Make Environment again."
        )
    errors = [line.strip() for line in lines if "ERROR" in line or line.startswith("Error")]
    last = errors[-1] if errors else next((x for x in reversed(lines) if x.strip()), "no reason")
    return f"The environment could not be made: {last[:300]}"


def _put_in_place(partial: Path, target: Path) -> None:
    """Rename, with the earlier environment moved aside until the new one is there.

    Only the scripts of a virtual environment know where it lies, and those are not used: its
    Python finds the rest by itself.
    """
    aside = target.with_name(f"{target.name}.{secrets.token_hex(4)}.old")
    try:
        if target.exists():
            _rename(target, aside)
        try:
            _rename(partial, target)
        except OSError:
            if aside.exists():
                _rename(aside, target)
            raise
    except OSError as error:
        raise SetupError(
            f"{target} cannot be replaced ({error.strerror}); stop trainings that use it, then "
            "press Make Environment again."
        ) from error
    shutil.rmtree(aside, ignore_errors=True)


def _rename(old: Path, new: Path) -> None:
    """Virus scanners of Windows hold new files for a moment."""
    for left in range(_RENAME_TRIES - 1, -1, -1):
        try:
            os.replace(old, new)  # noqa: PTH105 - also of folders
            return
        except PermissionError:
            if not left:
                raise
            time.sleep(0.5)
