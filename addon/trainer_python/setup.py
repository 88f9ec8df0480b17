"""Setup of the trainer's Python: search, check and installation in the background."""

from pathlib import Path
from typing import Any

import bpy

from .. import preferences
from ..core import __version__
from ..paths import own_folder
from ..process import poll_timer
from ..process.background_task import BackgroundTask
from . import environment, installer
from .environment import Verdict


def private_folder() -> Path:
    """Folder of the add-on's own environment, whether or not it exists."""
    return own_folder() / "trainer"


def trainer_python(prefs: Any) -> Path:
    """The trainer's Python: the chosen one, the add-on's own, or one that was found.

    Raises:
        ValueError: there is none, or the chosen one does not exist.
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


def contents(prefs: Any, *, wheel: Path | None = None) -> list[str]:
    """Sentences on what `start_make` installs: packages, size and source.

    Raises:
        ValueError: as `start_make`, or there are no packages for this system.
    """
    wheel = _wheel(wheel)
    if not bpy.app.online_access:
        raise ValueError(installer.OFFLINE)
    try:
        return installer.contents(wheel, private_folder(), cpu=prefs.torch_source == "CPU")
    except installer.SetupError as error:
        raise ValueError(str(error)) from error


def _wheel(chosen: Path | None) -> Path:
    root = Path(__file__).parents[2]
    wheel = chosen or installer.find_wheel([root / "wheels", root / "dist"], __version__)
    if wheel is None:
        raise ValueError(
            f"This copy of the add-on has no gscore {__version__} for this system; install the "
            "extension from its zip file, or choose a Python that has gscore."
        )
    return wheel


class Setup:
    """State of the trainer's Python: running checks and installations, and their results."""

    def __init__(self) -> None:
        self._checking: BackgroundTask | None = None
        self._making: BackgroundTask | None = None
        self.verdict: Verdict | None = None
        """Result of the check of the chosen Python; None: not checked."""
        self._chosen = ""
        """The Python in check."""
        self.make_problem = ""
        """Error message of the last installation."""
        self._shown: list[str] = []
        """`progress` at the last call of `collect`."""

    def start_check(self, prefs: Any) -> BackgroundTask:
        """Search for a Python that can train, or check the chosen one; does not wait."""
        chosen = bpy.path.abspath(prefs.python_path) if prefs.python_path.strip() else ""
        if self._checking is not None and self._checking.running:
            if chosen == self._chosen:
                return self._checking
            self._checking.cancel()
        private, self._chosen = private_folder(), chosen
        self._checking = BackgroundTask(
            lambda task: environment.find(task, chosen=chosen, private=private)
        )
        return self._checking

    def chosen(self, prefs: Any) -> None:
        """Drop the result of another Python, and check the chosen one, except in background mode,
        where scripts call `check`."""
        self.verdict = None
        if prefs.python_path.strip() and not bpy.app.background:
            self.start_check(prefs)
            poll_timer.ensure()

    def check(self, prefs: Any) -> Verdict:
        """Like `start_check`, but waits; for scripts.

        Raises:
            ValueError: the check itself failed.
        """
        task = self.start_check(prefs)
        task.wait(10 * environment.CHECK_TIMEOUT)
        self.collect(prefs)
        if task.result is None:
            raise ValueError(task.problem)
        return task.result

    def start_make(self, prefs: Any, *, wheel: Path | None = None) -> BackgroundTask:
        """Make the add-on's own environment; does not wait.

        Args:
            prefs: The preferences.
            wheel: gscore to install; None: the one in the extension.

        Raises:
            ValueError: there is no wheel, or it cannot go online.
        """
        if self._making is not None and self._making.running:
            return self._making
        wheel, online = _wheel(wheel), bpy.app.online_access
        if not online:
            raise ValueError(installer.OFFLINE)
        target, cpu = private_folder(), prefs.torch_source == "CPU"
        self.make_problem = ""
        self._making = BackgroundTask(
            lambda task: installer.make(target, wheel, task, online=online, cpu=cpu)
        )
        return self._making

    def make(self, prefs: Any, *, wheel: Path | None = None) -> Path:
        """Like `start_make`, but waits; returns the environment's Python.

        Raises:
            ValueError: as `start_make`, or it could not be made, with the reason.
        """
        task = self.start_make(prefs, wheel=wheel)
        while not task.wait(3600):
            pass
        self.collect(prefs)
        if task.result is None:
            raise ValueError(task.problem)
        return task.result

    def collect(self, prefs: Any) -> bool:
        """Collect finished tasks; return whether there were any, or other progress to draw. For the
        main thread."""
        before, self._shown = self._shown, self.progress()
        changed = self._shown != before
        if self._checking is not None and not self._checking.running:
            task, self._checking, changed = self._checking, None, True
            if task.result is not None:
                self.verdict = task.result
                if self.verdict.good and not prefs.python_path.strip():
                    prefs.found_python = self.verdict.python
        if self._making is not None and not self._making.running:
            task, self._making, changed = self._making, None, True
            self.make_problem = task.problem
            if not task.problem:
                self.start_check(prefs)
        return changed

    def progress(self) -> list[str]:
        """Messages of running tasks, one line each."""
        return [
            t.last_line or "Checking"
            for t in (self._checking, self._making)
            if t is not None and t.running
        ]

    def busy(self) -> bool:
        """Whether a task is running or its result is not collected."""
        return self._checking is not None or self._making is not None

    def cancel(self) -> None:
        """Cancel running tasks; an earlier environment is kept."""
        for task in (self._checking, self._making):
            if task is not None:
                task.cancel()

    def shut_down(self) -> None:
        """Cancel running tasks and wait shortly for their end, when the add-on is disabled."""
        self.cancel()
        for task in (self._checking, self._making):
            if task is not None:
                task.wait(5.0)
        self._checking = self._making = self.verdict = None


CURRENT = Setup()
"""Setup of this Blender session."""
_POLLER = poll_timer.Poller(lambda: CURRENT.collect(preferences.get()), CURRENT.busy)
APPENDED = ((poll_timer.POLLERS, _POLLER), (preferences.PYTHON_CHOSEN, CURRENT.chosen))


def on_unregister() -> None:
    """Cancel running tasks."""
    CURRENT.shut_down()
