"""Depth of field and motion blur. Oracles: thin-lens optics, and pictures without either."""

from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from addon.core import Splats, write_splats
from addon.render import compositor, panels, pass_renderer, shutter_lens
from addon.render.samples import Aperture, Shutter, samples
from addon.timeline import mesh
from tests.addon import splat_scenes as lab
from tests.addon.calls import import_sequence
from tests.addon.drawn import Layout
from tests.addon.render import test_mesh_holdout as meshes
from tests.light_changes import encode

LEVEL = 1 / 255


def point(place: tuple[float, float, float]) -> Splats:
    """One white opaque splat much smaller than a pixel."""
    return Splats(
        means=np.array([place], np.float32),
        quats=np.array([[1, 0, 0, 0]], np.float32),
        scales=np.full((1, 3), np.log(1e-4), np.float32),
        opacities=np.full(1, 8, np.float32),
        sh0=np.full((1, 1, 3), 0.5 / lab.SH_C0, np.float32),
        shN=np.zeros((1, 0, 3), np.float32),
    )


def open_lens(
    scene: bpy.types.Scene, diameter: float, focus: float, count: int = 256
) -> bpy.types.Camera:
    """Give the scene's camera an aperture of a diameter in world units, and a focus distance."""
    data = scene.camera.data
    data.dof.use_dof, data.dof.focus_distance = True, focus
    length = data.lens * 1e-3 if data.type == "PERSP" else 1.0
    data.dof.aperture_fstop = length / diameter
    scene.gscore_render.blur_samples = count
    return data


