"""The photo in a camera's background: the photo itself, or its straightened copy."""

import os
from pathlib import Path
from typing import Any

import bpy

from .. import stored_paths
from .objects import stated
from .straight import copy_of


def photo_of(ob: bpy.types.Object) -> bpy.types.Image | None:
    """The picture in a camera's background, or None."""
    return next((slot.image for slot in ob.data.background_images if slot.image), None)


def set_photo(ob: bpy.types.Object, file: Path, known: dict[str, bpy.types.Image]) -> bool:
    """Put a photo into a camera's background; whether the file is there.

    Blender decodes it when it is first drawn. Of a lens that bends lines it is the straightened
    copy, which may still have to be made (`straightening`); until then nothing is drawn.

    Args:
        ob: The camera.
        file: The photo.
        known: Images already in the file by absolute path; the new one is added.
    """
    stored_paths.write(ob, stored_paths.PHOTO, file)
    if not file.is_file():
        return False
    own = stated(ob)
    shown = file if own.photo_size is None else copy_of(own, file)
    image = known.get(str(shown))
    if image is None:
        # `images.load` looks into every file, which makes it 80 times slower.
        image = known[str(shown)] = bpy.data.images.new(file.name, 1, 1)
        image.source = "FILE"
        image.filepath = ob[stored_paths.PHOTO] if shown == file else str(shown)
    slots = ob.data.background_images
    slot = slots[0] if slots else slots.new()
    if slot.image != image:
        slot.image = image
    slot.alpha = 1.0
    # The raster of the photo is the camera's own, so it fills the frame whatever the pixel aspect.
    slot.frame_method, slot.display_depth = "STRETCH", "BACK"
    ob.data.show_background_images = True
    return True


def known_images() -> dict[str, Any]:
    """The images of this file by absolute path."""
    images = (i for i in bpy.data.images if i.source == "FILE" and i.filepath)
    return {str(file_of(image)): image for image in images}


def file_of(image: bpy.types.Image) -> Path:
    """The file of a picture, absolute."""
    return Path(os.path.normpath(bpy.path.abspath(image.filepath, library=image.library)))


def copy_needed(ob: bpy.types.Object) -> Path | None:
    """The straightened copy that a camera's background shows and that is not there; None: there is
    nothing to make."""
    image = photo_of(ob)
    if image is None or "gs_photo_size" not in ob:
        return None
    own = stated(ob)
    photo = Path(own.photo)
    if not photo.is_file():
        return None
    copy = copy_of(own, photo)
    return None if copy.is_file() and file_of(image) == copy else copy
