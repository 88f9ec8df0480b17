"""Viewport rendering: Rendered shading from pictures that a thread draws, shown when complete."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Protocol
from weakref import WeakValueDictionary

import bpy
import gpu
import numpy as np
from gpu_extras.presets import draw_texture_2d
from mathutils import Matrix

from ..cameras.camera_math import FLIP
from ..cameras.render_camera import RenderCamera
from ..core import CancelFlag, Cancelled, GsError
from ..interface.option_labels import error_words
from ..interface.views import redraw_views
from ..process import threads
from . import picture
from .holdout_meshes import HoldoutMesh, same_meshes
from .model import Model, SplatCache
from .pass_renderer import Film
from .scene import Placed
from .selections import Tinted, marked
from .shutter_lens import View

QUICK = 0.08
"""Seconds a picture should take while the view turns; above, it is drawn smaller first."""
PATIENCE = 2 * QUICK
"""Seconds that a picture in full size may take before a newer wish drops it."""
COARSEST = 8
"""Largest factor by which it is drawn smaller."""
_POLL = 0.02
"""Seconds between two looks whether a picture is ready."""


class ViewRequest(Protocol):
    """A picture that is wanted of a painter."""

    @property
    def placed(self) -> list[Placed]:
        """The objects."""
        ...

    @property
    def camera(self) -> RenderCamera:
        """Of the view."""
        ...

    def same(self, other: Any) -> bool:
        """Whether the other picture, or None, is this one."""
        ...

    def shoot(
        self, model: Model, camera: RenderCamera, stop: Callable[[], bool], cancel: CancelFlag
    ) -> np.ndarray:
        """[H, W, 4] float32, premultiplied, the bottom row first; errors as `picture.draw`.

        Args:
            model: Of `placed`.
            camera: The wish's, or one with fewer pixels.
            stop: As `picture.draw`.
            cancel: As `picture.draw`.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class Request:
    """A picture that is wanted in Rendered shading."""

    placed: list[Placed]
    held: tuple[HoldoutMesh, ...]
    camera: RenderCamera
    options: picture.Options
    transparent: bool
    to_scene: np.ndarray
    over_view: bool = False
    """As `Film`; whether it is laid over what Blender draws over views of the engine."""
    tinted: Tinted = Tinted.NONE
    """Of which objects what is selected is seen."""

    def same(self, other: "Request | None") -> bool:
        """Whether the other picture is this one."""
        return (
            other is not None
            and [(p.part, p.antialias, p.holdout, p.edited) for p in self.placed]
            == [(p.part, p.antialias, p.holdout, p.edited) for p in other.placed]
            and all(
                a.frozen is b.frozen and np.array_equal(a.matrix, b.matrix)
                for a, b in zip(self.placed, other.placed, strict=True)
            )
            and same_meshes(self.held, other.held)
            and self.camera.same(other.camera)
            and (self.options, self.transparent) == (other.options, other.transparent)
            and (self.over_view, self.tinted) == (other.over_view, other.tinted)
            and np.array_equal(self.to_scene, other.to_scene)
        )

    def shoot(
        self, model: Model, camera: RenderCamera, stop: Callable[[], bool], cancel: CancelFlag
    ) -> np.ndarray:
        """As `ViewRequest`; scene-linear, if it is not to lie over the view."""
        options = self.options
        if options.window is not None:
            camera, window = _scaled(self.camera, options.window, camera)
            options = replace(options, window=window)
        film = Film(
            options=options,
            transparent=self.transparent,
            to_scene=self.to_scene,
            over_view=self.over_view,
        )
        seen = marked(model, self.placed, self.tinted)
        view = View(model=seen, camera=camera, held=self.held)
        return film.shoot(view, stop, cancel)["Combined"]


