"""Comparison with photos. Oracle: gscore's metrics and pictures of the same view."""

import json
import os
import shutil
import threading
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from addon import stored_paths
from addon.cameras.objects import photo_camera_of
from addon.cameras.undistorted_photos import lens_of
from addon.core import Folder, downscale, plan_undistortion, psnr, read_colmap, render, write_colmap
from addon.panels.render import RenderPanel
from addon.process.incremental_tasks import Steps, TaskRunner, run_blocking
from addon.render import camera_photo as photo_module
from addon.render import compare
from addon.splats import objects
from gscore.io.exposure_json import EXPOSURE_FILE, write_exposures
from gscore.io.images.png import write_png
from gscore.photo_exposure import PhotoExposure
from tests.addon import splat_scenes as lab
from tests.addon.calls import import_capture
from tests.addon.drawn import drawn
from tests.light_changes import encode

STUDIO = Path(__file__).parents[3] / "examples" / "studio"


@pytest.fixture
def studio(scene):
    """The bundled capture, a splat at each of its points, and the engine's settings."""
    capture = import_capture(bpy.context.scene, STUDIO, photos=False)
    values = np.empty(3 * len(capture.points.data.vertices), np.float32)
    capture.points.data.attributes["position"].data.foreach_get("vector", values)
    means = values.reshape(-1, 3)
    blob = lab.blob(len(means))
    fields = {n: getattr(blob, n) for n in ("quats", "opacities", "sh0", "shN")}
    splats = type(blob)(means=means, scales=blob.scales - 0.5, **fields)
    objects.create(splats, "s", collection=capture.collection, parent=capture.root)
    lab.prepare(scene, light=0.1)
    return capture, splats


def compared(scene, camera, depsgraph) -> compare.Comparison:
    """Compare in one call, as in scripts."""
    return run_blocking(compare.Comparing(scene, camera, depsgraph).compared())


def pixels(image: bpy.types.Image) -> np.ndarray:
    """[H, W, 3], the top row first."""
    values = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)[::-1, :, :3]


def test_the_picture_has_the_exposure_of_the_photo(studio, scene, tmp_path):
    """Oracle: the picture without exposures, exposed as in the run's exposure.json, but for the
    background; without it, or for splats of two runs, the picture as it is."""
    capture, _ = studio
    camera, scene.gscore.use_masks = capture.cameras[9], False
    ob = bpy.data.objects["s"]
    graph = bpy.context.evaluated_depsgraph_get
    stored_paths.write(ob, stored_paths.RUN, tmp_path)
    plain = compared(scene, camera, graph())
    before = pixels(plain.images["Render"])
    gain = np.array([0.5, 0.7, 0.9])
    write_exposures(
        tmp_path / EXPOSURE_FILE, {photo_camera_of(camera).image: PhotoExposure.of(gain)}
    )
    found = compared(scene, camera, graph())
    after = pixels(found.images["Render"])
    background = float(encode(0.1))
    empty = (np.abs(before - background) < 0.5 / 255).all(axis=2)
    assert not plain.exposed and found.exposed and found.psnr < plain.psnr
    assert np.abs(after - before)[empty].max(initial=0) <= 4 / 255
    assert (after <= before + 1 / 255).all() and (after < before - 0.05).any()
    solid = before[~empty].max(axis=0)  # opaque and bright
    wanted = (solid + 0.055) * gain - 0.055
    np.testing.assert_allclose(after[~empty].max(axis=0), wanted, atol=0.03)
    copy = ob.copy()
    capture.collection.objects.link(copy)
    stored_paths.write(copy, stored_paths.RUN, tmp_path / "other")
    assert not compared(scene, camera, graph()).exposed


