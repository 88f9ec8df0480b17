"""Backgrounds of photos with lens distortion. Oracle: a chessboard, photographed by the formulas of
the lenses, and its corners by Blender's own projection."""

import os
import shutil
import threading
import time
from functools import lru_cache
from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from addon import preferences
from addon.cameras import backgrounds, captures, undistort_jobs, undistorted_photos
from addon.cameras.backgrounds import photo_of, undistorted_background
from addon.cameras.objects import PhotoCamera, is_camera, photo_camera_of
from addon.core import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints, write_colmap
from addon.panels.cameras import CamerasPanel
from addon.process import poll_timer
from addon.region_training import masks
from gscore.io.images.png import write_png
from tests.addon.calls import import_capture
from tests.addon.drawn import Layout, drawn

SIZE = (320, 240)
LENSES = {
    "OPENCV": (260.0, 264.0, 165.0, 116.0, -0.16, 0.03, 0.004, -0.003),
    "OPENCV_FISHEYE": (200.0, 203.0, 157.0, 122.0, -0.03, 0.01, -0.002, 0.001),
    "SIMPLE_RADIAL": (260.0, 158.0, 121.0, 0.18),
}
FIELD, FAR = 0.25, 2.0
"""Side of a field of the board, and its distance from the first camera, whose axes are its own."""


def copy_needed(ob: bpy.types.Object) -> Path | None:
    """The missing copy of a camera's background, if it shows an undistorted photo."""
    found = undistorted_background(ob)
    return None if found is None else found.missing_copy()


def bend(model: str, rays: np.ndarray) -> np.ndarray:
    """Pixels of rays [..., 2], from the formulas in OpenCV's manual."""
    p, x, y = LENSES[model], rays[..., 0], rays[..., 1]
    r = np.sqrt(x**2 + y**2)
    if model == "SIMPLE_RADIAL":
        f, cx, cy, k = p
        return np.stack([f * x * (1 + k * r**2) + cx, f * y * (1 + k * r**2) + cy], axis=-1)
    fx, fy, cx, cy, a, b, c, d = p
    if model == "OPENCV":
        s = 1 + a * r**2 + b * r**4
        u = x * s + 2 * c * x * y + d * (r**2 + 2 * x**2)
        v = y * s + c * (r**2 + 2 * y**2) + 2 * d * x * y
    else:
        t = np.arctan(r)
        s = t * (1 + a * t**2 + b * t**4 + c * t**6 + d * t**8) / np.maximum(r, 1e-12)
        u, v = x * s, y * s
    return np.stack([fx * u + cx, fy * v + cy], axis=-1)


def rays_of(model: str, places: np.ndarray) -> np.ndarray:
    """The inverse, by fixed-point iteration."""
    focal = np.array(LENSES[model][:1] * 2 if model == "SIMPLE_RADIAL" else LENSES[model][:2])
    middle = bend(model, np.zeros(2))
    ray = (places - middle) / focal
    for _ in range(60):
        ray = ray + 0.8 * (places - bend(model, ray)) / focal
    assert np.abs(bend(model, ray) - places).max() < 1e-3
    return ray


@lru_cache
def board(model: str, times: int = 2) -> np.ndarray:
    """Picture of the board, [H, W, 3] uint8, each pixel the mean of `times` squared samples."""
    y, x = (np.mgrid[0 : SIZE[1] * times, 0 : SIZE[0] * times] + 0.5) / times
    at = rays_of(model, np.stack([x, y], axis=-1)) * FAR / FIELD
    white = (np.floor(at[..., 0]) + np.floor(at[..., 1])) % 2
    gray = white.reshape(SIZE[1], times, SIZE[0], times).mean(axis=(1, 3))
    return np.repeat(np.rint(255 * gray)[..., None], 3, axis=2).astype(np.uint8)


def capture_of(folder: Path, names: list[str], ending: str = ".png") -> Path:
    """A capture with a camera and a photo of the board for each given name of `LENSES`."""
    table, listed = {}, []
    for i, model in enumerate(names, 1):
        lens = np.array(LENSES[model])
        table[i] = ColmapCamera(model=model, width=SIZE[0], height=SIZE[1], params=lens)
        listed.append(
            ColmapImage(
                id=i,
                name=f"{model}{ending}",
                camera_id=i,
                qvec=np.array([1.0, 0, 0, 0]),
                tvec=np.zeros(3),
                xys=np.zeros((0, 2)),
                point3D_ids=np.zeros(0, np.int64),
            )
        )
        write_png(folder / "images" / f"{model}.png", board(model))
        if ending == ".jpg":
            image = bpy.data.images.load(str(folder / "images" / f"{model}.png"))
            image.file_format = "JPEG"
            image.save(filepath=str(folder / "images" / f"{model}.jpg"), quality=98)
            bpy.data.images.remove(image)
            (folder / "images" / f"{model}.png").unlink()
    model = ColmapModel(cameras=table, images=listed, points=ColmapPoints.none())
    write_colmap(model, folder / "sparse" / "0")
    return folder


