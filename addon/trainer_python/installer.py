"""Installer of the add-on's own Python environment for training; no bpy.

It runs only when the user presses the button. The environment is built under a temporary name
and renamed when it is complete, so that after a failure an earlier one is unchanged. Only one
Blender installs at a time, and removes the leftovers of one that was killed.
"""

import math
import os
import platform
import re
import secrets
import shutil
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from ..core import FolderLock, GsError
from ..process.background_task import BackgroundTask
from ..process.child_program import Process
from . import pins
from .environment import check, python_in

_WITHOUT_TORCH = 2000
"""Required free space for the other packages unpacked and their downloads, MB."""
_TORCH = 2.5
"""Required free space for torch, unpacked and its download, per download; measured with CUDA."""
OFFLINE = (
    "Blender does not allow add-ons to go online; switch on Preferences > System > Network > Allow "
    "Online Access, then press Make Environment again."
)
_OLDEST = (3, 11)


class SetupError(Exception):
    """The environment cannot be made; the message gives the reason and the remedy."""


def make(
    target: Path,
    wheel: Path,
    task: BackgroundTask,
    *,
    online: bool,
    base: Path | None = None,
    cpu: bool = True,
) -> Path:
    """Make the environment `target` with gscore from `wheel` and all dependencies of training.

    Installs the packages that `pins` lists, in exact versions and, except for torch without CUDA,
    with checked hashes.

    Args:
        target: Folder of the environment; replaced if it exists.
        wheel: gscore for this system.
        task: Receives the progress; may cancel.
        online: Whether Blender allows add-ons to go online.
        base: The Python to build on; None: Blender's own, or an installed one.
        cpu: Prefer torch without CUDA.

    Returns:
        The environment's Python.

    Raises:
        SetupError: no network, no space, no venv, a package cannot be installed, or another
            Blender is installing.
        Cancelled: the task was cancelled.
    """
    if not online:
        raise SetupError(OFFLINE)
    try:
        with _turn(target):
            _check_space(target, cpu)
            _make(target, wheel, task, base=base, cpu=cpu)
    except GsError as error:
        raise SetupError(str(error)) from error
    task.report("Done")
    return python_in(target)


