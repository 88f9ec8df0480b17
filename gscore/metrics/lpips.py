"""LPIPS (Zhang et al. 2018) by onnxruntime from an ONNX file; its key names the net."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from ..config import checked_threads
from ..errors import BackendError, ConfigError, FormatError, ShapeError
from ..extras import need
from .image import as_float

SHORTEST_SIDE = 32
"""Pixels; smaller pictures vanish in the pooling of the networks."""


class Lpips:
    """A perceptual distance: 0 for identical pictures, larger is worse.

    The ONNX graph is the whole metric: two inputs [n, 3, h, w] float32 RGB in [-1, 1] of any size,
    one output with a number a picture. The file name says which network it is:
    `lpips_<net>.onnx`. Numbers of different networks cannot be compared.
    """

    def __init__(self, path: Path, *, threads: int = 0) -> None:
        """Load the graph.

        Args:
            path: The ONNX file.
            threads: Threads to use; 0: all cores.

        Raises:
            BackendError: onnxruntime is not installed.
            ConfigError: There is no such file, or more threads are asked for than 1024.
            FormatError: The file is no ONNX graph or does not take two pictures.
        """
        onnxruntime = need("onnxruntime", "LPIPS")
        if not path.is_file():
            raise ConfigError(
                f"No LPIPS network at {path}: expected a file such as lpips_squeeze.onnx."
            )
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = checked_threads(threads)
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(
                str(path), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime has no common base for its errors
            raise FormatError(f"{path} is no ONNX graph onnxruntime can load: {error}") from error
        inputs = [i.name for i in self._session.get_inputs()]
        if len(inputs) != 2:
            raise FormatError(f"{path} must take two pictures, got the inputs {inputs}.")
        self._inputs = inputs
        self.path = path
        """The file the numbers come from."""
        self.net = path.stem.removeprefix("lpips_")
        """Name of the network, from the file name."""
        self.key = f"lpips_{self.net}"
        """Key of the number in metrics.json."""

    def __call__(self, image: Any, target: Any) -> float:
        """The distance of two [H, W, 3] pictures, float in [0, 1] or uint8.

        Raises:
            ShapeError: Sizes differ or a side is shorter than 32 pixels.
        """
        a, b = as_float("image", image), as_float("target", target)
        if a.shape != b.shape:
            raise ShapeError(
                f"image and target must have one size, got {list(a.shape)} and {list(b.shape)}."
            )
        if min(a.shape[:2]) < SHORTEST_SIDE:
            raise ShapeError(
                f"LPIPS needs pictures of at least {SHORTEST_SIDE} x {SHORTEST_SIDE} pixels, "
                f"got {a.shape[1]} x {a.shape[0]}."
            )
        feed = {
            name: np.ascontiguousarray((x * 2.0 - 1.0).transpose(2, 0, 1)[None], dtype=np.float32)
            for name, x in zip(self._inputs, (a, b), strict=True)
        }
        return float(np.asarray(self._session.run(None, feed)[0]).reshape(-1)[0])


def lpips_file(path: Path | None = None) -> Path | None:
    """Where the LPIPS network to use is looked for; None: nowhere.

    In this order: `path`, the file named by GSCORE_LPIPS, and
    models/lpips_squeeze/lpips_squeeze.onnx in the folder named by GSCORE_DATA.
    """
    if path is not None:
        return path
    named, data = os.environ.get("GSCORE_LPIPS"), os.environ.get("GSCORE_DATA")
    if named:
        return Path(named)
    return Path(data) / "models" / "lpips_squeeze" / "lpips_squeeze.onnx" if data else None


def find_lpips(path: Path | None = None, *, threads: int = 0) -> tuple[Lpips | None, str]:
    """The LPIPS network to use, or None and the reason why there is none.

    Args:
        path: A file the user named, or None: see `lpips_file`.
        threads: As in `Lpips`.

    Returns:
        The metric and "", or None and a reason for metrics.json.

    Raises:
        GsError: `path` does not work. What was not asked for may be absent.
    """
    found = lpips_file(path)
    if found is None:
        return None, "no LPIPS network: name an ONNX file with --lpips or GSCORE_LPIPS"
    try:
        return Lpips(found, threads=threads), ""
    except (BackendError, ConfigError, FormatError) as error:
        if path is not None:
            raise
        return None, str(error)


def lpips_warnings(reason: str) -> list[str]:
    """A sentence where GSCORE_LPIPS names a network that was not found usable; else none.

    Args:
        reason: From `find_lpips`.
    """
    if not reason or not os.environ.get("GSCORE_LPIPS"):
        return []
    return [f"LPIPS is not measured, though GSCORE_LPIPS names a network: {reason}"]
