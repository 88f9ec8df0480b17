"""Training job: a trainer process in the background, its events and its commands; no bpy."""

import threading
import time
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..core import Snapshot, clear_run
from ..process import threads
from ..process.child_program import Process
from . import run_state
from .loader import Loaded, Loader

STOP_GRACE = 120.0
"""Seconds without a sign of life after which a trainer that was asked to stop is killed."""
SILENT = 20.0
"""Seconds without a sign of life that are worth telling."""


class Job:
    """One training: the trainer's process and its state."""

    def __init__(
        self,
        python: str | Path,
        arguments: Sequence[str],
        *,
        source: Path,
        output: Path,
        resumed: bool = False,
        replaces: bool = False,
        earlier_source: Path | None = None,
        scene_uid: int = 0,
    ) -> None:
        """Start the trainer.

        Args:
            python: The Python that has gscore and torch.
            arguments: Of `gscore`, see `options`.
            source: Folder of the capture.
            output: Folder of the results.
            resumed: Whether the run began earlier; then its folder is never removed.
            replaces: Whether it replaces an earlier run there.
            earlier_source: Folder that the capture had when a resumed run began.
            scene_uid: Session number of the scene that it was started from.

        Raises:
            OSError: `python` cannot be run.
        """
        self.id = uuid.uuid4().hex[:8]
        self.python, self.source, self.output = str(python), source, output
        self.resumed = resumed
        self.may_replace = resumed or replaces
        """Whether the splats of an earlier run in the same folder may be replaced."""
        self.sources = (source,) if earlier_source is None else (source, earlier_source)
        """Folders that the capture has, and had."""
        self.scene_uid = scene_uid
        self.state = run_state.RunState()
        self.live_seconds = 0.0
        """Seconds between two requested snapshots; 0: none."""
        self.live_most = 0
        """Splats of a snapshot that are kept at most; 0: all."""
        self.loader = Loader()
        self.result_wanted = False
        """Whether the result still has to be shown."""
        self.result_requested = False
        """Whether the result is being read in order to be shown."""
        self.filling: Any = None
        """The running import of splats; set by `display`."""
        self.chores: list[Callable[[], Any]] = []
        """Preparations of the import that remain, one per poll; set by `start_training` and
        `display`."""
        self.preview_shown = ""
        self.told = False
        """Whether the last poll received events; set by `training_poller`."""
        self._discarding = False
        self._clearer: threading.Thread | None = None
        self._asked_for_live = time.monotonic()
        self._live_underway = False
        self._process = Process([str(python), "-u", "-m", "gscore", *arguments])

    @property
    def pid(self) -> int:
        """Number of the trainer's process."""
        return self._process.pid

    @property
    def antialias(self) -> bool:
        """Whether the run was trained with antialiasing, which renders must use too."""
        started = self.state.started
        train = started.config.get("train") if started else None
        return isinstance(train, dict) and train.get("antialias") is True

    @property
    def silent_s(self) -> float:
        """Seconds since the last event of a trainer that should send events."""
        if self.state.ended or self.state.status == run_state.PAUSED:
            return 0.0
        return time.monotonic() - self._process.last_line_at

    @property
    def silence(self) -> str:
        """A sentence on a trainer without events for long; else empty."""
        if self.silent_s < SILENT:
            return ""
        return f"No sign of life for {self.silent_s:.0f} s"

    def poll(self, budget: float = run_state.BUDGET) -> bool:
        """Process the trainer's events since the last call.

        Args:
            budget: Seconds to spend at most; what is left is taken by the next call.

        Returns:
            Whether something changed.
        """
        if self.state.ended:
            return False
        changed = False
        for event in run_state.events(self._process.lines(budget)):
            changed = True
            self.state.apply(event)
            if isinstance(event, Snapshot):
                self._live_underway = False
                self.loader.request(Path(event.path), most=self.live_most)
        if self._process.ended and not self._clearing():
            self._end()
            return True
        if self.state.status == run_state.STOPPING and self.silent_s > STOP_GRACE:
            self._process.kill()
        self._ask_for_live()
        return changed

    def take_loaded(self) -> Loaded | None:
        """The snapshot or result loaded since the last call."""
        return self.loader.take()

    def pause(self) -> None:
        """Pause the trainer; it keeps its memory and uses no core."""
        self._process.send("pause")

    def unpause(self) -> None:
        """Continue a paused trainer."""
        self._process.send("resume")

    def snapshot(self) -> None:
        """Request a snapshot of the current splats."""
        self._live_underway, self._asked_for_live = True, time.monotonic()
        self._process.send("snapshot")

    def stop(self) -> None:
        """Stop the trainer after it writes a checkpoint and its results."""
        if not self.state.ended:
            self.state.status = run_state.STOPPING
            self._process.send("stop")

    def leave(self) -> None:
        """Release the job because Blender quits: the trainer writes a checkpoint and ends."""
        self._process.end_input()

    def kill(self) -> None:
        """End the trainer at once; checkpoints that are written stay."""
        self._process.kill()

    def discard(self) -> None:
        """End the trainer at once and remove the files of this run, unless it was resumed."""
        self._discarding, self.result_wanted = True, False
        self._process.kill()

    def wait(self, timeout: float) -> bool:
        """Wait for the process without reading its events; return whether it has ended."""
        return self._process.wait(timeout)

    def _end(self) -> None:
        state = self.state
        if self._discarding:
            state.status, state.eta_s = run_state.DISCARDED, None
            earlier = self.output / "point_cloud.ply"
            if self.resumed and earlier.is_file():
                state.result, self.result_wanted = earlier, True
            state.sentence = "Discarded: the files of this run are removed."
            if self.resumed:
                state.sentence = (
                    "Stopped; what was trained since the last checkpoint is discarded, earlier "
                    "files of the run are kept."
                )
            elif state.started is None:
                state.sentence = "Discarded before the first step."
            return
        state.end(self._process.returncode, self._process.stderr_tail, python=self.python)
        if state.result is not None:
            self.result_wanted = True

    def _clearing(self) -> bool:
        """Whether files of a discarded run are being removed, which a slow disk makes long."""
        # Before it has started, a trainer has written nothing: files there are somebody else's.
        if not self._discarding or self.resumed or self.state.started is None:
            return False
        if self._clearer is None:
            self._clearer = threads.start(lambda: clear_run(self.output), "gscore-clearer")
        return self._clearer.is_alive()

    def _ask_for_live(self) -> None:
        due = time.monotonic() - self._asked_for_live >= self.live_seconds > 0
        if due and not self._live_underway and self.state.status == run_state.RUNNING:
            self.snapshot()
