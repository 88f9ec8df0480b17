"""Monocular depth networks in ONNX files: recognised by their graphs, run photo by photo."""

from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from ..config import checked_threads
from ..errors import ConfigError, FormatError, GsError
from ..extras import need
from ..io.images.read_image import resize_map
from .maps import DepthKind
from .onnx_graph import GraphFacts, read_facts

NETWORK_HINT = (
    "`gscore depth --list-models` names networks that `--download` fetches. As files: "
    "model-small.onnx of https://github.com/isl-org/MiDaS/releases (v2_1), and Depth Anything V2 "
    "exports of https://github.com/fabio-sim/Depth-Anything-ONNX/releases; check their licences"
)
"""Instruction on how to get a network."""


class Normalization(StrEnum):
    """Normalization of photos that a network expects."""

    AUTO = "auto"
    """Detected from the network."""
    IMAGENET = "imagenet"
    """(RGB in [0, 1] - mean) / deviation of ImageNet: MiDaS 2.1, Depth Anything."""
    HALF = "half"
    """RGB in [-1, 1]: DPT and MiDaS 3."""
    UNIT = "unit"
    """RGB in [0, 1]: files that include the normalization, such as MiDaS' own exports."""
    BYTES = "bytes"
    """RGB in [0, 255]."""


_SCALES = {
    Normalization.IMAGENET: ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)),
    Normalization.HALF: ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5)),
    Normalization.UNIT: ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
    Normalization.BYTES: ((0.0, 0.0, 0.0), (1 / 255, 1 / 255, 1 / 255)),
}
"""Mean and deviation of RGB in [0, 1]."""
_INPUT_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
_RESHAPING = frozenset(
    {"If", "Equal", "Gather", "Shape", "Squeeze", "Unsqueeze", "Reshape", "Identity", "Cast"}
)
"""Operations that do not change numbers; exporters squeeze the output in several ways."""
_OUTPUT_NAMES = ("predicted_depth", "depth", "inverse_depth", "disparity", "inv_depth")


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Input and output format of a network."""

    family: str
    """Detected family of networks, for messages."""
    normalization: Normalization
    """Normalization of the input, never AUTO."""
    kind: DepthKind
    """Kind of the output; never AUTO."""
    width: int
    """Width of the input, px; 0: any."""
    height: int
    """Height of the input, px; 0: any."""
    multiple: int
    """Both sides must be multiples of this, if they are free."""
    short_side: int
    """Shorter side of the input if both are free, px."""
    channels_last: bool
    """Whether the input is [1, H, W, 3] instead of [1, 3, H, W]."""


def recognize(
    shape: list[Any], name: str, file_name: str, facts: GraphFacts, *, size: int = 0
) -> Profile:
    """Profile of a network from its input and its graph.

    Args:
        shape: Shape of the input; names or None for free sizes.
        name: Name of the input.
        file_name: Name of the file; `metric` and `small` in it are used.
        facts: Properties of the graph.
        size: Shorter side of the input if it is free, px; 0: the family's default.

    Raises:
        FormatError: the input is not a batch of one colour picture.
    """
    numbers = [n if isinstance(n, int) and n > 0 else 0 for n in shape]
    if len(numbers) != 4 or numbers[0] > 1 or 3 not in (numbers[1], numbers[3]):
        raise FormatError(
            f"{file_name} takes {name} of the shape {shape}, expected one colour picture: "
            f"[1, 3, height, width] or [1, height, width, 3]. It is not a network for depth from "
            f"one photo"
        )
    last = numbers[1] != 3
    height, width = numbers[1:3] if last else numbers[2:]
    dino = facts.kernel == (14, 14) or (
        not facts.kernel and facts.attention and (width or height or 518) % 14 == 0
    )
    if dino:
        family, normalization, multiple, short = "Depth Anything", Normalization.IMAGENET, 14, 518
    elif facts.attention:
        family, normalization, multiple, short = "DPT / MiDaS 3", Normalization.HALF, 32, 384
    else:
        family, normalization, multiple, short = "MiDaS 2.1", Normalization.IMAGENET, 32, 384
        if max(width, height) == 256 or "small" in file_name.lower():
            family, short = "MiDaS 2.1 small", 256
    if {"Sub", "Add", "BatchNormalization"} & set(facts.arithmetic):
        # The file includes the normalization. Large or tiny factors convert bytes to [0, 1] first.
        of_bytes = any(c > 100 or 0 < c < 0.01 for c in facts.constants)
        normalization = Normalization.BYTES if of_bytes else Normalization.UNIT
    ending = [op for op in facts.last if op not in _RESHAPING][:2]
    metric = "metric" in file_name.lower() or "Sigmoid" in ending
    return Profile(
        family=family,
        normalization=normalization,
        kind=DepthKind.DEPTH if metric else DepthKind.INVERSE,
        width=width,
        height=height,
        multiple=multiple,
        short_side=size or short,
        channels_last=last,
    )


class Network:
    """A network loaded into onnxruntime."""

    def __init__(
        self,
        path: Path,
        *,
        normalization: Normalization = Normalization.AUTO,
        size: int = 0,
        threads: int = 0,
    ) -> None:
        """Load a network.

        Args:
            path: The ONNX file.
            normalization: Overrides the detected one, unless AUTO.
            size: Shorter side of the input, px; 0: the family's default.
            threads: Number of threads; 0: all cores.

        Raises:
            ConfigError: the file does not exist, the network does not support that size, or
                `threads` is more than 1024.
            BackendError: onnxruntime is not installed.
            FormatError: the file is not a network from a photo to a map.
        """
        if not path.is_file():
            raise ConfigError(f"There is no model {path}. {NETWORK_HINT}.")
        self._session = _load(path, threads)
        entry, output = _ends(path, self._session)
        self._input, self._output = entry.name, output.name
        self._dtype = _INPUT_TYPES[entry.type]
        facts = read_facts(path, entry.name, output.name)
        profile = recognize(entry.shape, entry.name, path.name, facts, size=size)
        if normalization is not Normalization.AUTO:
            profile = replace(profile, normalization=normalization)
        self.profile = profile
        """Input and output format."""
        self.path = path
        """The file."""
        if size and profile.width and profile.height and size != min(profile.width, profile.height):
            raise ConfigError(
                f"{path.name} only takes pictures of {profile.width} x {profile.height} pixels; "
                f"leave `--input-size` out."
            )
        if size % profile.multiple and not (profile.width and profile.height):
            raise ConfigError(
                f"`--input-size` is {size}, expected a multiple of {profile.multiple} for "
                f"{profile.family}."
            )

    def input_size(self, width: int, height: int) -> tuple[int, int]:
        """Width and height to which a photo of this size is scaled.

        For a network of fixed size the whole photo is stretched, as in its authors' scripts; for
        one of free size the proportions are kept, rounded to the required multiple.
        """
        profile = self.profile
        scale = profile.short_side / min(width, height)

        def free(side: int) -> int:
            return max(1, round(side * scale / profile.multiple)) * profile.multiple

        return profile.width or free(width), profile.height or free(height)

    def predict(self, photo: np.ndarray) -> np.ndarray:
        """The network's output for a photo, scaled to its size.

        Args:
            photo: [H, W, 3] uint8 RGB.

        Returns:
            [H, W] float32; NaN where the output is not finite.

        Raises:
            GsError: the network failed, or its output is not a map.
        """
        height, width = photo.shape[:2]
        feed = {self._input: self._tensor(photo)}
        try:
            output = self._session.run([self._output], feed)[0]
        except Exception as error:  # onnxruntime has no common base for its errors
            raise GsError(
                f"{self.path.name} failed on a picture of {feed[self._input].shape}: "
                f"{str(error).strip()[:300]}. Try another `--input-size`, or another model."
            ) from error
        values = np.asarray(output, np.float32).squeeze()
        if values.ndim != 2 or min(values.shape) < 2:
            raise GsError(
                f"{self.path.name} gives {list(np.shape(output))}, expected one number per pixel. "
                f"It is not a network for depth from one photo. {NETWORK_HINT}."
            )
        values[~np.isfinite(values)] = np.nan
        return resize_map(values, width, height)

    def _tensor(self, photo: np.ndarray) -> np.ndarray:
        from PIL import Image

        size = self.input_size(photo.shape[1], photo.shape[0])
        scaled = Image.fromarray(photo).resize(size, Image.Resampling.BICUBIC)
        mean, deviation = np.array(_SCALES[self.profile.normalization], np.float32)
        values = (np.asarray(scaled, np.float32) / 255 - mean) / deviation
        if not self.profile.channels_last:
            values = values.transpose(2, 0, 1)
        return np.ascontiguousarray(values[None], self._dtype)


def _load(path: Path, threads: int) -> Any:
    onnxruntime = need("onnxruntime", "Predicting depth")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = checked_threads(threads)
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has no common base for its errors
        reason = str(error).strip().rstrip(".")[:300]
        raise FormatError(
            f"{path} cannot be loaded by onnxruntime as an ONNX model: {reason}. Download it "
            f"again, or update onnxruntime."
        ) from error


def _ends(path: Path, session: Any) -> tuple[Any, Any]:
    """The single input, and the output with the map."""
    inputs, outputs = session.get_inputs(), session.get_outputs()
    if len(inputs) != 1 or inputs[0].type not in _INPUT_TYPES:
        stated = ", ".join(f"{i.name} {i.type} {i.shape}" for i in inputs)
        raise FormatError(
            f"{path.name} takes {stated or 'nothing'}, expected one picture of float numbers. It "
            f"is not a network for depth from one photo. {NETWORK_HINT}."
        )
    named = [o for name in _OUTPUT_NAMES for o in outputs if o.name == name]
    maps = [o for o in outputs if len(o.shape) in (2, 3, 4)]
    if not (named or maps):
        raise FormatError(
            f"{path.name} gives {[o.shape for o in outputs]}, expected a map. It is not a network "
            f"for depth from one photo. {NETWORK_HINT}."
        )
    return inputs[0], (named or maps)[0]
