"""Incremental import and export of cameras, in a Blender with a window; required programs:
`test_live.py`.

Oracle: Blender's counts of data, its list of running operators, files, and its undo.
"""

import shutil
from pathlib import Path

import pytest

from tests.addon.captures import STUDIO
from tests.window.scenes import run_scene

pytestmark = pytest.mark.window

LONGEST = 200
MODEL = ["cameras.bin", "images.bin", "points3D.bin"]


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path]:
    """The results of `import_scene.py`, and its folder."""

    def prepare(folder: Path) -> None:
        shutil.copytree(STUDIO, folder / "studio")

    found, folder, output = run_scene(
        "import",
        tmp_path_factory,
        "--enable-event-simulate",
        longest=LONGEST,
        prepare=prepare,
    )
    assert "Traceback" not in output, output
    return found, folder


def test_esc_leaves_nothing(seen):
    """While the capture is read and while cameras are created; the window responds meanwhile, and
    shows the running operator."""
    found, folder = seen
    assert found["begun"] == ["RUNNING_MODAL"] and found["alive"]
    assert found["after reading"] and found["after cameras"] and found["scene meanwhile"] == 0
    assert f"Reading {folder / 'studio'}   |   Esc cancels" in found["said"]
    assert found["said"][-1] == ""


def test_an_import_is_one_undo_step(seen):
    found, _ = seen
    assert found["made"] == ["studio", 60, 6725] and found["images"] >= 60
    assert found["undone"] == [0, 0] and found["redone"] == 60


def test_reimport(seen):
    """Esc keeps manual changes; a complete import does not, and undo restores them."""
    found, _ = seen
    assert (found["moved after Esc"], found["count after Esc"]) == (50, 59)
    assert found["moved anew"] != 50 and found["count anew"] == 60
    assert found["moved undone"] == 50


def test_an_export_is_written_or_not(seen):
    found, _ = seen
    assert found["export"] == ["RUNNING_MODAL"] and not found["given up"]
    assert found["written"] == MODEL


def test_a_path_goes_out_and_comes_in(seen):
    """Esc leaves no file and no camera; the timeline stays where the user moves it."""
    found, _ = seen
    assert found["export_camera_path"] == found["import_camera_path"] == ["RUNNING_MODAL"]
    assert found["path given up"] == [False, 7]
    assert found["path meanwhile"] == [7, 40, False] and found["path"] == [True, 40]
    assert found["path not in"] and found["path in"] == ["walk", 100, "walk"]
    assert found["path undone"] == [True, "view_000"]


def test_the_menu_asks_for_a_folder(seen):
    """The folder of the panel is the default; chosen again, it is no second set of cameras."""
    found, folder = seen
    assert found["menu"] == ["RUNNING_MODAL"]
    assert Path(found["folder"]) == folder / "studio" and found["by menu"] == 60
