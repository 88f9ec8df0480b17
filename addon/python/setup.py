"""The Python for training as the preferences want it: found, checked and made beside Blender."""

from pathlib import Path
from typing import Any

import bpy

from ..core import __version__
from ..paths import ROOT
from ..process.background import Task
from . import environment, installer
from .environment import Verdict

_checking: Task | None = None
_making: Task | None = None
verdict: Verdict | None = None
"""What the last check found."""
make_problem = ""
"""Why the last environment was not made."""


def private_folder() -> Path:
    """Folder of the add-on's own environment, whether it is there or not."""
    try:
        base = bpy.utils.extension_path_user(ROOT)
    except ValueError:  # run from a checkout, not installed as an extension
        base = bpy.utils.user_resource("DATAFILES", path="gscore")
    return Path(base) / "trainer"


def bundled_wheel() -> Path | None:
    """gscore's wheel in the extension, for this system."""
    root = Path(__file__).parents[2]
    return installer.find_wheel([root / "wheels", root / "dist"], __version__)


def trainer_python(prefs: Any) -> Path:
    """The Python that trains: the chosen one, the add-on's own, or one that was found.

    Raises:
        ValueError: there is none, or the chosen one is not there.
    """
    if prefs.python_path.strip():
        python = environment.chosen_python(bpy.path.abspath(prefs.python_path))
        if python.is_file():
            return python
        raise ValueError(
            f"There is no Python {python}; choose another in the add-on's preferences, or clear "
            "the field and press Make Environment."
        )
    for python in (environment.python_in(private_folder()), Path(prefs.found_python or "/-")):
        if python.is_file():
            return python
    raise ValueError(
        "No Python for training is set up; press Find or Make Environment in the add-on's "
        "preferences."
    )


def start_check(prefs: Any) -> Task:
    """Look for a Python that can train, or check the chosen one; does not wait."""
    global _checking
    if _checking is None or not _checking.running:
        chosen = bpy.path.abspath(prefs.python_path) if prefs.python_path.strip() else ""
        private = private_folder()
        _checking = Task(lambda task: environment.find(task, chosen=chosen, private=private))
    return _checking


def check(prefs: Any) -> Verdict:
    """As `start_check`, and wait; for scripts.

    Raises:
        RuntimeError: the check itself failed.
    """
    task = start_check(prefs)
    task.wait(10 * environment.CHECK_TIMEOUT)
    collect(prefs)
    if task.result is None:
        raise RuntimeError(task.problem)
    return task.result


def start_make(prefs: Any, *, wheel: Path | None = None) -> Task:
    """Make the add-on's own environment; does not wait.

    Args:
        prefs: The preferences.
        wheel: gscore to install; None: the one in the extension.

    Raises:
        ValueError: there is no wheel, or it cannot go online.
    """
    global _making, make_problem
    if _making is not None and _making.running:
        return _making
    wheel, online = _wheel(wheel), bpy.app.online_access
    if not online:
        raise ValueError(installer.OFFLINE)
    target, cpu = private_folder(), prefs.torch_source == "CPU"
    make_problem = ""
    _making = Task(lambda task: installer.make(target, wheel, task, online=online, cpu=cpu))
    return _making


def contents(prefs: Any, *, wheel: Path | None = None) -> list[str]:
    """What `start_make` would install, how large, and from where, in sentences.

    Raises:
        ValueError: as `start_make`, or nothing is made for this system.
    """
    wheel = _wheel(wheel)
    if not bpy.app.online_access:
        raise ValueError(installer.OFFLINE)
    try:
        return installer.contents(wheel, private_folder(), cpu=prefs.torch_source == "CPU")
    except installer.SetupError as error:
        raise ValueError(str(error)) from error


def _wheel(chosen: Path | None) -> Path:
    wheel = chosen or bundled_wheel()
    if wheel is None:
        raise ValueError(
            f"This copy of the add-on holds no gscore {__version__} for this system; install the "
            "extension from its zip file, or choose a Python that has gscore."
        )
    return wheel


def make(prefs: Any, *, wheel: Path | None = None) -> Path:
    """As `start_make`, and wait; returns the environment's Python.

    Raises:
        ValueError: as `start_make`.
        RuntimeError: it could not be made; the message says why.
    """
    task = start_make(prefs, wheel=wheel)
    while not task.wait(3600):
        pass
    collect(prefs)
    if task.result is None:
        raise RuntimeError(task.problem)
    return task.result


def collect(prefs: Any) -> bool:
    """Take in what has ended; whether anything did. Called in Blender's main thread."""
    global _checking, _making, verdict, make_problem
    changed = False
    if _checking is not None and not _checking.running:
        task, _checking, changed = _checking, None, True
        if task.result is not None:
            verdict = task.result
            if verdict.good and not prefs.python_path.strip():
                prefs.found_python = verdict.python
    if _making is not None and not _making.running:
        task, _making, changed = _making, None, True
        make_problem = task.problem
        if not task.problem:
            start_check(prefs)
    return changed


def progress() -> list[str]:
    """What is under way, one line each."""
    return [t.last_line or "Checking" for t in (_checking, _making) if t is not None and t.running]


def making() -> bool:
    """Whether an environment is being made."""
    return _making is not None and _making.running


def busy() -> bool:
    """Whether anything is under way or waits for `collect`."""
    return _checking is not None or _making is not None


def cancel() -> None:
    """End whatever is under way; an environment that was there before stays."""
    for task in (_checking, _making):
        if task is not None:
            task.cancel()


def shut_down() -> None:
    """End whatever is under way and wait for it shortly, because the add-on is switched off."""
    global _checking, _making, verdict
    cancel()
    for task in (_checking, _making):
        if task is not None:
            task.wait(5.0)
    _checking = _making = verdict = None
