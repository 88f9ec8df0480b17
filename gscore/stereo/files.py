"""Stereo depth files for a training: PNGs with confidence and scale."""

from pathlib import Path

import numpy as np

from ..datasets import Dataset
from ..datasets.decode import ViewFile
from ..datasets.resolution import divided_size
from ..depth.fit import Fit
from ..depth.maps import CONFIDENCE, PNG_UNIT, MapFolder, stem
from ..depth.origin import STEREO_RECORD, read_record, write_record
from ..errors import ConfigError
from ..io.images.png import write_png
from ..text_format import count_text
from .maps import StereoMap, StereoMaps

_WHITE = 65535
_FARTHEST_KEPT = 0.999
"""Quantile of a map's inverse depths up to which they are stored; nearer pixels are dropped."""


def check_maps_folder(folder: Path, names: tuple[str, ...], *, overwrite: bool) -> None:
    """Raise ConfigError if `folder` contains maps of these views that stereo did not make."""
    if overwrite or not folder.is_dir() or read_record(folder) is not None:
        return
    maps = MapFolder(folder)
    there = [name for name in names if maps.find(name) is not None]
    if there:
        raise ConfigError(
            f"{folder} already contains depth maps of {count_text(len(there), 'view')}, which "
            "were not made by stereo. Give `--overwrite` to replace them, or another folder with "
            "`--depths`."
        )


def write_maps(
    found: StereoMaps, dataset: Dataset, used: list[int], folder: Path
) -> dict[str, Fit]:
    """Write maps and confidence in the geometry of the original, distorted photos.

    Maps of an earlier call that this one does not replace are removed.

    Args:
        found: At least one map.
        dataset: The capture.
        used: Indices of the participating views.
        folder: Output folder for `<view>.png` and `<view>.confidence.png`.

    Returns:
        Scale of the values by name of the view without ending.

    Raises:
        GsError: a file cannot be written.
    """
    _remove_before(folder)
    high = max(_nearest(one) for one in found.maps.values())
    written = {dataset.names[index]: one for index, one in found.maps.items()}
    write_record(folder, [dataset.names[i] for i in used], [*written])
    fits = {}
    for name, one in written.items():
        file = dataset.files[one.photo.index]
        inverse, confidence = _as_taken(file, one)
        inverse = np.where(inverse <= high, inverse, 0)
        code = np.rint(inverse * (_WHITE / high)).astype(np.uint16)
        sure = np.where(code > 0, np.rint(255 * confidence), 0).astype(np.uint8)
        write_png(folder / f"{stem(name)}.png", code)
        write_png(folder / f"{stem(name)}{CONFIDENCE}", sure)
        fits[stem(name)] = Fit(scale=float(high * PNG_UNIT / _WHITE), offset=0.0, accepted=True)
    return fits


def _remove_before(folder: Path) -> None:
    """Remove the maps of an earlier call, because a photo may be held out now."""
    record = read_record(folder) if folder.is_dir() else None
    if record is None:
        return
    for name in record["maps"]:
        for ending in (".png", CONFIDENCE):
            path = (folder / f"{stem(name)}{ending}").resolve()
            if path.is_relative_to(folder.resolve()):  # the record is untrusted input
                path.unlink(missing_ok=True)
    (folder / STEREO_RECORD).unlink()


def _nearest(one: StereoMap) -> float:
    known = one.inverse_depth[one.inverse_depth > 0]
    return float(np.quantile(known, _FARTHEST_KEPT, method="higher"))


def _as_taken(file: ViewFile, one: StereoMap) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth and confidence at the pixels of the downscaled original photo."""
    if file.plan is None:
        return one.inverse_depth, one.confidence
    height, width = one.inverse_depth.shape
    factor = max(file.plan.width / width, 1.0)
    camera = file.plan.camera
    size = divided_size(camera.width, camera.height, factor)
    x, y = np.meshgrid(
        (np.arange(size[0]) + 0.5) * (camera.width / size[0]),
        (np.arange(size[1]) + 0.5) * (camera.height / size[1]),
    )
    pinhole = file.plan.undistort(np.stack([x.ravel(), y.ravel()], axis=1))
    u = pinhole[:, 0] * (width / file.plan.width)
    v = pinhole[:, 1] * (height / file.plan.height)
    with np.errstate(invalid="ignore"):
        inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    at = np.where(inside, v, 0).astype(np.int64), np.where(inside, u, 0).astype(np.int64)
    shape = size[1], size[0]
    return (
        np.where(inside, one.inverse_depth[at], 0).reshape(shape),
        np.where(inside, one.confidence[at], 0).reshape(shape),
    )
