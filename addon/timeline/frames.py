"""Sequence frames: the files of a folder that are frames, and the frame at a time; no bpy.

A sequence is the folder of `gscore sequence`, a folder of numbered files, or a folder of numbered
folders with a file each. Frames are identified by their numbers: 2 comes before 10, and a missing
number between others is a gap.
"""

import math
import os
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

from ..core import SPLAT_ENDINGS, GsError, read_sequence
from ..interface.option_labels import error_text

LOOP, HOLD, HIDE = "LOOP", "HOLD", "HIDE"
"""Behaviour before the first frame and after the last one."""
RESULT = "point_cloud.ply"
"""Splat file in the output folder of a training."""
_DIGITS = re.compile(r"\d+")
_ITERATION = re.compile(r"iteration_(\d+)")
_ENDINGS = tuple(ending for ending in SPLAT_ENDINGS if not ending.endswith(".json"))
_MOSTLY_GAPS = 10
"""Ratio of the range of numbers to files above which numbers are not frame counts, but for example
clock times."""
_NAMED = 5
"""Number of missing frames listed in a sentence."""
_ROUNDED = 6
"""Decimals of a speed, which Blender stores in single precision."""
_SLACK = 1e-6
"""Rounding tolerance of a time, frames."""


@dataclass(frozen=True)
class FrameFile:
    """The file of one frame."""

    number: int
    """Number in the name."""
    path: Path
    stamp: tuple[int, int]
    """Modification time, nanoseconds, and size, bytes, which identify the content."""

    @property
    def label(self) -> str:
        """Unique label within the sequence."""
        return f"{self.number} {self.path.name} {self.stamp}"


def stride_of(numbers: Sequence[int]) -> int:
    """Stride of increasing numbers; 0 if they are not frame counts."""
    found = math.gcd(*(b - a for a, b in pairwise(numbers))) or 1
    whole = (numbers[-1] - numbers[0]) // found + 1
    return found if whole <= _MOSTLY_GAPS * len(numbers) else 0


