"""Oracle: the files written by examples/photos_to_blend.py, opened again."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest

from addon.core import Splats, render, write_splats

ROOT = Path(__file__).parent.parent.parent
STUDIO = ROOT / "examples" / "studio"
SCRIPT = ROOT / "examples" / "photos_to_blend.py"


def test_photos_to_blend(
    scene: bpy.types.Scene,
    run_blender: Callable[..., str],
    make_splats: Callable[..., Splats],
    tmp_path: Path,
) -> None:
    """Oracle: gscore.render with the exact camera in the file; the PLY's number of splats."""
    splats, ply = make_splats(3000), tmp_path / "some.ply"
    write_splats(ply, splats)
    views = [{"width": 40, "height": 30}] * 7
    (tmp_path / "metrics.json").write_text(json.dumps({"psnr": 31.25, "views": views}))
    blend, picture = tmp_path / "made" / "scene.blend", tmp_path / "picture.png"
    said = run_blender(
        SCRIPT,
        STUDIO,
        *("-o", blend, "--render", picture, "--camera", "view_007.jpg", "--splats", ply),
    )
    assert "31.25 dB: the mean of 7 views at 40 x 30 px" in said
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    kinds = [ob.get("gs_kind") for ob in bpy.context.scene.objects]
    assert kinds.count("camera") == 60 and kinds.count("splats") == 1
    (ob,) = [ob for ob in bpy.context.scene.objects if ob.get("gs_kind") == "splats"]
    assert len(ob.data.vertices) == 3000 and ob.modifiers
    camera = bpy.context.scene.camera
    assert camera["gs_image"] == "view_007.jpg"
    width, height = camera["gs_size"]
    K, viewmat = np.reshape(camera["gs_K"], (3, 3)), np.reshape(camera["gs_viewmat"], (4, 4))
    expected = render(splats, K, viewmat, width, height)
    image = bpy.data.images.load(str(picture))
    assert tuple(image.size) == (width, height)
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    shown = pixels.reshape(height, width, 4)[::-1, :, :3]
    assert expected.alpha.mean() > 0.05  # an empty file has no world, so the background is black
    assert np.abs(shown - np.clip(expected.rgb, 0, 1)).max() <= 1 / 255


def test_a_comparison_that_fails_loses_no_file(
    run_blender: Callable[..., str], make_splats: Callable[..., Splats], tmp_path: Path
) -> None:
    """Oracle: splats and cameras in the .blend file, although the photo is removed after the
    render."""
    capture, ply, blend = tmp_path / "capture", tmp_path / "some.ply", tmp_path / "scene.blend"
    shutil.copytree(STUDIO / "sparse", capture / "sparse")
    shutil.copytree(STUDIO / "images", capture / "images")
    first = capture / "images/view_000.jpg"
    script = (
        "import bpy, os, runpy\n"
        "@bpy.app.handlers.persistent\n"
        f"def away(*ignored): os.path.exists({str(first)!r}) and os.remove({str(first)!r})\n"
        "bpy.app.handlers.render_complete.append(away)\n"
        f"runpy.run_path({str(SCRIPT)!r}, run_name='__main__')\n"
    )
    write_splats(ply, make_splats(300))
    with pytest.raises((AssertionError, pytest.fail.Exception)):
        run_blender(script, capture, "-o", blend, "--splats", ply)
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    kinds = [ob.get("gs_kind") for ob in bpy.context.scene.objects]
    assert kinds.count("camera") == 60 and kinds.count("splats") == 1


@pytest.mark.skipif(bool(bpy.app.binary_path), reason="the Python of a program has no bpy")
@pytest.mark.parametrize(
    ("taken", "arguments", "said"),
    [
        ("scene.png", (STUDIO, "-o", "scene.blend"), "scene.png would be replaced"),
        ("scene.blend", (STUDIO, "-o", "scene.blend"), "scene.blend would be replaced"),
        ("scene_run/config.json", (STUDIO, "-o", "scene.blend"), "config.json would be replaced"),
        ("notes.txt", (STUDIO, "-o", "notes.txt"), "notes.txt does not end in .blend"),
        ("walk.mp4", ("walk.mp4", "-o", "scene.blend"), "walk.mp4 is a file"),
    ],
)
def test_files_of_others_stay(
    taken: str, arguments: tuple[str | Path, ...], said: str, tmp_path: Path
) -> None:
    """Oracle: an existing file keeps its content, and nothing else is made."""
    mine = tmp_path / taken
    mine.parent.mkdir(exist_ok=True)
    mine.write_text("mine")
    done = started(arguments, tmp_path)
    assert done.returncode and said in " ".join(done.stderr.split()), done.stderr
    assert mine.read_text() == "mine"
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [mine]


def test_python_without_bpy(tmp_path: Path) -> None:
    """Oracle: one sentence instead of a traceback, in a Python without packages."""
    done = started((STUDIO, "-o", "scene.blend"), tmp_path, "-I", "-S")
    assert done.returncode == 1 and "has no bpy" in done.stderr
    assert "Traceback" not in done.stderr


def started(
    arguments: tuple[str | Path, ...], folder: Path, *flags: str
) -> subprocess.CompletedProcess[str]:
    """Run the script in a folder with this Python."""
    return subprocess.run(
        [sys.executable, *flags, str(SCRIPT), *map(str, arguments)],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