@pytest.mark.parametrize("percentage", [100, 50, 37])
def test_psnr_and_pictures(studio, scene, percentage):
    """Oracle: gscore.render with the capture's own K, and the photo scaled by gscore."""
    capture, splats = studio
    camera = capture.cameras[9]
    scene.render.resolution_percentage, scene.gscore.use_masks = percentage, False
    found = compared(scene, camera, bpy.context.evaluated_depsgraph_get())
    own = photo_camera_of(camera)
    width, height = own.width * percentage // 100, own.height * percentage // 100
    K = np.diag([width / own.width, height / own.height, 1]) @ own.K
    near = camera.data.clip_start / capture.root.scale[0]
    background = (float(encode(0.1)),) * 3
    want = render(splats, K, own.viewmat, width, height, near=near, background=background)
    shown = np.clip(want.rgb, 0, 1)
    photo = lab.read_image(Path(own.photo))[..., :3]
    photo = downscale(np.rint(photo * 255).astype(np.uint8), width, height) / np.float32(255)
    assert found.psnr == pytest.approx(psnr(shown, photo), abs=1e-3)
    assert camera["gs_psnr"] == found.psnr
    images = {kind: pixels(image) for kind, image in found.images.items()}
    np.testing.assert_allclose(images["Photo"], photo, atol=0.51 / 255)
    np.testing.assert_allclose(images["Render"], shown, atol=1.5 / 255)
    assert images["Comparison"].shape == (height, 3 * width, 3)
    error = np.abs(shown - photo).mean(axis=2)
    bright = images["Error"].sum(axis=2)
    assert bright[error > 0.2].min() > bright[error < 0.01].max()
    assert 3 < found.psnr < 40
    assert found.psnr_masked is None


