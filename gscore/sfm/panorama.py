"""Panoramas: detection and refusal, with instructions to cut them into views."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import ConfigError
from ..io.colmap.lenses import NO_PINHOLE
from ..quoting import first_few
from ..text_format import count_text
from .search_request import USUAL_LENS, SearchRequest

STATED, PARTIAL, HINTED = "stated", "partial", "hinted"
"""Kinds of evidence: XMP or the camera states a full sphere; XMP states a part of it or a cylinder;
XMP that does not fit the size, as in a view cut out of a panorama."""
SEEN, PLAIN, POSSIBLE, ORDINARY = "seen", "plain", "possible", "ordinary"
"""Kinds of photos twice as wide as high without such statements: the pixels show a sphere; they are
too plain to tell; the same with a lens in EXIF or one varied pole, or not read; they show none."""
_PROJECTION = re.compile(rb"GPano:ProjectionType\W{0,4}?(?:=\s*[\"']|>)\s*(\w+)")
_CROPPED = re.compile(rb"GPano:CroppedAreaImage(Width|Height)Pixels(?:=\s*[\"']|>)\s*(\d+)")
"""Sizes of a cropped panorama, as attributes or elements (Google, Photo Sphere XMP)."""
_CAMERAS = re.compile(
    r"theta|insta360|arashi vision|gopro max|gear 360|sm-[cr]2[01]0|virb 360|keymission 360|qoocam"
    r"|lg-r105|mi sphere|madv360|yi 360|osmo 360|antigravity|kandao|xphase|labpano|trisio",
    re.IGNORECASE,
)
"""Makes and models of 360-degree cameras in EXIF."""
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
    "and so on to 135, and give `gscore sfm` the views with `--camera-model SIMPLE_PINHOLE` and "
    "`--focal-length 600`, half their width. Pictures of two circles need stitching first"
)


def panorama_of(image: Any, camera: Sequence[str] = (), *, whole: bool = True) -> str:
    """Evidence that Pillow's image is a panorama, one of the kinds above; empty: none.

    Args:
        image: Opened; its pixels are decoded if `whole`.
        camera: Make, model, lens and focal lengths from EXIF.
        whole: Use pixels too.
    """
    double = abs(image.width - 2 * image.height) <= 0.005 * image.width
    packets = _xmp(image)
    if projection := _PROJECTION.search(packets):
        kind = projection[1].lower()
        size = {b"Width": image.width, b"Height": image.height}
        cropped = dict(_CROPPED.findall(packets))
        fits = bool(cropped) and all(int(cropped[side]) == size[side] for side in cropped)
        if kind == b"equirectangular":
            return STATED if double else PARTIAL if fits else HINTED
        if kind == b"cylindrical":
            return PARTIAL
    if not double:
        return ""
    if _CAMERAS.search(" ".join(camera[:2])):
        return STATED
    has_lens = any(camera[2:])
    if not whole:
        return ORDINARY if has_lens else POSSIBLE
    kind = _look(image)
    return POSSIBLE if kind == PLAIN and has_lens else kind


def _xmp(image: Any) -> bytes:
    """The XMP packets of Pillow's image."""
    packets = [image.info.get("xmp"), image.info.get("XML:com.adobe.xmp")]
    packets += [body for _, body in getattr(image, "applist", [])]
    texts = (text.encode() if isinstance(text, str) else text for text in packets)
    return b"\n".join(text for text in texts if isinstance(text, bytes))


def _look(image: Any) -> str:
    """Kind of evidence in the pixels of a picture twice as wide as high.

    In a panorama the left and right edges match, and the upper and lower edges, each one point of
    the sphere, have one colour. One of these suffices, because tripods and lamps are there, but not
    where left and right are too plain to tell.
    """
    pixels = np.asarray(image.convert("RGB").resize(_GRID), np.float32).mean(axis=2)
    step = np.abs(np.diff(pixels, axis=1)).mean()
    seam = np.abs(pixels[:, 0] - pixels[:, -1]).mean()
    contrast = pixels.std()
    poles = sum(row.std() <= _POLE * contrast for row in (pixels[0], pixels[-1]))
    sides = min(pixels[:, 0].std(), pixels[:, -1].std())
    if not contrast > 0 or seam > _SEAM * step or not poles:
        return ORDINARY
    if sides >= _UPRIGHT * contrast:
        return SEEN
    return PLAIN if poles == 2 else POSSIBLE


def check_lens(model: str) -> None:
    """Raise ConfigError for a 360-degree lens model."""
    if model in NO_PINHOLE:
        raise ConfigError(
            f"camera_model {model} is for 360-degree photos, which a camera search cannot use. "
            f"{_HOW}."
        )


def refused_panoramas(photos: Mapping[str, str], request: SearchRequest) -> str:
    """Message on photos that are panoramas; empty if none is.

    Args:
        photos: Evidence by name. Pixels count only if they agree in most photos twice as wide as
            high, because few may look like it by chance; plain ones alone, if most photos are.
        request: Its lens model or focal length, if given, overrides all evidence but `STATED` and
            `PARTIAL`.
    """
    if parts := [name for name, how in photos.items() if how == PARTIAL]:
        return (
            f"{count_text(len(parts), 'photo is a panorama', 'photos are panoramas')} of a part "
            f"of all directions (cylindrical or equirectangular, by XMP): {first_few(parts, 3)}. "
            "No lens model fits them: leave them out."
        )
    names = [name for name, how in photos.items() if how == STATED]
    what = count_text(len(names), "photo shows", "photos show")
    why = "by XMP or by the camera"
    excuse = (
        "If these are ordinary photos, remove that statement, as with `exiftool -XMP-GPano:all= "
        "-Model= PHOTOS`."
    )
    if not names and not _lens_is_given(request):
        kinds = (HINTED, SEEN, PLAIN) if _pixels_agree(list(photos.values())) else (HINTED,)
        names = [name for name, how in photos.items() if how in kinds]
        what = count_text(len(names), "photo seems", "photos seem") + " to show"
        why = "by XMP, or because they are twice as wide as high and left and right edge meet"
        excuse = (
            "If they are ordinary photos, give `gscore sfm` their `--focal-length` in px or "
            "another `--camera-model`, as OPENCV."
        )
    if not names:
        return ""
    return (
        f"{what} all directions (360-degree panoramas, {why}): {first_few(names, 3)}. {_HOW}. "
        f"{excuse}"
    )


def _pixels_agree(kinds: list[str]) -> bool:
    """Whether the pixels of all photos, by their kinds of evidence, make panoramas of them."""
    wide = sum(how in (SEEN, PLAIN, POSSIBLE, ORDINARY) for how in kinds)
    alike = sum(how in (SEEN, PLAIN) for how in kinds)
    return 2 * alike > (wide if SEEN in kinds else len(kinds))


def possible_panoramas(photos: Mapping[str, str], request: SearchRequest) -> str:
    """Message on photos that may be panoramas where nothing decides it; empty otherwise."""
    names = [name for name, how in photos.items() if how in (POSSIBLE, PLAIN, SEEN)]
    if _lens_is_given(request) or not names:
        return ""
    return (
        f"{count_text(len(names), 'photo is', 'photos are')} twice as wide as high, as "
        f"360-degree panoramas are: {first_few(names, 3)}. If they show all directions, no search "
        f"can use them as they are. {_HOW}."
    )


def _lens_is_given(request: SearchRequest) -> bool:
    return request.camera_model != USUAL_LENS or bool(request.focal_length)
