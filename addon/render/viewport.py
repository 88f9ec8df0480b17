"""Viewport rendering: Rendered shading from pictures that a thread draws, shown when complete."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Protocol
from weakref import WeakValueDictionary

import bpy
import gpu
import numpy as np
from gpu_extras.presets import draw_texture_2d
from mathutils import Matrix

from ..cameras.camera_math import FLIP
from ..cameras.render_camera import RenderCamera
from ..core import CancelFlag, Cancelled, GsError
from ..equality import same
from ..interface.option_labels import error_text
from ..interface.windows import redraw_views
from ..process.background_task import Latest
from . import picture
from .device import RenderDevice
from .holdout_meshes import HoldoutMesh
from .model import Model, SplatCache
from .pass_renderer import PassRenderer
from .scene import Placed
from .selections import Tinted, marked
from .shutter_lens import View

QUICK = 0.08
"""Seconds a picture should take while the view moves; above, a smaller picture comes first."""
PATIENCE = 2 * QUICK
"""Seconds that a picture in full size may take before a newer request cancels it."""
COARSEST = 8
"""Largest factor of the reduction of smaller pictures."""
_POLL = 0.02
"""Seconds between two checks for a finished picture."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """A picture requested for Rendered shading."""

    placed: list[Placed]
    holdout_meshes: tuple[HoldoutMesh, ...]
    camera: RenderCamera
    options: picture.Options
    transparent: bool
    to_scene: np.ndarray
    over_view: bool = False
    """True if it is drawn over Blender's overlays of the view."""
    tinted: Tinted = Tinted.NONE
    """Objects whose selection is shown."""

    def render(
        self, model: Model, camera: RenderCamera, stop: Callable[[], bool], cancel: CancelFlag
    ) -> np.ndarray:
        """The picture, [H, W, 4] float32, premultiplied, the bottom row first; scene-linear unless
        `over_view`.

        Args:
            model: Model of `placed`.
            camera: The request's, or one with fewer pixels.
            stop: As for `picture.draw`, also for errors.
            cancel: As for `picture.draw`.
        """
        options = self.options
        if options.window is not None:
            camera, window = _scaled(self.camera, options.window, camera)
            options = replace(options, window=window)
        pass_renderer = PassRenderer(
            options=options,
            transparent=self.transparent,
            to_scene=self.to_scene,
            over_view=self.over_view,
        )
        visible = marked(model, self.placed, self.tinted)
        view = View(model=visible, camera=camera, holdouts=self.holdout_meshes)
        return pass_renderer.render(view, stop, cancel)["Combined"]


class ViewRenderer:
    """Thread that draws the last requested picture, smaller first; without bpy."""

    def __init__(self, cache: SplatCache) -> None:
        self._cache = cache
        self._worker: Latest[Request, None] = Latest(self._answer, "gscore-viewport")
        self._request: Request | None = None
        self._cancel = CancelFlag()
        self._factor = 1
        self.pixels: np.ndarray | None = None
        """The last finished picture, [H, W, 4], bottom row first."""
        self.made: Request | None = None
        """Request of the last picture."""
        self.problem = ""
        """Why there is no picture; empty: no problem."""
        self.fresh = False
        """Whether a picture was finished since this was last set to False."""
        self._finished: Request | None = None

    @property
    def busy(self) -> bool:
        """Whether a picture is being drawn."""
        return self._worker.busy

    def shows(self, request: Request) -> bool:
        """Whether `pixels` are the requested picture in full size."""
        return self.pixels is not None and same(request, self._finished)

    def submit(self, request: Request) -> None:
        """Draw a picture, instead of earlier requests.

        An earlier picture in full size is cancelled if it takes long. Its small picture is
        finished, because requests of a moving view come faster than pictures are drawn.
        """
        if not same(request, self._request):
            self._request = request
            self._worker.submit(request)

    def close(self) -> None:
        """End the thread."""
        self._request = None
        self._cancel.set()
        self._worker.close()

    def _answer(self, request: Request) -> None:
        self._cancel = CancelFlag()  # a stopped picture has set the last one
        if self._request is None:
            return  # closed
        try:
            self._paint(request)
        except Cancelled:
            self._factor = max(2, self._factor)
        except (GsError, ValueError, MemoryError) as error:
            self.problem = error_text(error) or "Out of memory."
            self.pixels, self.fresh = None, True

    def _paint(self, request: Request) -> None:
        """Draw at a small, quick size, then at full size."""
        model = self._cache.model(request.placed)
        for factor in dict.fromkeys((self._factor, 1)):
            began = time.perf_counter()
            camera = smaller(request.camera, factor)
            until = began + PATIENCE if factor == 1 else float("inf")
            pixels = request.render(
                model,
                camera,
                lambda until=until: self._is_old(request) and time.perf_counter() > until,
                self._cancel,
            )
            took = time.perf_counter() - began
            self.pixels, self.made, self.problem, self.fresh = pixels, request, "", True
            if factor > 1 and self._is_old(request):
                self._factor = min(COARSEST, factor + (took > 2 * QUICK))
                return
        self._finished = request
        factor = (took / QUICK) ** 0.5  # the last picture had full size
        self._factor = min(COARSEST, max(1, int(np.ceil(factor))))

    def _is_old(self, request: Request) -> bool:
        return self._request is not request