class ViewPainter:
    """Draws the last picture that was asked for, smaller first; knows nothing of bpy."""

    def __init__(self, cache: SplatCache) -> None:
        self._cache = cache
        self._wish = threading.Condition()
        self._request: ViewRequest | None = None
        self._cancel = CancelFlag()
        self._thread: threading.Thread | None = None
        self._factor = 1
        self.pixels: np.ndarray | None = None
        """[H, W, 4] of the last finished picture, bottom row first."""
        self.made: ViewRequest | None = None
        """What it was made of."""
        self.problem = ""
        """Why there is no picture."""
        self.fresh = False
        """Whether something was finished since this was last set to False."""
        self.busy = False
        """Whether something is being drawn."""
        self._finished: ViewRequest | None = None

    def shows(self, request: ViewRequest) -> bool:
        """Whether `pixels` are this picture in full size."""
        return self.pixels is not None and request.same(self._finished)

    def ask(self, request: ViewRequest) -> None:
        """Draw this from now on.

        What is drawn for an older wish is dropped where it takes long, but for its small picture:
        while a view turns, wishes come faster than pictures can be finished.
        """
        with self._wish:
            if request.same(self._request):
                return
            self._request, self.busy = request, True
            if self._thread is None:
                self._thread = threads.start(self._run, "gscore-viewport", cancel=self.close)
            self._wish.notify()

    def close(self) -> None:
        """End the thread."""
        with self._wish:
            self._request, self._closed = None, True
            self._cancel.set()
            self._wish.notify()

    _closed = False

    def _run(self) -> None:
        done: ViewRequest | None = None
        while True:
            with self._wish:
                self.busy = self._request is not None and self._request is not done
                while self._request is done and not self._closed:
                    self._wish.wait()
                if self._closed:
                    return
                request, self._cancel = self._request, CancelFlag()
            try:
                self._paint(request)
                done = request
            except Cancelled:
                self._factor = max(2, self._factor)
            except (GsError, ValueError, MemoryError) as error:
                self.problem = error_words(error) or "Out of memory."
                self.pixels, done, self.fresh = None, request, True

    def _paint(self, request: ViewRequest) -> None:
        """Draw at a size that is quick, then at the full one."""
        model = self._cache.model(request.placed)
        for factor in dict.fromkeys((self._factor, 1)):
            began = time.perf_counter()
            camera = smaller(request.camera, factor)
            until = began + PATIENCE if factor == 1 else float("inf")
            pixels = request.shoot(
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
        wanted = (took / QUICK) ** 0.5  # the last one was full size
        self._factor = min(COARSEST, max(1, int(np.ceil(wanted))))

    def _is_old(self, request: ViewRequest) -> bool:
        return self._request is not request


class Viewport:
    """One 3D viewport in Rendered shading; used on the main thread only."""

    def __init__(self, cache: SplatCache) -> None:
        self.painter = ViewPainter(cache)
        self._texture: tuple[np.ndarray, gpu.types.GPUTexture] | None = None

    @property
    def window(self) -> picture.Window | None:
        """The part of the view that the painter's last picture is of; None: all of it."""
        made = self.painter.made
        return made.options.window if isinstance(made, Request) else None

    def draw(
        self, pixels: np.ndarray, width: int, height: int, window: picture.Window | None = None
    ) -> None:
        """Draw [H, W, 4] float32, premultiplied, over a region of width x height pixels.

        They are taken to the graphics card when they are others than before.

        Args:
            pixels: What is drawn.
            width: Of the region.
            height: Of the region.
            window: The part of it that they fill; None: all.
        """
        left, top, wide, high = window or (0, 0, width, height)
        if self._texture is None or self._texture[0] is not pixels:
            flat = gpu.types.Buffer("FLOAT", pixels.size, pixels.reshape(-1))
            made = gpu.types.GPUTexture(pixels.shape[1::-1], format="RGBA16F", data=flat)
            self._texture = pixels, made
        gpu.state.blend_set("ALPHA_PREMULT")
        draw_texture_2d(self._texture[1], (left, height - top - high), wide, high)
        gpu.state.blend_set("NONE")

    def draw_over(self, pixels: np.ndarray, clip: picture.Window | None = None) -> None:
        """The same over all that Blender has drawn of a view, while it draws it.

        Args:
            pixels: What is drawn.
            clip: The part of the view that gets any of it; None: all.
        """
        view = gpu.state.viewport_get()
        part = part_of(view, clip)
        low = part[0] - view[0], part[1] - view[1]
        with drawn_to(part), gpu.matrix.push_pop(), gpu.matrix.push_pop_projection():
            gpu.matrix.load_identity()
            gpu.matrix.load_projection_matrix(_from(*low, *part[2:]))
            gpu.state.depth_test_set("NONE")
            gpu.state.depth_mask_set(False)
            self.draw(pixels, *view[2:], self.window)


def part_of(
    view: tuple[int, int, int, int], window: picture.Window | None
) -> tuple[int, int, int, int]:
    """Left, bottom, width and height of a window of a view that is given in the same way."""
    left, bottom, width, height = view
    own_left, top, wide, high = window or (0, 0, width, height)
    return left + own_left, bottom + height - top - high, wide, high


@contextmanager
def drawn_to(part: tuple[int, int, int, int]) -> Iterator[None]:
    """Draw to a part of a target, as `part_of`, and to nothing beside it."""
    before = gpu.state.viewport_get()
    gpu.state.viewport_set(*part)
    try:
        yield
    finally:
        gpu.state.viewport_set(*before)


@contextmanager
def bound(target: gpu.types.GPUFrameBuffer) -> Iterator[None]:
    """Draw to another target, then to the same part of the present one as before.

    OpenGL keeps the part with each target; Blender's Vulkan backend resets it to the whole target
    each time one is bound, also when the inner `with` of two ends.
    """
    viewport, scissor = gpu.state.viewport_get(), gpu.state.scissor_get()
    try:
        with target.bind():
            yield
    finally:
        gpu.state.viewport_set(*viewport)
        gpu.state.scissor_set(*scissor)


def _from(left: int, bottom: int, width: int, height: int) -> Matrix:
    """The projection of pixels in which a part of them fills what is drawn to."""
    right, up = 2 / width, 2 / height
    return Matrix(
        (
            (right, 0, 0, -1 - left * right),
            (0, up, 0, -1 - bottom * up),
            (0, 0, 1, 0),
            (0, 0, 0, 1),
        )
    )


class StandIn(Protocol):
    """Draws splats over views whose picture is not ready."""

    def stands_in(self, context: bpy.types.Context) -> bool:
        """Whether it draws the view of a context."""

    def moves(self, context: bpy.types.Context) -> bool:
        """Whether the view of a context is on the move, so that no picture will be of use."""

    def stays(self, context: bpy.types.Context) -> bool:
        """Whether it draws the view of a context as long as nothing there is held out, so that no
        picture is wanted."""

    def lays_over(self, context: bpy.types.Context) -> bool:
        """Whether it draws what `OVER` has of the view of a context over what Blender draws."""


STAND_INS: list[StandIn] = []
"""What was registered."""
EXACT: set[int] = set()
"""Pointers of the regions that show a finished picture of what they show now."""
OVER: WeakValueDictionary[int, Viewport] = WeakValueDictionary()
"""Whose last picture is to be laid over what Blender draws, by the pointer of its region."""


def view_camera(
    view: np.ndarray, window: np.ndarray, width: int, height: int, *, perspective: bool
) -> RenderCamera:
    """The camera of a 3D view from its matrices, both [4, 4] float64 as Blender has them.

    Orthographic views see behind their own origin; they are moved back so that all is in front.
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
    """The same view with that many times fewer pixels a side."""
    width, height = max(1, camera.width // factor), max(1, camera.height // factor)
    K = camera.K.copy()
    K[0] *= width / camera.width
    K[1] *= height / camera.height
    return replace(camera, K=K, width=width, height=height)


def _scaled(
    view: RenderCamera, window: picture.Window, small: RenderCamera
) -> tuple[RenderCamera, picture.Window]:
    """The whole view in about as many pixels as `small` has, and a window of it in whole ones.

    The camera stays that of the whole view: how large a splat near its edges is drawn depends on
    where they are, so a camera of the window alone would show another picture.

    Args:
        view: The whole view.
        window: In pixels of the view.
        small: The view with as many pixels or fewer.
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


def redraw_when_ready(painter: ViewPainter) -> None:
    """Have 3D views drawn again once the painter has something new."""

    def poll() -> float | None:
        if painter.fresh:
            redraw_views()
        return _POLL if painter.busy or painter.fresh else None

    bpy.app.timers.register(poll, first_interval=_POLL)