def slots_of(numbers: Sequence[int]) -> list[int]:
    """Slot of each of the increasing numbers, from 0; gaps count as slots."""
    stride = stride_of(numbers)
    return [(n - numbers[0]) // stride if stride else i for i, n in enumerate(numbers)]


@dataclass(frozen=True)
class Series:
    """The frames of a sequence."""

    files: tuple[FrameFile, ...]
    """Files, at least one, sorted by number, without duplicates."""
    name: str
    """Name pattern of the files, `#` for the number."""

    @cached_property
    def stride(self) -> int:
        """Stride of the numbers; 0 if they are not frame counts."""
        return stride_of([file.number for file in self.files])

    @property
    def slots(self) -> int:
        """Number of frames from the first to the last, including gaps."""
        if not self.stride:
            return len(self.files)
        return (self.files[-1].number - self.files[0].number) // self.stride + 1

    @cached_property
    def _by_slot(self) -> dict[int, FrameFile]:
        if not self.stride:
            return dict(enumerate(self.files))
        first = self.files[0].number
        return {(file.number - first) // self.stride: file for file in self.files}

    def at(self, slot: int) -> FrameFile:
        """The file of a slot, or for a gap the last one before it."""
        while slot not in self._by_slot:
            slot -= 1
        return self._by_slot[slot]

    @property
    def gaps(self) -> int:
        """Number of missing frames."""
        return self.slots - len(self.files)

    def gap_text(self) -> str:
        """Sentence about missing numbers; empty if none."""
        if not self.gaps:
            return ""
        first = self.files[0].number
        missing = (first + s * self.stride for s in range(self.slots) if s not in self._by_slot)
        named = [str(number) for number, _ in zip(missing, range(_NAMED), strict=False)]
        more = f" and {self.gaps - len(named)} more" if self.gaps > len(named) else ""
        what = "Frame" if self.gaps == 1 else "Frames"
        lacks = "is" if self.gaps == 1 else "are"
        return f"{what} {', '.join(named)}{more} {lacks} missing; the one before is shown."


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Mapping from timeline frames to the frames of a sequence."""

    start: int = 1
    """Frame of the timeline that shows the first one."""
    offset: int = 0
    """Number of frames to skip at the beginning of the sequence."""
    speed: float = 1.0
    """Frames of the sequence per frame of the timeline; below 0 it plays backwards."""
    step: int = 1
    """Show every n-th frame only, for the duration of the skipped ones too."""
    beyond: str = HOLD
    """LOOP, HOLD or HIDE."""

    def slot(self, frame: float, slots: int) -> int | None:
        """The slot, from 0, at a frame of the timeline; None: nothing is shown.

        Args:
            frame: Frame of the timeline, with its fraction.
            slots: Number of slots of the sequence.
        """
        first = min(max(self.offset, 0), slots - 1)
        count, speed = slots - first, round(self.speed, _ROUNDED)
        passed = math.floor((frame - self.start) * speed + _SLACK)
        if speed < 0:
            passed += count - 1
        if self.beyond == HIDE and not 0 <= passed < count:
            return None
        passed = passed % count if self.beyond == LOOP else min(max(passed, 0), count - 1)
        step = max(self.step, 1)
        return first + passed // step * step

    def ahead(self, frame: float, slots: int, count: int) -> Iterator[int]:
        """Unique slots of a timeline frame and of the `count` frames after it."""
        known = set()
        for further in range(count + 1):
            slot = self.slot(frame + further, slots)
            if slot is not None and slot not in known:
                known.add(slot)
                yield slot


def find_series(folder: Path, chosen: str = "") -> Series:
    """The frames in a folder.

    Args:
        folder: Output of `gscore sequence`, or a folder with numbered files or folders.
        chosen: Name pattern of the files, as `Series.name`; empty: the most frequent pattern.

    Raises:
        ValueError: the folder does not exist, or has no frames.
    """
    try:
        index = read_sequence(folder)
        frames = [] if index is None else index.frames  # the complete ones
        trained = {int(entry["frame"]): folder / entry["folder"] / RESULT for entry in frames}
        groups = {f"frame_#/{RESULT}": trained} if trained else _grouped(folder)
        name = chosen or max(groups, key=lambda key: (len(groups[key]), key), default="")
        files = _stamped(groups.get(name, {}))
    except GsError as error:
        raise ValueError(error_text(error)) from error
    except OSError as error:
        raise ValueError(
            f"The frame folder {folder} cannot be read ({error.strerror or error}): choose where "
            "it is now."
        ) from error
    if chosen and not files:
        raise ValueError(f"{folder} has no files named {chosen}: choose the folder again.")
    if not files:
        raise ValueError(
            f"{folder} has no frames: choose the output folder of gscore sequence, or a folder "
            f"with numbered splat files ({', '.join(_ENDINGS[:4])} ...)."
        )
    return Series(files=tuple(files), name=name)


def name_of_file(path: Path) -> tuple[Path, str]:
    """Folder and name pattern of the sequence of a chosen file.

    Raises:
        ValueError: it is not a numbered splat file.
    """
    folder = path.parent
    if _ITERATION.fullmatch(folder.name):
        folder = folder.parent.parent
    for place in (folder, folder.parent):
        beside = _grouped(place) if place.is_dir() else {}
        found = [name for name, files in beside.items() if path in files.values()]
        if found:
            return place, max(found, key=lambda name: (len(beside[name]), name))
    raise ValueError(f"{path.name} has no number in its name: choose a frame, or the folder.")


def _grouped(folder: Path) -> dict[str, dict[int, Path]]:
    """Files by number, by name pattern, `#` in place of the frame number."""
    groups: dict[str, dict[int, Path]] = defaultdict(dict)
    with os.scandir(folder) as entries:
        names = sorted((entry.name, entry.is_dir()) for entry in entries)
    for name, is_folder in names:
        if not _DIGITS.search(name) or not (is_folder or _holds_splats(name)):
            continue
        path = _inside(folder / name) if is_folder else folder / name
        if path is None:
            continue
        rest = f"/{path.name}" if is_folder else ""
        for digits in _DIGITS.finditer(name):
            called = f"{name[: digits.start()]}#{name[digits.end() :]}{rest}"
            groups[called].setdefault(int(digits.group()), path)
    return groups


def _stamped(named: Mapping[int, Path]) -> list[FrameFile]:
    """Existing files, by number."""
    found = []
    for number, path in sorted(named.items()):
        try:
            facts = path.stat()
        except OSError:
            continue  # a gap
        found.append(FrameFile(number, path, (facts.st_mtime_ns, facts.st_size)))
    return found


def _holds_splats(name: str) -> bool:
    return name.lower().endswith(_ENDINGS)


def _inside(folder: Path) -> Path | None:
    """Splat file in the folder of a frame: the result of a training, or the only one."""
    try:
        names = os.listdir(folder)  # noqa: PTH208 - names alone
        if RESULT in names:
            return folder / RESULT
        files = [name for name in names if _holds_splats(name)]
        if len(files) == 1:
            return folder / files[0]
        rounds = folder / "point_cloud"
        found = [(m, p) for p in rounds.iterdir() if (m := _ITERATION.fullmatch(p.name))]
    except OSError:
        return None
    last = max(found, key=lambda pair: int(pair[0].group(1)), default=None)
    return None if last is None or not (last[1] / RESULT).is_file() else last[1] / RESULT
