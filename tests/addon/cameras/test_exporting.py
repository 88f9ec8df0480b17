"""Incremental camera export. Oracle: the same export in one call, and the folder."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from addon.cameras import export_views
from addon.cameras.importing import ImportedCapture
from addon.core import atomic_write
from addon.process.background_task import Cancelled
from addon.process.incremental_tasks import TaskRunner
from tests.addon.calls import import_capture
from tests.addon.cameras.test_importing import until
from tests.addon.captures import STUDIO
from tools.measure.windowless import windowless


@pytest.fixture
def made(scene: bpy.types.Scene) -> ImportedCapture:
    """A capture in the scene, one of its cameras moved."""
    found = import_capture(scene, STUDIO, photos=False)
    found.cameras[3].location.x += 1
    bpy.context.view_layer.update()
    return found


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """One camera per step."""
    monkeypatch.setattr(export_views, "BUDGET", 0.0)


def going(folder: Path, **settings: Any) -> TaskRunner:
    """The operator in a window, before its first step."""
    work = windowless("export_cameras", directory=str(folder), **settings)
    return TaskRunner(work.steps(bpy.context))


def files(folder: Path) -> dict[str, bytes]:
    """All files below a folder."""
    found = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


@pytest.mark.parametrize("kind", ["COLMAP", "COLMAP_TEXT", "TRANSFORMS"])
@pytest.mark.parametrize("world", ["CAPTURE", "BLENDER"])
def test_bit_by_bit_as_at_once(
    made: ImportedCapture, tmp_path: Path, kind: str, world: str
) -> None:
    """Equal to the byte; steps report the progress."""
    bpy.ops.gscore.export_cameras(directory=str(tmp_path / "a"), kind=kind, world=world)
    work = going(tmp_path / "b", kind=kind, world=world)
    assert not until(work, lambda: work.sentence == "Reading cameras: 30 of 60")
    assert not (tmp_path / "b").exists()
    assert until(work, lambda: False)
    assert "60 cameras" in work.result
    wanted = files(tmp_path / "a")
    assert len(wanted) >= (3 if kind != "TRANSFORMS" else 1 + (world == "CAPTURE"))
    assert files(tmp_path / "b") == wanted


def _set_frame(made: ImportedCapture) -> None:
    bpy.context.scene.frame_set(9)


def _remove(made: ImportedCapture) -> None:
    bpy.data.objects.remove(made.cameras[-1])


def _add_points(made: ImportedCapture) -> None:
    made.points.data.vertices.add(5)


@pytest.mark.parametrize(
    ("act", "when", "says"),
    [
        (_set_frame, "Reading cameras: 30 of 60", "The frame was changed"),
        (_remove, "Reading cameras: 30 of 60", "Cameras were removed"),
        (_add_points, "positions", "studio points was changed"),
    ],
)
def test_changes_during_an_export_are_refused(
    made: ImportedCapture, tmp_path: Path, act: Callable, when: str, says: str
) -> None:
    """Oracle: an error; nothing is written."""
    work, reported = going(tmp_path / "b"), []

    def comes() -> bool:
        reported.append(work.sentence)
        return (
            reported.count("Reading studio points") == 2
            if when == "positions"
            else reported[-1] == when
        )

    assert not until(work, comes)
    act(made)
    with pytest.raises(ValueError, match=says):
        until(work, lambda: False)
    assert not files(tmp_path)


def test_undo_meanwhile(made: ImportedCapture, tmp_path: Path) -> None:
    """Oracle: the export in one call; undo replaces objects."""
    bpy.ops.ed.undo_push(message="start")
    bpy.context.scene.frame_end = 77
    bpy.ops.ed.undo_push(message="a frame")
    bpy.ops.gscore.export_cameras(directory=str(tmp_path / "a"))
    work = going(tmp_path / "b")
    assert not until(work, lambda: work.sentence == "Reading cameras: 30 of 60")
    bpy.ops.ed.undo()
    assert until(work, lambda: False)
    assert files(tmp_path / "b") == files(tmp_path / "a")


def test_files_belong_together(tmp_path: Path) -> None:
    """Oracle: no file if it was cancelled before the first of two, else both."""
    given_up = np.array([False])

    def check() -> None:
        if given_up[0]:
            raise Cancelled

    with export_views.all_or_none(check):
        atomic_write(tmp_path / "a", b"a")
        given_up[0] = True
        atomic_write(tmp_path / "b", b"b")
    assert files(tmp_path) == {"a": b"a", "b": b"b"}
    with pytest.raises(Cancelled), export_views.all_or_none(check):
        atomic_write(tmp_path / "a", b"other")
    assert files(tmp_path) == {"a": b"a", "b": b"b"}
