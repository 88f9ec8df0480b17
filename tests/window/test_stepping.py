"""Buttons of incremental operators, in a Blender with a window; required programs:
`test_live.py`."""

from pathlib import Path

import pytest

from tests.window.scenes import run_scene

pytestmark = pytest.mark.window

LONGEST = 200
COUNT = 3000


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path]:
    """The results of `stepping_scene.py`, and the folder of its picture."""
    found, folder, output = run_scene(
        "stepping", tmp_path_factory, "--enable-event-simulate", longest=LONGEST
    )
    assert "Traceback" not in output, output
    return found, folder


def test_a_button_does_what_a_script_has_at_once(seen):
    """Oracle: the same operator called by a script; undo, with one step."""
    found, _ = seen
    assert found["begun"] == ["RUNNING_MODAL"] and found["under way"]
    assert found["mode"] == "EDIT" and found["bit by bit"] == found["at once"]
    assert 1000 < len(found["at once"]) < COUNT
    assert found["undone"] == [3]


def test_esc_leaves_all_as_it_was(seen):
    """Oracle: the previous selection and mode, counts, and no mesh of ours."""
    found, _ = seen
    assert found["meanwhile"] == "OBJECT"
    assert found["mode after Esc"] == "EDIT" and found["after Esc"] == [3]
    assert found["Esc"] == COUNT and not found["meshes"]


@pytest.mark.parametrize("name", ["painted", "undone meanwhile"])
def test_changes_during_an_edit_are_kept(seen, name):
    """Oracle: the count of splats, most of which the same button deletes in an undisturbed
    scene."""
    found, _ = seen
    assert found[name] == COUNT and found["nothing"] == 500


def test_repeat_last_has_it_at_once(seen):
    """Oracle: counts right after it, and a Blender that keeps running: it exits where a repeated
    operator waits for events."""
    assert seen[0]["repeated"] == [True, 700]


def test_a_workspace_may_go(seen):
    """Oracle: the requested count."""
    assert seen[0]["without workspace"] == 500


def test_the_add_on_may_be_disabled(seen):
    """Oracle: mode, meshes and selection as after a cancel."""
    found, _ = seen
    assert found["disabled"] == ["EDIT", True] and found["chosen when disabled"] == [3]


def test_a_comparison_goes_on_beside_and_can_be_given_up(seen):
    """Oracle: the camera's data and the images after Esc; then a picture of three photos' width in
    a separate window, which Blender would not offer to save."""
    found, _ = seen
    assert found["compare"] == ["RUNNING_MODAL"]
    assert found["given up"][0] is False
    assert found["windows"] == 2 and 3 < found["psnr"] < 40
    assert found["size"][0] % 3 == 0
    assert found["packed"] and not found["dirty"]