def shown(image: bpy.types.Image) -> np.ndarray:
    """[H, W] grey values of a picture, the top row first."""
    flat = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
    image.pixels.foreach_get(flat)
    return flat.reshape(image.size[1], image.size[0], -1)[::-1, :, 0]


def corner_near(picture: np.ndarray, place: np.ndarray, half: int = 4) -> np.ndarray:
    """Corner of four fields of a board: the saddle point of a quadric fitted to the pixels
    around."""
    column, row = (int(v) for v in place)
    part = picture[row - half : row + half + 1, column - half : column + half + 1]
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    x, y = (v.ravel() + 0.5 + o - p for v, o, p in zip((x, y), (column, row), place, strict=True))
    weight = np.exp(-(x**2 + y**2) / 8)
    terms = np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=1)
    a, b, c, d, e, _ = np.linalg.lstsq(terms * weight[:, None], part.ravel() * weight, rcond=None)[
        0
    ]
    return place - np.linalg.solve([[2 * a, b], [b, 2 * c]], [d, e])


def panel() -> str:
    """The text of the panel once the missing copies are known."""
    text = drawn(CamerasPanel)
    while undistort_jobs.MISSING_COPIES.busy:
        time.sleep(0.01)
        poll_timer.poll()
        text = drawn(CamerasPanel)
    return text


@pytest.fixture(autouse=True)
def own_copies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Copies go to a folder of the test."""
    folder = tmp_path / "own"
    monkeypatch.setattr(undistorted_photos, "own_folder", lambda: folder)
    return folder / "straight"


@pytest.mark.parametrize("ending", [".png", ".jpg"])
def test_backgrounds_fit_up_to_the_corners(scene, tmp_path: Path, ending: str) -> None:
    """Oracle: corners of the board by Blender's projection, at their place in the background."""
    names = [*LENSES] if ending == ".png" else ["OPENCV"]
    made = import_capture(
        scene, capture_of(tmp_path / "c", names, ending), align=False, points=False
    )
    assert bpy.ops.gscore.straighten_photos() == {"FINISHED"}
    bpy.context.view_layer.update()
    for ob in made.cameras:
        assert not any("is missing" in note for note in captures.use_camera(scene, ob))
        own, picture = photo_camera_of(ob), shown(photo_of(ob))
        assert picture.shape == (own.height, own.width)
        assert picture.shape == (scene.render.resolution_y, scene.render.resolution_x)
        errors, reach, original = [], [], []
        for i, j in np.ndindex(41, 41):
            point = np.array([(i - 20) * FIELD, (j - 20) * FIELD, FAR])
            found = world_to_camera_view(scene, ob, Vector(point))
            place = np.array([found.x * own.width, (1 - found.y) * own.height])
            if (place < 6).any() or (place > [own.width - 6, own.height - 6]).any():
                continue
            errors.append(np.linalg.norm(corner_near(picture, place) - place))
            reach.append(np.abs((place - own.K[:2, 2]) / own.K[:2, 2]).min())
            bent = bend(own.model, point[:2] / point[2])
            original.append(np.abs(bent / SIZE - place / [own.width, own.height]).max() * SIZE[0])
        assert len(errors) > 60 and max(reach) > 0.8  # well into the corners
        assert max(errors) < 0.5, (own.model, max(errors))
        assert max(original) > 2  # as it was taken, it would not fit


def test_masks_stay_those_of_the_photo(scene, tmp_path: Path) -> None:
    """Oracle: the photo's own pixels and size, and the size of the file that is saved."""
    made = import_capture(scene, capture_of(tmp_path / "c", ["OPENCV"]))
    scene.gscore.capture_path = str(tmp_path / "c")
    image, own = masks.make(scene, made.cameras[0]), photo_camera_of(made.cameras[0])
    assert tuple(image.size) == SIZE != (own.width, own.height)
    np.testing.assert_array_equal(np.rint(shown(image) * 255), board("OPENCV")[..., 0])
    saved = bpy.data.images.load(str(masks.save(scene, image)))
    assert tuple(saved.size) == SIZE


