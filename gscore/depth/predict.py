"""Prediction of the depth maps of all views, written as 16-bit PNGs; resumable."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .._version import __version__
from ..datasets import Dataset
from ..datasets.decode import ViewFile
from ..errors import Cancelled, ConfigError, FormatError, GsError
from ..io.files import atomic_write
from ..io.images.png import write_png
from ..io.images.read_image import read_image, read_mask
from ..json_text import parse_json
from ..quoting import brief
from ..text_format import count_text
from .fitting import find_kind
from .maps import DepthKind, MapFolder, stem, to_inverse
from .network import Network
from .observations import Observations
from .samples import sampled

PREDICTION_FILE = "prediction.json"
"""Record of the network, next to its maps."""
_HIDDEN = 127
"""Grey background of photos with opacity in the network's input."""
_VIEWS_FOR_KIND = 3
"""Number of views from which the kind of the output is detected."""


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """Result of a prediction, by view names."""

    written: list[str]
    """Newly predicted views."""
    kept: list[str]
    """Views that already had a map."""
    kind: DepthKind
    """Kind of the network's output; the files contain inverse depth in either case."""


def predict_views(
    network: Network,
    dataset: Dataset,
    seen: list[Observations],
    folder: Path,
    *,
    kind: DepthKind = DepthKind.AUTO,
    overwrite: bool = False,
    on_view: Callable[[int, int, str], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Prediction:
    """Predict every view that has no map in `folder` yet.

    Each map is written atomically right after its prediction, so an interrupted call can be
    repeated to resume.

    Args:
        network: The network.
        dataset: The capture; its photos are read at full size.
        seen: Points of each view, from which `kind` AUTO is detected.
        folder: Output folder for `<view>.png`.
        kind: Kind of the network's output.
        overwrite: Predict all views, replacing existing maps.
        on_view: Called with (done, total, name) after each view.
        cancelled: Called before each view; True stops.

    Raises:
        Cancelled: `cancelled` returned True.
        ConfigError: the folder contains maps of another network.
        GsError: the network failed, or a file cannot be written.
    """
    record = _record(network)
    kept = [] if overwrite else _kept(folder, record, dataset.names)
    todo = [i for i, name in enumerate(dataset.names) if name not in set(kept)]
    outputs: dict[int, np.ndarray] = {}
    if kind is DepthKind.AUTO and todo:
        kind, outputs = _find_kind(network, dataset, seen, todo)
    if todo:
        text = json.dumps(record | {"kind": kind.value}, indent=2) + "\n"
        atomic_write(folder / PREDICTION_FILE, text.encode("utf-8"))
    for done, index in enumerate(todo, start=1):
        if cancelled is not None and cancelled():
            raise Cancelled("Predicting depth was stopped.")
        name = dataset.names[index]
        output = outputs.pop(index, None)
        photo, mask = photo_of(dataset.files[index], dataset.mask_mode)
        values = network.predict(photo) if output is None else output
        write_png(folder / f"{stem(name)}.png", encoded(name, values, mask, kind))
        if on_view is not None:
            on_view(done, len(todo), name)
    return Prediction(written=[dataset.names[i] for i in todo], kept=kept, kind=kind)


def photo_of(file: ViewFile, mask_mode: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Input of a network: the full-size photo [H, W, 3] uint8, and its valid pixels [H, W] bool.

    If the mask is opacity, hidden pixels are not part of the scene: they become grey and get no
    depth. Other masks only hide pixels from the training; the network needs the whole photo.
    """
    photo = read_image(file.image, upright=file.upright)
    mask = None
    if mask_mode == "composite":
        if file.use_alpha and photo.shape[2] == 4:
            mask = photo[..., 3]
        elif file.mask is not None:
            mask = read_mask(file.mask, inverted=file.mask_inverted)
    photo = np.ascontiguousarray(photo[..., :3])
    if mask is None:
        return photo, None
    alpha = mask[..., None].astype(np.float32) / 255
    return (photo * alpha + _HIDDEN * (1 - alpha) + 0.5).astype(np.uint8), mask >= 128


def encoded(name: str, values: np.ndarray, mask: np.ndarray | None, kind: DepthKind) -> np.ndarray:
    """[H, W] uint16 inverse depth, stretched to 1 to 65535; 0 where unknown.

    Raises:
        GsError: the map has a single value.
    """
    if kind is DepthKind.DEPTH:
        values = to_inverse(values, kind)
    known = np.isfinite(values) if mask is None else np.isfinite(values) & mask
    low, high = (values[known].min(), values[known].max()) if known.any() else (0.0, 0.0)
    if not high > low:
        raise GsError(
            f"The network gives {name} one value everywhere. Set `--normalization` to its input "
            f"format, or try another model."
        )
    code = np.zeros(values.shape, np.uint16)
    share = (values[known].astype(np.float64) - low) / (float(high) - float(low))
    code[known] = np.rint(1 + share * 65534)
    return code


def _record(network: Network) -> dict[str, Any]:
    profile = network.profile
    with network.path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {
        "gscore": __version__,
        "model": network.path.name,
        "sha256": digest,
        "family": profile.family,
        "normalization": profile.normalization.value,
        "input_size": [profile.width, profile.height, profile.short_side],
    }


def _kept(folder: Path, record: dict[str, Any], names: tuple[str, ...]) -> list[str]:
    """Views that have a map by the same network; raise if the maps have another origin."""
    if not folder.is_dir():
        return []
    maps = MapFolder(folder)
    there = [name for name in names if maps.find(name) is not None]
    if not there:
        return []
    path = folder / PREDICTION_FILE
    by = "it is unknown by which model they were made"
    if path.is_file():
        try:
            before = parse_json(path.read_bytes())
            changed = [k for k in record if k != "gscore" and before.get(k) != record[k]]
        except (OSError, ValueError, AttributeError) as error:
            raise FormatError(
                f"{path} is damaged ({brief(error)}). Remove the folder or give `--overwrite`."
            ) from error
        if not changed:
            return there
        by = f"they were made by {before.get('model')} with another {' and '.join(changed)}"
    raise ConfigError(
        f"{folder} already contains depth maps of {count_text(len(there), 'view')}, and {by}. "
        "Give `--overwrite` to replace them, or another folder with `--depths`."
    )


def _find_kind(
    network: Network, dataset: Dataset, seen: list[Observations], todo: list[int]
) -> tuple[DepthKind, dict[int, np.ndarray]]:
    """Kind of the network's output, from the views with the most points; and their outputs."""
    rich = sorted(todo, key=lambda i: -len(seen[i]))[:_VIEWS_FOR_KIND]
    outputs = {}
    for index in rich:
        photo, _ = photo_of(dataset.files[index], dataset.mask_mode)
        outputs[index] = network.predict(photo)
    kind, doubts = find_kind([sampled(outputs[i], seen[i]) for i in rich])
    return (network.profile.kind if doubts else kind), outputs
