"""Render regions of renders, and of 3D views with their cameras."""

import bpy
import numpy as np

from .picture import Window


def camera_of(context: bpy.types.Context) -> bpy.types.Object | None:
    """The camera of a view in camera perspective, else None."""
    space, region = context.space_data, context.region_data
    if region.view_perspective != "CAMERA":
        return None
    return space.camera if space.use_local_camera else context.scene.camera


def frame_of(
    camera: bpy.types.Object, scene: bpy.types.Scene, window: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray]:
    """Lower left corner and size of a camera's frame in its view, px.

    Args:
        camera: Of type CAMERA.
        scene: Defines the frame's aspect ratio.
        window: [4, 4] float64, Blender's projection of the view.
        width: Width of the view, px.
        height: Height of the view, px.
    """
    corners = np.array([tuple(c) for c in camera.data.view_frame(scene=scene)])
    clip = np.column_stack([corners, np.ones(4)]) @ window.T
    places = (clip[:, :2] / clip[:, 3:] + 1) / 2 * (width, height)
    return places.min(axis=0), np.ptp(places, axis=0)


def drawn_window(
    context: bpy.types.Context, window: np.ndarray, width: int, height: int
) -> Window | None:
    """The Render Region (Ctrl-B) of a view, as in Cycles and EEVEE; None: all of it.

    Args:
        context: Context of the view.
        window: As for `frame_of`.
        width: Width of the view, px.
        height: Height of the view, px.
    """
    render, space = context.scene.render, context.space_data
    workbench = space.shading.type == "RENDERED" and render.engine == "BLENDER_WORKBENCH"
    if space.shading.type not in {"MATERIAL", "RENDERED"} or workbench:
        return None
    low, size = np.zeros(2), np.array([width, height], np.float64)
    if context.region_data.view_perspective != "CAMERA":
        if not space.use_render_border:
            return None
        least = space.render_border_min_x, space.render_border_min_y
        most = space.render_border_max_x, space.render_border_max_y
    else:
        camera = camera_of(context)
        if camera is None or camera.type != "CAMERA" or not render.use_border:
            return None
        low, size = frame_of(camera, context.scene, window, width, height)
        least = render.border_min_x, render.border_min_y
        most = render.border_max_x, render.border_max_y
    left, bottom = (round(v) for v in low + size * least)
    right, top = (round(v) for v in low + size * most)
    # One pixel at least, as in Cycles, even if the region is outside of the view.
    left, bottom = min(max(left, 0), width - 1), min(max(bottom, 0), height - 1)
    right, top = min(max(right, left + 1), width), min(max(top, bottom + 1), height)
    return left, height - top, right - left, top - bottom


def border_window(
    render: bpy.types.RenderSettings, width: int, height: int
) -> tuple[Window | None, tuple[int, int]]:
    """A window of a render that includes its border, and the border's left and bottom pixel in it;
    None and (0, 0) without a border."""
    if not render.use_border:
        return None, (0, 0)
    # In float32, as in Blender.
    ends = np.float32([render.border_min_x, render.border_min_y])
    corner = [int(end) for end in ends * np.float32([width, height])]
    right = min(int(np.ceil(render.border_max_x * width)) + 1, width)
    top = min(int(np.ceil(render.border_max_y * height)) + 1, height)
    left, bottom = min(corner[0], width - 1), min(corner[1], height - 1)
    window = left, height - top, max(right - left, 1), max(top - bottom, 1)
    return window, (corner[0] - left, corner[1] - (height - window[1] - window[3]))