def test_photos_that_change_or_move_get_new_copies(scene, tmp_path: Path, own_copies: Path) -> None:
    """Oracle: the files in the folder, and the picture of the current photo."""
    made = import_capture(scene, capture_of(tmp_path / "c", ["OPENCV"]))
    ob = made.cameras[0]
    assert copy_needed(ob) is not None and "(Undistort Photos)" in panel()
    bpy.ops.gscore.straighten_photos()
    assert copy_needed(ob) is None and "(Undistort Photos)" not in panel()
    (first,) = own_copies.iterdir()
    before = shown(photo_of(ob)).copy()

    photo = Path(photo_camera_of(ob).photo)
    write_png(photo, 255 - board("OPENCV"))
    os.utime(photo, (1e9, 1e9))
    ob.data.background_images[0].alpha, ob.data.show_background_images = 0.5, False
    bpy.ops.gscore.straighten_photos()
    (second,) = own_copies.iterdir()
    assert second != first
    np.testing.assert_allclose(shown(photo_of(ob)), 1 - before, atol=1.5 / 255)
    assert ob.data.background_images[0].alpha == 0.5 and not ob.data.show_background_images

    shutil.move(tmp_path / "c", tmp_path / "d")
    assert copy_needed(ob) is None  # there is no photo to make it from
    assert captures.relink(made.root, tmp_path / "d") == (1, 1)
    assert copy_needed(ob) is not None
    bpy.ops.gscore.straighten_photos()
    assert len([*own_copies.iterdir()]) == 2
    np.testing.assert_allclose(shown(photo_of(ob)), 1 - before, atol=1.5 / 255)


def test_files_find_their_copies_again(scene, tmp_path: Path, own_copies: Path) -> None:
    """Oracle: the picture after opening the file; a message if no copy can be made."""
    import_capture(scene, capture_of(tmp_path / "c", ["OPENCV", "SIMPLE_RADIAL"]))
    bpy.ops.gscore.straighten_photos()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "c" / "x.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "c" / "x.blend"))
    cameras = [ob for ob in bpy.data.objects if is_camera(ob)]
    assert [copy_needed(ob) for ob in cameras] == [None, None]
    assert undistort_jobs.queue_copies(cameras) == 0
    assert shown(photo_of(cameras[0])).std() > 0.3
    assert bpy.ops.gscore.straighten_photos() == {"FINISHED"}
    undistorted_photos.part_of(undistorted_photos.copies(own_copies)[0]).write_bytes(b"half")
    assert bpy.ops.gscore.remove_straight_photos() == {"FINISHED"}
    assert [*own_copies.iterdir()] == []
    assert None not in [copy_needed(ob) for ob in cameras]


def test_unreadable_photo_is_reported(scene, tmp_path: Path, own_copies: Path) -> None:
    """Oracle: the message of the operator and in the panel; the other photo is shown."""
    folder = capture_of(tmp_path / "c", ["OPENCV", "SIMPLE_RADIAL"])
    (folder / "images" / "OPENCV.png").write_bytes(b"no picture")
    import_capture(scene, folder)
    with pytest.raises(RuntimeError, match=r"OPENCV\.png"):
        bpy.ops.gscore.straighten_photos()
    assert "OPENCV.png" in panel()
    (copy,) = own_copies.iterdir()
    assert copy.name.startswith("SIMPLE_RADIAL-")


def test_the_queue_stops_and_goes_on(scene, tmp_path: Path, own_copies: Path) -> None:
    """Oracle: the existing copies; none is waited for."""
    made = import_capture(scene, capture_of(tmp_path / "c", [*LENSES]))
    assert not bpy.ops.gscore.stop_straightening.poll()
    assert undistort_jobs.queue_copies(made.cameras) == 3
    assert not undistort_jobs.collect()
    begun = copy_needed(made.cameras[0])
    assert "Undistorting photos: 0 of 3" in drawn(CamerasPanel)
    assert not bpy.ops.gscore.remove_straight_photos.poll()
    assert bpy.ops.gscore.stop_straightening() == {"FINISHED"}
    undistort_jobs.wait()
    assert undistorted_photos.copies(own_copies) == [begun]  # which was under way, and stays whole
    bpy.ops.gscore.straighten_photos()
    assert len(undistorted_photos.copies(own_copies)) == 3
    assert [copy_needed(ob) for ob in made.cameras] == [None] * 3


def test_a_picture_that_the_user_chose_stays(scene, tmp_path: Path, own_copies: Path) -> None:
    """Oracle: the picture in the background, after backgrounds were linked to their copies."""
    made = import_capture(scene, capture_of(tmp_path / "c", ["OPENCV"]))
    ob = made.cameras[0]
    write_png(tmp_path / "own.png", board("OPENCV"))
    chosen = bpy.data.images.load(str(tmp_path / "own.png"))
    ob.data.background_images[0].image = chosen
    assert undistort_jobs.queue_copies([ob]) == 0 and copy_needed(ob) is None
    assert "(Undistort Photos)" not in panel()
    captures.relink(made.root, tmp_path / "c")
    assert [slot.image for slot in ob.data.background_images] == [chosen]
    assert not own_copies.exists()

    slot = ob.data.background_images[0]
    slot.image = None
    captures.relink(made.root, tmp_path / "c")
    assert copy_needed(ob) is not None and len(ob.data.background_images) == 1


