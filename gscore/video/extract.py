"""Frame extraction from a video: survey, selection, second decoding, writing."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..control import Control
from ..errors import Cancelled, DatasetError, FormatError
from ..events import FramesDone, FramesProgress, Show, Warn, seconds_left
from ..quoting import as_typed, brief
from ..text_format import count_text, number, time_text
from .frame_folder import FrameFolder
from .frame_image import upright_rgb
from .frame_survey import Survey, survey
from .request import FEWEST_FRAMES, ExtractRequest
from .source import VideoFacts, damage_text, opened_video

SPACING = 0.05
"""Default camera motion between two frames, share of the longer side."""
FEWEST, MOST = 30, 300
"""Range of the default number of frames."""
_BLURRED = 0.45
"""Frames with less than this share of the detail of sharp frames nearby are blurred."""
_NEARBY = 3.0
"""Window of nearby frames to each side, seconds."""
_SHARP = 75
"""Percentile of the detail nearby that counts as sharp."""
_MIN_DISTANCE = 0.35
"""Least motion between two frames, in sections."""
_CENTRE = 0.5
"""Reduction of the weight of a frame at the end of its section, relative to the middle."""


@dataclass(frozen=True, kw_only=True)
class Choice:
    """Selected frames, and statistics of the others."""

    frames: np.ndarray
    """[k] int64, numbers of the frames from 0, ascending."""
    sharpness: np.ndarray
    """[n] float64: detail as a share of that of sharp frames nearby."""
    blurred: int
    """Number of frames that were too blurred."""
    repeated: int
    """Number of frames equal to the one before."""
    gaps: list[tuple[float, float]]
    """Start and end in seconds of parts with camera motion but without sharp frames."""


def choose(survey: Survey, count: int) -> Choice:
    """Select the sharpest frame of each section of equal camera motion.

    Args:
        survey: Survey of all frames.
        count: Most frames; 0: one per 5 % of the picture's longer side, 30 to 300.
    """
    sharpness = relative_sharpness(survey)
    blurred = sharpness < _BLURRED
    usable = ~blurred & ~survey.repeated
    way = _way(survey, blurred)
    if count == 0:
        count = int(np.clip(round(way[-1] / SPACING), FEWEST, MOST))
    taken = _most_sections(way, sharpness, usable, count)
    return Choice(
        frames=taken,
        sharpness=sharpness,
        blurred=int((blurred & ~survey.repeated).sum()),
        repeated=int(survey.repeated.sum()),
        gaps=_gaps(survey, taken, blurred),
    )


def relative_sharpness(survey: Survey) -> np.ndarray:
    """[n]: detail as a share of that of sharp frames within three seconds.

    Detail is the variance of the Laplacian over the root of that at a quarter of the size: slight
    blur changes only the former, the content of the view both. If a long part is blurred
    completely, half of the video's usual detail counts as sharp.
    """
    detail = survey.fine / np.sqrt(survey.coarse + 1.0)
    usual = np.percentile(detail, _SHARP)
    first = np.searchsorted(survey.seconds, survey.seconds - _NEARBY, side="left")
    last = np.searchsorted(survey.seconds, survey.seconds + _NEARBY, side="right")
    sharp = np.array([np.percentile(detail[a:b], _SHARP) for a, b in zip(first, last, strict=True)])
    return detail / np.maximum(np.maximum(sharp, usual / 2), 1e-12)


def _way(survey: Survey, blurred: np.ndarray) -> np.ndarray:
    """[n]: camera motion, limited in blurred frames to its usual speed, because a shake moves far
    without useful frames, and would take sections away from useful parts."""
    steps = np.diff(survey.travel, prepend=survey.travel[0])
    sharp = ~blurred & ~survey.repeated
    usual = float(steps[sharp].mean()) if sharp.any() else 0.0
    return np.where(blurred, np.minimum(steps, usual), steps).cumsum()


def _most_sections(
    way: np.ndarray, sharpness: np.ndarray, usable: np.ndarray, count: int
) -> np.ndarray:
    """Frames of the largest number of sections that gives at most `count`; some have none."""
    best = _taken(way, sharpness, usable, count)
    low, high = count, max(4 * count, count + 1)
    while low + 1 < high and len(best) < count:
        middle = (low + high) // 2
        found = _taken(way, sharpness, usable, middle)
        if len(found) > count:
            high = middle
        else:
            low = middle
            best = found if len(found) > len(best) else best
    return best


def _taken(way: np.ndarray, sharpness: np.ndarray, usable: np.ndarray, sections: int) -> np.ndarray:
    length = way[-1] / sections
    if length <= 0:
        return np.flatnonzero(usable)[:1]
    place = way / length
    piece = np.minimum(place.astype(np.int64), sections - 1)
    worth = np.minimum(sharpness, 1.5) * (1 - _CENTRE * (2 * np.abs(place - piece - 0.5)) ** 2)
    taken: list[int] = []
    ends = np.searchsorted(piece, np.arange(sections + 1))
    for a, b in pairwise(ends):
        fits = usable[a:b].copy()
        if taken:
            fits &= place[a:b] - place[taken[-1]] >= _MIN_DISTANCE
        if fits.any():
            taken.append(int(a + np.where(fits, worth[a:b], -1.0).argmax()))
    return np.array(taken, np.int64)


def _gaps(survey: Survey, taken: np.ndarray, blurred: np.ndarray) -> list[tuple[float, float]]:
    """Parts between two selected frames with more than three times the median motion, and with
    blur."""
    if len(taken) < 3:
        return []
    ways = np.diff(survey.travel[taken])
    usual = np.median(ways)
    found = []
    for a, b, way in zip(taken, taken[1:], ways, strict=False):
        if way > 3 * usual and blurred[a:b].any():
            found.append((float(survey.seconds[a]), float(survey.seconds[b])))
    return found


_STILL = 0.02
"""Least camera motion of a usable video, share of the longer side."""


@dataclass(frozen=True, kw_only=True)
class Frames:
    """Extracted frames, written now or by an earlier run."""

    folder: Path
    names: tuple[str, ...]
    """File names, in order of time."""
    seconds: tuple[float, ...]
    """Time of each frame since the first frame of the video, s."""
    width: int
    """Pixels of the pictures."""
    height: int
    """Pixels of the pictures."""
    total: int
    """Number of frames in the video."""
    blurred: int
    """Number of frames that were too blurred."""
    repeated: int
    """Number of frames equal to the one before."""
    found: bool
    """True if an earlier run had written them."""
    took: float
    """Duration of the call, s."""
    warnings: tuple[str, ...]

    def facts(self) -> dict[str, Any]:
        """The result for JSON."""
        return {
            "folder": str(self.folder),
            "frames": len(self.names),
            "total": self.total,
            "blurred": self.blurred,
            "repeated": self.repeated,
            "width": self.width,
            "height": self.height,
            "found": self.found,
            "seconds": round(self.took, 2),
            "warnings": list(self.warnings),
        }

    def lines(self) -> list[str]:
        """The result as lines of text."""
        count = count_text(len(self.names), "frame")
        if self.found:
            return [f"{brief(self.folder)} already has the {count} of this video."]
        left = f"{number(self.blurred)} blurred and {number(self.repeated)} repeated left out"
        return [
            f"{count} of {number(self.total)} in {brief(self.folder)}, {self.width} x "
            f"{self.height} px; {left}; {time_text(round(self.took))}.",
            "Next: " + as_typed("sfm", self.folder, "-o", "CAPTURE", "--matching", "sequential"),
        ]


def extract_frames(
    request: ExtractRequest,
    *,
    on_event: Show = lambda event: None,
    control: Control | None = None,
    overwrite: bool = False,
) -> Frames:
    """Select frames of a video and write them into a folder, which appears when it is complete.

    A second call with the same video and options reuses them. The same file gives the same frames
    on every machine.

    Args:
        request: Video, output folder and number of frames.
        on_event: Receives `FramesProgress`, `Warn`, and `FramesDone` at the end.
        control: Requests to stop.
        overwrite: Replace frames of another request when the new ones are complete.

    Raises:
        Cancelled: stopped by `control`; nothing is left behind.
        DatasetError: there is no such file, no video stream in it, or no camera motion.
        FormatError: it is not a video, damaged, encrypted or of an unsupported codec.
        ConfigError: the output is taken.
        BackendError: PyAV is not installed.
        GsError: the output cannot be written.
    """
    return _Extraction(request, on_event, control or Control()).run(overwrite)


class _Extraction:
    """One extraction."""

    def __init__(self, request: ExtractRequest, show: Show, control: Control) -> None:
        self._request, self._show, self._control = request, show, control
        self._began = time.monotonic()
        self._warnings: list[str] = []

    def run(self, overwrite: bool) -> Frames:
        """Run the extraction, or return the frames of an earlier run."""
        folder = FrameFolder(self._request, overwrite=overwrite)
        if folder.found is not None:
            return self._done(folder.found, found=True)
        with folder.writing():
            if folder.found is not None:
                return self._done(folder.found, found=True)
            record = self._record(folder)
            folder.publish(record)
        return self._done(record, found=False)

    def _record(self, folder: FrameFolder) -> dict[str, Any]:
        """Survey, select and write frames; returns the record."""
        with opened_video(self._request.video) as video:
            facts = video.facts
            surveyed = survey(
                video,
                on_frame=self._counted("looking at frames", facts.frames),
                cancelled=self._stopping,
            )
            if warning := damage_text(video, float(surveyed.seconds[-1])):
                self._warn(warning)
        choice = choose(surveyed, self._request.frames)
        self._check(surveyed, choice)
        if facts.hdr:
            self._warn(f"The video is {facts.hdr}; its frames are tone-mapped to display range.")
        written, size = self._write(folder, facts, choice, surveyed)
        return {
            "width": size[0],
            "height": size[1],
            "total": len(surveyed.seconds),
            "blurred": choice.blurred,
            "repeated": choice.repeated,
            "warnings": self._warnings,
            "frames": written,
        }

    def _check(self, surveyed: Survey, choice: Choice) -> None:
        """Raise if SfM is impossible with the frames, warn if it will be hard."""
        name = brief(self._request.video)
        motion = float(surveyed.travel[-1])
        if motion < _STILL:
            raise DatasetError(
                f"The camera does not move in {name}: all frames show the same view. Walk around "
                "the subject while filming."
            )
        if len(choice.frames) < FEWEST_FRAMES:
            raise DatasetError(
                f"Only {count_text(len(choice.frames), 'frame')} of {name} can be used: "
                f"{number(choice.blurred)} of {number(len(surveyed.seconds))} are blurred. Film "
                "again, slower and with more light."
            )
        for begin, end in choice.gaps:
            self._warn(
                f"From {begin:.1f} s to {end:.1f} s the camera moves and every frame is blurred; "
                "cameras before and after may not join."
            )

    def _write(
        self, folder: FrameFolder, facts: VideoFacts, choice: Choice, surveyed: Survey
    ) -> tuple[list[dict[str, Any]], tuple[int, int]]:
        """Decode again and write the selected frames; returns rows for the record and the size."""
        selected = set(choice.frames.tolist())
        last, rows, size = int(choice.frames[-1]), [], (0, 0)
        report = self._counted("writing frames", len(selected))
        with opened_video(self._request.video) as video:
            for index, frame in enumerate(video.frames()):
                if self._stopping():
                    raise Cancelled("Writing frames was stopped.")
                if index not in selected:
                    continue
                pixels = upright_rgb(frame, facts)
                size = (pixels.shape[1], pixels.shape[0])
                rows.append(
                    {
                        "name": folder.put(index, pixels),
                        "seconds": round(float(surveyed.seconds[index]), 4),
                        "sharpness": round(float(choice.sharpness[index]), 4),
                        "travel": round(float(surveyed.travel[index]), 4),
                    }
                )
                report(len(rows))
                if index == last:
                    break
        if len(rows) != len(selected):
            raise FormatError(
                f"{brief(self._request.video)} changed while it was read. Try again when nothing "
                "writes to it."
            )
        return rows, size

    def _done(self, record: dict[str, Any], *, found: bool) -> Frames:
        rows = record["frames"]
        frames = Frames(
            folder=self._request.output,
            names=tuple(row["name"] for row in rows),
            seconds=tuple(row["seconds"] for row in rows),
            width=record["width"],
            height=record["height"],
            total=record["total"],
            blurred=record["blurred"],
            repeated=record["repeated"],
            found=found,
            took=time.monotonic() - self._began,
            warnings=tuple(record["warnings"]),
        )
        self._show(
            FramesDone(
                frames=len(rows),
                total=frames.total,
                blurred=frames.blurred,
                repeated=frames.repeated,
                seconds=frames.took,
                path=str(frames.folder),
            )
        )
        return frames

    def _counted(self, phase: str, total: int) -> Callable[[int], None]:
        began, reported = time.monotonic(), 0.0
        self._show(FramesProgress(phase=phase, done=0, total=total, eta_s=float("nan")))

        def report(done: int) -> None:
            nonlocal reported
            spent = time.monotonic() - began
            if spent - reported < 0.2 and done != total:
                return
            reported = spent
            left = seconds_left(began, done, total)
            self._show(FramesProgress(phase=phase, done=done, total=total, eta_s=left))

        return report

    def _warn(self, sentence: str) -> None:
        self._warnings.append(sentence)
        self._show(Warn(message=sentence))

    def _stopping(self) -> bool:
        return self._control.stopping
