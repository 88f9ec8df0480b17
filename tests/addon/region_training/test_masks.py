"""Painted masks; oracle: the files that training reads, decoded by Blender."""

import json
import shutil
import struct
import zlib
from pathlib import Path

import bpy
import numpy as np
import pytest

from addon.cameras.objects import photo_camera_of
from addon.core import Folder, masks_inside, png_bytes
from addon.panels.cameras import CamerasPanel
from addon.process.incremental_tasks import run_blocking
from addon.region_training import masks
from addon.region_training.mask_operators import MaskPanel
from addon.render.camera_photo import load_target
from addon.training import facts, start_training
from tests.addon.calls import import_capture
from tests.addon.captures import STUDIO
from tests.addon.drawn import drawn
from tests.addon.splat_scenes import read_image


@pytest.fixture
def studio(scene: bpy.types.Scene, tmp_path: Path) -> bpy.types.Scene:
    """A scene with the cameras of a copy of the studio, whose photos must not change."""
    shutil.copytree(STUDIO, tmp_path / "studio", ignore=shutil.ignore_patterns("masks"))
    scene.gscore.capture_path = str(tmp_path / "studio")
    facts.refresh(scene)
    capture = import_capture(bpy.context.scene, tmp_path / "studio")
    scene.camera = capture.cameras[5]
    bpy.context.view_layer.objects.active = capture.cameras[5]
    return scene


def read_mask(file: Path) -> np.ndarray:
    """[H, W] uint8."""
    return np.rint(read_image(file)[..., 0] * 255).astype(np.uint8)


def write_png(file: Path, levels: np.ndarray) -> None:
    """A grey picture."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(png_bytes(levels))


def painted(image: bpy.types.Image) -> np.ndarray:
    """Erase a rectangle and half-erase a row, as brushes do; return the alpha, [H, W] uint8."""
    width, height = image.size
    pixels = np.array(image.pixels[:], np.float32).reshape(height, width, 4)
    pixels[10:40, 5:25, 3] = 0
    pixels[50, :, 3] = 0.5
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    return np.rint(pixels[::-1, :, 3] * 255).astype(np.uint8)


def test_from_button_to_training(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: the mask as training reads it, the photos' bytes, and the warnings before a start."""
    own = photo_camera_of(studio.camera)
    before = {path: path.read_bytes() for path in (tmp_path / "studio" / "images").iterdir()}
    assert "(Paint Mask)" in drawn(CamerasPanel)
    assert bpy.ops.gscore.paint_mask() == {"FINISHED"}
    image = next(filter(masks.is_mask, bpy.data.images))
    assert tuple(image.size) == (own.width, own.height)
    assert not masks.is_unsaved(image) and start_training.unsaved(studio) == []
    assert "(Save)" not in drawn(CamerasPanel)
    levels = painted(image)
    assert masks.is_unsaved(image)
    assert own.image in start_training.unsaved(studio)[0]
    assert "(Save)" in drawn(CamerasPanel)

    assert bpy.ops.gscore.save_mask(image=image.name) == {"FINISHED"}
    file = tmp_path / "studio" / "masks" / f"{own.image}.png"
    assert np.array_equal(read_mask(file), levels)
    assert not masks.is_unsaved(image) and start_training.unsaved(studio) == []
    assert Folder(tmp_path / "studio" / "masks").find_mask(own.image) == file
    assert list((tmp_path / "studio" / "masks").iterdir()) == [file]
    assert before == {p: p.read_bytes() for p in (tmp_path / "studio" / "images").iterdir()}
    assert facts.refresh(studio)[0].masks == 1


def test_image_editor_is_ready_to_paint(studio: bpy.types.Scene) -> None:
    """Oracle: Blender's own image editor: its mode, and the effect of its brush; the regions around
    it are tested in a window."""
    area = bpy.context.window_manager.windows[0].screen.areas[0]
    before, area.type = area.type, "IMAGE_EDITOR"
    try:
        space = area.spaces.active
        assert bpy.ops.gscore.paint_mask() == {"FINISHED"}
        assert masks.is_mask(space.image)
        assert space.ui_mode == "PAINT"
        assert bpy.context.scene.tool_settings.image_paint.brush.blend == "ERASE_ALPHA"
    finally:
        area.type = before


