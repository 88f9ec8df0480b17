"""What lies in the graphics card's memory, and how it is drawn; used where Blender draws."""

from dataclasses import dataclass

import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from ..cameras.captures import RenderCamera
from . import program
from .atlas import Atlas
from .program import ORDER_COLUMNS, QUADS


@dataclass(frozen=True, kw_only=True)
class Shot:
    """How a picture is drawn."""

    camera: RenderCamera
    """Of the view, in Blender's world; its size is the picture's."""
    viewmats: tuple[np.ndarray, ...]
    """[4, 4] float64 of each object of the atlas, from its space to the camera."""
    window: np.ndarray
    """[4, 4] float64, Blender's projection, whose depths meshes have."""
    antialias: bool
    limit: int
    """Rows of the atlas that are drawn."""

    def same(self, other: "Shot") -> bool:
        """Whether the other gives the same picture of the same objects."""
        return (
            self.camera.same(other.camera)
            and (self.antialias, self.limit) == (other.antialias, other.limit)
            and np.array_equal(self.window, other.window)
            and all(map(np.array_equal, self.viewmats, other.viewmats))
        )


class Card:
    """The programs, and the shapes they draw."""

    def __init__(self) -> None:
        """Compile.

        Raises:
            Exception: the driver refuses a program.
        """
        self._splats, self._view = program.splats(), program.view()
        corners, indices = [], []
        for k in range(QUADS):
            corners += [(x, y, float(k)) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            indices += [(4 * k, 4 * k + 1, 4 * k + 2), (4 * k, 4 * k + 2, 4 * k + 3)]
        self._quads = batch_for_shader(
            self._splats, "TRIS", {"corner": corners}, indices=np.array(indices, np.int32)
        )
        big = [(-1, -1), (3, -1), (-1, 3)]
        self._screen = batch_for_shader(self._view, "TRIS", {"corner": big})
        self._nothing = texture(np.full((1, 1, 1), 2, np.float32))

    def draw(
        self,
        target: gpu.types.GPUOffScreen,
        atlas: gpu.types.GPUTexture,
        order: "Order",
        shot: Shot,
        meshes: gpu.types.GPUTexture | None,
    ) -> None:
        """Blend splats on a target of the camera's size, premultiplied sRGB values.

        Args:
            target: Receives them, the bottom row first.
            atlas: Of `upload`.
            order: Its entries name rows of the atlas.
            shot: From where.
            meshes: Depths of what hides splats, of the camera's size or of one proportional to it.
        """
        camera, shader = shot.camera, self._splats
        rows = np.concatenate([m[:3] for m in shot.viewmats]).astype(np.float32)
        places = texture(rows[None])  # kept by this name until all is drawn
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
            shader.uniform_float("projection", _projection(shot))
            shader.uniform_sampler("atlas", atlas)
            shader.uniform_sampler("places", places)
            shader.uniform_sampler("meshes", self._nothing if meshes is None else meshes)
            hides = float(meshes is not None)
            for entries, count in order.chunks:
                shader.uniform_sampler("sorted", entries)
                shader.uniform_float("count", (count, shot.limit, hides, 0))
                self._quads.draw_instanced(shader, instance_count=-(-count // QUADS))
            gpu.state.blend_set("NONE")

    def show(
        self, picture: gpu.types.GPUTexture, left: int, bottom: int, width: int, height: int
    ) -> None:
        """Lay a picture over a part of what is drawn to, as Blender's 3D view keeps it."""
        gpu.state.blend_set("ALPHA_PREMULT")
        gpu.state.depth_test_set("NONE")
        self._view.bind()
        smaller = picture.width / width, picture.height / height
        self._view.uniform_float("place", (left, bottom, *smaller))
        self._view.uniform_sampler("picture", picture)
        self._screen.draw(self._view)
        gpu.state.blend_set("NONE")


class Order:
    """An order of splats on the card, in chunks that are uploaded one at a time."""

    CHUNK = 1 << 17
    """Entries; one takes a millisecond or two."""

    def __init__(self, entries: np.ndarray, before: "Order | None" = None) -> None:
        """Nothing is uploaded yet.

        Args:
            entries: [N, 4] float32, of `order.arrange`.
            before: Another that is on the card; chunks that are the same need no upload.
        """
        self._entries = entries
        self._before = () if before is None else (before._entries, tuple(before.chunks))
        self.chunks: list[tuple[gpu.types.GPUTexture, int]] = []
        """Textures and how many entries each has, in the order of drawing."""

    def step(self) -> bool:
        """Upload one more chunk; whether all are there."""
        number = len(self.chunks)
        at = number * self.CHUNK
        part = self._entries[at : at + self.CHUNK]
        known = self._known(number, part)
        if known is not None:
            self.chunks.append(known)
        elif len(part):
            rows = -(-len(part) // ORDER_COLUMNS)
            padded = np.zeros((rows * ORDER_COLUMNS, 4), np.float32)
            padded[: len(part)] = part
            self.chunks.append((texture(padded.reshape(rows, ORDER_COLUMNS, 4)), len(part)))
        complete = at + self.CHUNK >= len(self._entries)
        if complete:
            self._before = ()  # else each would keep all that were before it
        return complete

    def _known(self, number: int, part: np.ndarray) -> tuple[gpu.types.GPUTexture, int] | None:
        """The chunk of this number of the order before, if it has the same entries."""
        if not self._before or number >= len(self._before[1]):
            return None
        at = number * self.CHUNK
        same = np.array_equal(self._before[0][at : at + self.CHUNK], part)
        return self._before[1][number] if same else None


def upload(atlas: Atlas) -> gpu.types.GPUTexture:
    """An atlas on the card."""
    rows, columns, texels, _ = atlas.texels.shape
    return texture(atlas.texels.reshape(rows, columns * texels, 4))


def texture(values: np.ndarray) -> gpu.types.GPUTexture:
    """[H, W, 1] or [H, W, 4] float32 as a texture of the same numbers."""
    flat = np.ascontiguousarray(values).reshape(-1)
    data = gpu.types.Buffer("FLOAT", flat.size, flat)
    kind = {1: "R32F", 4: "RGBA32F"}[values.shape[2]]
    return gpu.types.GPUTexture(values.shape[1::-1], format=kind, data=data)


def _projection(shot: Shot) -> tuple[float, float, float, float]:
    """What takes a splat's z to a depth as Blender keeps it, and whether opacities are compensated.

    Orthographic cameras were moved along their axis (`view_camera`); their own z is moved back.
    """
    factor, offset = shot.window[2, 2], shot.window[2, 3]
    if shot.camera.orthographic:
        own_near = (offset + 1) / factor
        offset += factor * (shot.camera.near - own_near)
    return factor, offset, float(not shot.camera.orthographic), float(shot.antialias)
