"""Frame extraction from a video: survey, selection, second decoding, writing."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..control import Control
from ..errors import Cancelled, DatasetError, FormatError
from ..events import FramesDone, FramesProgress, Show, Warn
from ..quoting import as_typed, brief
from ..text_format import count_words, number, time_words
from .frame_folder import FrameFolder
from .frame_image import upright_rgb
from .frame_selection import Choice, choose
from .frame_survey import Survey, survey
from .request import FEWEST_FRAMES, ExtractRequest
from .source import VideoFacts, damage_words, opened_video

_STILL = 0.02
"""Of the longer side: a camera that goes less far has seen one view."""


@dataclass(frozen=True, kw_only=True)
class Frames:
    """Frames that were written, or found from a run before."""

    folder: Path
    names: tuple[str, ...]
    """Of the files, in the order of time."""
    seconds: tuple[float, ...]
    """When each is, from the first frame of the video on."""
    width: int
    """Pixels of the pictures."""
    height: int
    """Pixels of the pictures."""
    total: int
    """Frames of the video."""
    blurred: int
    """Frames that were too blurred."""
    repeated: int
    """Frames that showed the picture before them again."""
    found: bool
    """Whether a run before had written them."""
    took: float
    """Seconds."""
    warnings: tuple[str, ...]

    def facts(self) -> dict[str, Any]:
        """The outcome for JSON."""
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
        """The outcome for people."""
        count = count_words(len(self.names), "frame")
        if self.found:
            return [f"{brief(self.folder)} holds the {count} of this video already."]
        left = f"{number(self.blurred)} blurred and {number(self.repeated)} repeated left out"
        return [
            f"{count} of {number(self.total)} in {brief(self.folder)}, {self.width} x "
            f"{self.height} px; {left}; {time_words(round(self.took))}.",
            "Next: " + as_typed("sfm", self.folder, "-o", "CAPTURE", "--matching", "sequential"),
        ]


def extract_frames(
    request: ExtractRequest,
    *,
    on_event: Show = lambda event: None,
    control: Control | None = None,
    overwrite: bool = False,
) -> Frames:
    """Choose frames of a video and write them into a folder, which appears when all is done.

    A second call with the same video and options finds them there. The same file gives the same
    frames everywhere.

    Args:
        request: Which video, where to, and how many.
        on_event: Told how far it is: `FramesProgress`, `Warn`, at the end `FramesDone`.
        control: Asked whether to stop.
        overwrite: Frames of another request are replaced when the new ones are complete.

    Raises:
        Cancelled: `control` said so; nothing is left behind.
        DatasetError: there is no such file, no moving pictures in it, or no motion.
        FormatError: it is no video, damaged, encrypted or of a codec that is not there.
        ConfigError: the output is taken.
        BackendError: PyAV is not installed.
        GsError: the output cannot be written.
    """
    return _Extraction(request, on_event, control or Control()).run(overwrite)


class _Extraction:
    """One extraction from its beginning to its end."""

    def __init__(self, request: ExtractRequest, show: Show, control: Control) -> None:
        self._request, self._show, self._control = request, show, control
        self._began = time.monotonic()
        self._warnings: list[str] = []

    def run(self, overwrite: bool) -> Frames:
        """The extraction itself."""
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
        """Look, choose and write; what is to be known of it."""
        with opened_video(self._request.video) as video:
            facts = video.facts
            looked = survey(
                video,
                on_frame=self._counted("looking at frames", facts.frames),
                cancelled=self._stopping,
            )
            if sentence := damage_words(video, float(looked.seconds[-1])):
                self._warn(sentence)
        choice = choose(looked, self._request.frames)
        self._check(looked, choice)
        if facts.hdr:
            self._warn(f"The video is {facts.hdr}; its frames are brought to a screen's range.")
        written, size = self._write(folder, facts, choice, looked)
        return {
            "width": size[0],
            "height": size[1],
            "total": len(looked.seconds),
            "blurred": choice.blurred,
            "repeated": choice.repeated,
            "warnings": self._warnings,
            "frames": written,
        }

    def _check(self, looked: Survey, choice: Choice) -> None:
        """Raise where no cameras could be found, warn where it will be hard."""
        name = brief(self._request.video)
        way = float(looked.travel[-1])
        if way < _STILL:
            raise DatasetError(
                f"The camera stands still in {name}: all frames show the same view. Walk around "
                "the subject while filming."
            )
        if len(choice.frames) < FEWEST_FRAMES:
            raise DatasetError(
                f"Only {count_words(len(choice.frames), 'frame')} of {name} can be used: "
                f"{number(choice.blurred)} of {number(len(looked.seconds))} are blurred. Film "
                "again, slower and with more light."
            )
        for begin, end in choice.gaps:
            self._warn(
                f"From {begin:.1f} s to {end:.1f} s the camera moves and every frame is blurred; "
                "cameras before and after may not join."
            )

    def _write(
        self, folder: FrameFolder, facts: VideoFacts, choice: Choice, looked: Survey
    ) -> tuple[list[dict[str, Any]], tuple[int, int]]:
        """Decode again and write the chosen frames: rows for the record, width and height."""
        wanted = set(choice.frames.tolist())
        last, rows, size = int(choice.frames[-1]), [], (0, 0)
        tell = self._counted("writing frames", len(wanted))
        with opened_video(self._request.video) as video:
            for index, frame in enumerate(video.frames()):
                if self._stopping():
                    raise Cancelled("Writing frames was stopped.")
                if index not in wanted:
                    continue
                pixels = upright_rgb(frame, facts)
                size = (pixels.shape[1], pixels.shape[0])
                rows.append(
                    {
                        "name": folder.put(index, pixels),
                        "seconds": round(float(looked.seconds[index]), 4),
                        "sharpness": round(float(choice.sharpness[index]), 4),
                        "travel": round(float(looked.travel[index]), 4),
                    }
                )
                tell(len(rows))
                if index == last:
                    break
        if len(rows) != len(wanted):
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
        began, told = time.monotonic(), 0.0
        self._show(FramesProgress(phase=phase, done=0, total=total, eta_s=float("nan")))

        def tell(done: int) -> None:
            nonlocal told
            spent = time.monotonic() - began
            if spent - told < 0.2 and done != total:
                return
            told = spent
            left = spent / done * (total - done) if total >= done else float("nan")
            self._show(FramesProgress(phase=phase, done=done, total=total, eta_s=left))

        return tell

    def _warn(self, sentence: str) -> None:
        self._warnings.append(sentence)
        self._show(Warn(message=sentence))

    def _stopping(self) -> bool:
        return self._control.stopping
