"""Optional packages (extras): the extra that installs each, and the message if one is missing."""

import sys
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from .errors import BackendError

_TRAIN = "train"
_EXTRAS = {
    "torch": _TRAIN,
    "pycolmap": _TRAIN,
    "PIL": _TRAIN,
    "scipy": _TRAIN,
    "safetensors": _TRAIN,
    "onnxruntime": "depth",
    "OpenEXR": "depth",
    "av": "video",
    "pillow_heif": "heic",
    "rawpy": "raw",
    "zstandard": "formats",
    "pxr": "usd",
    "huggingface_hub": "hub",
    "lpips": "lpips-torch",
    "torchvision": "lpips-torch",
    "bpy": "blender",
}
"""Name of the module to name of the extra in pyproject.toml."""
_PACKAGES = {"PIL": "pillow", "pxr": "usd-core", "pillow_heif": "pillow-heif"}
"""Name of the module to name of the package, where they differ."""
_CPU_INDEX = "https://download.pytorch.org/whl/cpu"
"""Packages of torch without CUDA, for Linux, where the usual one brings gigabytes of it."""


def how_to_install(*modules: str) -> str:
    """The command that brings optional packages, with all that the same work needs besides; empty
    where none of the modules is one of them."""
    found = (_EXTRAS.get(module.partition(".")[0]) for module in modules)
    extras = list(dict.fromkeys(extra for extra in found if extra))
    if not extras:
        return ""
    command = f'pip install "gscore[{",".join(extras)}]"'
    if _TRAIN in extras and sys.platform.startswith("linux"):
        command += f" --extra-index-url {_CPU_INDEX}"
    return command


def missing(module: str, purpose: str) -> str:
    """The sentence for a package that is not installed.

    Args:
        module: Its name in an import.
        purpose: What needs it, the beginning of a sentence.
    """
    package = module.partition(".")[0]
    package = _PACKAGES.get(package, package)
    return f"{purpose} needs the package {package}; install it with: {how_to_install(module)}"


def need(module: str, purpose: str) -> Any:
    """The module, loaded, which leaves signals where they went; `purpose` as in `missing`.

    Raises:
        BackendError: It is not installed.
    """
    loaded = sys.modules.get(module)
    if loaded is not None and not _is_loading(loaded):
        return loaded
    # Here, for it loads ctypes and threading, which `import gscore` alone has no use for.
    from .signal_guard import keep_signal_handlers

    try:
        with keep_signal_handlers():
            return import_module(module)
    except ImportError as error:
        raise BackendError(f"{missing(module, purpose)}.") from error


def _is_loading(module: Any) -> bool:
    """Whether another thread, or a caller of this one, is in the middle of importing it."""
    return bool(getattr(getattr(module, "__spec__", None), "_initializing", False))


def offered(door: str, name: str, homes: Mapping[str, str]) -> Any:
    """A name that a module offers but does not hold, for that module's `__getattr__`.

    Args:
        door: The module's own name, for messages.
        name: Asked for.
        homes: Where each name that the module offers lives within gscore, `module:name` where it is
            called differently there.

    Raises:
        AttributeError: the module does not offer it.
        ModuleNotFoundError: a package that it takes is not installed; the sentence says which.
    """
    home = homes.get(name)
    if home is None:
        raise AttributeError(f"module {door!r} has no attribute {name!r}")
    module, _, inner = home.partition(":")
    try:
        return getattr(import_module(f".{module}", __package__), inner or name)
    except ModuleNotFoundError as error:
        needed = error.name or ""
        if not how_to_install(needed):
            raise
        sentence = missing(needed, f"{door}.{name}")
        raise ModuleNotFoundError(sentence, name=error.name) from error
