"""Run start: from points, start splats, a checkpoint, or a run that is already complete."""

import contextlib
from dataclasses import replace
from pathlib import Path

from ..config import DataConfig, TrainConfig, limited_as, unlimited
from ..config_file import differences, load_config
from ..errors import ConfigError, FormatError, GsError
from ..formats import read_decoded
from ..io.files import reason
from ..option_marks import mark_option
from .files import checkpoint
from .files.checkpoint import Checkpoint
from .files.run_folder import RunFolder
from .files.run_result import TrainResult, finished_run
from .model.checkpoint_schema import as_int_dict
from .model.training_frame import TrainingFrame
from .photos.view_sampler import Photos
from .prepare import StartState
from .session import Session
from .trainer import Trainer


class RunStart:
    """Start state of a run, read before the photos so that invalid input fails early."""

    def __init__(
        self,
        folder: RunFolder,
        config: TrainConfig,
        data: DataConfig,
        *,
        resume: bool,
        start_checkpoint: Path | None,
    ) -> None:
        """Read the checkpoint and the start splats of the run, if any.

        Args:
            folder: Run folder.
            config: Training options.
            data: Capture options.
            resume: Resume from the last checkpoint in `folder`.
            start_checkpoint: Resume from this checkpoint of another folder.

        Raises:
            ConfigError: both `resume` and `start_checkpoint` are given, or a file is missing.
            FormatError: the given checkpoint, all checkpoints in the folder, or the file of start
                splats is damaged.
        """
        if resume and start_checkpoint is not None:
            raise ConfigError("Give either `--resume` or `--start-checkpoint`, not both.")
        self._folder, self._data = folder, data
        self._resumes = resume
        self._damaged: list[Path] = []
        self._checkpoint = self._last() if resume else None
        if start_checkpoint is not None:
            self._checkpoint = checkpoint.load(start_checkpoint)
        requested: dict[str, int] = {}
        if self._checkpoint is not None:
            with checkpoint.checkpoint_errors(self._checkpoint.path):
                requested = as_int_dict("asked", self._checkpoint.session.get("asked", {}))
            config = limited_as(config, requested, self._checkpoint.config)
        self._config = config
        """The options, capped as in the checkpoint where the requested values are the same."""
        self.config = unlimited(config, requested)
        """The options before caps by the number of photos."""
        self.ended = self._end()
        """Result of a run that is already complete; None: steps are left."""
        self.state = self._state()
        """State of the checkpoint, and start splats until `resume`."""

    @property
    def isa(self) -> str:
        """Identity of the bits of the steps taken so far; empty: none, or unknown."""
        return (self._checkpoint and self._checkpoint.isa) or ""

    def check(self, photos: Photos) -> None:
        """Check the capture against the checkpoint, if any.

        Raises:
            ConfigError: it has other photos, or other options that must not change.
        """
        if self._checkpoint is not None:
            changed = self._other_capture_options() if self._resumes else []
            checkpoint.check_compatible(self._checkpoint, self._config, photos, changed=changed)

    def resume(self, trainer: Trainer, session: Session) -> None:
        """Restore trainer and session from the checkpoint, and release the data that was read.

        Raises:
            ConfigError: the checkpoint's depth maps, region or guides are not those of `trainer`.
            FormatError: it has invalid values.
            GsError: a damaged checkpoint cannot be renamed.
        """
        self.state = replace(self.state, splats=None)  # as large as the parameters
        found = self._checkpoint
        if found is None:
            return
        checkpoint.check_same_inputs(found, trainer)
        with checkpoint.checkpoint_errors(found.path):
            trainer.restore(found.trainer, found.tensors)
            session.restore(found.session)
        found.tensors.clear()  # the model replaces them as it grows
        if other_isa := checkpoint.isa_warning(found, trainer):
            session.warn(other_isa, "isa")
        for text in found.warnings:
            session.warn(text, "no_effect")
        for path in self._damaged:
            session.warn(_rename_damaged(path, found.steps), "damaged_checkpoint")

    def _state(self) -> StartState:
        splats, found = None, self._checkpoint
        if self._config.start_splats is not None and self.ended is None:
            splats = read_decoded(self._config.start_splats)
        if found is None:
            return StartState(splats=splats)
        with checkpoint.checkpoint_errors(found.path):
            frame = found.trainer["frame"]
            TrainingFrame.from_dict(frame)
            # A resumed run computes stereo points only if it started with them.
            stereo = bool(found.session.get("stereo"))
            return StartState(taken=found.steps, stereo=stereo, frame=frame, splats=splats)

    def _last(self) -> Checkpoint | None:
        """The last intact checkpoint of the folder; later, damaged ones are recorded."""
        paths = self._folder.checkpoints()
        for path in reversed(paths):
            try:
                return checkpoint.load(path)
            except FormatError as error:
                self._damaged.append(path)
                if len(self._damaged) < len(paths):
                    continue
                if len(paths) == 1:
                    raise FormatError(f"{error} Or start again with `--overwrite`.") from error
                raise FormatError(
                    f"All {len(paths)} checkpoints in {path.parent} are damaged, the oldest: "
                    f"{error} Start again with `--overwrite`."
                ) from error
        return None

    def _end(self) -> TrainResult | None:
        """Result of the run in the folder, if it is complete and its last checkpoint intact."""
        if not self._resumes or self._checkpoint is None or self._damaged:
            return None
        return finished_run(self._folder, self._checkpoint, self._config, self._data)

    def _other_capture_options(self) -> list[str]:
        """Differences between the capture options and those of the run in the folder."""
        with contextlib.suppress(ConfigError):
            stored, _ = load_config(self._folder.config)
            found = differences(stored, self._data, ignore=("source", "rig", "test_list"))
            pairs = [change.partition(" ") for change in found]
            return [f"{mark_option(name)} {rest}" for name, _, rest in pairs]
        return []


def _rename_damaged(path: Path, step: int) -> str:
    """Rename a damaged checkpoint, so that it is not read again; returns a warning."""
    renamed = path.with_name(f"{path.name}.damaged")
    try:
        path.replace(renamed)
    except OSError as error:
        raise GsError(f"Cannot rename the damaged {path}: {reason(error)}") from error
    return f"{path.name} is damaged (now {renamed.name}); continuing from step {step} before it."