def spot(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Centroid, standard deviations (x, y in pixels) and sum of the light of a picture."""
    light = picture[..., 3].astype(np.float64)
    y, x = np.mgrid[: light.shape[0], : light.shape[1]] + 0.5
    places = np.stack([x, y])
    middle = (places * light).sum((1, 2)) / light.sum()
    variance = ((places - middle[:, None, None]) ** 2 * light).sum((1, 2)) / light.sum()
    return middle, np.sqrt(variance), float(light.sum())


@pytest.mark.parametrize(
    ("depth", "focus", "diameter"), [(4.0, 2.0, 0.5), (2.0, 4.0, 0.25), (3.0, 40.0, 0.4)]
)
def test_circle_of_confusion(scene, tmp_path, depth, focus, diameter):
    """Oracle: the thin lens, c = A f |1/F - 1/z| pixels, by extent and by second moment."""
    lab.prepare(scene, size=(120, 100))
    scene.render.film_transparent = True
    lab.add(scene, point((0.0, 0.0, 4.0 - depth)))
    _, sharp, _ = spot(lab.render_exr(tmp_path, "sharp"))
    data = open_lens(scene, diameter, focus)
    picture = lab.render_exr(tmp_path)
    pixels = data.lens / data.sensor_width * 120
    wanted = diameter * pixels * abs(1 / focus - 1 / depth)
    assert wanted > 10
    middle, spread, _ = spot(picture)
    np.testing.assert_allclose(middle, [60, 50], atol=0.2)
    # A disk's variance along an axis is a sixteenth of its squared diameter.
    disk = 4 * np.sqrt(spread**2 - sharp**2)
    np.testing.assert_allclose(disk, wanted, atol=0.5)
    lit = picture[..., 3] > picture[..., 3].max() / 8
    across = lit.any(0).sum(), lit.any(1).sum()
    np.testing.assert_allclose(across, wanted + 1.5, atol=2)


def test_splats_in_focus_are_sharp(scene, tmp_path):
    """Oracle: the picture without depth of field, to 2/255 in sRGB; nearer splats differ."""
    lab.prepare(scene, light=0.2)
    lab.add(scene, lab.wall(0.0, (0.2, 0.5, 0.8), half=0.8))
    lab.add(scene, lab.wall(0.001, (0.9, 0.5, 0.1), half=0.3), "smaller")
    sharp = encode(lab.render_exr(tmp_path, "sharp")[..., :3])
    open_lens(scene, 0.3, 4.0, 32)
    focused = encode(lab.render_exr(tmp_path, "focused")[..., :3])
    assert np.abs(focused - sharp).max() <= 2 * LEVEL
    scene.camera.data.dof.focus_distance = 2.0
    blurred = encode(lab.render_exr(tmp_path, "blurred")[..., :3])
    assert np.abs(blurred - sharp).max() > 40 * LEVEL


def test_parallel_rays_lean_through_what_is_in_focus(scene, tmp_path):
    """Oracle: the cone of an aperture A that meets at F is A |1 - z / F| wide at z."""
    camera = lab.prepare(scene, size=(100, 100))
    camera.data.type, camera.data.ortho_scale = "ORTHO", 4.0
    scene.render.film_transparent = True
    ob = lab.add(scene, point((0.0, 0.0, 0.0)))
    _, sharp, _ = spot(lab.render_exr(tmp_path, "sharp"))
    open_lens(scene, 0.5, 2.0)
    middle, spread, _ = spot(lab.render_exr(tmp_path))
    np.testing.assert_allclose(middle, [50, 50], atol=0.2)
    np.testing.assert_allclose(4 * np.sqrt(spread**2 - sharp**2), 0.5 * 25, atol=0.5)
    ob.location.z = 2.0
    np.testing.assert_allclose(spot(lab.render_exr(tmp_path, "focused"))[1], sharp, atol=0.01)


def test_focus_on_an_object(scene, tmp_path):
    """Oracle: the distance along the camera's axis, typed in."""
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    data = open_lens(scene, 0.3, 2.5, 8)
    typed = lab.render_exr(tmp_path, "typed")
    target = bpy.data.objects.new("target", None)
    scene.collection.objects.link(target)
    target.location = (0.7, -0.4, 1.5)
    data.dof.focus_object, data.dof.focus_distance = target, 77.0
    np.testing.assert_allclose(lab.render_exr(tmp_path, "object"), typed, atol=1e-5)


def test_blades_and_ratio_shape_the_hole():
    """Oracle: the outline and area moments of a regular polygon, and of an ellipse."""
    many = samples(4096)
    disk = np.array([Aperture(radius=2.0, distance=1.0).point(s) for s in many])
    np.testing.assert_allclose((disk**2).mean(0), 1.0, rtol=5e-3)  # R^2 / 4
    assert np.abs(disk.mean(0)).max() < 5e-3
    wide = [Aperture(radius=2.0, distance=1.0, ratio=2.0).point(s) for s in many]
    np.testing.assert_allclose(np.array(wide), disk / [2, 1])
    square = Aperture(radius=1.0, distance=1.0, blades=4)
    corners = np.array([square.point(s) for s in many])
    # Circumradius 1, corners at 45 degrees: sides of length sqrt 2 along the axes.
    assert 0.69 < np.abs(corners).max() <= 0.5**0.5 + 1e-9
    np.testing.assert_allclose((corners**2).mean(0), 2 / 12, rtol=1e-2)
    turned = Aperture(radius=1.0, distance=1.0, blades=4, rotation=np.pi / 4)
    assert np.abs(np.abs(np.array([turned.point(s) for s in many])).sum(1)).max() <= 1 + 1e-9


def test_a_shutter_curve_gives_moments_their_share():
    """Oracle: a shutter that opens linearly has half of its light after sqrt(1/2)."""
    even = Shutter(opens=-0.25, length=0.5)
    times = [even.time(s) for s in samples(4)]
    np.testing.assert_allclose(times, [-0.1875, -0.0625, 0.0625, 0.1875])
    rising = Shutter(opens=0.0, length=1.0, curve=tuple(np.linspace(0, 1, 65)))
    times = [rising.time(s) for s in samples(64)]
    np.testing.assert_allclose(times, np.sqrt((np.arange(64) + 0.5) / 64), atol=2e-3)


def column(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centroid and standard deviation of the light of each row, pixels."""
    light = picture[..., 3].astype(np.float64)
    x = np.arange(light.shape[1]) + 0.5
    middle = (light * x).sum(1) / light.sum(1)
    return middle, np.sqrt((light * (x - middle[:, None]) ** 2).sum(1) / light.sum(1))


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 1.0])
def test_a_rolling_shutter_leans_like_that_of_cycles(scene, tmp_path, share):
    """Oracle: a thin bar rendered by Cycles, row by row; and its slant by the speed."""
    camera = lab.prepare(scene, size=(120, 60))
    scene.render.film_transparent = True
    places = np.stack([np.zeros(81), np.linspace(-1.2, 1.2, 81), np.zeros(81)], 1)
    dots = point((0.0, 0.0, 0.0))
    names = ("quats", "scales", "opacities", "sh0", "shN")
    fields = {name: np.repeat(getattr(dots, name), 81, axis=0) for name in names}
    fields["scales"] = fields["scales"] + 5
    splats = lab.add(scene, Splats(means=places.astype(np.float32), **fields))
    mesh = bpy.data.meshes.new("bar")
    corners = [(-0.02, -1.2, 0), (0.02, -1.2, 0), (0.02, 1.2, 0), (-0.02, 1.2, 0)]
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    bar = bpy.data.objects.new("bar", mesh)
    scene.collection.objects.link(bar)
    for ob in (splats, bar):
        lab.moving(ob, 0.6)
    scene.frame_set(5)
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
    curve = scene.render.motion_blur_shutter_curve
    curve.curves[0].points[0].location.y = 0.2
    curve.update()
    scene.cycles.rolling_shutter_type, scene.cycles.rolling_shutter_duration = "TOP", share
    scene.gscore_render.blur_samples = 120
    bar.hide_render = True
    ours, width = column(lab.render_exr(tmp_path, "ours"))
    bar.hide_render, splats.hide_render = False, True
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 256, False
    scene.cycles.use_adaptive_sampling, scene.cycles.pixel_filter_type = False, "BOX"
    theirs, spread = column(lab.render_exr(tmp_path, "theirs"))
    assert np.abs(ours - theirs).max() < 0.35
    assert np.abs(width - spread).max() < 0.5  # splats are wider than the bar
    speed = 0.6 * camera.data.lens / camera.data.sensor_width * 120 / 4
    lean = (1 - share) * speed * 59 / 60
    assert ours[-1] - ours[0] == pytest.approx(lean, abs=0.3)


def test_mattes_and_borders_roll_too(scene, tmp_path):
    """Oracle: the rows of the whole picture; the alpha of the only object."""
    lab.prepare(scene, size=(60, 40))
    scene.render.film_transparent = True
    lab.moving(lab.add(scene, lab.wall(0.0, (0.9, 0.2, 0.1)), "only"), 0.5)
    scene.frame_set(5)
    scene.render.use_motion_blur = True
    scene.cycles.rolling_shutter_type, scene.cycles.rolling_shutter_duration = "TOP", 0.2
    scene.gscore_render.blur_samples = 8
    whole = lab.render_exr(tmp_path, "whole")
    layer = scene.view_layers[0]
    layer.use_pass_cryptomatte_object = True
    np.testing.assert_allclose(
        lab.render_pass(scene, tmp_path, "CryptoObject00") != 0, whole[..., 3] > 0
    )
    layer.use_pass_cryptomatte_object, scene.render.use_compositing = False, False
    scene.render.use_border = scene.render.use_crop_to_border = True
    scene.render.border_min_y, scene.render.border_max_y = 0.5, 0.75
    part = lab.render_exr(tmp_path, "part")
    np.testing.assert_allclose(part, whole[10:20], atol=1e-5)


def test_composites_roll_where_cycles_draws_the_meshes(scene):
    """Oracle: the duration in Cycles; none with another engine, or without a rolling shutter."""
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    scene.render.engine = "CYCLES"
    scene.render.use_motion_blur = True
    other = compositor.set_up(scene)
    assert shutter_lens.shutter_of(other).row is None
    scene.cycles.rolling_shutter_type, scene.cycles.rolling_shutter_duration = "TOP", 0.25
    assert shutter_lens.shutter_of(other).row == 0.25
    scene.render.engine = "BLENDER_WORKBENCH"
    assert shutter_lens.shutter_of(other).row is None


@pytest.mark.parametrize("what", ["splats", "camera"])
@pytest.mark.parametrize(("position", "offset"), [("START", 0.5), ("CENTER", 0), ("END", -0.5)])
def test_motion_makes_streaks(scene, tmp_path, what, position, offset):
    """Oracle: a streak of speed times shutter, at the position of the exposure."""
    camera = lab.prepare(scene, size=(160, 40))
    scene.render.film_transparent = True
    splats = lab.add(scene, point((0.0, 0.0, 0.0)))
    scene.frame_set(5)
    _, sharp, light = spot(lab.render_exr(tmp_path, "sharp"))
    ob, sign = (splats, 1) if what == "splats" else (camera, -1)
    lab.moving(ob, 0.4)
    scene.frame_set(5)
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 0.8
    scene.render.motion_blur_position = position
    scene.gscore_render.blur_samples = 64
    middle, spread, streak = spot(lab.render_exr(tmp_path))
    pixels = camera.data.lens / camera.data.sensor_width * 160 / 4
    length = 0.4 * 0.8 * pixels
    np.testing.assert_allclose(middle, [80 + sign * offset * length, 20], atol=0.1)
    # A line's variance is a twelfth of its squared length.
    assert np.sqrt(12 * (spread[0] ** 2 - sharp[0] ** 2)) == pytest.approx(length, abs=0.3)
    assert spread[1] == pytest.approx(sharp[1], abs=0.05)
    assert streak == pytest.approx(light, rel=0.05)
    assert scene.frame_current_final == 5


def test_static_splats_are_drawn_once(scene, tmp_path, monkeypatch):
    """Oracle: the picture without motion blur, and the number of drawings."""
    drawings, drawn = [], pass_renderer.picture.draw

    def draw(*args, **options):
        drawings.append(args)
        return drawn(*args, **options)

    lab.prepare(scene, light=0.3)
    lab.add(scene, lab.blob())
    still = lab.render_exr(tmp_path, "still")
    monkeypatch.setattr(pass_renderer.picture, "draw", draw)
    scene.render.use_motion_blur = True
    np.testing.assert_allclose(lab.render_exr(tmp_path), still, rtol=1e-6, atol=1e-7)
    assert len(drawings) == 1


def test_depth_is_that_of_the_frame_itself(scene, tmp_path):
    """Oracle: the wall's distance at the frame, with an open lens and a moving wall."""
    camera = lab.prepare(scene)
    lab.add(scene, lab.wall(1.0, (0.9, 0.2, 0.1), half=0.5))
    lab.moving(camera, 0.3)
    scene.frame_set(5)
    scene.view_layers[0].use_pass_z = True
    sharp = lab.render_pass(scene, tmp_path, "Depth")
    open_lens(scene, 0.5, 1.0, 4)
    scene.render.use_motion_blur = True
    np.testing.assert_array_equal(lab.render_pass(scene, tmp_path, "Depth"), sharp)
    assert (sharp < 1e9).any()


def test_hidden_for_half_of_the_exposure(scene, tmp_path):
    """Oracle: half of the light, from an object that is hidden from the frame's middle on."""
    lab.prepare(scene)
    scene.render.film_transparent = True
    ob = lab.add(scene, lab.wall(0.0, (0.9, 0.2, 0.1)))
    for frame, hidden in ((5, False), (6, True)):
        ob.hide_render = hidden
        ob.keyframe_insert("hide_render", frame=frame)
    scene.frame_set(5)
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 2.0
    scene.render.motion_blur_position = "START"
    assert lab.render_exr(tmp_path)[35, 45, 3] == pytest.approx(0.5, abs=0.01)


def test_same_picture_every_time(scene, tmp_path):
    """Oracle: the first render, bit by bit."""
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    open_lens(scene, 0.3, 3.0, 8)
    first = lab.render_exr(tmp_path, "first")
    np.testing.assert_array_equal(lab.render_exr(tmp_path, "second"), first)


def test_a_sequence_blurs_over_its_frames(scene, tmp_path: Path):
    """Oracle: the mean of the frames within the exposure, rendered alone; their mesh stays."""
    lab.prepare(scene)
    scene.render.film_transparent = True
    folder = tmp_path / "frames"
    folder.mkdir()
    for i in range(1, 9):
        write_splats(folder / f"{i:04}.ply", lab.blob(200, seed=i))
    ob, _ = import_sequence(bpy.context, folder)
    alone = []
    for frame in (3, 4):
        scene.frame_set(frame)
        alone.append(lab.render_exr(tmp_path, f"alone{frame}"))
    scene.frame_set(3)
    held = mesh.file_label(ob)
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 2.0
    scene.render.motion_blur_position = "START"
    scene.gscore_render.blur_samples = 16
    got = lab.render_exr(tmp_path)
    np.testing.assert_allclose(got, np.mean(alone, 0), atol=1e-5)
    assert np.abs(alone[0] - alone[1]).max() > 0.1
    assert mesh.file_label(ob) == held
    ob.cycles.use_deform_motion = False
    got = lab.render_exr(tmp_path, "frame")
    np.testing.assert_allclose(got, alone[0], atol=1e-5)


@pytest.mark.parametrize("what", ["object", "camera", "instancer", "held", "layer"])
def test_objects_without_motion_blur_are_sharp(scene, tmp_path, what):
    """Oracle: the picture of the frame itself; and a streak with one switch on again."""
    camera = lab.prepare(scene)
    scene.render.film_transparent = True
    ob = lab.add(scene, lab.blob(200, size=0.3))
    lab.add(scene, lab.wall(-1.0, (0.9, 0.2, 0.1), half=0.4), "still")
    if what == "instancer":
        group = bpy.data.collections.new("group")
        scene.collection.objects.unlink(ob)
        group.objects.link(ob)
        ob = bpy.data.objects.new("instancer", None)
        scene.collection.objects.link(ob)
        ob.instance_type, ob.instance_collection = "COLLECTION", group
    moved = camera if what == "camera" else ob
    if what == "held":
        moved = meshes.plane(scene, z=0.3, right=0.1)
        moved.is_holdout = True
    lab.moving(moved, 0.3)
    scene.frame_set(5)
    sharp = lab.render_exr(tmp_path, "sharp")
    scene.render.use_motion_blur = True
    scene.gscore_render.blur_samples = 4
    owner = scene.view_layers[0] if what == "layer" else moved.cycles
    owner.use_motion_blur = False
    np.testing.assert_allclose(lab.render_exr(tmp_path, "rests"), sharp, atol=1e-5)
    owner.use_motion_blur = True
    assert np.abs(lab.render_exr(tmp_path, "moves") - sharp).max() > 0.1


def test_one_object_rests_while_another_moves(scene, tmp_path):
    """Oracle: where the unblurred object is alone, its own picture of the frame; a streak
    elsewhere; it is visible for the whole exposure, although it is hidden after the frame."""
    lab.prepare(scene)
    scene.render.film_transparent = True
    rests = lab.add(scene, lab.blob(200, center=(-0.8, 0, 0), size=0.3), "rests")
    moves = lab.add(scene, lab.blob(200, center=(0.8, 0, 0), size=0.2, seed=1), "moves")
    for ob in (rests, moves):
        lab.moving(ob, 0.3)
    for frame, hidden in ((5, False), (6, True)):
        rests.hide_render = hidden
        rests.keyframe_insert("hide_render", frame=frame)
    scene.frame_set(5)
    sharp = lab.render_exr(tmp_path, "sharp")
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 2.0
    scene.gscore_render.blur_samples = 4
    rests.cycles.use_motion_blur = False
    got = np.abs(lab.render_exr(tmp_path) - sharp).max((0, 2))
    assert got[:40].max() < 1e-5 and got[50:].max() > 0.1


def test_the_switch_is_offered(scene, tmp_path):
    """Oracle: Blender's names of the switches; that of frames only for a sequence."""

    def offered(ob: bpy.types.Object) -> str:
        layout = Layout()
        context = SimpleNamespace(object=ob, scene=scene, engine=scene.render.engine)
        panel = panels.OBJECT_PT_gscore_motion_blur
        assert panel.poll(context)
        shown = SimpleNamespace(layout=layout)
        panel.draw_header(shown, context)
        panel.draw(shown, context)
        return layout.text

    camera = lab.prepare(scene)
    write_splats(tmp_path / "1.ply", lab.blob(20))
    playing, _ = import_sequence(bpy.context, tmp_path)
    for ob in (camera, lab.add(scene, lab.blob(20))):
        assert offered(ob) == "<use_motion_blur>"
    assert offered(playing) == "<use_motion_blur> <use_deform_motion>"
    light = bpy.data.objects.new("light", bpy.data.lights.new("light", "SUN"))
    context = SimpleNamespace(object=light, engine=scene.render.engine)
    assert not panels.OBJECT_PT_gscore_motion_blur.poll(context)