class Viewport:
    """One 3D viewport in Rendered shading; main thread only."""

    def __init__(self, cache: SplatCache) -> None:
        self.renderer = ViewRenderer(cache)
        self._texture: tuple[np.ndarray, gpu.types.GPUTexture] | None = None

    @property
    def window(self) -> picture.Window | None:
        """The part of the view in the renderer's last picture; None: all of it."""
        made = self.renderer.made
        return None if made is None else made.options.window

    def draw(
        self, pixels: np.ndarray, width: int, height: int, window: picture.Window | None = None
    ) -> None:
        """Draw a picture over a region, uploading it to the graphics card if it is new.

        Args:
            pixels: [H, W, 4] float32, premultiplied.
            width: Width of the region, px.
            height: Height of the region, px.
            window: The part of it to fill; None: all.
        """
        left, top, wide, high = window or (0, 0, width, height)
        if self._texture is None or self._texture[0] is not pixels:
            flat = gpu.types.Buffer("FLOAT", pixels.size, pixels.reshape(-1))
            made = gpu.types.GPUTexture(pixels.shape[1::-1], format="RGBA16F", data=flat)
            self._texture = pixels, made
        gpu.state.blend_set("ALPHA_PREMULT")
        draw_texture_2d(self._texture[1], (left, height - top - high), wide, high)
        gpu.state.blend_set("NONE")

    def draw_over(self, pixels: np.ndarray) -> None:
        """Draw a picture over everything that Blender has drawn of a view, in a draw handler.

        Args:
            pixels: As for `draw`.
        """
        view = gpu.state.viewport_get()
        with gpu.matrix.push_pop(), gpu.matrix.push_pop_projection():
            gpu.matrix.load_identity()
            gpu.matrix.load_projection_matrix(_from(*view[2:]))
            gpu.state.depth_test_set("NONE")
            gpu.state.depth_mask_set(False)
            self.draw(pixels, *view[2:], self.window)


def part_of(
    view: tuple[int, int, int, int], window: picture.Window | None
) -> tuple[int, int, int, int]:
    """Left, bottom, width and height of a window of a view, which is given in the same order."""
    left, bottom, width, height = view
    own_left, top, wide, high = window or (0, 0, width, height)
    return left + own_left, bottom + height - top - high, wide, high


@contextmanager
def drawn_to(part: tuple[int, int, int, int]) -> Iterator[None]:
    """Limit drawing to a part of a target, as from `part_of`."""
    before = gpu.state.viewport_get()
    gpu.state.viewport_set(*part)
    try:
        yield
    finally:
        gpu.state.viewport_set(*before)


@contextmanager
def bound(target: gpu.types.GPUFrameBuffer) -> Iterator[None]:
    """Draw to another target, then restore viewport and scissor of the current one.

    OpenGL stores them with each target; Blender's Vulkan backend resets them to the whole target
    whenever one is bound, also when the inner `with` of two ends.
    """
    viewport, scissor = gpu.state.viewport_get(), gpu.state.scissor_get()
    try:
        with target.bind():
            yield
    finally:
        gpu.state.viewport_set(*viewport)
        gpu.state.scissor_set(*scissor)


