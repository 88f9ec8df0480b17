"""Optional packages (extras): the extra that installs each, and the message if one is missing."""

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from typing import Any

from .errors import BackendError

_ROOM = 1024
"""Buffer for a `struct sigaction`, bytes; it has 152 on Linux and 16 on macOS."""
_lock = threading.Lock()


@contextmanager
def keep_signal_handlers() -> Iterator[None]:
    """Context after which all signal handlers are as before; usable from any thread.

    Imported libraries may replace handlers: pycolmap installs a crash handler that answers SIGTERM
    with a stack trace, so a terminated run would leave no checkpoint. Python's `signal.signal`
    works in the main thread only, so this calls the system's `sigaction`. On systems without it
    (Windows) this does nothing.
    """
    if os.name != "posix":
        yield
        return
    with _lock:
        before = _handlers()
        try:
            yield
        finally:
            library = ctypes.CDLL(None)
            for number, handler in before.items():
                library.sigaction(number, handler, None)


def _handlers() -> dict[int, Any]:
    """The raw `struct sigaction` of each signal that can be handled."""
    library, handlers = ctypes.CDLL(None), {}
    for number in sorted(signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}):
        handler = ctypes.create_string_buffer(_ROOM)
        if library.sigaction(number, None, handler) == 0:
            handlers[int(number)] = handler
    return handlers


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
    "skimage": "mesh",
    "fast_simplification": "mesh",
    "xatlas": "texture",
    "pxr": "usd",
    "huggingface_hub": "hub",
    "lpips": "lpips-torch",
    "torchvision": "lpips-torch",
    "bpy": "blender",
}
"""Module to extra in pyproject.toml."""
_PACKAGES = {
    "PIL": "pillow",
    "pxr": "usd-core",
    "pillow_heif": "pillow-heif",
    "skimage": "scikit-image",
    "fast_simplification": "fast-simplification",
}
"""Module to package, where the names differ."""
_CPU_INDEX = "https://download.pytorch.org/whl/cpu"
"""torch without CUDA, for Linux, where the default package includes gigabytes of it."""


def install_hint(*modules: str) -> str:
    """The command that installs the extras of optional modules; empty if none is optional."""
    known = (_EXTRAS.get(module.partition(".")[0]) for module in modules)
    extras = list(dict.fromkeys(extra for extra in known if extra))
    if not extras:
        return ""
    command = f'pip install "gscore[{",".join(extras)}]"'
    if _TRAIN in extras and sys.platform.startswith("linux"):
        command += f" --extra-index-url {_CPU_INDEX}"
    return command


def missing(module: str, purpose: str) -> str:
    """The message on a package that is not installed.

    Args:
        module: Its name in an import.
        purpose: Subject of the sentence, such as "Writing a video".
    """
    facts = package_facts(module)
    return f"{purpose} needs the package {facts['package']}; install it with: {facts['install']}"


def package_facts(module: str) -> dict[str, str]:
    """`package` and `install` of `BackendError` and `events.Failed` for a missing module."""
    name = module.partition(".")[0]
    return {"package": _PACKAGES.get(name, name), "install": install_hint(module)}


def need(module: str, purpose: str) -> Any:
    """Import a module without changes of the signal handlers; `purpose` as in `missing`.

    Raises:
        BackendError: The module is not installed.
    """
    loaded = sys.modules.get(module)
    if loaded is not None and not _is_loading(loaded):
        return loaded
    # A local import, because it loads ctypes and threading, which `import gscore` does not need.

    try:
        with keep_signal_handlers():
            return import_module(module)
    except ImportError as error:
        raise BackendError(f"{missing(module, purpose)}.", **package_facts(module)) from error


def _is_loading(module: Any) -> bool:
    """True while another thread, or a caller of this one, imports the module."""
    return bool(getattr(getattr(module, "__spec__", None), "_initializing", False))


def stub_name(door: str, name: str) -> Any:
    """Load a name that the stub of a module re-exports, for that module's `__getattr__`.

    Args:
        door: Name of the re-exporting module, whose stub is beside its file.
        name: The requested name; `__all__` gives the list of names.

    Raises:
        AttributeError: the module does not export the name.
        ModuleNotFoundError: a required package is not installed; the message names it.
    """
    homes = _stub(door)
    if name == "__all__":
        return list(homes)
    if name not in homes:
        raise AttributeError(f"module {door!r} has no attribute {name!r}")
    module, inner = homes[name]
    try:
        return getattr(import_module(module, __package__), inner)
    except ModuleNotFoundError as error:
        needed = error.name or ""
        if not install_hint(needed):
            raise
        sentence = missing(needed, f"{door}.{name}")
        raise ModuleNotFoundError(sentence, name=error.name) from error


@cache
def _stub(door: str) -> dict[str, tuple[str, str]]:
    """Module of each name of a stub, and its name there.

    Its lines are `from .MODULE import NAME as NAME`; or `from .MODULE import NAME`, and below them
    `OFFERED = NAME`.
    """
    homes: dict[str, tuple[str, str]] = {}
    with open(f"{sys.modules[door].__file__}i", encoding="utf-8") as stub:  # noqa: PTH123 - light
        for line in stub:
            if line.startswith("from "):
                _, module, _, names = line.split(maxsplit=3)
                homes |= {name.split()[-1]: (module, name.split()[0]) for name in names.split(",")}
            elif " = " in line:
                offered, _, name = line.split()
                homes[offered] = homes.pop(name)
    return homes
