"""Photo comparison: a photo and the render from its camera side by side, with the PSNR."""

import math
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import bpy
import numpy as np

from .. import stored_paths
from ..cameras import camera_math as cm
from ..cameras.objects import PhotoCamera, is_camera, photo_camera_of, rigid_viewmat
from ..cameras.pictures import levels_of
from ..cameras.render_camera import RenderCamera
from ..compat import matrix_to_numpy
from ..core import colorize, png_bytes, psnr, read_exposures, read_header
from ..interface.blocks import block_of
from ..process.incremental_tasks import Check, Steps, run_in_thread
from ..splats.read_chunked import ChunkedRead
from ..stored_paths import RUN
from . import picture
from .camera_photo import Target, load_target
from .color import background_of, world_light
from .engine import final_cache
from .mesh_copies import Frozen, FrozenMesh
from .scene import NO_SPLATS, NONE_IN_VIEW, Placed, place, sources

ERROR_GAIN = 4.0
"""Factor of the mean absolute channel difference in error pictures, as in gscore's."""
PSNR, PSNR_MASKED = "gs_psnr", "gs_psnr_masked"
"""Custom properties of a camera: results of the last comparison, dB."""
KINDS = ("Photo", "Render", "Error", "Comparison")
"""Pictures of a comparison; Comparison shows the others side by side."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Result of a comparison."""

    psnr: float
    """PSNR of the rendered splats against the photo, dB, on sRGB values; inf if they are equal.
    With a mask, both are black outside of it, as in gscore's metrics."""
    psnr_masked: float | None
    """PSNR of the pixels inside the mask, dB; None without a mask."""
    exposed: bool
    """True: the picture has the exposure that the training found, or predicted, for the photo."""
    images: dict[str, bpy.types.Image]
    """Images by the names in `KINDS`."""


class Comparing:
    """Snapshot of a camera, its visible splats and the scene's settings, to compare from."""

    def __init__(
        self, scene: bpy.types.Scene, camera: bpy.types.Object, depsgraph: bpy.types.Depsgraph
    ) -> None:
        """Take the snapshot.

        Args:
            scene: Percentage, world and settings; not changed.
            camera: Of an imported capture, in its current pose.
            depsgraph: Its visible splats are drawn.

        Raises:
            ValueError: no such camera, or no splats.
        """
        if not is_camera(camera):
            raise ValueError(
                f"{camera.name} is not the camera of a photo: choose one that Import Cameras made."
            )
        own = photo_camera_of(camera)
        self._camera, self._name, self._photo = camera.session_uid, camera.name, own.image
        self._runs = {stored_paths.read(one.ob.original, RUN) for one in sources(depsgraph)} - {""}
        background = background_of(world_light(scene.world)[0])
        percentage = scene.render.resolution_percentage
        size = cm.frame_size(*_full_size(own), percentage)
        width, height = max(size[0], 1), max(size[1], 1)
        self._target = load_target(
            camera,
            width,
            height,
            background=background,
            mask_mode=scene.gscore.mask_mode if scene.gscore.use_masks else "none",
            invert_masks=scene.gscore.invert_masks,
        )
        self._view = photo_view(camera, own, depsgraph, width, height)
        self._options = picture.Options(
            background=background, antialias=scene.gscore_render.antialias
        )
        self._snapshot = snapshot(depsgraph)
        next(self._snapshot)  # takes it

    def compared(self) -> Steps[Comparison]:
        """Render from the camera and compare with its photo.

        The picture has the photo's size times the scene's resolution percentage, whatever the
        scene's resolution; the photo is scaled to it as for training. Masks follow the scene's
        settings for training; transparent pixels show the world's colour. Photos with lens
        distortion are undistorted as for training. Splats of one run get the exposure of the photo
        in it. Sets `PSNR` on the camera.

        Raises:
            ValueError: no photo, its camera model cannot be undistorted, or the camera has been
                removed; nothing is changed.
            GsError: the native library is missing.
        """
        try:
            target = yield from self._target
            placed = yield from self._snapshot
        finally:
            self._snapshot.close()
        found, pictures = yield from run_in_thread(
            partial(self._drawn, placed, target), "Drawing the splats"
        )
        gone = f"The camera {self._name} was removed during the comparison."
        camera = block_of(bpy.data.objects, self._camera, gone)
        camera[PSNR] = found.psnr
        camera.pop(PSNR_MASKED, None)
        if found.psnr_masked is not None:
            camera[PSNR_MASKED] = found.psnr_masked
        images = {kind: store(kind, png, camera.name) for kind, png in pictures.items()}
        return replace(found, images=images)

    def _drawn(
        self, placed: list[Placed], target: Target, check: Check
    ) -> tuple[Comparison, dict[str, bytes]]:
        """The result without images, and the PNGs by the names in `KINDS`."""
        model = final_cache.model(placed)
        check()
        stop = picture.stopped(check)
        rendered = picture.draw(model, self._view, self._options, stop=stop)
        found = [read_exposures(Path(run)).get(self._photo) for run in sorted(self._runs)]
        exposure = found[0] if len(found) == 1 else None
        if exposure is not None:
            rendered = rendered.exposed(exposure, self._options.background)
        return _compared(np.clip(rendered.rgb, 0, 1), target, check, exposed=exposure is not None)


