"""Asynchronous import of a folder of frames as an object that plays them."""

from dataclasses import replace
from pathlib import Path

import bpy

from ..splats import splat_files
from ..splats.async_import import AsyncImport
from ..splats.splat_files import ImportRequest
from . import mesh
from .frames import Series, find_series
from .importing import set_up_playback


class SequenceImport:
    """Import of a sequence: a thread finds the frames and reads the first, which is then written to
    Blender in chunks."""

    def __init__(
        self,
        context: bpy.types.Context,
        folder: Path,
        *,
        called: str,
        start: int,
        parent: bpy.types.Object | None,
        up: str,
    ) -> None:
        """Start the search for frames.

        Args:
            As `importing.import_sequence`.
        """
        self._folder, self._called, self._start = folder, called, start
        self._series: Series | None = None
        wanted = splat_files.import_request(folder, parent=parent, up=up)
        self._arrival = AsyncImport(context, [wanted], find=self._first, note=mesh.mark_of)

    @property
    def warnings(self) -> list[str]:
        """Warnings for the user."""
        return self._arrival.warnings

    @property
    def series(self) -> Series:
        """The frames, once the object exists."""
        assert self._series is not None
        return self._series

    @property
    def sentence(self) -> str:
        """Progress sentence."""
        return self._arrival.sentence

    def step(self) -> list[bpy.types.Object] | None:
        """Run a short step; the object once it exists.

        Raises:
            ValueError: there are no frames, or the first cannot be imported; nothing of it is left.
        """
        made = self._arrival.step()
        for ob, mark in zip(made or (), self._arrival.notes, strict=False):
            ob.name = ob.data.name = self._folder.name
            mesh.note(ob.data, self.series.files[0], mark)
            set_up_playback(ob, self._folder, called=self._called, start=self._start)
        return made

    def cancel(self) -> None:
        """Remove all partial results."""
        self._arrival.cancel()

    def _first(self, wanted: ImportRequest) -> ImportRequest:
        """Find the frames and the first one; runs in the thread."""
        self._series = find_series(self._folder, self._called)
        return replace(wanted, path=self._series.files[0].path)
