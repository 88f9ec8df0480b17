"""A mask painted in the window of a real Blender; required programs: `test_live.py`."""

import pytest

from tests.window.scenes import run_scene

pytestmark = pytest.mark.window

LONGEST, SCREEN = 120, (1400, 900)


def test_an_editor_opens_with_the_whole_photo(tmp_path_factory):
    """Oracle: Blender's own editor: its mode, the tab in which the mask is saved, and a photo that
    neither the sidebar nor a shelf of brushes covers."""
    seen, _, _ = run_scene("mask", tmp_path_factory, longest=LONGEST, size=SCREEN)
    assert seen["painting"] == ["FINISHED"]
    assert seen["mode"] == "PAINT" and seen["open"] and not seen["shelf"]
    assert seen["free"] > 0 and seen["height"] > 0