def _compared(
    shown: np.ndarray, target: Target, check: Check, *, exposed: bool
) -> tuple[Comparison, dict[str, bytes]]:
    """The result and PNGs of sRGB values [H, W, 3]; see `Comparing._drawn`."""
    photo, masked = target.pixels, None
    if target.weight is not None:
        weight = target.weight[..., None]
        squares = float((weight * (shown - photo).astype(np.float64) ** 2).sum())
        counted = 3 * float(weight.sum())
        masked = -10 * math.log10(squares / counted) if squares and counted else math.inf
        shown, photo = shown * weight, photo * weight
    error = np.abs(shown - photo).mean(axis=2)
    found = {"Photo": photo, "Render": shown, "Error": colorize(error * ERROR_GAIN) / 255.0}
    found["Comparison"] = np.concatenate(list(found.values()), axis=1)
    value, pictures = psnr(shown, photo), {}
    for kind in KINDS:
        check()
        levels = levels_of(found[kind])
        opaque = np.full((*levels.shape[:2], 1), 255, np.uint8)
        # Uncompressed: compressing takes long, and Blender would decode it more slowly.
        pictures[kind] = png_bytes(np.concatenate([levels, opaque], axis=2), packed=False)
    return Comparison(psnr=value, psnr_masked=masked, exposed=exposed, images={}), pictures


def _full_size(own: PhotoCamera) -> tuple[int, int]:
    """Width and height of a camera's view, px, at the resolution of its photo, which may be smaller
    than the camera's (images_4)."""
    info = read_header(own.photo)
    if info is None or info.width >= own.taken[0]:
        return own.width, own.height
    across, down = info.width / own.taken[0], info.height / own.taken[1]
    return math.floor(own.width * across + 1e-6), math.floor(own.height * down + 1e-6)


def photo_view(
    camera: bpy.types.Object,
    own: PhotoCamera,
    depsgraph: bpy.types.Depsgraph,
    width: int,
    height: int,
) -> RenderCamera:
    """An imported camera with its photo's own K in float64, scaled to another size in pixels."""
    K = own.K.copy()
    K[0] *= width / own.width
    K[1] *= height / own.height
    placed = camera.evaluated_get(depsgraph)
    return RenderCamera(
        viewmat=rigid_viewmat(matrix_to_numpy(placed.matrix_world), camera.name),
        K=K,
        width=width,
        height=height,
        near=camera.data.clip_start,
        orthographic=False,
        name=camera.name,
    )


def store(kind: str, png: bytes, camera: str) -> bpy.types.Image:
    """Put a picture into the image for its kind.

    The image is a packed file: otherwise Blender offers to save it, and a .blend file that shows it
    loses it. Blender decodes it when it is shown, in a third of the time that packing takes.
    """
    name = f"GS {kind}"
    image = bpy.data.images.get(name)
    if image is None:
        image = bpy.data.images.new(name, 1, 1)
    image.pack(data=png, data_len=len(png))
    image.source = "FILE"
    image.buffers_free()  # of the picture before
    image["gs_image"] = camera
    return image


def snapshot(depsgraph: bpy.types.Depsgraph) -> Steps[list[Placed]]:
    """The splats of a depsgraph as captured, at the first step, unaffected by later changes.

    Raises:
        ValueError: there is nothing to draw, attributes are missing or not finite, or a copy was
            removed.
    """
    placed: list[Placed] = []
    frozen: dict[int, Frozen] = {}
    reads: dict[int, tuple[str, ChunkedRead]] = {}
    try:
        for source in sources(depsgraph):
            placed.append(place(source, FrozenMesh(source.ob.name, {}, {}), captured=True))
            if source.moment is not None:
                frozen[source.uid] = source.frozen()
            elif source.uid not in reads:
                reads[source.uid] = source.ob.name, ChunkedRead(source.ob.original)
        if not placed:
            raise ValueError(NO_SPLATS if depsgraph.mode == "RENDER" else NONE_IN_VIEW)
        yield "Reading splats"
        for uid, (name, taken) in reads.items():
            columns = yield from taken.read()
            frozen[uid] = yield from run_in_thread(
                lambda check, of=(name, columns): FrozenMesh.of(*of), "Reading splats"
            )
        return [replace(one, frozen=frozen[one.uid]) for one in placed]
    finally:
        for _, taken in reads.values():
            taken.drop()
