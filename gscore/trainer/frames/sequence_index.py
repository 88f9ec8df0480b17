"""Sequence index: sequence.json, kept current by all processes that train frames, lock-free."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from ..._version import __version__
from ...io.sequences import SequenceIndex, write_sequence
from ...sequence_options import SequenceOptions
from .frame_results import FrameResult, SequenceResult, completed
from .plan import PlannedFrame


class SequenceListing:
    """The complete frames of a sequence, by whichever process they were trained."""

    def __init__(
        self, output: Path, options: SequenceOptions, frames: Sequence[PlannedFrame]
    ) -> None:
        self._output, self._options, self._frames = output, options, frames
        self._known: dict[int, FrameResult] = {}

    def refresh(self) -> None:
        """Find the frames that others have completed.

        Raises:
            ConfigError: one of them was trained with other options.
        """
        for place, frame in enumerate(self._frames):
            found = None if place in self._known else completed(frame)
            if found is not None:
                self._known[place] = found

    def add(self, place: int, result: FrameResult) -> None:
        """Note a frame that is complete."""
        self._known[place] = result

    def get(self, place: int) -> FrameResult | None:
        """The frame at a place, if it is complete and that is known."""
        return self._known.get(place)

    def result(self, reason: str, places: Sequence[int]) -> SequenceResult:
        """How the sequence, or this part of it, ended."""
        return SequenceResult(
            reason=reason,
            total=len(places),
            frames=[self._known[place] for place in places if place in self._known],
            output=self._output,
        )

    def write(self) -> None:
        """Write sequence.json, and again where another process has completed a frame meanwhile: so
        whoever writes last lists them all, in the order of the frames.

        Raises:
            GsError: it cannot be written.
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
