"""Native library: its functions, errors and workspaces.

`csrc/include/gscore.h` documents everything declared here. `arguments.py` checks dtype, shape and
layout of arrays; the library checks their values.
"""

import ctypes as ct
import os
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ..errors import BackendError, Cancelled, ConfigError, ShapeError
from . import arguments, header
from .buffers import UINT32, Array, address, optional
from .request import Frustum, Settings
from .shared_library import SharedLibrary

_pointer = ct.c_void_p


def _check_environment(lib: ct.CDLL) -> None:
    """Raise ConfigError for an invalid GSCORE_ISA or GSCORE_THREADS."""
    wanted, there = os.environ.get("GSCORE_ISA"), lib.gs_isas().decode().split(",")
    if wanted and wanted not in there:  # the library itself would ignore it
        raise ConfigError(
            f"The environment variable GSCORE_ISA is {wanted[:40]!r}, expected an instruction set "
            f"available here: {', '.join(there)}."
        )
    if lib.gs_default_threads() == 0:
        text = lib.gs_last_error().decode("utf-8", "replace")
        raise ConfigError(f"{text[:1].upper()}{text[1:]}.")


def _declare(lib: ct.CDLL) -> None:
    """Declare argument and result types of the functions for ctypes."""
    for name in ("gs_last_error", "gs_isas", "gs_isa"):
        getattr(lib, name).restype = ct.c_char_p
    lib.gs_default_threads.restype = ct.c_int32
    lib.gs_set_isa.argtypes = [ct.c_char_p]
    lib.gs_raster_destroy.restype = None
    for name, types in header.SIGNATURES.items():
        getattr(lib, name).argtypes = types


LIBRARY = SharedLibrary(
    name="gscore",
    variable="GSCORE_LIBRARY",
    function="gs_abi_version",
    version=header.ABI_VERSION,
    declare=_declare,
    check=_check_environment,
)
"""The native library."""


def library_path() -> Path:
    """Path of the native library: GSCORE_LIBRARY unless that is empty, else next to this file."""
    return LIBRARY.path


def library() -> ct.CDLL:
    """The loaded library.

    Raises:
        BackendError: it is missing or of another version.
        ConfigError: GSCORE_THREADS or GSCORE_ISA has an invalid value.
    """
    return LIBRARY.get()


def raise_status(status: int) -> None:
    """Raise the exception for a gs_status."""
    if status == header.OK:
        return
    message = library().gs_last_error().decode("utf-8", "replace")
    if status == header.CANCELLED:
        raise Cancelled("Rendering was cancelled.")
    if status == header.OUT_OF_MEMORY:
        raise BackendError(
            f"{message}. Close programs, or use smaller images (`--resolution`) or fewer splats "
            "(`--max-splats`)."
        )
    if status == header.BAD_ARGUMENT:
        raise ShapeError(f"{message}.")
    raise BackendError(f"{message}.")


def available_isas() -> list[str]:
    """Instruction sets supported by this CPU, best first."""
    return library().gs_isas().decode().split(",")


def isa() -> str:
    """The instruction set in use."""
    return library().gs_isa().decode()


def set_isa(name: str) -> None:
    """Switch to another instruction set. Raises BackendError if it is not available."""
    raise_status(library().gs_set_isa(name.encode()))


def default_threads() -> int:
    """Default number of threads: GSCORE_THREADS, else one per usable core."""
    return library().gs_default_threads()


def exp2(x: np.ndarray) -> np.ndarray:
    """gs_exp2: 2^x of C-contiguous float32 values in [-126, 127], as the blend loops compute it."""
    y = np.empty_like(x)
    raise_status(library().gs_exp2(address("x", x, x.shape), address("y", y, x.shape), x.size))
    return y