@pytest.mark.parametrize("inverted", [False, True])
def test_a_mask_that_is_there_is_painted_on(studio: bpy.types.Scene, inverted: bool) -> None:
    """Oracle: the levels of a file, and those after painting."""
    own = photo_camera_of(studio.camera)
    studio.gscore.invert_masks = inverted
    file = Path(studio.gscore.capture_path) / "masks" / Path(own.image).with_suffix(".png").name
    rng = np.random.default_rng(0)
    given = rng.integers(0, 256, (own.height, own.width)).astype(np.uint8)
    write_png(file, given)
    bpy.ops.gscore.paint_mask()
    image = next(filter(masks.is_mask, bpy.data.images))
    alpha = np.array(image.pixels[:], np.float32).reshape(own.height, own.width, 4)[::-1, :, 3]
    kept = 255 - given if inverted else given
    assert np.array_equal(np.rint(alpha * 255).astype(np.uint8), kept)
    levels = painted(image)
    bpy.ops.gscore.save_mask(image=image.name)
    assert np.array_equal(read_mask(file), 255 - levels if inverted else levels)
    assert list(file.parent.iterdir()) == [file]


def test_painting_survives_saving_and_loading(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: the pixels after saving and loading the file, and that they are still reported as not
    saved; a second press of the button continues with them."""
    bpy.ops.gscore.paint_mask()
    image = next(filter(masks.is_mask, bpy.data.images))
    levels = painted(image)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    image = next(filter(masks.is_mask, bpy.data.images))
    assert masks.is_unsaved(image)
    bpy.ops.gscore.paint_mask()
    assert len([i for i in bpy.data.images if masks.is_mask(i)]) == 1
    bpy.ops.gscore.save_mask(image=image.name)
    file = next((tmp_path / "studio" / "masks").iterdir())
    assert np.array_equal(read_mask(file), levels)


def test_discarding_leaves_the_file(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: no image, no file."""
    bpy.ops.gscore.paint_mask()
    image = next(filter(masks.is_mask, bpy.data.images))
    painted(image)
    assert bpy.ops.gscore.discard_mask(image=image.name) == {"FINISHED"}
    assert not any(map(masks.is_mask, bpy.data.images))
    assert not (tmp_path / "studio" / "masks").exists()
    with pytest.raises(RuntimeError, match="press Paint Mask first"):
        bpy.ops.gscore.save_mask()
    assert drawn(MaskPanel) == ""


def test_undo_of_a_save_is_reported(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: the image restored by undo, with its properties, and the remaining file."""
    bpy.ops.gscore.paint_mask()
    image = next(filter(masks.is_mask, bpy.data.images))
    before = {key: image[key] for key in image.keys() if key.startswith("gs_mask")}  # noqa: SIM118
    painted(image)
    bpy.ops.gscore.save_mask(image=image.name)
    assert not masks.is_unsaved(image)
    for key, value in before.items():
        image[key] = value
    assert masks.is_unsaved(image)


def test_no_mask_among_photos(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: a folder of masks that links to the photos': an error, and the photos' bytes."""
    folder = tmp_path / "studio"
    before = {path: path.read_bytes() for path in (folder / "images").iterdir()}
    bpy.ops.gscore.paint_mask()
    image = next(filter(masks.is_mask, bpy.data.images))
    (folder / "masks").symlink_to(folder / "images", target_is_directory=True)
    with pytest.raises(RuntimeError, match="is in a folder of photos"):
        bpy.ops.gscore.save_mask(image=image.name)
    assert before == {path: path.read_bytes() for path in (folder / "images").iterdir()}


def test_photos_with_opacity_of_their_own(scene: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: training ignores the alpha of such photos if there is one mask file."""
    folder = tmp_path / "cut out"
    write_png(folder / "a.png", np.zeros((30, 40), np.uint8))
    grey = (folder / "a.png").read_bytes()
    # A tRNS chunk, which makes one level transparent.
    clear = b"tRNS\0\0"
    chunk = struct.pack(">I", 2) + clear + struct.pack(">I", zlib.crc32(clear))
    (folder / "a.png").write_bytes(grey[:33] + chunk + grey[33:])
    frame = {"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}
    facts_of = {"w": 40, "h": 30, "fl_x": 30, "frames": [frame]}
    (folder / "transforms.json").write_text(json.dumps(facts_of))
    capture = import_capture(bpy.context.scene, folder)
    scene.gscore.capture_path = str(folder)
    facts.refresh(scene)
    scene.camera = capture.cameras[0]
    with pytest.raises(RuntimeError, match="own transparency"):
        bpy.ops.gscore.paint_mask()


def test_a_mask_that_the_capture_names(scene: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: the file named in transforms.json, which training reads."""
    folder = tmp_path / "c"
    write_png(folder / "a.png", np.zeros((30, 40), np.uint8))
    write_png(folder / "m" / "a.png", np.full((30, 40), 255, np.uint8))
    frame = {"file_path": "a.png", "mask_path": "m/a.png", "transform_matrix": np.eye(4).tolist()}
    facts_of = {"w": 40, "h": 30, "fl_x": 30, "frames": [frame]}
    (folder / "transforms.json").write_text(json.dumps(facts_of))
    scene.gscore.capture_path = str(folder)
    import_capture(bpy.context.scene, folder)
    bpy.ops.gscore.paint_mask(camera="a.png")
    image = next(filter(masks.is_mask, bpy.data.images))
    pixels = np.array(image.pixels[:], np.float32).reshape(30, 40, 4)
    pixels[:10, :, 3] = 0
    image.pixels.foreach_set(pixels.ravel())
    bpy.ops.gscore.save_mask(image=image.name)
    assert read_mask(folder / "m" / "a.png")[20:].max() == 0
    assert not (folder / "masks").exists()


def test_packed_masks_are_small(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: Blender's own packing, within a tenth; the levels; and that nothing is unsaved then.

    Before, pixels are packed uncompressed, which is fast.
    """
    bpy.ops.gscore.paint_mask()
    image = next(filter(masks.is_mask, bpy.data.images))
    levels = painted(image)
    bpy.ops.gscore.save_mask(image=image.name)
    assert image.packed_file.size > 4 * levels.size
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    image = next(filter(masks.is_mask, bpy.data.images))
    assert not masks.is_unsaved(image)
    kept = np.array(image.pixels[:], np.float32).reshape(*levels.shape, 4)[::-1, :, 3]
    assert np.array_equal(np.rint(kept * 255).astype(np.uint8), levels)
    ours = image.packed_file.size
    image.pixels[0] = 0.0
    image.pack()
    assert ours < 1.1 * image.packed_file.size


@pytest.mark.parametrize("folder", ["masks", "mask"])
def test_full_size_masks_of_either_folder_keep_their_size(
    studio: bpy.types.Scene, folder: str
) -> None:
    """Oracle: the levels of a file twice as large as its photo, and the file found by gscore's
    rule."""
    own, source = photo_camera_of(studio.camera), Path(studio.gscore.capture_path)
    file = source / folder / f"{own.image}.png"
    given = np.kron(
        np.arange(own.height * own.width).reshape(own.height, -1) // 97 % 256, [[1] * 2] * 2
    )
    write_png(file, given.astype(np.uint8))
    bpy.ops.gscore.paint_mask()
    image = next(filter(masks.is_mask, bpy.data.images))
    assert tuple(image.size) == (2 * own.width, 2 * own.height)
    levels = painted(image)
    bpy.ops.gscore.save_mask(image=image.name)
    assert np.array_equal(read_mask(file), levels)
    assert masks_inside(source) == file.parent and list(file.parent.iterdir()) == [file]


@pytest.mark.parametrize("folder", ["masks", "mask"])
def test_a_comparison_takes_the_same_masks(studio: bpy.types.Scene, folder: str) -> None:
    """Oracle: the written mask at the photo's size; blocks of 2 x 2 pixels are equal."""
    own = photo_camera_of(studio.camera)
    given = np.zeros((own.height, own.width), np.uint8)
    given[:20] = 255
    file = Path(studio.gscore.capture_path) / folder / f"{own.image}.png"
    write_png(file, np.kron(given, np.ones((2, 2), np.uint8)))
    steps = load_target(
        studio.camera, own.width, own.height, background=(0, 0, 0), mask_mode="ignore"
    )
    weight = run_blocking(steps).weight
    assert weight is not None and np.array_equal(np.rint(weight * 255), given)
