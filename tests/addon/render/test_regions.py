"""Render regions of 3D views, without a window. Oracles are named in the tests."""

from dataclasses import replace
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from addon.compat import matrix_to_numpy
from addon.core import CancelFlag, Splats
from addon.equality import same
from addon.render.model import SplatCache
from addon.render.regions import drawn_window
from addon.render.viewport import Request, smaller
from tests.addon import splat_scenes as lab
from tests.addon.render.test_viewport import request_for

SIZE = (120, 70)
PART = (30, 12, 52, 36)
"""Left, top, width and height of a region."""


def looking(
    scene: bpy.types.Scene, perspective: str, shading: str = "RENDERED", *, local: bool = False
) -> SimpleNamespace:
    """The context of a view with a render region; in camera perspective, with the scene's
    region."""
    ob = lab.prepare(scene, SIZE)
    render = scene.render
    render.border_min_x, render.border_max_x = 0.25, 0.75
    render.border_min_y, render.border_max_y = 0.5, 0.9
    space = SimpleNamespace(
        shading=SimpleNamespace(type=shading),
        use_render_border=True,
        render_border_min_x=0.1,
        render_border_max_x=0.4,
        render_border_min_y=0.2,
        render_border_max_y=0.9,
        use_local_camera=local,
        camera=ob,
    )
    region = SimpleNamespace(view_perspective=perspective)
    return SimpleNamespace(scene=scene, space_data=space, region_data=region)


def projection(scene: bpy.types.Scene, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Blender's own projection of the scene's camera in a view of that size, in which the picture
    fills the width."""
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return matrix_to_numpy(scene.camera.calc_matrix_camera(depsgraph, x=size[0], y=size[1]))


def test_a_views_own_region(scene: bpy.types.Scene) -> None:
    """Oracle: parts of the view by hand, from its upper left corner; none if it is off, in Solid
    shading, and with Workbench, which draws everything; Material Preview has it."""
    context = looking(scene, "PERSP")
    window = projection(scene)
    want = 12, 7, 36, 49
    assert drawn_window(context, window, *SIZE) == want
    context.space_data.shading.type = "MATERIAL"
    assert drawn_window(context, window, *SIZE) == want
    context.space_data.shading.type = "SOLID"
    assert drawn_window(context, window, *SIZE) is None
    context.space_data.shading.type = "RENDERED"
    scene.render.engine = "BLENDER_WORKBENCH"
    assert drawn_window(context, window, *SIZE) is None
    scene.render.engine = "GSCORE_SPLATS"
    context.space_data.use_render_border = False
    scene.render.use_border = True  # which is that of cameras
    assert drawn_window(context, window, *SIZE) is None


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("local", [False, True])
def test_the_region_of_the_camera_that_is_looked_through(
    scene: bpy.types.Scene, kind: str, local: bool
) -> None:
    """Oracle: parts of the camera's frame by hand: it fills the view, or is wider
    and lower than it."""
    context = looking(scene, "CAMERA", local=local)
    scene.camera.data.type = kind
    assert drawn_window(context, projection(scene), *SIZE) is None  # no region
    scene.render.use_border = True
    assert drawn_window(context, projection(scene), *SIZE) == (30, 7, 60, 28)
    high = SIZE[0], 4 * SIZE[1]
    window = projection(scene, high)
    scale = window[1, 1] / projection(scene)[1, 1] * high[1] / SIZE[1]
    got = drawn_window(context, window, *high)
    frame = np.array(SIZE) * scale
    left, bottom = (np.array(high) - frame) / 2
    low = max(left + 0.25 * frame[0], 0), bottom + 0.5 * frame[1]
    upper = min(left + 0.75 * frame[0], high[0]), bottom + 0.9 * frame[1]
    want = low[0], high[1] - upper[1], upper[0] - low[0], upper[1] - low[1]
    assert np.abs(np.subtract(got, want)).max() <= 1


def test_a_region_beside_the_view_is_a_pixel(scene: bpy.types.Scene) -> None:
    """Oracle: the pixel in the corner nearest to it, by hand."""
    context = looking(scene, "CAMERA")
    scene.render.use_border = True
    window = projection(scene)
    moved = np.eye(4)
    moved[0, 3], moved[1, 3] = 5, 5
    assert drawn_window(context, moved @ window, *SIZE) == (SIZE[0] - 1, 0, 1, 1)


def shot(request: Request, factor: int = 1) -> np.ndarray:
    """[H, W, 4], the top row first."""
    camera = smaller(request.camera, factor)  # as a renderer requests it
    model = SplatCache().model(request.placed)
    return request.render(model, camera, lambda: False, CancelFlag())[::-1]


def with_near_splat() -> Splats:
    """The first splat is large, close to the camera of `splat_scenes.prepare` and left of its view:
    its picture depends on the edges of the view."""
    splats = lab.blob(300)
    splats.means[0], splats.scales[0], splats.opacities[0] = (-0.9, 0.1, 3.2), np.log(0.3), 4
    return splats


@pytest.mark.parametrize("factor", [1, 2])
@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_the_region_shows_what_the_view_does(
    scene: bpy.types.Scene, kind: str, factor: int
) -> None:
    """Oracle: the same pixels of the whole view's picture, to the bit; a splat near the camera
    covers most of them."""
    lab.prepare(scene, SIZE).data.type = kind
    whole, _ = request_for(scene, with_near_splat(), size=SIZE)
    whole = replace(whole, transparent=True)
    part = replace(whole, options=replace(whole.options, window=PART))
    left, top, width, height = (v // factor for v in PART)
    want = shot(whole, factor)[top : top + height, left : left + width]
    np.testing.assert_array_equal(shot(part, factor), want)
    assert (want[..., 3] > 0.1).mean() > 0.5


def test_a_small_picture_of_a_region_stands_in_its_place(scene: bpy.types.Scene) -> None:
    """Oracle: centroids of light in the region's pixels of the whole picture, by hand, to 0.5 % of
    its size; odd sizes that are not divisible by three."""
    lab.prepare(scene, SIZE)
    whole, _ = request_for(scene, lab.blob(1500), size=SIZE)
    whole = replace(whole, transparent=True)
    part = replace(whole, options=replace(whole.options, window=(31, 13, 53, 37)))

    def middles(rgba: np.ndarray) -> np.ndarray:
        light = rgba[..., 3]
        shares = [(np.arange(n) + 0.5) / n for n in light.shape]
        return np.array([light.sum(1) @ shares[0], light.sum(0) @ shares[1]]) / light.sum()

    assert shot(part, 3).shape[:2] == (12, 18)
    assert np.abs(middles(shot(part, 3)) - middles(shot(part))).max() < 0.005


def test_the_picture_of_a_region(scene: bpy.types.Scene) -> None:
    """Oracle: the same pixels of the whole picture, to the bit; a smaller one: their means."""
    lab.prepare(scene, SIZE)
    whole, _ = request_for(scene, lab.blob(1500), size=SIZE)
    part = replace(whole, options=replace(whole.options, window=PART))
    assert not same(part, whole)
    left, top, width, height = PART
    want = shot(whole)[top : top + height, left : left + width]
    np.testing.assert_array_equal(shot(part), want)
    small = shot(part, 2)
    means = want.reshape(height // 2, 2, width // 2, 2, 4).mean((1, 3))
    assert small.shape == means.shape
    assert np.abs(small - means).mean() < 0.02 < np.std(means[..., :3])
