"""Masks painted on photos: an image whose alpha is the mask, and the mask file of the training.

The image has the colours of the photo, which shows what is masked; brushes that erase and add
alpha paint the mask. Files are grey, white where pixels count, unless the scene inverts masks.
"""

from pathlib import Path

import bpy
import numpy as np
from bpy.app.handlers import persistent

from .. import stored_paths
from ..cameras.objects import cameras_of, photo_camera_of, root_of
from ..cameras.pictures import levels_of, pixels_of, read_picture
from ..capture.folders import same_folder
from ..core import (
    Folder,
    atomic_write,
    png_bytes,
    read_header,
)
from ..interface.windows import push_undo
from ..render.camera_photo import kept_of, mask_folder, mask_place, source_of, stated_masks
from ..training import facts, lookups, start_training

_CAPTURE, _PHOTO, _SAVED = "gs_mask_capture", "gs_mask_photo", "gs_mask_saved"
_FILE = "gs_mask_file"
"""Custom properties of an image: the capture's folder, the photo's name in it, the fingerprint at
the last save, and the mask's file."""


def is_mask(image: bpy.types.Image | None) -> bool:
    """Whether an image is a mask of this add-on."""
    return image is not None and _PHOTO in image


def photo_name(image: bpy.types.Image) -> str:
    """Name of the photo in the capture that a mask belongs to."""
    return str(image[_PHOTO])


def is_unsaved(image: bpy.types.Image) -> bool:
    """Whether a mask has unsaved strokes."""
    return image.is_dirty or image.get(_SAVED, "") != _mark(image)


def unsaved_of(root: bpy.types.Object | None) -> list[bpy.types.Image]:
    """Masks of a capture with unsaved strokes."""
    if root is None:
        return []
    source = Path(stored_paths.read(root, stored_paths.SOURCE))
    return [image for image in _of_capture(source) if is_unsaved(image)]


def make(scene: bpy.types.Scene, camera: bpy.types.Object) -> bpy.types.Image:
    """The image of a camera's mask: the one in the file, else one made from the mask file, else an
    empty mask.

    Raises:
        ValueError: the photo or its mask cannot be read, or a mask of it would not be used.
    """
    own, root = photo_camera_of(camera), root_of(camera)
    if root is None:
        raise ValueError(f"{camera.name} is not a camera of a capture; import its cameras first.")
    source = stored_paths.read(root, stored_paths.SOURCE)
    for image in _of_capture(Path(source)):
        if photo_name(image) == own.image:
            return image
    _check_usable(scene, Path(own.photo))
    rgba = read_picture(own.photo, own)
    rgba[..., 3] = 1
    file = _stated_file(camera, own.image) or _found_file(camera, own.image)
    if file is not None and file.is_file():
        mask = read_picture(str(file), own)
        if mask.shape[0] < rgba.shape[0] or mask.shape[1] < rgba.shape[1]:
            raise ValueError(f"The mask {file} is smaller than its photo: fix it first.")
        # Enlarged by nearest pixels, because the mask keeps its own size.
        rows, columns = (
            np.arange(n) * own_n // n
            for n, own_n in zip(mask.shape[:2], rgba.shape[:2], strict=True)
        )
        rgba = rgba[rows[:, None], columns]
        rgba[..., 3] = kept_of(mask, scene.gscore.invert_masks)
    height, width = rgba.shape[:2]
    image = bpy.data.images.new(f"Mask of {Path(own.image).name}", width, height, alpha=True)
    image.alpha_mode = "STRAIGHT"
    image[_CAPTURE], image[_PHOTO] = source, own.image
    image[_FILE] = str(file or mask_place(camera) / f"{own.image}.png")
    image.use_fake_user = True  # keeps it until its file is written
    _finish(image, levels_of(rgba))
    return image


def save(scene: bpy.types.Scene, image: bpy.types.Image) -> Path:
    """Write the mask file of the training, atomically; return its path.

    Raises:
        ValueError: its camera is gone, or the file would be one of the photos.
        GsError: it cannot be written.
    """
    camera = _camera_of(image)
    place = mask_place(camera)
    assert place is not None
    file = _target(camera, place, photo_name(image))
    pixels = levels_of(pixels_of(image)[::-1])
    levels = pixels[..., -1]
    atomic_write(file, png_bytes(255 - levels if scene.gscore.invert_masks else levels))
    image[_FILE] = str(file)
    _finish(image, pixels)
    lookups.captures.expire()
    facts.capture(scene)
    return file


def discard(image: bpy.types.Image) -> None:
    """Discard unsaved strokes; the mask file, if there is one, is not changed."""
    bpy.data.images.remove(image)
    push_undo("Discard Mask")


