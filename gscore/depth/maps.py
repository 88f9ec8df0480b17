"""Depth map files: PNG, TIFF, NPY and EXR, with depth or inverse depth."""

import os
import struct
from enum import StrEnum
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ..datasets.folder import same_name
from ..errors import BackendError, DatasetError, FormatError
from ..extras import need
from ..io.files import check_regular, open_regular, read_bytes
from ..io.images.pillow_images import loaded
from ..io.npy import read_npy
from ..quoting import quoted

_MAGIC = 0x01312F76
_LONGEST = 1 << 20
_MOST_PIXELS = 1 << 28
_MOST_CHANNELS = 256


def check_exr_size(path: Path) -> None:
    """Raise ValueError if the header is damaged or states a size too large for a depth map."""
    with open_regular(path) as file:
        raw = file.read(_LONGEST)
    if len(raw) < 8 or struct.unpack_from("<I", raw)[0] != _MAGIC:
        raise ValueError("it does not start with OpenEXR's magic number")
    at, found = 8, False
    while at < len(raw) and raw[at]:
        name, at = _text(raw, at)
        _, at = _text(raw, at)
        if at + 4 > len(raw):
            break
        (size,) = struct.unpack_from("<i", raw, at)
        at += 4
        if size < 0 or at + size > len(raw):
            raise ValueError("its header is damaged")
        if name == b"dataWindow" and size == 16:
            left, top, right, bottom = struct.unpack_from("<4i", raw, at)
            width, height = right - left + 1, bottom - top + 1
            if not (width > 0 and height > 0 and width * height <= _MOST_PIXELS):
                raise ValueError(f"its header states {width} x {height} pixels")
            found = True
        if name == b"channels" and raw[at : at + size].count(b"\0") > 17 * _MOST_CHANNELS:
            raise ValueError("its header states too many channels")
        at += size
    if not found:
        raise ValueError("its header states no size")


def _text(raw: bytes, at: int) -> tuple[bytes, int]:
    end = raw.find(b"\0", at, at + 256)
    if end < 0:
        raise ValueError("its header is damaged")
    return raw[at:end], end + 1


ENDINGS = (".png", ".npy", ".exr", ".tif", ".tiff")
"""File name endings of depth maps, in order of preference."""
SHEET = "contact_sheet.png"
"""Contact sheet of all maps, which `gscore depth` writes next to them; not a map."""
CONFIDENCE = ".confidence.png"
"""Ending of a confidence file, `<stem of the map>.confidence.png`: 8-bit grey, 255: confident."""
PNG_UNIT = 65536.0
"""Divisor of PNG values, 8 and 16 bit alike, as in 3DGS trainers."""
FARTHEST_DEPTH = 1e9
"""Value from which on it is not a depth; Blender's Z pass has 1e10 in the background."""


class DepthKind(StrEnum):
    """Meaning of the numbers in a depth map."""

    AUTO = "auto"
    """Detected from the SfM points."""
    INVERSE = "inverse"
    """Inverse depth up to scale and offset: larger is nearer (MiDaS, Depth Anything)."""
    DEPTH = "depth"
    """Depth along the optical axis up to scale: larger is farther (metric models, Z passes)."""


class MapFolder:
    """The depth maps below a folder, listed once and looked up by view name."""

    def __init__(self, root: Path) -> None:
        """List a folder.

        Raises:
            DatasetError: the folder does not exist.
        """
        if not root.is_dir():
            raise DatasetError(
                f"There is no folder {root} with depth maps. Make them with `gscore depth`, or "
                f"name the folder with `--depths`."
            )
        self.root = root
        self._files: dict[str, Path] = {}
        for folder, _, names in os.walk(root):
            for name in names:
                hidden = name.startswith(".") or name == SHEET or name.endswith(CONFIDENCE)
                if not hidden and Path(name).suffix.lower() in ENDINGS:
                    path = Path(folder) / name
                    self._files[_key(path.relative_to(root).as_posix())] = path

    def __len__(self) -> int:
        return len(self._files)

    def find(self, view: str) -> Path | None:
        """The map of a view: its name with the ending of a map replaced or appended; None: none."""
        for base in (stem(view), view):
            for ending in ENDINGS:
                found = self._files.get(_key(f"{base}{ending}"))
                if found is not None:
                    return found
        return None


def _key(path: str) -> str:
    return same_name(path).lower()


def stem(view: str) -> str:
    """Name of a view without ending, sub-folders kept: its key in depth_params.json."""
    return str(PurePosixPath(view).with_suffix(""))


