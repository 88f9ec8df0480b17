"""Graphics card resources: textures and shaders in its memory, draws, and the last
picture of a view; for draw handlers.
"""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field

import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from ..cameras.render_camera import RenderCamera
from ..compat import blends_float32, shaders_write_depth
from ..equality import same
from ..render.picture import Window
from ..render.viewport import bound, drawn_to, part_of
from . import program
from .clip import PLANES, Cuts, depth_of_z
from .program import QUADS
from .texture_upload import Order, texture
from .view_context import FrontPhoto

_log = logging.getLogger(__name__)
_OVER, _WITHIN, _HIDDEN = 0.0, 1.0, 2.0
"""Values of `layer` of `program.view`."""


@dataclass(frozen=True, kw_only=True)
class Shot:
    """Settings of a picture."""

    camera: RenderCamera
    """The view's camera, in Blender's world, with the picture's size."""
    viewmats: tuple[np.ndarray, ...]
    """[4, 4] float64 of each object of the atlas, from its space to the camera."""
    window: np.ndarray
    """[4, 4] float64, Blender's projection, which defines depths."""
    antialias: bool
    limit: int
    """Number of rows of the atlas to draw."""
    cuts: Cuts = field(default_factory=Cuts)


class Canvas:
    """Target on which splats are blended: premultiplied sRGB values, the bottom row first."""

    def __init__(self, width: int, height: int, *, nearness: bool, exact: bool = False) -> None:
        """Allocate the target.

        Args:
            width: Pixels.
            height: Pixels.
            nearness: Whether it includes nearness.
            exact: Whether to store float32 instead of float16, in which hundreds of faint splats
                are lost; a moving view does not need it.
        """
        self.width, self.height = width, height
        self.kind = width, height, nearness, exact
        """The arguments."""
        kind = "RGBA32F" if exact and blends_float32() else "RGBA16F"
        self.picture = gpu.types.GPUTexture((width, height), format=kind)
        self.nearness = gpu.types.GPUTexture((width, height), format="R32F") if nearness else None
        """1 - depth of splats, blended like their colours; None: not drawn."""
        slots = [t for t in (self.picture, self.nearness) if t is not None]
        self._buffer = gpu.types.GPUFrameBuffer(color_slots=slots)

    def bind(self) -> AbstractContextManager[None]:
        """Context manager that draws to it."""
        return bound(self._buffer)


