"""Oracle: the folders, and the splats and photos found in them."""

import shutil
from pathlib import Path

import bpy

from addon import paths, stored_paths
from addon.cameras import captures
from addon.cameras import objects as co
from addon.cameras.backgrounds import photo_of

STUDIO = Path(__file__).parent.parent.parent / "examples" / "studio"


def _save(file: Path, **options: bool) -> None:
    file.parent.mkdir(exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(file), **options)


def _first(kind: str) -> bpy.types.Object:
    return next(ob for ob in bpy.context.scene.objects if co.is_kind(ob, kind))


def test_a_project_moves_as_a_whole(scene: bpy.types.Scene, tmp_path: Path) -> None:
    """The first camera's photo is read from the new folder, with the file saved before or after
    import."""
    for number, saved in enumerate((False, True)):
        here, there = tmp_path / f"here {number}", tmp_path / f"thäre {number}"
        shutil.copytree(STUDIO, here / "shots")
        bpy.ops.wm.read_homefile(use_empty=True)
        if saved:
            _save(here / "a.blend")
        bpy.ops.gscore.import_cameras(directory=str(here / "shots"))
        assert Path(co.photo_camera_of(_first("camera")).photo).is_relative_to(here / "shots")
        _save(here / "a.blend")
        here.rename(there)
        bpy.ops.wm.open_mainfile(filepath=str(there / "a.blend"))
        scene, camera, root = bpy.context.scene, _first("camera"), _first("capture")
        assert stored_paths.read(root, stored_paths.SOURCE) == str(there / "shots")
        assert paths.capture_folder(scene) == there / "shots"
        assert (
            Path(co.photo_camera_of(camera).photo)
            == there / "shots" / "images" / camera["gs_image"]
        )
        assert captures.use_camera(scene, camera) == []
        assert len(photo_of(camera).pixels) == 4 * 480 * 640


def test_saving_elsewhere_keeps_what_is_meant(scene: bpy.types.Scene, tmp_path: Path) -> None:
    """Also after saving a copy, which is not the open file, or a failed save."""
    (tmp_path / "a" / "shots").mkdir(parents=True)
    _save(tmp_path / "a" / "x.blend")
    settings = scene.gscore
    settings.capture_path, settings.output_path = "//shots", "//out"
    capture, output = tmp_path / "a" / "shots", tmp_path / "a" / "out"
    _save(tmp_path / "b" / "copy.blend", copy=True)
    assert (settings.capture_path, settings.output_path) == ("//shots", "//out")
    _save(tmp_path / "b" / "x.blend")
    assert paths.capture_folder(scene) == capture and paths.output_folder(scene) == output
    assert settings.capture_path == "//../a/shots"
    _save(tmp_path / "x.blend")
    assert settings.capture_path == "//a/shots"
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "b" / "copy.blend"))
    scene = bpy.context.scene
    assert paths.capture_folder(scene) == capture and paths.output_folder(scene) == output
