"""LPIPS (Zhang et al. 2018): choice of the network, and evaluation of ONNX files."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from ..config import checked_threads
from ..errors import BackendError, ConfigError, FormatError
from ..extras import need
from .lpips_net import NETS, LpipsNet, checked_pair


class Lpips:
    """A perceptual distance: 0 for identical pictures, lower is better.

    The ONNX graph is the whole metric: two inputs [n, 3, h, w] float32 RGB in [-1, 1] of any size,
    one output with one number per picture. The file name contains the network:
    `lpips_<net>.onnx`. Values of different networks cannot be compared.
    """

    def __init__(self, path: Path, *, threads: int = 0) -> None:
        """Load the graph.

        Args:
            path: The ONNX file.
            threads: Number of threads; 0: all cores.

        Raises:
            BackendError: onnxruntime is not installed.
            ConfigError: The file does not exist, or `threads` is more than 1024.
            FormatError: The file is not an ONNX graph or does not take two pictures.
        """
        onnxruntime = need("onnxruntime", "LPIPS")
        if not path.is_file():
            raise ConfigError(
                f"There is no LPIPS network {path}: expected a file such as lpips_squeeze.onnx, "
                f"or one of {', '.join(NETS)} of the package lpips."
            )
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = checked_threads(threads)
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(
                str(path), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime has no common base for its errors
            raise FormatError(
                f"{path} is not an ONNX graph that onnxruntime can load: {error}"
            ) from error
        inputs = [i.name for i in self._session.get_inputs()]
        if len(inputs) != 2:
            raise FormatError(f"{path} must take two pictures, got the inputs {inputs}.")
        self._inputs = inputs
        self.path = path
        """The ONNX file."""
        self.net = path.stem.removeprefix("lpips_")
        """Name of the network, from the file name."""
        self.key = f"lpips_{self.net}"
        """Key in metrics.json."""

    def __call__(self, image: Any, target: Any) -> float:
        """The distance of two [H, W, 3] pictures, float in [0, 1] or uint8.

        Raises:
            ShapeError: Sizes differ or a side is shorter than 32 px.
        """
        feed = dict(zip(self._inputs, checked_pair(image, target), strict=True))
        return float(np.asarray(self._session.run(None, feed)[0]).reshape(-1)[0])


def lpips_file(path: Path | None = None) -> Path | None:
    """Path of the LPIPS network; None: not configured.

    In this order: `path`, the file in GSCORE_LPIPS, and models/lpips_squeeze/lpips_squeeze.onnx in
    the folder in GSCORE_DATA.
    """
    if path is not None:
        return path
    named, data = os.environ.get("GSCORE_LPIPS"), os.environ.get("GSCORE_DATA")
    if named:
        return Path(named)
    return Path(data) / "models" / "lpips_squeeze" / "lpips_squeeze.onnx" if data else None


def named_net(path: Path | None) -> str:
    """The name of the requested network, `alex`, `vgg` or `squeeze`; empty if `path` is a file or
    None."""
    name = "" if path is None else str(path)
    return name if name in NETS and path is not None and not path.is_file() else ""


def find_lpips(
    path: Path | None = None, *, threads: int = 0, download: bool = False
) -> tuple[Lpips | LpipsNet | None, str]:
    """The LPIPS network to use, or None and the reason.

    Args:
        path: A file, the name of a network of the package `lpips`, or None: see `lpips_file`.
        threads: As in `Lpips`.
        download: As in `LpipsNet`, for a name.

    Returns:
        The metric and "", or None and a reason for metrics.json.

    Raises:
        GsError: `path` does not work. A network that was not requested may be missing.
    """
    if net := named_net(path):
        return LpipsNet(net, threads=threads, download=download), ""
    found = lpips_file(path)
    if found is None:
        return None, "no LPIPS network: give one with `--lpips`, or an ONNX file in GSCORE_LPIPS"
    try:
        return Lpips(found, threads=threads), ""
    except (BackendError, ConfigError, FormatError) as error:
        if path is not None:
            raise
        return None, str(error)


def lpips_warnings(reason: str) -> list[str]:
    """Warning if the network of GSCORE_LPIPS cannot be used; else empty.

    Args:
        reason: From `find_lpips`.
    """
    if not reason or not os.environ.get("GSCORE_LPIPS"):
        return []
    return [f"LPIPS is not measured, although GSCORE_LPIPS is set: {reason}"]
