"""Sequence index: sequence.json, updated without locks by all processes that train frames."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from ..._version import __version__
from ...io.sequences import SequenceIndex, write_sequence
from ...sequence_options import SequenceOptions
from .frame_results import FrameResult, SequenceResult, completed
from .plan import PlannedFrame


class SequenceListing:
    """Complete frames of a sequence, trained by any process."""

    def __init__(
        self, output: Path, options: SequenceOptions, frames: Sequence[PlannedFrame]
    ) -> None:
        self._output, self._options, self._frames = output, options, frames
        self._known: dict[int, FrameResult] = {}

    def refresh(self) -> None:
        """Find frames that other processes have completed.

        Raises:
            ConfigError: a frame was trained with other options.
        """
        for place, frame in enumerate(self._frames):
            found = None if place in self._known else completed(frame)
            if found is not None:
                self._known[place] = found

    def add(self, place: int, result: FrameResult) -> None:
        """Add a complete frame."""
        self._known[place] = result

    def get(self, place: int) -> FrameResult | None:
        """Return the frame at index `place` if it is known to be complete."""
        return self._known.get(place)

    def result(self, reason: str, places: Sequence[int]) -> SequenceResult:
        """Return the result of the sequence, or of the part at `places`."""
        return SequenceResult(
            reason=reason,
            total=len(places),
            frames=[self._known[place] for place in places if place in self._known],
            output=self._output,
        )

    def write(self) -> None:
        """Write sequence.json, and again if another process completed a frame meanwhile, so that
        the last writer lists all frames in order.

        Raises:
            GsError: the file cannot be written.
        """
        written = -1
        self.refresh()
        while written != len(self._known):
            written = len(self._known)
            whole = self.result("", range(len(self._frames)))
            index = SequenceIndex(
                options=asdict(self._options),
                frames=[frame.to_dict(self._output) for frame in whole.frames],
                mean=whole.headline,
            )
            write_sequence(self._output, index, version=__version__)
            self.refresh()
