"""Guide meshes of a sequence: written for each frame, as evaluated at that frame."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

import bpy

from ..cameras.lookup import root_from
from ..core import GUIDE_FILE, GUIDES, SequenceFrame, frame_pattern, write_mesh
from ..timeline import frame_sync
from ..timeline.frames import slots_of
from ..training import guides
from ..triangles import Triangles


def arguments(
    scene: bpy.types.Scene, frames: Callable[[], list[SequenceFrame]], output: Path
) -> tuple[list[str], Callable[[], None]]:
    """Write the guide meshes of a scene for a sequence into `output`.

    A role whose meshes never change has one file, else one file per frame.

    Returns:
        Options for the trainer, and a function that removes the files of the replaced sequence, to
        be called when the training begins, as that sequence can be resumed until then.

    Args:
        scene: Its guide collections, and the timeline frame of the first frame.
        frames: Returns the trained frames, ascending; not called without guides.
        output: Output folder of the sequence.

    Raises:
        ValueError: the cameras of the first frame are not in the scene, or a collection shows no
            mesh at a frame.
        GsError: a file cannot be written.
    """
    roles = list(guides.chosen(scene))
    if not roles:
        return [], lambda: None
    trained = frames()
    root = root_from(scene, trained[0].data.source)
    if root is None:
        raise ValueError(
            f"The meshes of {roles[0][1].name} must be aligned with the photos: import the cameras "
            f"of frame {trained[0].number} first, because all frames are trained in its world."
        )
    files = {role: _Files(output / GUIDES, role) for role, _ in roles}
    start = scene.gscore_train_sequence.guide_start
    places = [start + slot for slot in slots_of([frame.number for frame in trained])]
    manager = bpy.context.window_manager
    manager.progress_begin(0, len(trained))
    try:
        with _other_frames(scene):
            for done, (frame, place) in enumerate(zip(trained, places, strict=True)):
                scene.frame_set(place)
                for role, collection in roles:
                    found = _meshes_at(scene, collection, root, frame, place)
                    files[role].add(frame.number, found)
                manager.progress_update(done)
    finally:
        manager.progress_end()
    line = []
    for role, written in files.items():
        line += [f"--guide-{role}", str(written.close())]

    def replace() -> None:
        for written in files.values():
            written.remove_earlier()

    return line, replace


def _meshes_at(
    scene: bpy.types.Scene,
    collection: bpy.types.Collection,
    root: bpy.types.Object,
    frame: SequenceFrame,
    place: int,
) -> Triangles:
    try:
        return guides.merged_mesh(scene, collection, root)
    except ValueError as error:
        where = f"At frame {place} of the timeline, for frame {frame.number} of the sequence"
        raise ValueError(f"{where}: {error}") from error


class _Files:
    """Files of a role: one as long as all frames have the same mesh."""

    def __init__(self, folder: Path, role: str) -> None:
        self._folder, self._role = folder, role
        self._name = f"{role}-{uuid4().hex[:8]}"
        self._first: Triangles | None = None
        self._digest = ""
        self._moves = False
        self._numbers: list[int] = []
        self._kept: set[Path] = set()

    def add(self, number: int, found: Triangles) -> None:
        """Add the mesh of a frame."""
        digest = guides.digest(found)
        if self._first is None:
            self._first, self._digest = found, digest
        if digest != self._digest and not self._moves:
            self._moves = True
            for earlier in self._numbers:
                write_mesh(self._path(earlier), *self._first)
        self._numbers.append(number)
        if self._moves:
            write_mesh(self._path(number), *found)

    def close(self) -> Path:
        """Complete the files; return the option's value."""
        assert self._first is not None
        if self._moves:
            self._kept = {self._path(n) for n in self._numbers}
            return frame_pattern(self._folder, f"{self._name}-{{frame:06d}}.ply")
        whole = self._folder / f"{self._role}-{self._digest}.ply"
        self._kept = {whole}
        write_mesh(whole, *self._first)
        return frame_pattern(self._folder, whole.name)

    def remove_earlier(self) -> None:
        """Remove the files of other sequences in the same folder."""
        for path in self._folder.iterdir():
            match = GUIDE_FILE.fullmatch(path.name)
            if match and match["role"] == self._role and path not in self._kept:
                with suppress(OSError):  # the trainer is already running without them
                    path.unlink(missing_ok=True)

    def _path(self, number: int) -> Path:
        return self._folder / f"{self._name}-{number:06d}.ply"


@contextmanager
def _other_frames(scene: bpy.types.Scene) -> Iterator[None]:
    """Step through the timeline and return; sequences of splats are not updated meanwhile."""
    frame, subframe = scene.frame_current, scene.frame_subframe
    with frame_sync.suspended_sync():
        try:
            yield
        finally:
            scene.frame_set(frame, subframe=subframe)
