"""An export in the window of a real Blender; required programs: `test_live.py`."""

import pytest

from tests.window.scenes import run_scene

pytestmark = pytest.mark.window

LONGEST = 120


def test_an_export_goes_bit_by_bit_and_can_be_given_up(tmp_path_factory):
    """Oracle: Blender's list of running operators, the file of a single-call export, and after Esc
    a folder without the other file or a part of it, and no copy of a mesh."""
    seen, folder, _ = run_scene(
        "export", tmp_path_factory, "--enable-event-simulate", longest=LONGEST
    )
    assert seen["begun"] == ["RUNNING_MODAL"] and seen["under_way"] and seen["same"]
    assert seen["still"] and seen["ended"] and not seen["meshes"]
    written = sorted(path.name for path in folder.iterdir() if ".ply" in path.name)
    assert written == ["at once.ply", "bit by bit.ply"]