def read_map(path: Path) -> np.ndarray:
    """Read a depth map with the values of its file.

    Args:
        path: PNG (grey, 8 or 16 bit), TIFF (grey, 8, 16 or 32 bit), NPY ([H, W] numbers) or EXR.

    Returns:
        [H, W] float32; PNG values divided by 65536, all others unchanged; NaN where the value is
        not finite or at least 1e9.

    Raises:
        DatasetError: the file does not exist, or is not a regular file.
        FormatError: it is damaged, or does not have one number per pixel.
        BackendError: the package OpenEXR is needed and not installed.
    """
    check_regular(path)
    if not path.is_file():
        raise DatasetError(f"There is no depth map {path}.")
    kind = path.suffix.lower()
    if kind == ".npy":
        values = _read_npy(path)
    elif kind == ".exr":
        values = _read_exr(path)
    else:
        values = _read_picture(path)
    if values.ndim != 2 or 0 in values.shape:
        raise FormatError(
            f"{path} has the shape {list(values.shape)}, expected [height, width] with one number "
            f"per pixel. Save it without channels."
        )
    with np.errstate(invalid="ignore", over="ignore"):
        values = values.astype(np.float32)
        values[~(np.abs(values) < FARTHEST_DEPTH)] = np.nan
    return values / np.float32(PNG_UNIT) if kind == ".png" else values


def to_inverse(values: np.ndarray, kind: DepthKind) -> np.ndarray:
    """Values that are affine in inverse depth, NaN where unknown.

    Zero means unknown in either kind: 16-bit depth images mark unknown pixels with it, and in a map
    of inverse depth it is the farthest point or the sky, which has no depth.

    Args:
        values: [H, W] float32, as returned by `read_map`.
        kind: INVERSE or DEPTH.

    Returns:
        [H, W] float32.
    """
    if kind is DepthKind.DEPTH:
        return np.divide(1, values, out=np.full_like(values, np.nan), where=values > 0)
    return np.where(values == 0, np.float32(np.nan), values)


def sample(values: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Bilinear interpolation, borders repeated; NaN next to unknown pixels.

    Args:
        values: [H, W] float.
        x: [M] columns, 0 = centre of the first pixel.
        y: [M] rows, 0 = centre of the first pixel.

    Returns:
        [M] float64.
    """
    height, width = values.shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    left = np.minimum(x.astype(np.int64), max(width - 2, 0))
    top = np.minimum(y.astype(np.int64), max(height - 2, 0))
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    fx, fy = x - left, y - top
    above = values[top, left] * (1 - fx) + values[top, right] * fx
    under = values[below, left] * (1 - fx) + values[below, right] * fx
    return above * (1 - fy) + under * fy


def _read_npy(path: Path) -> np.ndarray:
    try:
        values = read_npy(read_bytes(path))
    except ValueError as error:
        raise FormatError(
            f"{path} cannot be read as a NumPy array: {str(error).rstrip('.')}. Save it again with "
            f"numpy.save."
        ) from error
    return values.squeeze()


def _read_picture(path: Path) -> np.ndarray:
    """[H, W] of a PNG or TIFF with one channel, or three equal ones."""
    with loaded(path) as (image, deep):
        mode = image.mode
        values = np.array(image)
    if deep and mode[0] != "I":
        raise FormatError(
            f"{path} is a colour picture of 16 bits per channel, which can only be read with 8 "
            f"bits. Save it as grey."
        )
    if mode in ("RGB", "RGBA", "LA"):
        colours = values[..., :3] if mode != "LA" else values[..., :1]
        if (colours != colours[..., :1]).any():
            raise FormatError(
                f"{path} is a coloured picture of depth, from which depth cannot be read back. "
                f"Save the depth map itself, as a grey 16-bit PNG."
            )
        return colours[..., 0]
    if mode not in ("L", "I", "F") and not mode.startswith("I;16"):
        raise FormatError(
            f"{path} is a picture of the mode {quoted(mode)}, expected grey values. Save the depth "
            f"map as a grey 16-bit PNG."
        )
    return values


def _read_exr(path: Path) -> np.ndarray:
    """[H, W] of the depth channel."""
    try:
        OpenEXR = need("OpenEXR", f"{path}: reading EXR files")
    except BackendError as error:
        raise BackendError(f"{error} Or save the depth maps as NPY or 16-bit PNG.") from error
    try:
        check_exr_size(path)
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: channel.pixels for name, channel in file.channels().items()}
    except Exception as error:  # the package has no common base for its errors
        raise FormatError(
            f"{path} cannot be read as an EXR file: {str(error).strip().rstrip('.')}. Render or "
            f"copy it again."
        ) from error
    return np.asarray(channels[_depth_channel(path, channels)])


def _depth_channel(path: Path, channels: dict[str, Any]) -> str:
    """Name of the depth channel: Blender writes Z, Depth.Z, ViewLayer.Depth.Z or Depth.V; other
    tools Y, or equal R, G, B."""
    for wanted in ("Z", "DEPTH", "V", "Y"):
        named = [name for name in channels if name.rpartition(".")[2].upper() == wanted]
        named.sort(key=lambda name: ("depth" not in name.lower(), len(name)))
        if named:
            return named[0]
    if len(channels) == 1:
        return next(iter(channels))
    if {"R", "G", "B"} <= channels.keys():
        red = channels["R"]
        if all(np.array_equal(red, channels[c], equal_nan=True) for c in "GB"):
            return "R"
    raise FormatError(
        f"{path} has the channels {', '.join(sorted(channels))}, expected a depth channel Z or one "
        f"like ViewLayer.Depth.Z. Render it with Blender's Z pass."
    )
