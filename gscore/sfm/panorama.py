"""Panoramas: detection and refusal, with instructions to cut them into views."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..datasets.capture import listing
from ..errors import ConfigError
from ..io.colmap.camera_models import NO_PINHOLE
from ..text_format import count_words
from .search_request import USUAL_LENS, SearchRequest

STATED, SEEN = "stated", "seen"
"""How a photo is known to be a panorama."""
_XMP = re.compile(rb"GPano:ProjectionType")
"""XMP tag that 360-degree cameras write (Google, Photo Sphere XMP metadata)."""
_GRID = 256, 128
"""Width and height of the reduced picture in which edges are compared, px."""
_SEAM = 3.0
"""Maximum difference of the first and last column, in mean differences of neighbouring columns."""
_POLE = 0.3
"""Maximum contrast within the first and last row, each one point, relative to the picture's."""
_UPRIGHT = 0.3
"""Minimum contrast within the first and last column, relative to the picture's: the edges of photos
of objects on white match too."""
_HOW = (
    "Cut each into views of 90 degrees, as with `ffmpeg -i PANORAMA.jpg -vf "
    "v360=equirect:flat:h_fov=90:v_fov=90:yaw=0:w=1200:h=1200 VIEW_0.jpg`, with yaw -180, -135 "
    "and so on to 135, and give `gscore sfm` the views with --camera-model SIMPLE_PINHOLE and "
    "--focal-length 600, half their width"
)


def states_panorama(image: Any) -> bool:
    """Whether the XMP of Pillow's image marks it as a panorama."""
    packets = [image.info.get("xmp"), image.info.get("XML:com.adobe.xmp")]
    packets += [body for _, body in getattr(image, "applist", [])]
    texts = (text.encode() if isinstance(text, str) else text for text in packets)
    return any(isinstance(text, bytes) and bool(_XMP.search(text)) for text in texts)


def looks_panoramic(image: Any) -> bool:
    """Whether Pillow's decoded image is twice as wide as high, its left and right edges match, and
    its upper and lower edges, each one point of the sphere, have one colour."""
    if abs(image.width - 2 * image.height) > 0.005 * image.width:
        return False
    pixels = np.asarray(image.convert("RGB").resize(_GRID), np.float32).mean(axis=2)
    step = np.abs(np.diff(pixels, axis=1)).mean()
    seam = np.abs(pixels[:, 0] - pixels[:, -1]).mean()
    contrast = pixels.std()
    poles = max(pixels[0].std(), pixels[-1].std())
    sides = min(pixels[:, 0].std(), pixels[:, -1].std())
    return bool(
        seam <= _SEAM * step and poles <= _POLE * contrast and sides >= _UPRIGHT * contrast > 0
    )


def check_lens(model: str) -> None:
    """Raise ConfigError for a 360-degree lens model."""
    if model in NO_PINHOLE:
        raise ConfigError(
            f"camera_model {model} is for 360-degree photos, which a camera search cannot use. "
            f"{_HOW}."
        )


def refused_panoramas(photos: Mapping[str, str], request: SearchRequest) -> str:
    """Message on photos that are panoramas; empty if none is, or if the lens was given.

    Args:
        photos: `STATED`, `SEEN` or an empty text by name. `SEEN` counts only if most photos are
            panoramas, since few may look like one by chance.
        request: Its lens model or focal length, if given, marks the photos as ordinary.
    """
    if request.camera_model != USUAL_LENS or request.focal_length:
        return ""
    often = 2 * sum(map(bool, photos.values())) > len(photos)
    names = [name for name, how in photos.items() if how == STATED or (how and often)]
    if not names:
        return ""
    what = count_words(len(names), "photo shows", "photos show")
    return (
        f"{what} all directions (360-degree panoramas, by XMP or because left and right edge "
        f"meet): {listing(names, 3)}. {_HOW}. If they are ordinary photos, give --focal-length in "
        "px or another --camera-model, as OPENCV."
    )
