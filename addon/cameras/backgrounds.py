"""Background images of cameras: the photo, or its undistorted copy."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import bpy

from .. import stored_paths
from ..interface import editable_check
from ..paths import relative
from .objects import PhotoCamera, photo_camera_of
from .undistorted_photos import copy_of

_MADE = "gs_background"
"""Custom property of background images set by the add-on; others are the user's."""

_BATCH = 50
"""Images removed per step, in about a millisecond."""


@dataclass(frozen=True, kw_only=True)
class UndistortedBackground:
    """Background of a camera with an undistorted photo; no bpy data."""

    own: PhotoCamera
    """The camera."""
    file: Path
    """The displayed image file."""
    can_change: bool
    """True if the image can be replaced."""

    def missing_copy(self) -> Path | None:
        """The undistorted copy that is missing or not displayed; None: nothing to do, or the photo
        is missing."""
        photo = Path(self.own.photo)
        if not photo.is_file():
            return None
        try:
            copy = copy_of(self.own, photo)
        except OSError:  # just removed
            return None
        if self.file != copy:
            return copy if self.can_change else None
        return None if copy.is_file() else copy


class KnownImages:
    """Images of the open file by image file. Stores names, because undo replaces images."""

    def __init__(self) -> None:
        """Collect all images of the file."""
        images = (i for i in bpy.data.images if i.source == "FILE" and i.filepath)
        self._names = {
            str(file_of(image)): (image.name, getattr(image.library, "filepath", None))
            for image in images
        }
        self._made: set[int] = set()
        """Session uids."""

    def of(self, shown: Path, photo: Path) -> bpy.types.Image:
        """The image of a file, created if missing, with the name of its photo."""
        name = self._names.get(str(shown))
        image = bpy.data.images.get(name) if name is not None else None
        if image is None or file_of(image) != shown:
            # `images.load` opens every file, which makes it 80 times slower.
            image = bpy.data.images.new(photo.name, 1, 1)
            image.source = "FILE"
            image.filepath = relative(shown) if shown == photo else str(shown)
            self._names[str(shown)] = image.name, None
            self._made.add(image.session_uid)
        if _MADE not in image and editable_check.keeps(image):
            image[_MADE] = True
        return image

    def dropping(self) -> Iterator[None]:
        """Remove unused images that the add-on created, some per step."""
        made = (image for image in bpy.data.images if image.session_uid in self._made)
        names = [image.name for image in made if _MADE in image and not image.users]
        for start in range(0, len(names), _BATCH):
            yield
            batch = map(bpy.data.images.get, names[start : start + _BATCH])
            unused = [one for one in batch if one is not None and not one.users]
            bpy.data.batch_remove([one for one in unused if one.session_uid in self._made])


@dataclass(frozen=True, kw_only=True)
class Photo:
    """Files of a photo; no bpy data."""

    file: Path
    """The photo."""
    shown: Path | None
    """Displayed file: the photo, or its undistorted copy, which may be missing yet, if its lens has
    distortion; None: the photo is missing."""


def photo_on_disk(own: PhotoCamera, file: Path) -> Photo:
    """Find the files of a camera's photo."""
    if not file.is_file():
        return Photo(file=file, shown=None)
    return Photo(file=file, shown=file if own.photo_size is None else copy_of(own, file))


def photo_of(ob: bpy.types.Object) -> bpy.types.Image | None:
    """The image in a camera's background, or None."""
    return next((slot.image for slot in ob.data.background_images if slot.image), None)


def set_photo(ob: bpy.types.Object, photo: Photo, known: KnownImages) -> None:
    """Set a photo as a camera's background, unless it is missing or the user chose another image.

    Blender decodes it when it is first drawn. Nothing is drawn before an undistorted copy is
    written (`undistort_jobs`).

    Args:
        ob: The camera.
        photo: The photo.
        known: Images already in the file; the new one is added.
    """
    stored_paths.write(ob, stored_paths.PHOTO, photo.file)
    if photo.shown is None:
        return
    slots = ob.data.background_images
    if (slot := _own_slot(ob)) is None:
        if any(one.image is not None for one in slots):
            return  # chosen by the user
        slot = slots[0] if slots else slots.new()
    image = known.of(photo.shown, photo.file)
    if slot.image != image:
        slot.image = image
    slot.alpha = 1.0
    # Photo and camera have the same raster, so it fills the frame at any pixel aspect.
    slot.frame_method, slot.display_depth = "STRETCH", "BACK"
    ob.data.show_background_images = True


def shows_photo(ob: bpy.types.Object, photo: Photo) -> bool:
    """True if a camera has the background of `set_photo`."""
    if stored_paths.read(ob, stored_paths.PHOTO) != str(photo.file):
        return False
    slot = _own_slot(ob)
    if photo.shown is None or (slot is None and photo_of(ob) is not None):
        return True
    return slot is not None and file_of(slot.image) == photo.shown


def show_copy(ob: bpy.types.Object, copy: Path, known: KnownImages) -> None:
    """Show another copy of the photo in the background that `undistorted_background` returned.

    Args:
        ob: The camera.
        copy: File of the copy, which may be missing yet.
        known: As for `set_photo`.
    """
    slot = _own_slot(ob)
    if slot is not None:
        slot.image = known.of(copy, Path(stored_paths.read(ob, stored_paths.PHOTO)))


def undistorted_background(ob: bpy.types.Object) -> UndistortedBackground | None:
    """The background of a camera with an undistorted photo; None: the photo has no distortion, or
    the user chose another image.

    Raises:
        ValueError: the camera has lost its custom properties.
    """
    if "gs_photo_size" not in ob:
        return None
    slot = _own_slot(ob)
    if slot is None:
        return None
    return UndistortedBackground(
        own=photo_camera_of(ob), file=file_of(slot.image), can_change=editable_check.keeps(ob.data)
    )


def file_of(image: bpy.types.Image) -> Path:
    """Absolute path of an image file."""
    return Path(os.path.normpath(bpy.path.abspath(image.filepath, library=image.library)))


def _own_slot(ob: bpy.types.Object) -> bpy.types.CameraBackgroundImage | None:
    """Background slot of a camera's photo, or None."""
    images = ((slot, slot.image) for slot in ob.data.background_images)
    return next((slot for slot, image in images if image and _MADE in image), None)