def _make(target: Path, wheel: Path, task: BackgroundTask, *, base: Path | None, cpu: bool) -> None:
    partial = _name(target, _NEW)
    try:
        _make_venv(partial, base or usable_base(), task)
        python = python_in(partial)
        for step in steps(python, wheel, cpu=cpu):
            task.report(step.words)
            _run(step.arguments, task, step.variables)
        task.report("Checking")
        verdict = check(python, task)
        if not verdict.good:
            raise SetupError(f"The new environment does not work: {verdict.sentence}")
        task.check()
        _put_in_place(partial, target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


@dataclass(frozen=True)
class Step:
    """One pip call of the installation."""

    words: str
    """Message shown during the call."""
    arguments: list[str]
    variables: Mapping[str, str] = field(default_factory=dict)
    """Environment variables in addition to the inherited ones."""


def steps(python: Path, wheel: Path, *, cpu: bool) -> list[Step]:
    """The calls of pip that fill an environment, in order.

    No call resolves dependencies, because each list is complete. A package comes from one source
    only: with hashes, the registry or mirror of pip's own settings; without, the index of the
    list, whatever pip's settings.
    """
    lists = [
        ("Updating pip", pins.pip(), []),
        ("Downloading torch, the largest of the packages", pins.torch(cpu=cpu), _PROGRESS),
        ("Downloading the other packages", pins.rest(), _PROGRESS),
    ]
    calls = [_install(python, words, pinned, more) for words, pinned, more in lists]
    own = [*_pip(python), "--no-deps", "--no-index", str(wheel)]
    return [*calls, Step("Installing gscore", own)]


def _install(python: Path, words: str, pinned: pins.Pins, more: list[str]) -> Step:
    what = [*more, "--no-deps", "--only-binary", ":all:", "-r", str(pinned.file)]
    if pinned.hashed:
        return Step(words, [*_pip(python), "--require-hashes", *what])
    # Neither configuration files nor variables of pip may add a second source.
    alone = {"PIP_CONFIG_FILE": os.devnull}
    return Step(words, [*_pip(python, "--isolated"), "--index-url", pinned.index, *what], alone)


def contents(wheel: Path, target: Path, *, cpu: bool) -> list[str]:
    """Sentences on what `make` installs: packages, size and source.

    Raises:
        SetupError: the packages are not made for this system.
    """
    torch, rest = pins.torch(cpu=cpu), pins.rest()
    if not rest.megabytes:
        raise SetupError(
            f"The packages for training are not made for this system ({pins.system()}); choose a "
            "Python that has gscore and torch in the add-on's preferences."
        )
    size = f"about {torch.megabytes} MB, " if torch.megabytes else ""
    registry = f"{pins.REGISTRY}, or the mirror that pip is set up for"
    others = ", ".join(rest.packages)
    checked = "each file checked against a hash in this extension"
    how = checked if torch.hashed else "that index only, with its hash"
    where = registry if torch.index == pins.REGISTRY else torch.index
    return [
        f"A Python environment is made in {target}; an earlier one there is replaced at the end. "
        f"The installation needs {needed_gigabytes(cpu=cpu)} GB of disk space.",
        f"gscore, from this extension: {wheel.name}.",
        f"{', '.join(torch.packages)}: {size}from {where}, {how}.",
        f"About {rest.megabytes + pins.pip().megabytes} MB from {registry}, {checked}: "
        f"{', '.join(pins.pip().packages)}, {others}.",
    ]


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
        SetupError: no Python 3.11 or later is available.
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


_PROGRESS = ["--progress-bar", "raw"]


def _pip(python: Path, *more: str) -> list[str]:
    options = ("--no-input", "--disable-pip-version-check", *more)
    return [str(python), "-m", "pip", *options, "install"]


def _make_venv(folder: Path, base: Path, task: BackgroundTask) -> None:
    task.report(f"Making an environment with {base}")
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


def needed_gigabytes(*, cpu: bool) -> int:
    """Required free space, GB; `cpu` as in `make`."""
    return math.ceil((_WITHOUT_TORCH + _TORCH * pins.torch(cpu=cpu).megabytes) / 1000)


def _check_space(target: Path, cpu: bool) -> None:
    folder = next(p for p in (target, *target.parents) if p.exists())
    free = shutil.disk_usage(folder).free
    needed = needed_gigabytes(cpu=cpu)
    if free < 1e9 * needed:
        raise SetupError(
            f"The environment needs about {needed} GB, but {folder} has only "
            f"{free / 1e9:.1f} GB free; free some space, then press Make Environment again."
        )


def _run(
    arguments: Sequence[str | Path],
    task: BackgroundTask,
    variables: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Run a program and report its lines; SetupError with its reason if it fails."""

    def report(line: str) -> None:
        if shown := _readable(line):
            task.report(shown)

    try:
        process = Process([str(a) for a in arguments], variables=variables)
    except OSError as error:
        raise SetupError(f"{arguments[0]} cannot be run: {error.strerror or error}.") from error
    printed = process.output(task.check, report)
    if process.returncode:
        raise SetupError(_reason([*printed, *process.stderr_tail]))


def _readable(line: str) -> str:
    """A readable form of a line from pip; empty if it has no information."""
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
        r"connection broken by|NewConnectionError|ConnectionError|NameResolutionError"
        r"|Temporary failure in name resolution|timed out"
        r"|getaddrinfo failed|Network is unreachable|Max retries exceeded|ProxyError|SSLError"
    )
    if re.search(network, text):
        return _unreachable(text)
    if "DO NOT MATCH THE HASHES" in text:
        return (
            "A downloaded package differs from the one of this extension (another hash), so "
            "nothing was installed; try another network, and report it if that does not help."
        )
    errors = [line.strip() for line in lines if "ERROR" in line or line.startswith("Error")]
    last = errors[-1] if errors else next((x for x in reversed(lines) if x.strip()), "no reason")
    return f"The environment could not be made: {last[:300]}"


def _unreachable(text: str) -> str:
    """The sentence for an error of the network."""
    if "CERTIFICATE_VERIFY_FAILED" in text:
        return (
            "The package registry's certificate is not trusted, as behind some proxies; set the "
            "environment variable REQUESTS_CA_BUNDLE to a file with the proxy's certificate, start "
            "Blender again, then press Make Environment again."
        )
    match = re.search(r"host='([^']+)'", text)
    host = match[1] if match else "The package registry"
    other = ", or choose Default Build, which is from PyPI" if host in pins.TORCH_INDEX else ""
    return (
        f"{host} cannot be reached; check the network and proxy of this computer{other}, then "
        "press Make Environment again."
    )


def _put_in_place(partial: Path, target: Path) -> None:
    """Rename, with the earlier environment kept under another name until the new one is complete.

    Only the scripts of a virtual environment contain its path, and they are not used: its Python
    finds everything else relative to itself.
    """
    earlier = _name(target, _OLD)
    try:
        if target.exists():
            _rename(target, earlier)
        try:
            _rename(partial, target)
        except OSError:
            if earlier.exists():
                _rename(earlier, target)
            raise
    except OSError as error:
        raise SetupError(
            f"{target} cannot be replaced ({error.strerror}); stop trainings that use it, then "
            "press Make Environment again."
        ) from error
    shutil.rmtree(earlier, ignore_errors=True)


_NEW, _OLD = "new", "old"
_RENAME_TRIES = 5


@contextmanager
def _turn(target: Path) -> Iterator[None]:
    """Lock the folder of an environment, and remove leftovers of earlier installations.

    An earlier environment that was moved aside, with none in its place, is restored. The
    operating system releases the lock when the process ends, so no process works on leftovers
    while the lock is taken.

    Raises:
        GsError: another process has the lock, or the folder cannot be written or cleaned up.
    """
    lock = FolderLock(target.parent, f"{target.name}.lock", "Make Environment")
    try:
        lock.take()
    except GsError as error:
        if (process := lock.holder()) is None:
            raise
        number = f" (process {process})" if process else ""
        raise GsError(
            f"Another Blender{number} is making the environment in {target.parent}; wait until it "
            "is done, then press Check."
        ) from error
    try:
        _clean_up(target)
        yield
    finally:
        lock.release()


def _name(target: Path, ending: str) -> Path:
    """A name for an incomplete environment, or for the earlier one until the new one is in its
    place."""
    return target.with_name(f"{target.name}.{secrets.token_hex(4)}.{ending}")


def _rename(old: Path, new: Path) -> None:
    """Rename with retries, because virus scanners of Windows lock new files for a moment."""
    for left in range(_RENAME_TRIES - 1, -1, -1):
        try:
            os.replace(old, new)  # noqa: PTH105 - also of folders
            return
        except PermissionError:
            if not left:
                raise
            time.sleep(0.5)


def _clean_up(target: Path) -> None:
    name = re.compile(rf"{re.escape(target.name)}\.[0-9a-f]{{8}}\.({_NEW}|{_OLD})")
    left = [path for path in target.parent.iterdir() if name.fullmatch(path.name)]
    earlier = [path for path in left if path.suffix == f".{_OLD}"]
    if earlier and not target.exists():
        try:
            _rename(max(earlier, key=lambda path: path.stat().st_mtime), target)
        except OSError as error:
            raise GsError(
                f"The earlier environment in {target.parent} cannot be restored "
                f"({error.strerror}); rename its folder to {target.name}, then press Make "
                "Environment again."
            ) from error
    for path in left:
        shutil.rmtree(path, ignore_errors=True)
