"""An artist's way through the add-on, in the window of a real Blender. Oracles: in the tests."""

import shutil
import sys
from pathlib import Path

import pytest

from tests.window.scenes import run_scene

STUDIO = Path(__file__).parents[2] / "examples" / "studio"
SIZE = (1280, 800)

pytestmark = pytest.mark.window


def _prepare(folder: Path) -> None:
    """Two captures, and the Python that trains them."""
    for name in ("first", "second"):
        shutil.copytree(STUDIO, folder / name)
    (folder / "python").write_text(sys.executable)


@pytest.fixture(scope="module")
def tour(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path, str]:
    """The results of the tour, the folder of its pictures, and Blender's output."""
    return run_scene("tour", tmp_path_factory, longest=900, size=SIZE, prepare=_prepare)


def test_tour_completes_without_errors(tour):
    """Oracle: every part was completed, and the console has no errors."""
    seen, folder, output = tour
    assert len(seen["parts"]) == 8
    for word in ("Traceback", "Error", "rror:"):
        assert word not in output, output
    assert all((folder / f"{name}.png").stat().st_size > 10_000 for name in ("render", "composite"))


def test_splats_come_while_they_are_trained(tour):
    """Oracle: an object before the end of the training; a camera for each photo."""
    seen, _, _ = tour
    assert seen["came_while_training"]
    assert seen["cameras"] == len(list((STUDIO / "images").iterdir()))
    assert seen["trained"] > 1000


def test_edits_are_undone_and_redone(tour):
    """Oracle: the numbers of splats before and after the deletion."""
    before, after, back, again = tour[0]["deleted"]
    assert before == back > after == again


def test_written_file_equals_the_view(tour):
    """Oracle: some splats in the crop box; half of these after thinning."""
    seen, _, _ = tour
    assert 0 < seen["cropped"] < seen["trained"]
    assert seen["decimated"] == seen["cropped"] // 2


def test_errors_are_shown_and_compared(tour):
    """Oracle: one map next to the splats, one window more."""
    assert (tour[0]["maps"], tour[0]["windows"]) == (1, 2)


def test_a_region_leaves_the_rest_alone(tour):
    """Oracle: most places unchanged, bit for bit."""
    assert 0.5 < tour[0]["still"] < 1.0


def test_a_second_capture_leaves_the_first_alone(tour):
    """Oracle: names, output folders and numbers of splats; then a file opened again."""
    seen, _, _ = tour
    assert seen["roots"] == 2
    assert all(seen["second"])
    assert all(seen["first_back"])
    assert seen["reopened"]