def _from(width: int, height: int) -> Matrix:
    """The projection from the pixels of a target."""
    return Matrix(((2 / width, 0, 0, -1), (0, 2 / height, 0, -1), (0, 0, 1, 0), (0, 0, 0, 1)))


class Fallback(Protocol):
    """Live drawing of views whose picture is not ready, see `live.draw_handler.LiveFallback`."""

    def draws_live(self, context: bpy.types.Context) -> bool: ...
    def moves(self, context: bpy.types.Context) -> bool: ...
    def stays(self, context: bpy.types.Context) -> bool: ...
    def covers_photos(self, context: bpy.types.Context) -> bool: ...


FALLBACKS: list[Fallback] = []
"""Registered live drawing."""
EXACT: set[int] = set()
"""Pointers of regions that show a finished, current picture."""
OVER: WeakValueDictionary[int, Viewport] = WeakValueDictionary()
"""Viewports whose last picture is drawn over Blender's drawing, by the pointer of the region."""


def view_camera(
    view: np.ndarray, window: np.ndarray, width: int, height: int, *, perspective: bool
) -> RenderCamera:
    """The camera of a 3D view from Blender's matrices, both [4, 4] float64.

    Orthographic views show points behind their origin; they are moved back so that all are in
    front.
    """
    viewmat = FLIP @ view
    K = np.eye(3)
    K[0, 0], K[1, 1] = window[0, 0] * width / 2, window[1, 1] * height / 2
    if perspective:
        K[0, 2], K[1, 2] = (1 - window[0, 2]) * width / 2, (1 + window[1, 2]) * height / 2
        near = window[2, 3] / (window[2, 2] - 1)
    else:
        K[0, 2], K[1, 2] = (1 + window[0, 3]) * width / 2, (1 - window[1, 3]) * height / 2
        near = (window[2, 3] + 1) / window[2, 2]
        far = (window[2, 3] - 1) / window[2, 2]
        ahead = 1e-3 * (far - near)
        viewmat[2, 3] += ahead - near
        near = ahead
    return RenderCamera(
        viewmat=viewmat,
        K=K,
        width=width,
        height=height,
        near=float(near),
        orthographic=not perspective,
        name="3D view",
    )


def smaller(camera: RenderCamera, factor: int) -> RenderCamera:
    """The view with each side reduced by a factor."""
    width, height = max(1, camera.width // factor), max(1, camera.height // factor)
    K = camera.K.copy()
    K[0] *= width / camera.width
    K[1] *= height / camera.height
    return replace(camera, K=K, width=width, height=height)


def _scaled(
    view: RenderCamera, window: picture.Window, small: RenderCamera
) -> tuple[RenderCamera, picture.Window]:
    """The whole view at about the size of `small`, and a window of it in whole pixels.

    The camera stays that of the whole view, because the drawn size of splats near its edges depends
    on the edges: a camera of the window alone would give another picture.

    Args:
        view: The whole view.
        window: In pixels of the view.
        small: The view at the same or a smaller size.
    """
    whole, part = (view.width, view.height), (small.width, small.height)
    K, places, sizes, ends = view.K.copy(), [], [], []
    for axis in (0, 1):
        low, length = window[axis], window[axis + 2]
        sizes.append(max(1, round(length * part[axis] / whole[axis])))
        scale = sizes[axis] / length
        places.append(round(low * scale))
        ends.append(max(places[axis] + sizes[axis], round(whole[axis] * scale)))
        K[axis] *= scale
        K[axis, 2] += places[axis] - low * scale
    return replace(view, K=K, width=ends[0], height=ends[1]), (*places, *sizes)


def redraw_when_ready(renderer: ViewRenderer, device: RenderDevice | None = None) -> None:
    """Redraw 3D views as soon as the renderer has a new picture, and when the status of the device
    that draws it changes."""
    shown = device.status if device else ""

    def poll() -> float | None:
        nonlocal shown
        status = device.status if device else ""
        if renderer.fresh or status != shown:
            shown = status
            redraw_views()
        return _POLL if renderer.busy or renderer.fresh else None

    bpy.app.timers.register(poll, first_interval=_POLL)
