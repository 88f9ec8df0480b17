"""Training job: a trainer process in the background, its events and its commands; no bpy."""

import threading
import time
import uuid
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ..core import Snapshot, clear_run
from ..process.background_task import Latest, start_thread
from ..process.child_program import Process
from . import run_state
from .loader import Loaded, load

STOP_GRACE = 120.0
"""Seconds without output after which a stopping trainer is killed."""
SILENT = 20.0
"""Seconds without output after which the panel reports it."""


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
            arguments: Arguments of `gscore`, see `options`.
            source: Folder of the capture.
            output: Folder of the results.
            resumed: True for a resumed run, whose folder is never removed.
            replaces: True if it replaces an earlier run there.
            earlier_source: Folder of the capture when a resumed run was started.
            scene_uid: Session uid of the scene that started it.

        Raises:
            OSError: `python` cannot be run.
        """
        self.id = uuid.uuid4().hex[:8]
        self.python, self.source, self.output = str(python), source, output
        self.resumed = resumed
        self.may_replace = resumed or replaces
        """True if the splats of an earlier run in the same folder may be replaced."""
        self.sources = (source,) if earlier_source is None else (source, earlier_source)
        """Current and earlier folders of the capture."""
        self.scene_uid = scene_uid
        self.state = run_state.RunState()
        self.live_seconds = 0.0
        """Seconds between two requested snapshots; 0: none."""
        self.live_most = 0
        """Maximum number of splats of a snapshot; 0: all."""
        self.loader: Latest[Callable[[], Loaded], Loaded]
        self.loader = Latest(lambda read: read(), "gscore-loader")
        self.awaits_import = False
        """True while the result is not shown yet."""
        self.result_requested = False
        """True once the loader has received the result."""
        self.filling: Any = None
        """The running import of splats; set by `display`."""
        self.preparations: list[Callable[[], Any]] = []
        """Remaining preparations of the import, one per poll; set by `start_training` and
        `display`."""
        self.preview_shown = ""
        self.has_events = False
        """True if the last poll received events; set by `display`."""
        self._discarding = False
        self._clearer: threading.Thread | None = None
        self._snapshot_requested_at = time.monotonic()
        self._snapshot_pending = False
        self._process = Process([str(python), "-u", "-m", "gscore", *arguments])

    @property
    def pid(self) -> int:
        """Process id of the trainer."""
        return self._process.pid

    @property
    def antialias(self) -> bool:
        """True if the run was trained with antialiasing, which renders must use too."""
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
        """Message on a long time without output; else empty."""
        if self.silent_s < SILENT:
            return ""
        return f"No response for {self.silent_s:.0f} s"

    def poll(self, budget: float = run_state.BUDGET) -> bool:
        """Process the trainer's events since the last call.

        Args:
            budget: Maximum duration, seconds; the next call reads the rest.

        Returns:
            True if something changed.
        """
        if self.state.ended:
            return False
        changed = False
        for event in run_state.events(self._process.lines(budget)):
            changed = True
            self.state.apply(event)
            if isinstance(event, Snapshot):
                self._snapshot_pending = False
                self.load(Path(event.path), most=self.live_most)
        if self._process.ended and not self._clearing():
            self._end()
            return True
        if self.state.status == run_state.STOPPING and self.silent_s > STOP_GRACE:
            self._process.kill()
        due = time.monotonic() - self._snapshot_requested_at >= self.live_seconds > 0
        if due and not self._snapshot_pending and self.state.status == run_state.RUNNING:
            self.snapshot()
        return changed

    def load(self, path: Path, *, most: int = 0, final: bool = False) -> None:
        """Read a splat file soon, instead of a waiting one; arguments as `loader.load`."""
        self.loader.submit(partial(load, path, most=most, final=final))

    def pause(self) -> None:
        """Pause the trainer; it keeps its memory and uses no core."""
        self._process.send("pause")

    def unpause(self) -> None:
        """Continue a paused trainer."""
        self._process.send("resume")

    def snapshot(self) -> None:
        """Request a snapshot of the current splats."""
        self._snapshot_pending, self._snapshot_requested_at = True, time.monotonic()
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
        """Kill the trainer; written checkpoints stay."""
        self._process.kill()

    def discard(self) -> None:
        """Kill the trainer and remove the files of this run, unless it was resumed."""
        self._discarding, self.awaits_import = True, False
        self._process.kill()

    def wait(self, timeout: float) -> bool:
        """Wait for the process without reading its events; True if it has ended."""
        return self._process.wait(timeout)

    def _end(self) -> None:
        state = self.state
        if self._discarding:
            state.status, state.eta_s = run_state.DISCARDED, None
            earlier = self.output / "point_cloud.ply"
            if self.resumed and earlier.is_file():
                state.result, self.awaits_import = earlier, True
            state.sentence = "Discarded; the files of this run were removed."
            if self.resumed:
                state.sentence = (
                    "Stopped; the steps since the last checkpoint were discarded, earlier files of "
                    "the run are kept."
                )
            elif state.started is None:
                state.sentence = "Discarded before the first step."
            return
        state.end(self._process.returncode, self._process.stderr_tail, python=self.python)
        if state.result is not None:
            self.awaits_import = True

    def _clearing(self) -> bool:
        """True while files of a discarded run are being removed, in a thread for slow disks."""
        # A trainer that has not started has written nothing, so the files belong to others.
        if not self._discarding or self.resumed or self.state.started is None:
            return False
        if self._clearer is None:
            self._clearer = start_thread(lambda: clear_run(self.output), "gscore-clearer")
        return self._clearer.is_alive()
