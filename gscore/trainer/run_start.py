"""Run start: from points, start splats, a checkpoint, or a run that is already complete."""

import contextlib
from pathlib import Path
from typing import Any

import numpy as np

from ..config import DataConfig, TrainConfig, limited_as, unlimited
from ..config_file import differences, load_config
from ..errors import ConfigError, FormatError, GsError
from ..formats import Decoded, read_decoded
from ..option_marks import mark_option
from .files import checkpoint
from .files.checkpoint import Checkpoint
from .files.run_folder import RunFolder
from .files.run_result import TrainResult, finished_run
from .model.checkpoint_schema import as_int_dict
from .model.training_frame import TrainingFrame, checkpoint_origin
from .photos.view_sampler import Photos
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
        self.splats: Decoded | None = None
        """Start splats, COLMAP world, until `resume`."""
        if config.start_splats is not None and self.ended is None:
            self.splats = read_decoded(config.start_splats)

    @property
    def resumes(self) -> bool:
        """True if the run resumes from a checkpoint."""
        return self._checkpoint is not None

    @property
    def taken(self) -> int:
        """Steps of the checkpoint; 0 without one."""
        return 0 if self._checkpoint is None else self._checkpoint.steps

    @property
    def origin(self) -> np.ndarray | None:
        """Local origin of the checkpoint, zeros if it has none; None: no checkpoint."""
        found = self._checkpoint
        if found is None:
            return None
        with checkpoint.checkpoint_errors(found.path):
            return checkpoint_origin(found.trainer["frame"])

    @property
    def wants_stereo(self) -> bool:
        """Whether to compute stereo points; a resumed run does so only if it started with them."""
        found = self._checkpoint
        return found is None or bool(found.session.get("stereo"))

    def facts(self) -> dict[str, Any]:
        """Values that worker ranks need for the same start, as JSON values."""
        found = self._checkpoint
        return {
            "taken": self.taken,
            "stereo": self.wants_stereo,
            "frame": None if found is None else found.trainer.get("frame"),
        }

    def frame(self, photos: Photos) -> TrainingFrame | None:
        """The training frame of the checkpoint; None: no checkpoint.

        Raises:
            ConfigError: the checkpoint has other photos, or other options that must not change.
            FormatError: it has no valid frame.
        """
        found = self._checkpoint
        if found is None:
            return None
        changed = self._other_capture_options() if self._resumes else []
        checkpoint.check_compatible(found, self._config, photos, changed=changed)
        with checkpoint.checkpoint_errors(found.path):
            return TrainingFrame.from_dict(found.trainer["frame"])

    def resume(self, trainer: Trainer, session: Session) -> None:
        """Restore trainer and session from the checkpoint, and release the data that was read.

        Raises:
            ConfigError: the checkpoint's depth maps, region or guides are not those of `trainer`.
            FormatError: it has invalid values.
            GsError: a damaged checkpoint cannot be renamed.
        """
        self.splats = None  # as large as the parameters
        found = self._checkpoint
        if found is None:
            return
        checkpoint.check_same_depth(found, trainer)
        checkpoint.check_same_region(found, trainer)
        checkpoint.check_same_guide(found, trainer)
        with checkpoint.checkpoint_errors(found.path):
            trainer.restore(found.trainer, found.tensors)
            session.restore(found.session)
        found.tensors.clear()  # the model replaces them as it grows
        if other_isa := checkpoint.isa_warning(found):
            session.warn(other_isa, "isa")
        for text in found.warnings:
            session.warn(text, "no_effect")
        for path in self._damaged:
            session.warn(_rename_damaged(path, found.steps), "damaged_checkpoint")

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
        raise GsError(f"Cannot rename the damaged {path}: {error.strerror}.") from error
    return f"{path.name} is damaged (now {renamed.name}); continuing from step {step} before it."
