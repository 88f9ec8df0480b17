"""Captures of a scene: chosen, recent and imported ones, and the operator that chooses one."""

from collections.abc import Iterator
from pathlib import Path

import bpy
from bpy.props import StringProperty

from .. import stored_paths
from ..cameras.lookup import roots_of
from ..capture.folders import means_capture
from ..interface.base_operator import OnScene
from ..paths import absolute, relative
from ..run_links import holders


def known(scene: bpy.types.Scene) -> list[Path]:
    """Folders of the captures that a scene has chosen or imported, unique and sorted by name."""
    unique: list[Path] = []
    # Parent folders first.
    for path in sorted(_all(scene), key=lambda path: len(path.parts)):
        if not any(means_capture(path, other) for other in unique):
            unique.append(path)
    return sorted(unique, key=lambda path: (path.name.lower(), str(path)))


def label(path: Path, among: list[Path]) -> str:
    """Label of a capture: its folder's name, with the parent folder if another has that name."""
    namesakes = [other for other in among if other.name == path.name]
    return path.name if len(namesakes) < 2 else f"{path.name} ({path.parent})"


def _all(scene: bpy.types.Scene) -> Iterator[Path]:
    for holder in holders(scene):
        if holder.capture_path.strip():
            try:
                yield absolute(holder.capture_path, "Capture")
            except ValueError:
                continue  # relative to an unsaved file
    for root in roots_of(scene):
        if text := stored_paths.read(root, stored_paths.SOURCE):
            yield Path(text)


class ChooseCapture(OnScene, bpy.types.Operator):
    """Choose a capture of this scene, with its output, splats and test view"""

    bl_idname = "gscore.choose_capture"
    bl_label = "Choose Capture"

    path: StringProperty(name="Capture", description="Folder of the capture", options={"SKIP_SAVE"})

    def run(self, context: bpy.types.Context) -> None:
        """Choose the capture."""
        if not self.path.strip():
            raise ValueError("No capture is given; choose one in the panel.")
        context.scene.gscore.capture_path = relative(absolute(self.path, "Capture"))