class Raster:
    """A native workspace, for one thread at a time; `pool` lends them."""

    def __init__(self) -> None:
        handle = _pointer()
        self._lib = library()
        raise_status(self._lib.gs_raster_create(ct.byref(handle)))
        self.handle = handle

    def __del__(self) -> None:
        handle = getattr(self, "handle", None)
        if handle:
            self._lib.gs_raster_destroy(handle)

    def forward(
        self,
        splats: Sequence[Array],
        view: Frustum,
        settings: Settings,
        pictures: Mapping[str, Array],
    ) -> None:
        """gs_raster_forward.

        Args:
            splats: `PARAMETERS`, in their order.
            view: Camera and picture size.
            settings: Render settings.
            pictures: Output arrays, by the names of gs_image.
        """
        image = arguments.image(pictures, view, settings.outputs, len(splats[0]))
        degree = arguments.evaluated_degree(splats[5], settings)
        raise_status(
            self._lib.gs_raster_forward(
                self.handle,
                ct.byref(arguments.splats(splats, settings)),
                ct.byref(arguments.view(view, settings, degree)),
                ct.byref(arguments.host(view, settings)),
                ct.byref(image),
            )
        )

    def backward(
        self,
        splats: Sequence[Array],
        view: Frustum,
        settings: Settings,
        v_pictures: Mapping[str, Array | None],
        grads: Mapping[str, Array],
        *,
        add_shN: bool = False,
    ) -> None:
        """gs_raster_backward of the last `forward`.

        Args:
            splats: As in that call.
            view: As in that call.
            settings: As in that call.
            v_pictures: Gradients in the pictures, by their names; None or missing: zero.
            grads: Output arrays by name: `PARAMETERS` and, optionally, `means2d` [N, 2] and
                `viewmat` [4, 4].
            add_shN: Accumulate into shN's gradient.
        """
        count, rest = len(splats[0]), splats[5].shape[1]
        v_image = arguments.image_grads(v_pictures, view, settings.outputs)
        v_splats = arguments.splat_grads(grads, count, rest, add_shN=add_shN)
        cancel = settings.cancel
        raise_status(
            self._lib.gs_raster_backward(
                self.handle,
                ct.byref(arguments.splats(splats, settings)),
                ct.byref(v_image),
                ct.byref(v_splats),
                None if cancel is None else ct.byref(cancel.value),
            )
        )

    def image_loss(self, args: ct.Structure, v_image: Array | None) -> ct.Structure:
        """gs_image_loss; `v_image` [H, W, 3] receives the gradient; None: no gradient."""
        result = header.LossResultStruct()
        found = optional("v_image", v_image, (args.height, args.width, 3))
        raise_status(self._lib.gs_image_loss(self.handle, ct.byref(args), ct.byref(result), found))
        return result

    def stats(self) -> dict[str, float]:
        """gs_raster_stats: counts and milliseconds by name."""
        stats = header.StatsStruct()
        raise_status(self._lib.gs_raster_stats(self.handle, ct.byref(stats)))
        return {name: getattr(stats, name) for name, *_ in stats._fields_}

    def projected(self, count: int) -> dict[str, np.ndarray]:
        """gs_raster_projected: means2d, depths, conics, colors, opacities of `count` splats."""
        arrays = {
            "means2d": np.zeros((count, 2), np.float32),
            "depths": np.zeros(count, np.float32),
            "conics": np.zeros((count, 3), np.float32),
            "colors": np.zeros((count, 3), np.float32),
            "opacities": np.zeros(count, np.float32),
        }
        found = [address(name, a, a.shape) for name, a in arrays.items()]
        raise_status(self._lib.gs_raster_projected(self.handle, *found))
        return arrays


class RasterPool:
    """Lends workspaces to reuse their buffers between calls.

    It has no lock, because destructors return workspaces too, and the garbage collector may run
    them at any point, also inside `take`. The ends of a deque are thread-safe.
    """

    def __init__(self) -> None:
        # The oldest are dropped, to release memory after a graph that used many.
        self._free: deque[Raster] = deque(maxlen=8)

    def take(self) -> Raster:
        """Take an unused workspace; return it with `release`."""
        try:
            return self._free.pop()
        except IndexError:
            return Raster()

    def release(self, raster: Raster) -> None:
        """Return a workspace."""
        self._free.append(raster)

    @contextmanager
    def lend(self) -> Iterator[Raster]:
        """A workspace for the duration of a block."""
        raster = self.take()
        try:
            yield raster
        finally:
            self.release(raster)


pool = RasterPool()


def blur_image(args: ct.Structure, blurred: Array) -> None:
    """gs_blur_image; `blurred` [H, W, 3] receives the result."""
    found = address("blurred", blurred, (args.height, args.width, 3))
    raise_status(library().gs_blur_image(ct.byref(args), found))


def philox(counter: np.ndarray, key: np.ndarray) -> np.ndarray:
    """gs_philox: [4] uint32 of `counter` [4] and `key` [2], uint32."""
    words = np.empty(4, np.uint32)
    found = [
        address(name, a, shape, UINT32)
        for name, a, shape in (
            ("counter", counter, (4,)),
            ("key", key, (2,)),
            ("words", words, (4,)),
        )
    ]
    raise_status(library().gs_philox(*found))
    return words
