"""LPIPS (Zhang et al. 2018): choice of the network, and evaluation of ONNX files."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from ..config import checked_threads
from ..errors import BackendError, ConfigError, FormatError, GsError, ShapeError
from ..extras import install_hint, need
from ..quoting import brief
from .image import as_float

NETS = {
    "alex": "alexnet-owt-7be5be79.pth",
    "vgg": "vgg16-397923af.pth",
    "squeeze": "squeezenet1_1-b8a52dc0.pth",
}
"""Names of the networks, and torchvision's weight files in torch's cache."""
_MEGABYTES = {"alex": 233, "vgg": 528, "squeeze": 5}


def weights_file(net: str) -> Path:
    """Path of a network's weights in torch's cache, which may not exist.

    The cache is TORCH_HOME, else `torch` in XDG_CACHE_HOME, else in `~/.cache`.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME", "~/.cache"))
    home = Path(os.environ.get("TORCH_HOME", cache / "torch")).expanduser()
    return home / "hub" / "checkpoints" / NETS[net]


class LpipsNet:
    """The metric as the package `lpips` computes it, version 0.1, on RGB in [-1, 1]."""

    def __init__(self, net: str, *, threads: int = 0, download: bool = False) -> None:
        """Load the package and the weights.

        Args:
            net: One of `NETS`.
            threads: Number of threads; 0: torch's setting.
            download: Allow torchvision to download weights that are not in torch's cache.

        Raises:
            BackendError: the package or torchvision is not installed, or does not load.
            ConfigError: the weights do not exist, and `download` is False.
            GsError: they cannot be downloaded or read.
        """
        self._threads = checked_threads(threads)
        self._torch = need("torch", "LPIPS")
        package = _package()
        path = weights_file(net)
        if not path.is_file() and not download:
            raise ConfigError(
                f"The weights of LPIPS with {net} are not on this machine: {path} "
                f"({_MEGABYTES[net]} MB, from torchvision). Copy them there, or download them "
                "with `--lpips-download`."
            )
        try:
            self._metric = package.LPIPS(net=net, version="0.1", verbose=False).eval()
        except Exception as error:  # of urllib, of torch, of the package
            raise GsError(
                f"LPIPS with {net} cannot be loaded from {path}: {brief(error)}. Remove the file "
                "to download it again, or check the connection."
            ) from error
        self.path = path
        """The weights file."""
        self.net = net
        self.key = f"lpips_{net}"
        """Key in metrics.json."""

    def __call__(self, image: Any, target: Any) -> float:
        """The distance of two [H, W, 3] pictures, float in [0, 1] or uint8.

        Raises:
            ShapeError: Sizes differ or a side is shorter than 32 px.
        """
        torch = self._torch
        pair = [torch.from_numpy(np.ascontiguousarray(x)) for x in checked_pair(image, target)]
        before = torch.get_num_threads()
        try:
            if self._threads:
                torch.set_num_threads(self._threads)
            with torch.no_grad():
                return float(self._metric(*pair).reshape(-1)[0])
        finally:
            torch.set_num_threads(before)


def _package() -> Any:
    """The package `lpips`, which loads torchvision.

    Raises:
        BackendError: one of the two is missing, or torchvision was built for another torch.
    """
    try:
        return need("lpips", "LPIPS by its name")
    except RuntimeError as error:
        if isinstance(error, BackendError):
            raise
        raise BackendError(
            f"torchvision does not load: {brief(error)}. It was made for another build of torch; "
            f"install both together: {install_hint('lpips')}"
        ) from error


SHORTEST_SIDE = 32
"""Minimum side, px; smaller pictures vanish in the pooling of the networks."""


def checked_pair(image: Any, target: Any) -> tuple[np.ndarray, np.ndarray]:
    """Two [1, 3, H, W] float32 arrays in [-1, 1].

    Args:
        image: [H, W, 3], float in [0, 1] or uint8.
        target: Likewise.

    Raises:
        ShapeError: Sizes differ or a side is shorter than 32 px.
    """
    a, b = as_float("image", image), as_float("target", target)
    if a.shape != b.shape:
        raise ShapeError(
            f"image and target must have the same size, got {list(a.shape)} and {list(b.shape)}."
        )
    if min(a.shape[:2]) < SHORTEST_SIDE:
        raise ShapeError(
            f"LPIPS needs pictures of at least {SHORTEST_SIDE} x {SHORTEST_SIDE} pixels, "
            f"got {a.shape[1]} x {a.shape[0]}."
        )
    one, other = (
        np.ascontiguousarray((x * 2.0 - 1.0).transpose(2, 0, 1)[None], dtype=np.float32)
        for x in (a, b)
    )
    return one, other


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
                f"{path} is not an ONNX graph that onnxruntime can load: {error}. Export or copy "
                "it again."
            ) from error
        inputs = [i.name for i in self._session.get_inputs()]
        if len(inputs) != 2:
            raise FormatError(
                f"{path} is not an LPIPS network: expected two inputs, pictures, got {inputs}. "
                "Export it again."
            )
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
