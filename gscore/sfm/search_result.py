"""Search result: figures and messages of a camera search."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..datasets.colmap_source import unplaced_photos_text
from ..quoting import as_typed, brief, first_few
from ..text_format import count_text, number, time_text
from .gps_scale import Gps

_BLURRED = 1.5
"""Mean reprojection error, px, above which photos or lens model are suspect."""
_SHORT_TRACKS = 2.7
"""Mean track length below which photos are too few or too far apart."""


@dataclass(frozen=True, kw_only=True)
class SearchResult:
    """Result of a camera search: figures of the largest model."""

    output: Path
    """The capture."""
    photos: int
    registered: int
    """Photos with a camera pose."""
    models: tuple[tuple[str, ...], ...]
    """Names of the photos of every model, the largest first; only that one is kept."""
    alone: tuple[str, ...]
    """Photos in no model."""
    blurred: tuple[str, ...] = ()
    """Photos with much less detail than the others."""
    jumps: tuple[str, ...] = ()
    """Photos much brighter or darker than their neighbours."""
    points: int
    reprojection_px: float
    """Mean over the points."""
    track_length: float
    """Mean number of photos that show a point."""
    cameras: tuple[dict[str, Any], ...]
    """Lens model, size and focal length of each camera, px."""
    lens: str = ""
    """Message if the lens model differs from the requested one; else empty."""
    in_metres: bool = False
    """Whether GPS in EXIF gave the model its size."""
    up: tuple[float, float, float] | None = None
    """Up direction in the model's world, unit, by GPS in EXIF; None: estimated from the cameras."""
    attempts: int
    """Number of attempts."""
    seconds: float
    resumed: bool
    """Whether features and matches of a stopped search were used."""
    warnings: tuple[str, ...]

    def facts(self) -> dict[str, Any]:
        """Result for JSON; `models` is their number, `others` the photos of all but the largest."""
        return vars(self) | {
            "output": str(self.output),
            "models": len(self.models),
            "others": self.models[1:],
        }

    def lines(self) -> list[str]:
        """Summary in text lines: quality, warnings and the next command."""
        return [
            f"{self.output}: {self.registered} of {count_text(self.photos, 'photo')} have a "
            f"camera, {count_text(self.points, 'point')}",
            f"  mean reprojection error {self.reprojection_px:.2f} px, each point seen in "
            f"{self.track_length:.1f} photos, "
            f"{count_text(len(self.cameras), 'camera and lens', 'cameras and lenses')}, "
            f"{time_text(self.seconds)}",
            *([f"  {self.lens}"] if self.lens else []),
            *(
                [f"  sizes are in metres{', and up is known' if self.up else ''}, by GPS in EXIF"]
                if self.in_metres
                else []
            ),
            *(f"  {sentence}" for sentence in self._findings()),
            f"Next: {as_typed('train', self.output, '-o', 'run', '--eval')}",
        ]

    def _findings(self) -> list[str]:
        messages = unplaced_photos_text(self.models[1:], self.alone)
        if self.blurred:
            messages.append(
                f"{count_text(len(self.blurred), 'photo is', 'photos are')} more blurred than the "
                f"others: {first_few(list(self.blurred))}. A training allows for their blur."
            )
        if self.jumps:
            messages.append(
                f"The exposure jumps in {count_text(len(self.jumps), 'photo')}: "
                f"{first_few(list(self.jumps))}. Lock it in the camera, or equalise the photos."
            )
        if self.reprojection_px > _BLURRED:
            messages.append(
                "The error is high: photos may be blurred or scaled by different factors, or the "
                "lens has more distortion than `--camera-model` describes; try "
                "`--camera-model OPENCV`."
            )
        if self.track_length < _SHORT_TRACKS:
            messages.append(
                "Few photos show the same points: more photos, closer together, would make "
                "cameras more accurate."
            )
        return messages or ["No problems found: every photo has a camera."]


def model_names(model: Any, names: dict[str, str]) -> tuple[str, ...]:
    """Names of the registered photos of a pycolmap Reconstruction, sorted; `names` by alias."""
    aliases = [model.images[i].name for i in model.reg_image_ids()]
    return tuple(names[alias] for alias in sorted(aliases))


def camera_facts(model: Any) -> tuple[dict[str, Any], ...]:
    """Cameras of registered photos in a pycolmap Reconstruction."""
    used = sorted({model.images[i].camera_id for i in model.reg_image_ids()})
    return tuple(
        {
            "model": model.cameras[i].model_name,
            "width": int(model.cameras[i].width),
            "height": int(model.cameras[i].height),
            "focal_px": float(model.cameras[i].mean_focal_length()),
        }
        for i in used
    )


def attempt_text(best: int, photos: int, name: str) -> str:
    """Message before a further attempt."""
    had = f"only {number(best)} of {count_text(photos, 'photo')}" if best else "no photo"
    return f"So far {had} got a camera. Trying again {name}."


def focal_text(cameras: list[tuple[float, bool]]) -> str:
    """Message on focal lengths that the photos do not constrain.

    Args:
        cameras: Focal length of each in px, and whether it was stated.
    """
    lengths = sorted({round(length) for length, _ in cameras})
    shown = f"{lengths[0]} px" if len(lengths) == 1 else f"{lengths[0]} to {lengths[-1]} px"
    source = "stated" if all(stated for _, stated in cameras) else "that of a typical lens"
    return (
        "The photos do not constrain the focal length: others fit as well, for example if the "
        f"camera only moves ahead. It is set to {shown}, {source}; if you know it "
        "better, give it with `--focal-length`."
    )


def lens_text(before: float, after: float) -> str:
    """Message on a lens model that fits better than the requested one; mean errors in px."""
    return (
        "The lenses are kept as OPENCV, with two focal lengths and more coefficients: that brought "
        f"the mean error from {before:.2f} px down to {after:.2f} px."
    )


def gps_text(gps: Gps, names: dict[str, str]) -> list[str]:
    """Messages on GPS outliers and on an unknown scale or up direction; `names` by alias."""
    sentences = []
    if gps.repeated:
        what = count_text(gps.repeated, "photo has", "photos have")
        sentences.append(
            f"GPS in EXIF of {what} one position in common, as where a phone repeats a fix: it was "
            "not used for size and up."
        )
    if gps.contradicts is not None:
        return [
            *sentences,
            "GPS in EXIF is not used for scale and up direction: it contradicts the camera "
            f"positions, by {_length(gps.contradicts)} for a typical photo.",
        ]
    if gps.outliers:
        outliers = [f"{brief(names[alias])} ({_length(off)})" for alias, off in gps.outliers[:5]]
        more = ", ..." if len(gps.outliers) > len(outliers) else ""
        sentences.append(
            f"GPS in EXIF of {count_text(len(gps.outliers), 'photo')} is an outlier, and was not "
            f"used for scale and up direction: {', '.join(outliers)}{more}."
        )
    if gps.metres is not None and gps.up is None:
        off = "by any angle" if gps.tilt > 45 else f"by {gps.tilt:.0f} degrees"
        sentences.append(
            "GPS in EXIF gives the scale of the capture but not its up direction: it may be off "
            f"{off}, because the photos are near one line or GPS is too coarse for so small a "
            "capture. The up direction is estimated from the cameras."
        )
    return sentences


def _length(metres: float) -> str:
    return f"{metres:.0f} m" if metres < 1000 else f"{number(round(metres / 1000))} km"
