"""Run folder: paths inside the output folder, its owner, and the lock of the run that writes."""

import contextlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from ...config import DataConfig
from ...errors import ConfigError, GsError
from ...io.files import atomic_write, reason
from ...io.lock import FolderLock
from ...io.output_paths import check_output_path
from ...io.runs import (
    RUN_LOCK,
    check_replaceable,
    checkpoint_path,
    checkpoints_in,
    clear_unfinished,
    remove_results,
    results_in,
)
from ...io.sequences import SEQUENCE_FILE
from ...quoting import brief


class RunFolder:
    """Names of the results of a run."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def config(self) -> Path:
        """Options of the run."""
        return self.path / "config.json"

    @property
    def point_cloud(self) -> Path:
        """The splats at the end."""
        return self.path / "point_cloud.ply"

    def saved(self, step: int) -> Path:
        """The splats after `step`, where 3DGS tools look for them."""
        return self.path / "point_cloud" / f"iteration_{step}" / "point_cloud.ply"

    def snapshot(self, step: int) -> Path:
        """The splats after `step`, on request."""
        return self.path / "snapshots" / f"step_{step:06d}.ply"

    def preview(self, step: int) -> Path:
        """A picture of one view after `step`."""
        return self.path / "previews" / f"step_{step:06d}.png"

    def checkpoint(self, step: int) -> Path:
        """The checkpoint after `step`."""
        return checkpoint_path(self.path, step)

    def checkpoints(self) -> list[Path]:
        """All checkpoints, the latest last."""
        return list(checkpoints_in(self.path).values())

    def drop_checkpoints(self, *, keep: int, protected: Collection[int]) -> None:
        """Remove all but the last `keep` checkpoints and those of the steps in `protected`."""
        spared = {self.checkpoint(step) for step in protected}
        droppable = [path for path in self.checkpoints() if path not in spared]
        for path in droppable[: max(len(droppable) - keep, 0)]:
            path.unlink(missing_ok=True)

    def drop_checkpoints_after(self, step: int) -> None:
        """Remove the checkpoints of later steps, which lead where the run does not go any more."""
        for path in self.checkpoints():
            if path > self.checkpoint(step):
                path.unlink(missing_ok=True)

    def results(self) -> list[str]:
        """Names of files and folders here that a run has written."""
        return results_in(self.path)

    def clear(self) -> None:
        """Remove what a run has written, and nothing else."""
        remove_results(self.path)

    def write_text(self, name: str, text: str) -> None:
        """Write a small file completely or not at all."""
        atomic_write(self.path / name, text.encode())


@contextmanager
def open_folder(
    path: Path, *, resume: bool, overwrite: bool, data: DataConfig | None = None
) -> Iterator[RunFolder]:
    """Hold an output folder, alone, for the duration of a run.

    Args:
        path: Made if it is not there; removed again if nothing was written into it.
        resume: It must hold a checkpoint.
        overwrite: It may hold another run.
        data: The capture, among which results must not go.

    Raises:
        ConfigError: it holds another run, something else of that name, or none to resume; or it
            is no place for results.
        GsError: another process trains into it, or it cannot be written.
    """
    folder = RunFolder(path)
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except (OSError, ValueError) as error:  # others answer otherwise to `exists` and `glob`
        raise GsError(f"Cannot use {brief(path)}: {reason(error)}") from error
    check_output_path(path, data)
    if resume:
        _check_begun(folder)
    new = not path.exists()
    lock = _lock(path)
    try:
        lock.take()
        if not resume:
            _check_room(folder, overwrite=overwrite)
        clear_unfinished(path)
        yield folder
    finally:
        lock.release()
        if new:
            with contextlib.suppress(OSError):
                path.rmdir()  # only an empty folder can be removed


def _check_begun(folder: RunFolder) -> None:
    """ConfigError unless a folder holds a checkpoint."""
    if not folder.checkpoints():
        check_free(folder.path)
        raise ConfigError(f"{folder.path} holds no checkpoint to resume from; leave --resume out.")


def _check_room(folder: RunFolder, *, overwrite: bool) -> None:
    """ConfigError unless another run may be written into a folder."""
    path, names = folder.path, folder.results()
    if (path / SEQUENCE_FILE).exists():
        raise ConfigError(f"{path} holds a sequence, of many runs; choose another folder.")
    check_replaceable(path)
    if names and not overwrite:
        raise ConfigError(
            f"{path} holds another run ({', '.join(names)}); continue it with --resume, replace it "
            "with --overwrite, or choose another folder."
        )


def check_writable(path: Path, *, resume: bool, overwrite: bool) -> None:
    """Raise what `open_folder` would, before work that comes first; nothing is made.

    Raises:
        ConfigError, GsError: as `open_folder`.
    """
    check_free(path)
    if resume:
        _check_begun(RunFolder(path))
    else:
        _check_room(RunFolder(path), overwrite=overwrite)


def check_free(path: Path) -> None:
    """Raise unless nobody trains into a folder now.

    Raises:
        GsError: another process does.
    """
    _lock(path).check_free()


def _lock(path: Path) -> FolderLock:
    return FolderLock(path, RUN_LOCK, "training")
