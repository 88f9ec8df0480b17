"""Existing run in an output folder: its steps, capture and date; no bpy."""

import time
import zlib
from dataclasses import dataclass, replace
from pathlib import Path

from ..core import RunInfo, find_capture, read_run
from ..interface.option_labels import panel_text

_HASHED_BYTES = 65_536
"""Bytes at the beginning of a file that go into its fingerprint."""


@dataclass(frozen=True, kw_only=True)
class EarlierRun:
    """A run on disk."""

    info: RunInfo
    """Facts of the run; its problem has panel labels."""
    trained: float
    """Modification time of its newest file, seconds since the epoch."""
    content: str
    """`content` of its splats; empty without splats."""
    foreign: bool
    """True if it certainly belongs to another capture than the chosen one."""

    @property
    def words(self) -> str:
        """Folder, steps and date."""
        steps = f"{self.info.steps:,} steps" if self.info.checkpoint else "no checkpoint"
        date = time.strftime("%Y-%m-%d %H:%M", time.localtime(self.trained))
        return f"{self.info.path} ({steps}, written {date})"

    @property
    def foreign_text(self) -> str:
        """Message for a run of another capture: why it is not changed, and what to do."""
        whose = "" if self.info.data is None else f", {self.info.data.source}"
        return (
            f"The output folder has the run of another capture{whose}: {self.words}. Choose that "
            "capture again, or another output folder."
        )


def read_existing_run(folder: Path, capture: Path | None) -> EarlierRun | None:
    """The run in an output folder; None if no training has written there.

    Args:
        folder: The output folder.
        capture: The chosen capture path; None: no choice.
    """
    info = read_run(folder)
    if info is None:
        return None
    files = [info.path / "config.json", info.checkpoint, info.splats]
    times = [file.stat().st_mtime for file in files if file is not None and file.is_file()]
    # A capture that is missing may have moved.
    is_known = capture is not None and info.data is not None and info.data.source.exists()
    return EarlierRun(
        info=replace(info, problem=panel_text(info.problem)),
        trained=max(times, default=info.path.stat().st_mtime),
        content="" if info.splats is None else content(info.splats),
        foreign=is_known and find_capture(capture).resolve() != info.data.source.resolve(),
    )


def content(path: Path) -> str:
    """Fingerprint of a splat file from its size and first bytes; empty if there is none.

    Copies of a folder keep it, unlike dates.
    """
    try:
        with path.open("rb") as file:
            return f"{path.stat().st_size}-{zlib.crc32(file.read(_HASHED_BYTES)):08x}"
    except OSError:
        return ""