def test_a_wrong_link_is_led_to_a_copy_that_is_there(
    scene, tmp_path: Path, own_copies: Path
) -> None:
    """Oracle: the file in the background; no copy is requested, and opacity stays."""
    made = import_capture(scene, capture_of(tmp_path / "c", ["OPENCV"]))
    bpy.ops.gscore.straighten_photos()
    (ob,), (copy,) = made.cameras, own_copies.iterdir()
    slot = ob.data.background_images[0]
    slot.image.filepath, slot.alpha = str(tmp_path / "elsewhere.png"), 0.5
    ob.data.show_background_images = False
    assert copy_needed(ob) == copy and "(Undistort Photos)" in panel()
    assert undistort_jobs.queue_copies([ob]) == 0 and not undistort_jobs.QUEUE.busy
    assert slot.image.filepath == str(copy) and copy_needed(ob) is None
    assert slot.alpha == 0.5 and not ob.data.show_background_images


def test_a_damaged_camera_keeps_none_from_the_others(scene, tmp_path: Path) -> None:
    """Oracle: the number of requested copies; the message in the panel and of the operator."""
    made = import_capture(scene, capture_of(tmp_path / "c", ["OPENCV", "SIMPLE_RADIAL"]))
    del made.cameras[0]["gs_K"]
    assert undistort_jobs.queue_copies(made.cameras) == 1
    undistort_jobs.QUEUE.kill()
    assert "has lost a custom property" in panel() and "(Undistort Photos)" in panel()
    with pytest.raises(RuntimeError, match="has lost a custom property"):
        bpy.ops.gscore.straighten_photos()
    assert copy_needed(made.cameras[1]) is None


def test_panels_wait_for_no_disk(scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the threads that check photos, and the number of checks."""
    import_capture(scene, capture_of(tmp_path / "c", [*LENSES]))
    main, looks = threading.current_thread(), []

    def copy_of(own: PhotoCamera, photo: Path) -> Path:
        looks.append((own.model, threading.current_thread()))
        return undistorted_photos.copy_of(own, photo)

    monkeypatch.setattr(backgrounds, "copy_of", copy_of)
    for _ in range(5):
        assert "(Undistort Photos)" in panel()
    assert sorted(model for model, _ in looks) == sorted(LENSES)
    assert main not in [thread for _, thread in looks]


def test_many_cameras_are_asked_for_at_once(
    scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the number of passes over all images of the file."""
    made = import_capture(scene, capture_of(tmp_path / "c", [*LENSES]))
    for ob in made.cameras:
        os.utime(photo_camera_of(ob).photo, (1e9, 1e9))  # so that all copies have other names
    calls = []
    known = backgrounds.KnownImages
    monkeypatch.setattr(undistort_jobs, "KnownImages", lambda: calls.append(1) or known())
    assert undistort_jobs.queue_copies(made.cameras) == 3 and len(calls) == 1
    undistort_jobs.QUEUE.kill()
    assert [copy_needed(ob) for ob in made.cameras] == [
        backgrounds.file_of(photo_of(ob)) for ob in made.cameras
    ]


def test_reason_of_a_refused_lens() -> None:
    """Oracle: the error of the trainer, which refuses the lens too; importing again helps only if a
    lens can be undistorted."""
    known = {"image": "a.png", "photo": "", "viewmat": np.eye(4), "K": np.eye(3)}
    known |= {"width": SIZE[0], "height": SIZE[1], "model": "SIMPLE_RADIAL"}
    folded = PhotoCamera(**known, params=(260.0, 160.0, 120.0, -1.5))
    with pytest.raises(ValueError, match=r"^a\.png cannot be undistorted.*folds back"):
        undistorted_photos.undistortion_of(folded)
    with pytest.raises(ValueError, match="import the capture's cameras again"):
        undistorted_photos.undistortion_of(PhotoCamera(**known, params=LENSES["SIMPLE_RADIAL"]))


def test_preferences_tell_the_copies_once_they_are_counted(
    scene, own_copies: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the files in the folder, and that the panel waits for the counting thread."""
    looked, count = threading.Event(), undistort_jobs._SIZES._function
    monkeypatch.setattr(
        undistort_jobs._SIZES, "_function", lambda folder: looked.wait(60) and count(folder)
    )
    own_copies.mkdir(parents=True)
    (own_copies / "a.png").write_bytes(bytes(3_000_000))
    layout = Layout()
    undistort_jobs.draw_copies(layout, preferences.get())
    assert layout.notes == [] and poll_timer.poll()
    looked.set()
    while poll_timer.poll():
        time.sleep(0.01)
    undistort_jobs.draw_copies(layout, preferences.get())
    assert "1 files, 3 MB" in layout.text and "(Remove Undistorted Photos)" in layout.text
