"""Contact sheet: photo and depth map of every view side by side, with the fit."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..datasets import Dataset
from ..datasets.decode import fit_map
from ..errors import GsError
from ..io.images.png import SIGNED, write_png
from ..io.images.read_image import resize, resize_map
from ..text_format import count_text
from .fit import Fit
from .maps import DepthKind, read_map, to_inverse

MOST_VIEWS = 96
"""Maximum number of views on a sheet, evenly spaced among all."""
_TILE = 200
"""Width of a picture, pixels."""
_GAP, _LINE = 8, 14
_BACK, _INK, _BAD = (24, 24, 27), (228, 228, 231), (248, 113, 113)
_UNKNOWN = (63, 63, 70)


def write_sheet(
    path: Path,
    dataset: Dataset,
    maps: list[Path | None],
    fits: list[Fit | None],
    kind: DepthKind,
    colorize: Callable[[np.ndarray], np.ndarray],
) -> int:
    """Draw and write the sheet; near is bright, unknown pixels are grey.

    Args:
        path: The PNG.
        dataset: The capture at any resolution.
        maps: Map file of each view; None: no map.
        fits: Fit of each view.
        kind: Kind of the maps.
        colorize: Colour map, [...] float in [0, 1] to [..., 3] uint8.

    Returns:
        The number of views on the sheet.

    Raises:
        GsError: the file cannot be written.
    """
    there = [i for i, file in enumerate(maps) if file is not None]
    shown = there[:: -(-len(there) // MOST_VIEWS)] if there else []
    tiles = [_tile(dataset, i, maps[i], fits[i], kind, colorize) for i in shown]
    if not tiles:
        return 0
    height = max(tile.shape[0] for tile in tiles)
    width = tiles[0].shape[1]
    columns = max(1, min(len(tiles), round((len(tiles) * 1.4 * height / width) ** 0.5)))
    rows = -(-len(tiles) // columns)
    sheet = np.full(
        (_GAP + rows * (height + _GAP), _GAP + columns * (width + _GAP), 3), _BACK, np.uint8
    )
    for place, tile in enumerate(tiles):
        row, column = divmod(place, columns)
        top, left = _GAP + row * (height + _GAP), _GAP + column * (width + _GAP)
        sheet[top : top + tile.shape[0], left : left + width] = tile
    write_png(path, sheet, SIGNED)
    return len(tiles)


def map_picture(values: np.ndarray, colorize: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Picture [H, W, 3] uint8 of a map affine in inverse depth, 1st to 99th percentile."""
    known = np.isfinite(values)
    if not known.any():
        return np.full((*values.shape, 3), _UNKNOWN, np.uint8)
    low, high = np.quantile(values[known], (0.01, 0.99))
    share = (np.nan_to_num(values, nan=low) - low) / max(float(high - low), 1e-30)
    picture = colorize(share)
    picture[~known] = _UNKNOWN
    return picture


def _tile(
    dataset: Dataset,
    index: int,
    path: Path | None,
    fit: Fit | None,
    kind: DepthKind,
    colorize: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    photo = dataset.image(index)
    width = min(_TILE, photo.shape[1])
    height = max(1, round(photo.shape[0] * width / photo.shape[1]))
    tile = np.full((height + 2 * _LINE + 2, 2 * _TILE, 3), _BACK, np.uint8)
    tile[:height, :width] = resize(photo, width, height)
    note = _fit_text(fit)
    try:
        values = fit_map(dataset.files[index], to_inverse(read_map(path), kind)) if path else None
    except GsError:  # the fit has the reason
        values = None
    if values is not None:
        picture = map_picture(resize_map(values, width, height), colorize)
        tile[:height, _TILE : _TILE + width] = picture
    return _with_text(tile, height, (dataset.names[index], _INK), note)


def _fit_text(fit: Fit | None) -> tuple[str, tuple[int, int, int]]:
    if fit is None:
        return "", _INK
    if fit.accepted:
        return (
            f"{fit.inliers:.0%} of {count_text(fit.points, 'point')} agree, scale {fit.scale:.4g}",
            _INK,
        )
    return f"refused: {fit.reason}", _BAD


def _with_text(tile: np.ndarray, top: int, *lines: tuple[str, tuple[int, int, int]]) -> np.ndarray:
    """The tile with lines of text below row `top`, truncated to its width."""
    from PIL import Image, ImageDraw, ImageFont

    picture = Image.fromarray(tile)
    draw: Any = ImageDraw.Draw(picture)
    font = ImageFont.load_default()
    for number, (text, ink) in enumerate(lines):
        printable = text.encode("latin-1", "replace").decode("latin-1")
        while printable and draw.textlength(printable, font=font) > tile.shape[1] - 4:
            printable = printable[:-4] + "..." if len(printable) > 7 else ""
        draw.text((2, top + 2 + number * _LINE), printable, fill=ink, font=font)
    return np.array(picture)
