"""LPIPS networks of the package lpips (Zhang et al. 2018), with torchvision's weights."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from ..config import checked_threads
from ..errors import BackendError, ConfigError, GsError, ShapeError
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
