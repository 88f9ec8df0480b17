"""Run folder: paths inside the output folder, its owner, and the lock of the run that writes."""

import contextlib
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from ...config import DataConfig, TrainConfig
from ...datasets.split import read_list, split_views
from ...errors import ConfigError, GsError
from ...formats import is_antialiased
from ...io.files import atomic_write, reason
from ...io.lock import FolderLock
from ...io.mesh.files import read_mesh
from ...io.output_paths import check_output_path
from ...io.region_file import read_region
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
from ...metrics.lpips import find_lpips
from ...quoting import brief
from ..depth.setup import depth_option_set
from . import checkpoint


class RunFolder:
    """Paths of the results of a run."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def config(self) -> Path:
        """Options of the run."""
        return self.path / "config.json"

    @property
    def point_cloud(self) -> Path:
        """Final splats."""
        return self.path / "point_cloud.ply"

    def saved(self, step: int) -> Path:
        """Splats after `step`, at the path of 3DGS tools."""
        return self.path / "point_cloud" / f"iteration_{step}" / "point_cloud.ply"

    def snapshot(self, step: int) -> Path:
        """Splats after `step`, written on request."""
        return self.path / "snapshots" / f"step_{step:06d}.ply"

    def preview(self, step: int) -> Path:
        """Rendered view after `step`."""
        return self.path / "previews" / f"step_{step:06d}.png"

    def checkpoint(self, step: int) -> Path:
        """Checkpoint after `step`."""
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
        """Remove checkpoints after `step`, which a run restarted from there no longer reaches."""
        for path in self.checkpoints():
            if path > self.checkpoint(step):
                path.unlink(missing_ok=True)

    def clear(self) -> None:
        """Remove only files and folders that a run wrote."""
        remove_results(self.path)

    def write_text(self, name: str, text: str) -> None:
        """Write a small file atomically."""
        atomic_write(self.path / name, text.encode())


@contextmanager
def open_folder(
    path: Path, *, resume: bool, overwrite: bool, data: DataConfig | None = None
) -> Iterator[RunFolder]:
    """Lock an output folder for the duration of a run.

    Args:
        path: Created if missing; removed again if it stays empty.
        resume: The folder must have a checkpoint.
        overwrite: The folder may contain another run.
        data: The capture, into which results must not be written.

    Raises:
        ConfigError: the folder contains another run, a foreign file of a result's name, or no
            checkpoint to resume; or results may not be written there.
        GsError: another process trains into it, or it is not writable.
    """
    folder = RunFolder(path)
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except (OSError, ValueError) as error:  # `exists` and `glob` would hide these errors
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
    """Raise ConfigError unless a folder has a checkpoint."""
    if not folder.checkpoints():
        check_free(folder.path)
        raise ConfigError(f"{folder.path} has no checkpoint to resume from; leave `--resume` out.")


def _check_room(folder: RunFolder, *, overwrite: bool) -> None:
    """Raise ConfigError unless a new run may be written into a folder."""
    path, names = folder.path, results_in(folder.path)
    if (path / SEQUENCE_FILE).exists():
        raise ConfigError(f"{path} contains a sequence of many runs; choose another folder.")
    check_replaceable(path)
    if names and not overwrite:
        raise ConfigError(
            f"{path} contains another run ({', '.join(names)}); continue it with `--resume`, "
            "replace it with `--overwrite`, or choose another folder."
        )


def check_writable(path: Path, *, resume: bool, overwrite: bool) -> None:
    """Raise the errors of `open_folder` without creating or locking the folder.

    Raises:
        ConfigError, GsError: as `open_folder`.
    """
    check_free(path)
    if resume:
        _check_begun(RunFolder(path))
    else:
        _check_room(RunFolder(path), overwrite=overwrite)


def check_free(path: Path) -> None:
    """Check that no other process trains into a folder.

    Raises:
        GsError: another process does.
    """
    _lock(path).check_free()


def _lock(path: Path) -> FolderLock:
    return FolderLock(path, RUN_LOCK, "training")


def check_option_files(
    config: TrainConfig,
    data: DataConfig,
    *,
    names: list[str] | None,
    start_checkpoint: Path | None,
) -> None:
    """Check the files named in options, before the cameras of a capture are estimated.

    The files of the capture itself cannot be checked yet.

    Args:
        config: The options.
        data: The capture, without cameras.
        names: Names of its photos, some of which may end up without a camera; None: unknown.
        start_checkpoint: Checkpoint to start from.

    Raises:
        GsError: a file is missing or invalid, the LPIPS network or its package is missing, the
            training or the test split is empty, or options require depth maps, which need cameras.
    """
    named: list[tuple[Path | None, Callable[[Path], object]]] = [
        (data.test_list, read_list),
        (start_checkpoint, checkpoint.load),
        (config.start_splats, is_antialiased),
        (config.region, read_region),
        (config.guide_surface, read_mesh),
        (config.guide_free, read_mesh),
        (config.lpips, lambda path: find_lpips(path, threads=config.threads)),
    ]
    for path, read in named:
        if path is not None:
            read(path)
    if names:
        split_views(sorted(names), data)
    option = f"`--depths {data.depths}`" if data.depths else depth_option_set(config)
    maps = Path(data.depths)
    if option and not (maps.is_absolute() and maps.is_dir()):  # relative to the capture
        raise ConfigError(
            f"{data.source} has no cameras yet, so no depth maps either. Leave {option} out; then "
            "`gscore depth OUTPUT/capture` writes maps, and `gscore train OUTPUT/capture -d depths`"
            " uses them."
        )
