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
"""Of the XMP that 360-degree cameras write (Google, Photo Sphere XMP metadata)."""
_GRID = 256, 128
"""Width and height at which it is compared how a picture goes on, px."""
_SEAM = 3.0
"""Times the step between neighbouring columns up to which the first and last one are neighbours."""
_POLE = 0.3
"""Contrast within the first and last row, against that of the picture, where each is one point."""
_UPRIGHT = 0.3
"""Contrast within the first column, against that of the picture, from which the seam says
something: photos of things before white go on at their edges too."""
_HOW = (
    "Cut each into views of 90 degrees, as with `ffmpeg -i PANORAMA.jpg -vf "
    "v360=equirect:flat:h_fov=90:v_fov=90:yaw=0:w=1200:h=1200 VIEW_0.jpg`, with yaw -180, -135 "
    "and so on to 135, and give `gscore sfm` the views with --camera-model SIMPLE_PINHOLE and "
    "--focal-length 600, half their width"
)


def states_panorama(image: Any) -> bool:
    """Whether the XMP of Pillow's image says that it is a panorama."""
    packets = [image.info.get("xmp"), image.info.get("XML:com.adobe.xmp")]
    packets += [body for _, body in getattr(image, "applist", [])]
    texts = (text.encode() if isinstance(text, str) else text for text in packets)
    return any(isinstance(text, bytes) and bool(_XMP.search(text)) for text in texts)


def looks_panoramic(image: Any) -> bool:
    """Whether Pillow's decoded image is twice as wide as high, goes on from its right edge to its
    left one, and has one colour along its upper and lower edge, where all is one point."""
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
    """Raise ConfigError for a lens model that sees all directions."""
    if model in NO_PINHOLE:
        raise ConfigError(
            f"camera_model {model} is that of 360-degree photos, which cannot be searched for "
            f"cameras as they are. {_HOW}."
        )


def refused_panoramas(photos: Mapping[str, str], request: SearchRequest) -> str:
    """The sentence on photos that are panoramas; empty where none is, or the lens was given.

    Args:
        photos: Of each name `STATED`, `SEEN` or nothing. What is seen counts where it is seen in
            most photos: few may look so by chance.
        request: A lens model or focal length in it states that the photos are ordinary.
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