class Card:
    """Shader programs and their geometry."""

    def __init__(self) -> None:
        """Prepare; `step` compiles."""
        self.nears = shaders_write_depth()
        """True if shaders of this card can write depth."""
        self.ready = False
        """Whether all programs are compiled."""
        self._compiling = self._compile()
        self._shut = False
        """Whether drawing to views' own pictures has failed."""

    def step(self) -> bool:
        """Compile the next program, which takes a driver up to some tens of milliseconds; return
        whether all are compiled.

        Raises:
            Exception: the driver cannot compile it.
        """
        if not self.ready:
            next(self._compiling)
        return self.ready

    def _compile(self) -> Iterator[None]:
        self._splats = program.splats()
        yield
        self._view = program.view()
        yield
        if self.nears:
            self._near_splats = program.splats(nearness=True)
            yield
            self._near_view = program.view(nearness=True)
            yield
        self._rows = program.rows()
        self._build_geometry()
        self.ready = True
        yield

    def _build_geometry(self) -> None:
        corners, indices = [], []
        for k in range(QUADS):
            corners += [(x, y, float(k)) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            indices += [(4 * k, 4 * k + 1, 4 * k + 2), (4 * k, 4 * k + 2, 4 * k + 3)]
        self._quads = batch_for_shader(
            self._splats, "TRIS", {"corner": corners}, indices=np.array(indices, np.int32)
        )
        big = [(-1, -1), (3, -1), (-1, 3)]
        self._screen = batch_for_shader(self._view, "TRIS", {"corner": big})
        self._piece = batch_for_shader(self._rows, "TRIS", {"corner": big})
        self._nothing = texture(np.full((1, 1, 1), 2, np.float32))

    def draw(
        self,
        target: Canvas,
        atlas: gpu.types.GPUTexture,
        order: Order,
        shot: Shot,
        meshes: gpu.types.GPUTexture | None,
    ) -> None:
        """Blend splats on a target of the camera's size.

        Args:
            target: The target.
            atlas: Texture of `Texels`.
            order: Order of rows of the atlas.
            shot: Camera and settings.
            meshes: Depths of objects that hide splats, at the camera's aspect ratio; None: none.
        """
        camera = shot.camera
        shader = self._splats if target.nearness is None else self._near_splats
        planes = np.zeros((PLANES, 4))  # in camera space; padding with zeros cuts nothing
        planes[: len(shot.cuts.planes)] = shot.cuts.planes @ np.linalg.inv(camera.viewmat)
        rows = np.concatenate([*(m[:3] for m in shot.viewmats), planes])
        places = texture(rows[None].astype(np.float32))  # must live until all is drawn
        with target.bind():
            gpu.state.active_framebuffer_get().clear(color=(0, 0, 0, 0))
            gpu.state.blend_set("ALPHA_PREMULT")
            gpu.state.depth_test_set("NONE")
            gpu.state.depth_mask_set(False)
            gpu.state.face_culling_set("NONE")
            shader.bind()
            K = camera.K
            shader.uniform_float("lens", (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
            parallel = float(camera.orthographic)
            shader.uniform_float("frame", (camera.width, camera.height, camera.near, parallel))
            # Coefficients from z to Blender's depth, and whether opacities are compensated.
            depth = depth_of_z(camera, shot.window)
            shader.uniform_float("projection", (*depth, 1 - parallel, float(shot.antialias)))
            shader.uniform_sampler("atlas", atlas)
            shader.uniform_sampler("places", places)
            shader.uniform_sampler("meshes", self._nothing if meshes is None else meshes)
            hides = float(meshes is not None)
            cuts = float(shot.cuts.far) + 2 * float(len(shot.cuts.planes) > 0)
            for entries, count in order.chunks:
                shader.uniform_sampler("sorted", entries)
                shader.uniform_float("count", (count, shot.limit, hides, cuts))
                self._quads.draw_instanced(shader, instance_count=-(-count // QUADS))
            gpu.state.blend_set("NONE")

    def copy(self, piece: gpu.types.GPUTexture, target: gpu.types.GPUFrameBuffer, row: int) -> None:
        """Copy the rows of a texture to a target of the same width, from `row` on."""
        with bound(target):
            # The target's own method has no parameters before 5.0.
            gpu.state.viewport_set(0, row, piece.width, piece.height)
            gpu.state.blend_set("NONE")
            gpu.state.depth_test_set("NONE")
            gpu.state.face_culling_set("NONE")
            self._rows.bind()
            self._rows.uniform_float("row", float(row))
            self._rows.uniform_sampler("piece", piece)
            self._piece.draw(self._rows)

    def show(
        self,
        canvas: Canvas,
        view: tuple[int, int, int, int],
        photo: FrontPhoto | None = None,
        scene: gpu.types.GPUFrameBuffer | None = None,
        window: Window | None = None,
    ) -> None:
        """Draw a picture over a part of the current target, in the encoding of Blender's 3D views.

        A picture with nearness is tested against the target's depth, one depth per pixel.

        Args:
            canvas: The picture.
            view: Left, bottom, width and height of the part, pixels.
            photo: Photo in front of the splats.
            scene: The target of the view's own picture, linear light, which is more precise than
                the overlay target; overlays behind the splats are removed. None: not available.
            window: The part of the view to draw to; None: all.
        """
        left, bottom, width, height = view
        place = left, bottom, canvas.width / width, canvas.height / height
        shown = part_of(view, window)
        with drawn_to(shown):
            if scene is not None and self._lay_within(scene, canvas, place, shown):
                self._lay(canvas, place, "MULTIPLY", _HIDDEN)
            else:
                self._lay(canvas, place, "ALPHA_PREMULT", _OVER, photo)

    def _lay_within(
        self,
        scene: gpu.types.GPUFrameBuffer,
        canvas: Canvas,
        place: tuple[float, ...],
        shown: tuple[int, int, int, int],
    ) -> bool:
        """Draw into a view's own picture; return whether that is possible."""
        if self._shut:
            return False
        try:
            with bound(scene), drawn_to(shown):
                self._lay(canvas, place, "ALPHA_PREMULT", _WITHIN)
        except Exception:  # drivers raise anything; the overlay target works as well
            _log.exception("Cannot draw to the pictures of views: dark colors are less exact.")
            self._shut = True
        return not self._shut

    def _lay(
        self,
        canvas: Canvas,
        place: tuple[float, ...],
        blend: str,
        layer: float,
        photo: FrontPhoto | None = None,
    ) -> None:
        near = canvas.nearness is not None
        shader = self._near_view if near else self._view
        gpu.state.blend_set(blend)
        gpu.state.depth_test_set("LESS_EQUAL" if near else "NONE")
        gpu.state.depth_mask_set(False)
        shader.bind()
        shader.uniform_float("place", place)
        shader.uniform_float("layer", layer)
        shader.uniform_sampler("picture", canvas.picture)
        shader.uniform_sampler("photo", self._nothing if photo is None else photo.texture)
        shader.uniform_float("photo_frame", (0, 0, 1, 1) if photo is None else photo.frame)
        shader.uniform_float("photo_opacity", 0.0 if photo is None else photo.opacity)
        if near:
            shader.uniform_sampler("nearness", canvas.nearness)
        self._screen.draw(shader)
        gpu.state.depth_test_set("NONE")
        gpu.state.blend_set("NONE")


class ViewPicture:
    """Keeps the drawn picture until it changes, because Blender redraws views often, for example
    at each mouse move over a panel."""

    def __init__(self) -> None:
        self._canvas: Canvas | None = None
        self._holds: tuple[Order, Shot, gpu.types.GPUTexture | None] | None = None
        """Content of the canvas."""

    def draw(
        self,
        card: Card,
        atlas: gpu.types.GPUTexture,
        order: Order,
        shot: Shot,
        meshes: gpu.types.GPUTexture | None,
        *,
        nearness: bool = False,
        exact: bool = False,
        took: Callable[[float], None] | None = None,
    ) -> Canvas:
        """The picture, drawn only if anything has changed.

        Args:
            card: The graphics card.
            atlas: As for `Card.draw`.
            order: Order of rows of the atlas.
            shot: Camera and settings.
            meshes: As for `Card.draw`; compared by identity (`Depths`).
            nearness: As for `Canvas`.
            exact: As for `Canvas`.
            took: Called with the seconds that the card needed to draw, which means waiting for it.
        """
        size = shot.camera.width, shot.camera.height
        canvas, kind = self._canvas, (*size, nearness, exact)
        if canvas is not None and canvas.kind != kind:
            canvas = None
        if canvas is not None and self._holds is not None:
            order_, shot_, meshes_ = self._holds
            if order_ is order and meshes_ is meshes and same(shot, shot_):
                return canvas
        self._holds = None  # until it is drawn
        if canvas is None:
            canvas = self._canvas = Canvas(*size, nearness=nearness, exact=exact)
        if took is None:
            card.draw(canvas, atlas, order, shot, meshes)
        else:
            _wait(canvas)
            began = time.perf_counter()
            card.draw(canvas, atlas, order, shot, meshes)
            _wait(canvas)
            took(time.perf_counter() - began)
        self._holds = order, shot, meshes
        return canvas


def _wait(canvas: Canvas) -> None:
    """Wait until the card has finished drawing, by reading a pixel."""
    with canvas.bind():
        gpu.state.active_framebuffer_get().read_color(0, 0, 1, 1, 4, 0, "FLOAT")