@pytest.mark.parametrize(("shrink", "percentage"), [(4, 100), (4, 50), (3, 100)])
def test_a_photo_smaller_than_its_camera(studio, scene, tmp_path, shrink, percentage):
    """Oracle: the picture has the photo's size times the percentage."""
    capture, _ = studio
    camera = capture.cameras[0]
    width, height = (int(side) // shrink for side in camera["gs_size"])
    write_png(tmp_path / "small.png", np.full((height, width, 3), 90, np.uint8))
    camera["gs_photo"] = str(tmp_path / "small.png")
    scene.render.resolution_percentage, scene.gscore.use_masks = percentage, False
    found = compared(scene, camera, bpy.context.evaluated_depsgraph_get())
    size = tuple(found.images["Photo"].size)
    assert size == (width * percentage // 100, height * percentage // 100)
    np.testing.assert_allclose(pixels(found.images["Photo"]), 90 / 255, atol=1e-3)


def test_masks_of_the_capture_count(studio, scene):
    """Oracle: gscore's definition, on the mask file read apart: both pictures times the mask."""
    camera = studio[0].cameras[9]
    depsgraph = bpy.context.evaluated_depsgraph_get()
    scene.gscore.use_masks = False
    whole = compared(scene, camera, depsgraph)
    photo, shown = (pixels(whole.images[kind]) for kind in ("Photo", "Render"))
    scene.gscore.use_masks, scene.gscore.mask_mode = True, "ignore"
    masked = compared(scene, camera, depsgraph)
    file = next((STUDIO / "masks").glob(f"{Path(camera['gs_image']).stem}*"))
    mask = lab.read_image(file)[..., :1].astype(np.float64)
    assert 0.05 < mask.mean() < 0.6
    squares = mask * (shown.astype(np.float64) - photo) ** 2
    assert masked.psnr == pytest.approx(-10 * np.log10((mask * squares).mean()), abs=0.05)
    inside = -10 * np.log10(squares.sum() / (3 * mask.sum()))
    assert masked.psnr_masked == pytest.approx(inside, abs=0.05)
    assert camera["gs_psnr_masked"] == masked.psnr_masked
    assert not pixels(masked.images["Photo"])[mask[..., 0] == 0].any()
    scene.gscore.invert_masks = True
    outside = compared(scene, camera, depsgraph)
    rest = ((1 - mask) * (shown.astype(np.float64) - photo) ** 2).sum() / (3 * (1 - mask).sum())
    assert outside.psnr_masked == pytest.approx(-10 * np.log10(rest), abs=0.05)
    scene.gscore.invert_masks = False
    for mode in ("composite", "auto"):  # they cut the figure out
        scene.gscore.mask_mode = mode
        composite = compared(scene, camera, depsgraph)
        assert composite.psnr_masked is None and "gs_psnr_masked" not in camera
        corner = pixels(composite.images["Photo"])[mask[..., 0] == 0]
        np.testing.assert_allclose(corner, encode(0.1), atol=1 / 255)


def target_pieces(camera) -> Steps[photo_module.Target]:
    """The target of the camera's picture."""
    own, options = photo_camera_of(camera), {"background": (0, 0, 0), "mask_mode": "auto"}
    return photo_module.load_target(camera, own.width, own.height, **options)


def target_of(camera) -> TaskRunner:
    """The steps that load the target."""
    return TaskRunner(target_pieces(camera))


def at_once_of(camera) -> photo_module.Target:
    """The target, loaded in one call."""
    return run_blocking(target_pieces(camera))


def test_masks_are_looked_for_in_a_thread(studio, scene, monkeypatch):
    """Oracle: the thread that searches each photo; the same target as in one call."""
    threads = {}

    class Noted(Folder):
        def find_mask(self, name: str) -> Path | None:
            threads[name] = threading.current_thread()
            return super().find_mask(name)

    camera = studio[0].cameras[9]
    at = at_once_of(camera)
    monkeypatch.setattr(photo_module, "Folder", Noted)
    work = target_of(camera)
    while not work.step():
        threading.Event().wait(0.0005)
    assert len(threads) == 60 and threading.main_thread() not in threads.values()
    np.testing.assert_array_equal(work.result.pixels, at.pixels)


@pytest.mark.parametrize("gone", [True, False])
def test_cameras_that_go_while_masks_are_read(studio, scene, gone):
    """Oracle: an error; cameras restored by undo, which are other objects in memory, work."""
    bpy.ops.ed.undo_push(message="before")
    name = studio[0].cameras[9].name
    work = target_of(studio[0].cameras[9])
    while not work.sentence.startswith("Reading masks"):
        work.step()
        threading.Event().wait(0.0005)
    if gone:
        for ob in studio[0].cameras:
            bpy.data.objects.remove(ob)
    else:
        bpy.data.objects[name].location.x += 1
        bpy.ops.ed.undo_push(message="moved")
        bpy.ops.ed.undo()

    def rest() -> None:
        while not work.step():
            threading.Event().wait(0.0005)

    if gone:
        with pytest.raises(ValueError, match="was removed while masks were read"):
            rest()
    else:
        rest()
        assert work.result.weight is None and work.result.pixels.size


def test_masks_of_a_linked_capture_beside_a_local_one(studio, scene, tmp_path):
    """With cameras of the same names. Oracle: the target of the local one, before."""
    local, file = studio[0], str(tmp_path / "capture.blend")
    name = local.cameras[9].name
    before = at_once_of(local.cameras[9])
    bpy.data.libraries.write(file, {local.root, *local.cameras})
    names = [local.root.name, *(camera.name for camera in local.cameras)]
    for camera in local.cameras:
        camera["gs_image"] = f"other/{camera['gs_image']}"
    with bpy.data.libraries.load(file, link=True) as (_, wanted):
        wanted.objects = names
    linked = [ob for ob in bpy.data.objects if ob.library is not None]
    for ob in linked:
        scene.collection.objects.link(ob)
    work = target_of(next(ob for ob in linked if ob.name == name))
    while not work.step():
        threading.Event().wait(0.0005)
    np.testing.assert_array_equal(work.result.pixels, before.pixels)


def test_operator_reports_and_stores(studio, scene, capfd):
    """Oracle: the function; running it again makes no further images."""
    capture, _ = studio
    scene.gscore.use_masks, scene.gscore.mask_mode = True, "ignore"
    name = capture.cameras[3].name
    assert bpy.ops.gscore.compare_photo(camera=name) == {"FINISHED"}
    images = len(bpy.data.images)
    scene.camera = capture.cameras[3]
    bpy.context.view_layer.objects.active = None
    assert bpy.ops.gscore.compare_photo() == {"FINISHED"}
    assert len(bpy.data.images) == images
    camera = capture.cameras[3]
    said = capfd.readouterr().out
    assert f"PSNR inside the mask {camera['gs_psnr_masked']:.2f} dB" in said
    scene.gscore.use_masks = False
    assert bpy.ops.gscore.compare_photo() == {"FINISHED"}
    assert f"PSNR {camera['gs_psnr']:.2f} dB" in capfd.readouterr().out


def test_one_click_from_the_worst_photo(studio, scene, tmp_path, capfd):
    """Oracle: metrics.json of the run, and Compare with Photo of its worst camera."""
    capture, _ = studio
    ob = bpy.data.objects["s"]
    names = [capture.cameras[i]["gs_image"] for i in (4, 7, 11)]
    views = [{"name": n, "psnr": p} for n, p in zip(names, (31.0, 17.5, 40.0), strict=True)]
    views.append({"name": "elsewhere.jpg", "psnr": 3.0})
    (tmp_path / "metrics.json").write_text(json.dumps({"views": views}))
    bpy.context.view_layer.objects.active = ob
    assert not bpy.ops.gscore.compare_worst_photo.poll()
    stored_paths.write(ob, stored_paths.RUN, tmp_path)
    assert "(Compare Worst Photo)" in drawn(RenderPanel)
    assert bpy.ops.gscore.compare_worst_photo() == {"FINISHED"}
    camera = capture.cameras[7]
    assert bpy.context.object == camera
    said = capfd.readouterr().out
    assert f"Worst of 3 photos, 17.50 dB when measured. {camera.name}: PSNR" in said
    assert "gs_psnr" in camera and "gs_psnr" not in capture.cameras[4]


def test_the_worst_photo_is_of_all_once_these_are_measured(studio, scene, tmp_path, capfd):
    """Oracle: metrics.json of Measure Errors; that of the training if it is newer."""
    capture, _ = studio
    ob = bpy.data.objects["s"]
    (tmp_path / "errors").mkdir()
    (tmp_path / "point_cloud.ply").write_bytes(b"ply")
    for folder, (row, worth) in ((tmp_path, (4, 31.0)), (tmp_path / "errors", (9, 12.25))):
        view = {"name": capture.cameras[row]["gs_image"], "psnr": worth}
        (folder / "metrics.json").write_text(json.dumps({"views": [view]}))
    stored_paths.write(ob, stored_paths.RUN, tmp_path)
    bpy.context.view_layer.objects.active = ob
    assert bpy.ops.gscore.compare_worst_photo() == {"FINISHED"}
    assert bpy.context.object == capture.cameras[9]
    assert "12.25 dB" in capfd.readouterr().out
    os.utime(tmp_path / "errors" / "metrics.json", (1e9, 1e9))
    bpy.context.view_layer.objects.active = ob
    assert bpy.ops.gscore.compare_worst_photo() == {"FINISHED"}
    assert bpy.context.object == capture.cameras[4]


@pytest.mark.parametrize("text", [None, "{", "[]", '{"views": [{"psnr": 1}]}', '{"views": []}'])
def test_a_run_that_evaluated_nothing_is_a_sentence(studio, tmp_path, text):
    """Oracle: the message names the file; nothing is selected."""
    ob = bpy.data.objects["s"]
    if text is not None:
        (tmp_path / "metrics.json").write_text(text)
    stored_paths.write(ob, stored_paths.RUN, tmp_path)
    bpy.context.view_layer.objects.active = ob
    assert "metrics.json" in lab.error_of(bpy.ops.gscore.compare_worst_photo)
    assert bpy.context.object == ob


def no_photo(camera, folder):
    camera["gs_photo"] = str(folder / "gone.jpg")


def other_photo(camera, folder):
    image = bpy.data.images.new("x", 30, 20)
    image.filepath_raw, image.file_format = str(folder / "x.png"), "PNG"
    image.save()
    camera["gs_photo"] = str(folder / "x.png")


def distorted(camera, folder):
    camera["gs_model"], camera["gs_params"] = "SIMPLE_RADIAL", [800.0, 240.0, 320.0, 0.1]


def no_picture(camera, folder):
    (folder / "x.jpg").write_bytes(b"no picture")
    camera["gs_photo"] = str(folder / "x.jpg")


def film(camera, folder):
    (folder / "x.mp4").write_text("#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/x.ts\n")
    camera["gs_photo"] = str(folder / "x.mp4")


@pytest.mark.parametrize("top", [1, 128])
def test_masks_of_labels_are_yes_and_no(studio, scene, tmp_path, top):
    """Oracle: the same mask in 0 and 255, as training reads it."""
    camera = studio[0].cameras[9]
    own = photo_camera_of(camera)
    shutil.copytree(STUDIO, tmp_path / "in", ignore=shutil.ignore_patterns("depths", "masks"))
    stored_paths.write(studio[0].root, stored_paths.SOURCE, str(tmp_path / "in"))
    found = []
    for white in (255, top):
        labels = np.zeros((own.height, own.width), np.uint8)
        labels[: own.height // 2] = white
        write_png(tmp_path / "in" / "masks" / f"{Path(own.photo).stem}.png", labels)
        options = {"background": (0.0, 0.0, 0.0), "mask_mode": "ignore"}
        found.append(
            run_blocking(photo_module.load_target(camera, own.width, own.height, **options))
        )
    np.testing.assert_array_equal(found[0].weight, found[1].weight)
    assert set(np.unique(found[0].weight).tolist()) == {0, 1}


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (film, "is a video file"),
        (no_photo, "find the capture's folder again"),
        (other_photo, "30 x 20 pixels"),
        (distorted, "has distortion (SIMPLE_RADIAL)"),
        (no_picture, "decode"),
    ],
)
def test_refusals_change_nothing(studio, scene, tmp_path, spoil, words):
    """Oracle: an error; no new images, no PSNR stored."""
    camera = studio[0].cameras[0]
    spoil(camera, tmp_path)
    images = set(bpy.data.images)
    message = lab.error_of(lambda: bpy.ops.gscore.compare_photo(camera=camera.name))
    assert words in message
    assert set(bpy.data.images) == images and "gs_psnr" not in camera


def test_a_camera_of_no_photo_is_refused(scene):
    """Oracle: the message says what to choose."""
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    assert "not the camera of a photo" in lab.error_of(
        lambda: bpy.ops.gscore.compare_photo(camera="Camera")
    )
    assert "Select an imported camera" in lab.error_of(bpy.ops.gscore.compare_photo)


def test_colours_of_the_photos_in_one_click(scene):
    """Oracle: Blender's own names; settings that already fit do not change a picture."""
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.exposure = 1.0
    from addon.render.operators import changes_colors

    assert "AgX" in changes_colors(scene) and "Exposure" in changes_colors(scene)
    assert bpy.ops.gscore.use_photo_colors() == {"FINISHED"}
    assert not changes_colors(scene)
    assert scene.view_settings.view_transform == "Standard"
    assert bpy.ops.gscore.use_engine() == {"FINISHED"}
    assert scene.render.engine == "GSCORE_SPLATS"


def test_pictures_are_kept_and_nothing_is_unsaved(studio, scene, tmp_path):
    """Oracle: Blender's own flag of unsaved images, and the pictures in the saved file."""
    for camera in studio[0].cameras[9:11]:  # the second time over the same images
        found = compared(scene, camera, bpy.context.evaluated_depsgraph_get())
        assert not any(image.is_dirty for image in bpy.data.images)
    before = pixels(found.images["Comparison"])
    found.images["Comparison"].use_fake_user = True  # as if an editor showed it
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "x.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "x.blend"))
    again = bpy.data.images["GS Comparison"]
    np.testing.assert_array_equal(pixels(again), before)
    assert not again.is_dirty and before.std() > 0.05


def test_splats_that_the_view_hides_are_not_blamed_on_renders(studio):
    """Oracle: the message about splats that are visible in renders, but not in the viewport."""
    bpy.data.objects["s"].hide_set(True)
    with pytest.raises(RuntimeError, match="show the splat object and its collection in the view"):
        bpy.ops.gscore.compare_photo(camera=studio[0].cameras[3].name)


@pytest.fixture
def bent(scene, tmp_path):
    """The studio photographed through a lens with this distortion: pixels of a pinhole are sampled
    by the lens's equation, solved for each pixel of the photo."""

    def make(k):
        model = read_colmap(STUDIO)
        (key,) = {image.camera_id for image in model.images}
        camera = model.cameras[key]
        focal, middle = camera.K[0, 0], camera.K[:2, 2]
        lens = replace(camera, model="SIMPLE_RADIAL", params=np.array([focal, *middle, k]))
        image = model.images[9]
        pinhole = lab.read_image(STUDIO / "images" / image.name)[..., :3]
        y, x = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
        wanted = (np.stack([x, y], axis=-1) - middle) / focal
        ray = wanted.copy()
        for _ in range(200):
            ray = wanted / (1 + k * (ray**2).sum(-1, keepdims=True))
        at = np.rint(ray * focal + middle - 0.5).astype(int)
        at = np.clip(at, 0, [camera.width - 1, camera.height - 1])
        photo = np.rint(pinhole[at[..., 1], at[..., 0]] * 255).astype(np.uint8)
        folder = tmp_path / "bent"
        write_png(folder / "images" / image.name.replace(".jpg", ".png"), photo)
        image = replace(image, name=image.name.replace(".jpg", ".png"))
        write_colmap(replace(model, cameras={key: lens}, images=[image]), folder / "sparse" / "0")
        return import_capture(scene, folder), pinhole, photo

    return make


@pytest.mark.parametrize("k", [-0.12, 0.1])
def test_photos_of_lenses_that_bend_are_straightened_as_for_training(scene, bent, k):
    """Oracle: the pinhole's picture before the distortion, moved to the principal point of the
    undistorted camera; and, to the byte, the undistorted photo of a training."""
    capture, pinhole, photo = bent(k)
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    scene.gscore.use_masks = False
    camera = capture.cameras[0]
    found = compared(scene, camera, bpy.context.evaluated_depsgraph_get())
    own, shown = photo_camera_of(camera), pixels(found.images["Photo"])
    plan = plan_undistortion(lens_of(own))
    assert shown.shape == (own.height, own.width, 3) == (plan.height, plan.width, 3)
    np.testing.assert_array_equal(np.rint(shown * 255), plan.undistort_photo(photo))
    assert found.psnr_masked is None
    y, x = np.mgrid[20 : own.height - 20, 20 : own.width - 20] + 0.5
    ray = np.stack([x - own.K[0, 2], y - own.K[1, 2]], axis=-1) / own.K[0, 0]
    at = np.rint(ray * own.K[0, 0] + np.array(own.params[1:3]) - 0.5).astype(int)
    inside = ((at >= 0) & (at < [pinhole.shape[1], pinhole.shape[0]])).all(-1)
    at = np.clip(at, 0, [pinhole.shape[1] - 1, pinhole.shape[0] - 1])
    straight = shown[20:-20, 20:-20]
    error = (straight - pinhole[at[..., 1], at[..., 0]])[inside]
    assert inside.mean() > 0.8 and -10 * np.log10((error**2).mean()) > 26


def test_masks_of_lenses_that_bend_are_straightened_too(scene, bent):
    """Oracle: the mask's rows, sampled where the lens has the rows of the undistorted photo."""
    capture, _, photo = bent(-0.12)
    camera = capture.cameras[0]
    own = photo_camera_of(camera)
    mask = np.zeros(photo.shape[:2], np.uint8)
    mask[200:] = 255
    folder = Path(own.photo).parents[1]
    write_png(folder / "masks" / f"{own.image}.png", mask)
    options = {"background": (0.0, 0.0, 0.0), "mask_mode": "ignore"}
    found = run_blocking(photo_module.load_target(camera, own.width, own.height, **options))
    y, x = np.mgrid[0 : own.height, 0 : own.width] + 0.5
    ray = (np.stack([x, y], axis=-1) - own.K[:2, 2]) / own.K[0, 0]
    f, _, cy, k = own.params
    row = (ray[..., 1] * (1 + k * (ray**2).sum(-1))) * f + cy
    sure = abs(row - 200) > 1
    np.testing.assert_array_equal(found.weight[sure], (row > 200)[sure])