def _finish(image: bpy.types.Image, pixels: np.ndarray) -> None:
    """Pack the pixels into the .blend file, and mark the image as saved.

    Args:
        image: The image.
        pixels: [H, W, 4] uint8, the top row first.
    """
    # Uncompressed: Blender's own packing compresses, which takes 0.1 s per megapixel.
    _pack(image, png_bytes(pixels, packed=False))
    image.source = "FILE"
    image.buffers_free()  # so that Blender reads the packed pixels, and the image is not dirty


def _pack(image: bpy.types.Image, png: bytes) -> None:
    image.pack(data=png, data_len=len(png))
    image[_SAVED] = _mark(image)


def _mark(image: bpy.types.Image) -> str:
    """Fingerprint of an image and its mask file, because undo of a save restores only the image."""
    packed, file = image.packed_file, Path(str(image.get(_FILE, "")))
    written = file.stat().st_mtime_ns if file.is_file() else 0
    return "" if packed is None else f"{packed.size} {written}"


def _of_capture(source: Path) -> list[bpy.types.Image]:
    masks = (image for image in bpy.data.images if is_mask(image) and image.library is None)
    return [image for image in masks if same_folder(Path(str(image[_CAPTURE])), source)]


def _camera_of(image: bpy.types.Image) -> bpy.types.Object:
    for ob in bpy.data.objects:
        if ob.get("gs_kind") != "capture":
            continue
        if same_folder(
            Path(stored_paths.read(ob, stored_paths.SOURCE)), Path(str(image[_CAPTURE]))
        ):
            named = (c for c in cameras_of(ob) if c.get("gs_image") == image[_PHOTO])
            if (found := next(named, None)) is not None:
                return found
    raise ValueError(
        f"The camera of {photo_name(image)} was removed; import the cameras of {image[_CAPTURE]} "
        f"again."
    )


def _check_usable(scene: bpy.types.Scene, photo: Path) -> None:
    """Raise ValueError if a mask file would change the use of the other photos, or be rotated."""
    found, problem = facts.capture(scene)
    if found is None and not problem:  # else the panel has checked a moment ago
        found, _ = facts.refresh(scene)
    if found is not None and found.alphas and not found.masks:
        raise ValueError(
            "The photos' own transparency is their mask, and would be ignored with mask files. "
            "Change it in the photos."
        )
    header = read_header(photo)
    if header is not None and (header.is_flipped or header.is_sideways):
        raise ValueError(
            f"{photo} is stored rotated or mirrored, and Blender ignores its orientation: a mask "
            "would not fit. Store the photos upright."
        )


def _stated_file(camera: bpy.types.Object, name: str) -> Path | None:
    """The mask file that the capture itself names."""
    source = source_of(camera)
    return None if source is None else stated_masks(source).get(name)


def _found_file(camera: bpy.types.Object, name: str) -> Path | None:
    """A photo's mask file in the folder of masks."""
    folder = mask_folder(camera)
    return None if folder is None else Folder(folder).find_mask(name)


def _target(camera: bpy.types.Object, place: Path, name: str) -> Path:
    """The file to write: the one that the mask was made from, else `masks/NAME.png`.

    Raises:
        ValueError: it must not be written.
    """
    stated_file, found = _stated_file(camera, name), _found_file(camera, name)
    file = stated_file or found
    if file is None or file.suffix.lower() != ".png":
        if stated_file is not None:
            raise ValueError(f"The mask {file} named by the capture is not a PNG: convert it.")
        file = place / f"{name}.png"
    photos = {Path(photo_camera_of(c).photo).resolve().parent for c in cameras_of(root_of(camera))}
    inside = stated_file is not None or place.resolve() in file.resolve().parents
    if file.resolve().parent in photos or not inside:
        raise ValueError(f"{file} is in a folder of photos; move the masks to another folder.")
    return file


def _unsaved_warnings(source: Path) -> list[str]:
    names = [photo_name(image) for image in _of_capture(source) if is_unsaved(image)]
    if not names:
        return []
    some = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
    return [f"Painted masks are not saved, so training ignores them: {some}."]


@persistent
def _save_begins(*_: object) -> None:
    """Pack unsaved strokes, because .blend files keep only packed pixels, and compress images that
    were packed uncompressed."""
    for image in filter(is_mask, bpy.data.images):
        if image.library is not None:
            continue
        if image.is_dirty:
            image.pack()
            image[_SAVED] = ""
        elif image.packed_file is not None and not is_unsaved(image):
            _compress(image)


def _compress(image: bpy.types.Image) -> None:
    width, height = image.size
    if image.packed_file.size >= 4 * width * height:
        _pack(image, png_bytes(levels_of(pixels_of(image)[::-1])))


HANDLERS = {"save_pre": _save_begins}
APPENDED = ((start_training.UNSAVED, _unsaved_warnings),)
