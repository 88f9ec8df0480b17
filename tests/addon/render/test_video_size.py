"""Even sizes of videos. Oracle: Blender's own encoders."""

from pathlib import Path

import bpy
import pytest

from addon.render import operators
from tests.addon import splat_scenes as lab


def write_videos(scene: bpy.types.Scene, codec: str) -> None:
    """Set the scene's output to a video of one frame."""
    output = scene.render.image_settings
    if hasattr(output, "media_type"):  # since 5.0
        output.media_type = "VIDEO"
    output.file_format = "FFMPEG"
    scene.render.ffmpeg.format, scene.render.ffmpeg.codec = "MKV", codec
    scene.frame_start = scene.frame_end = 1


@pytest.mark.parametrize(
    ("size", "even"),
    [
        ((65, 48, 100), (66, 48)),
        ((64, 49, 100), (64, 50)),
        ((131, 99, 50), (132, 100)),
        ((190, 190, 37), (190, 190)),
    ],
)
def test_odd_sizes_are_made_even(
    scene: bpy.types.Scene, tmp_path: Path, size: tuple[int, int, int], even: tuple[int, int]
) -> None:
    """Oracle: Blender refuses to write the video exactly if there is a problem, and writes it after
    one press; the least even resolution from the percentage, rounded down."""
    lab.prepare(scene, size[:2])
    lab.add(scene, lab.blob(20))
    render = scene.render
    render.resolution_percentage = size[2]
    render.filepath = str(tmp_path / "a.mkv")
    write_videos(scene, "H264")
    if size[:2] != even:
        assert "divisible by 2" in lab.error_of(lambda: bpy.ops.render.render(animation=True))
        assert operators.size_problem(scene)
        assert bpy.ops.gscore.make_size_even() == {"FINISHED"}
    assert not operators.size_problem(scene) and not bpy.ops.gscore.make_size_even.poll()
    assert (render.resolution_x, render.resolution_y, render.resolution_percentage) == (
        *even,
        size[2],
    )
    assert bpy.ops.render.render(animation=True) == {"FINISHED"}
    assert (tmp_path / "a.mkv").stat().st_size > 0


def test_other_output_keeps_its_size(scene: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: Blender writes an odd size with a lossless codec; pictures have no such limit."""
    lab.prepare(scene, (65, 49))
    lab.add(scene, lab.blob(20))
    assert not operators.size_problem(scene)
    write_videos(scene, "FFV1")
    assert not operators.size_problem(scene)
    scene.render.filepath = str(tmp_path / "a.mkv")
    assert bpy.ops.render.render(animation=True) == {"FINISHED"}
