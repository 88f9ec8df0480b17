"""The photo in a camera's background: the photo itself, or its straightened copy."""

import os
from dataclasses import dataclass
from pathlib import Path

import bpy

from .. import stored_paths
from ..interface import writable
from ..paths import relative
from .objects import PhotoCamera, stated
from .straight import copy_of

_MADE = "gs_background"
"""Custom property of the images that the add-on puts into backgrounds; others are the user's."""


@dataclass(frozen=True, kw_only=True)
class StraightBackground:
    """The background of a camera whose photo is straightened; needs no bpy any more."""

    own: PhotoCamera
    """The camera."""
    file: Path
    """The picture that it shows."""
    can_change: bool
    """Whether it can be led to another picture."""

    def lacks(self) -> Path | None:
        """The straightened copy that is not there, or not what is shown; None: nothing is to be
        done, or the photo is not there."""
        photo = Path(self.own.photo)
        if not photo.is_file():
            return None
        try:
            copy = copy_of(self.own, photo)
        except OSError:  # it has just gone
            return None
        if self.file != copy:
            return copy if self.can_change else None
        return None if copy.is_file() else copy


def photo_of(ob: bpy.types.Object) -> bpy.types.Image | None:
    """The picture in a camera's background, or None."""
    return next((slot.image for slot in ob.data.background_images if slot.image), None)


def set_photo(ob: bpy.types.Object, file: Path, known: dict[str, bpy.types.Image]) -> bool:
    """Put a photo into a camera's background, unless the user chose pictures for it; whether the
    file is there.

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
    slot = _own_slot(ob) or _free_slot(ob)
    if slot is None:
        return True
    own = stated(ob)
    image = _image(file if own.photo_size is None else copy_of(own, file), file, known)
    if slot.image != image:
        slot.image = image
    slot.alpha = 1.0
    # The raster of the photo is the camera's own, so it fills the frame whatever the pixel aspect.
    slot.frame_method, slot.display_depth = "STRETCH", "BACK"
    ob.data.show_background_images = True
    return True


def lead_to(ob: bpy.types.Object, copy: Path, known: dict[str, bpy.types.Image]) -> None:
    """Have the background that `straight_background` told of show another copy of its photo.

    Args:
        ob: The camera.
        copy: The file, which may still have to be made.
        known: As for `set_photo`.
    """
    slot = _own_slot(ob)
    if slot is not None:
        slot.image = _image(copy, Path(stored_paths.read(ob, stored_paths.PHOTO)), known)


def straight_background(ob: bpy.types.Object) -> StraightBackground | None:
    """The background of a camera, where the add-on shows a straightened photo there; None: it is
    straight by itself, or the user chose a picture.

    Raises:
        ValueError: the camera has lost what the capture says about it.
    """
    if "gs_photo_size" not in ob:
        return None
    slot = _own_slot(ob)
    if slot is None:
        return None
    return StraightBackground(
        own=stated(ob), file=file_of(slot.image), can_change=writable.keeps(ob.data)
    )


def known_images() -> dict[str, bpy.types.Image]:
    """The images of this file by absolute path."""
    images = (i for i in bpy.data.images if i.source == "FILE" and i.filepath)
    return {str(file_of(image)): image for image in images}


def file_of(image: bpy.types.Image) -> Path:
    """The file of a picture, absolute."""
    return Path(os.path.normpath(bpy.path.abspath(image.filepath, library=image.library)))


def _own_slot(ob: bpy.types.Object) -> bpy.types.CameraBackgroundImage | None:
    """Where the add-on has put a camera's photo, or None."""
    images = ((slot, slot.image) for slot in ob.data.background_images)
    return next((slot for slot, image in images if image and _MADE in image), None)


def _free_slot(ob: bpy.types.Object) -> bpy.types.CameraBackgroundImage | None:
    """Where a camera's photo can be put, made where it has to be; None: the user chose pictures."""
    slots = ob.data.background_images
    if any(slot.image is not None for slot in slots):
        return None
    return slots[0] if slots else slots.new()


def _image(shown: Path, photo: Path, known: dict[str, bpy.types.Image]) -> bpy.types.Image:
    """The image of a file, called like its photo."""
    image = known.get(str(shown))
    if image is None:
        # `images.load` looks into every file, which makes it 80 times slower.
        image = known[str(shown)] = bpy.data.images.new(photo.name, 1, 1)
        image.source = "FILE"
        image.filepath = relative(shown) if shown == photo else str(shown)
    if _MADE not in image and writable.keeps(image):
        image[_MADE] = True
    return image
