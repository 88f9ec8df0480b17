"""The only file that loads the native library: its C structs, its errors, its workspaces.

`csrc/include/gscore.h` is the manual of everything declared here. Callers check arrays for dtype,
shape and layout; values are the library's matter.
"""

import ctypes as ct
import os
import sys
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ..errors import BackendError, Cancelled, ShapeError

ABI_VERSION = 3

OUT_INVERSE_DEPTH, OUT_DEPTH, OUT_MEDIAN_DEPTH, COUNT_USEFUL = 1, 2, 4, 8
NO_EXACT_CULL, NO_ZERO_TILE, NO_OPACITY_EXTENT, NO_ROW_RANGE = 1, 2, 4, 8
TILE = 16
"""Side of the tiles of `tiles`, px (GS_TILE)."""
LIST_TILE = 16, 32
"""Width and height of the tiles by which splats are listed, px (GS_LIST_TILE_*)."""
MAX_SIDE = 65536
ADAM_ALL, ADAM_SEEN, ADAM_WAIT = 0, 1, 2
ADAM_LAGS = 256
MASK_MODES = {"none": 0, "composite": 1, "ignore": 2}

_OK, _BAD_ARGUMENT, _OUT_OF_MEMORY, _CANCELLED = 0, 1, 2, 3

_pointer = ct.c_void_p


class SplatsStruct(ct.Structure):
    """gs_splats"""

    _fields_ = (
        ("count", ct.c_int64),
        ("means", _pointer),
        ("quats", _pointer),
        ("scales", _pointer),
        ("opacities", _pointer),
        ("sh0", _pointer),
        ("shN", _pointer),
        ("sh_rest", ct.c_int32),
        ("sh_degree", ct.c_int32),
        ("raw", ct.c_int32),
    )


class CameraStruct(ct.Structure):
    """gs_camera"""

    _fields_ = (
        ("viewmat", ct.c_float * 16),
        ("fx", ct.c_float),
        ("fy", ct.c_float),
        ("cx", ct.c_float),
        ("cy", ct.c_float),
        ("width", ct.c_int32),
        ("height", ct.c_int32),
        ("near_plane", ct.c_float),
        ("far_plane", ct.c_float),
        ("orthographic", ct.c_int32),
    )


class OptionsStruct(ct.Structure):
    """gs_options"""

    _fields_ = (
        ("eps2d", ct.c_float),
        ("antialias", ct.c_int32),
        ("background", ct.c_float * 3),
        ("outputs", ct.c_uint32),
        ("disable", ct.c_uint32),
        ("threads", ct.c_int32),
        ("cancel", ct.POINTER(ct.c_int32)),
        ("tiles", _pointer),
    )


class ImageStruct(ct.Structure):
    """gs_image"""

    _fields_ = (
        ("rgb", _pointer),
        ("alpha", _pointer),
        ("inverse_depth", _pointer),
        ("depth", _pointer),
        ("median_depth", _pointer),
        ("radii", _pointer),
    )


class ImageGradsStruct(ct.Structure):
    """gs_image_grads"""

    _fields_ = (
        ("rgb", _pointer),
        ("alpha", _pointer),
        ("inverse_depth", _pointer),
        ("depth", _pointer),
    )


class SplatGradsStruct(ct.Structure):
    """gs_splat_grads"""

    _fields_ = (
        ("means", _pointer),
        ("quats", _pointer),
        ("scales", _pointer),
        ("opacities", _pointer),
        ("sh0", _pointer),
        ("shN", _pointer),
        ("means2d", _pointer),
        ("viewmat", _pointer),
        ("add_shN", ct.c_int32),
    )


class StatsStruct(ct.Structure):
    """gs_stats"""

    _fields_ = (
        ("visible", ct.c_int64),
        ("entries", ct.c_int64),
        ("forward_pairs", ct.c_int64),
        ("useful_pairs", ct.c_int64),
        ("backward_pairs", ct.c_int64),
        ("project_ms", ct.c_double),
        ("sort_ms", ct.c_double),
        ("bin_ms", ct.c_double),
        ("blend_ms", ct.c_double),
        ("blend_backward_ms", ct.c_double),
        ("project_backward_ms", ct.c_double),
        ("workspace_bytes", ct.c_int64),
    )

    def as_dict(self) -> dict[str, float]:
        """Names and values."""
        return {field[0]: getattr(self, field[0]) for field in self._fields_}


class LossArgsStruct(ct.Structure):
    """gs_loss_args"""

    _fields_ = (
        ("width", ct.c_int32),
        ("height", ct.c_int32),
        ("image", _pointer),
        ("target", _pointer),
        ("mask", _pointer),
        ("mask_mode", ct.c_int32),
        ("background", ct.c_float * 3),
        ("ssim_weight", ct.c_float),
        ("threads", ct.c_int32),
    )


class LossResultStruct(ct.Structure):
    """gs_loss_result"""

    _fields_ = (
        ("loss", ct.c_double),
        ("l1", ct.c_double),
        ("ssim", ct.c_double),
        ("mse", ct.c_double),
    )


class AdamTensorStruct(ct.Structure):
    """gs_adam_tensor"""

    _fields_ = (
        ("param", _pointer),
        ("grad", _pointer),
        ("moment1", _pointer),
        ("moment2", _pointer),
        ("width", ct.c_int32),
        ("mode", ct.c_int32),
        ("lr", ct.c_float),
        ("step", ct.c_int64),
        ("seen", _pointer),
        ("lag", _pointer),
        ("drift", _pointer),
    )


class AdamStruct(ct.Structure):
    """gs_adam"""

    _fields_ = (
        ("count", ct.c_int64),
        ("tensor_count", ct.c_int32),
        ("tensors", ct.POINTER(AdamTensorStruct)),
        ("radii", _pointer),
        ("threads", ct.c_int32),
    )


def library_path() -> Path:
    """Where the native library is looked for: GSCORE_LIBRARY, else beside this file."""
    override = os.environ.get("GSCORE_LIBRARY")
    if override:
        return Path(override)
    name = {"win32": "gscore.dll", "darwin": "libgscore.dylib"}.get(sys.platform, "libgscore.so")
    return Path(__file__).with_name(name)


def _load() -> ct.CDLL:
    path = library_path()
    if not path.exists():
        raise BackendError(
            f"The native library is missing: {path} does not exist. "
            "Install gscore as a wheel for this platform, or build it with `pip install .`."
        )
    try:
        lib = ct.CDLL(str(path))
    except OSError as error:
        raise BackendError(f"The native library {path} does not load: {error}.") from error
    lib.gs_abi_version.restype = ct.c_int32
    version = lib.gs_abi_version()
    if version != ABI_VERSION:
        raise BackendError(
            f"The native library {path} has interface version {version}, this gscore needs "
            f"{ABI_VERSION}. Reinstall gscore so that both come from one version."
        )
    try:
        _declare(lib)
    except AttributeError as error:  # a build from before a function was added
        raise BackendError(
            f"The native library {path} is another build than this gscore: {error}. "
            "Reinstall gscore so that both come from one version."
        ) from None
    return lib


def _declare(lib: ct.CDLL) -> None:
    """Tell ctypes what the functions take and give."""
    for name in ("gs_last_error", "gs_isas", "gs_isa"):
        getattr(lib, name).restype = ct.c_char_p
    lib.gs_default_threads.restype = ct.c_int32
    lib.gs_set_isa.argtypes = [ct.c_char_p]
    lib.gs_raster_create.argtypes = [ct.POINTER(_pointer)]
    lib.gs_raster_destroy.argtypes = [_pointer]
    lib.gs_raster_destroy.restype = None
    lib.gs_raster_forward.argtypes = [
        _pointer,
        ct.POINTER(SplatsStruct),
        ct.POINTER(CameraStruct),
        ct.POINTER(OptionsStruct),
        ct.POINTER(ImageStruct),
    ]
    lib.gs_raster_backward.argtypes = [
        _pointer,
        ct.POINTER(SplatsStruct),
        ct.POINTER(ImageGradsStruct),
        ct.POINTER(SplatGradsStruct),
        ct.POINTER(ct.c_int32),
    ]
    lib.gs_raster_stats.argtypes = [_pointer, ct.POINTER(StatsStruct)]
    lib.gs_raster_projected.argtypes = [_pointer] * 6
    lib.gs_exp2.argtypes = [_pointer, _pointer, ct.c_int64]
    lib.gs_image_loss.argtypes = [
        _pointer,
        ct.POINTER(LossArgsStruct),
        ct.POINTER(LossResultStruct),
        _pointer,
    ]
    lib.gs_add_pull.argtypes = [
        ct.c_int64,
        *[_pointer] * 4,
        ct.c_float,
        ct.c_float,
        ct.c_int32,
    ]
    lib.gs_adam_step.argtypes = [ct.POINTER(AdamStruct), ct.POINTER(ct.c_int64)]
    lib.gs_adam_catch_up.argtypes = [
        ct.POINTER(AdamTensorStruct),
        ct.POINTER(SplatsStruct),
        ct.POINTER(CameraStruct),
        ct.c_float,
        _pointer,
        ct.c_int32,
    ]


_lock = threading.Lock()
_library: ct.CDLL | None = None


def library() -> ct.CDLL:
    """The loaded library. Raises BackendError if it is missing or of another version."""
    global _library
    with _lock:
        if _library is None:
            _library = _load()
        return _library


def check(status: int) -> None:
    """Raise the error that belongs to a gs_status."""
    if status == _OK:
        return
    message = library().gs_last_error().decode("utf-8", "replace")
    if status == _CANCELLED:
        raise Cancelled("Rendering was cancelled.")
    if status == _OUT_OF_MEMORY:
        raise BackendError(
            f"{message}. Use a smaller image (-r), fewer splats (--max-splats), or close programs."
        )
    if status == _BAD_ARGUMENT:
        raise ShapeError(f"{message}.")
    raise BackendError(f"{message}.")


def available_isas() -> list[str]:
    """Instruction sets that run here, best first."""
    return library().gs_isas().decode().split(",")


def isa() -> str:
    """The instruction set in use."""
    return library().gs_isa().decode()


def set_isa(name: str) -> None:
    """Use another instruction set from now on. Raises BackendError if it is not available."""
    check(library().gs_set_isa(name.encode()))


def default_threads() -> int:
    """Threads used where none are asked for."""
    return library().gs_default_threads()


def exp2(x: np.ndarray) -> np.ndarray:
    """gs_exp2: 2^x of C-contiguous float32 values in [-126, 127], as the blend loops compute it."""
    y = np.empty_like(x)
    check(library().gs_exp2(x.ctypes.data, y.ctypes.data, x.size))
    return y


class Raster:
    """A native workspace. Use one at a time per thread; `pool` lends them."""

    def __init__(self) -> None:
        handle = _pointer()
        self._lib = library()
        check(self._lib.gs_raster_create(ct.byref(handle)))
        self.handle = handle

    def __del__(self) -> None:
        handle = getattr(self, "handle", None)
        if handle:
            self._lib.gs_raster_destroy(handle)

    def forward(
        self,
        splats: SplatsStruct,
        camera: CameraStruct,
        options: OptionsStruct,
        image: ImageStruct,
    ) -> None:
        """gs_raster_forward"""
        check(
            self._lib.gs_raster_forward(
                self.handle, ct.byref(splats), ct.byref(camera), ct.byref(options), ct.byref(image)
            )
        )

    def backward(
        self,
        splats: SplatsStruct,
        image_grads: ImageGradsStruct,
        grads: SplatGradsStruct,
        cancel: "CancelFlag | None" = None,
    ) -> None:
        """gs_raster_backward"""
        flag = None if cancel is None else ct.byref(cancel.value)
        arguments = (ct.byref(splats), ct.byref(image_grads), ct.byref(grads), flag)
        check(self._lib.gs_raster_backward(self.handle, *arguments))

    def image_loss(self, args: LossArgsStruct, v_image: int | None) -> LossResultStruct:
        """gs_image_loss; `v_image` is the address of the gradient or None."""
        result = LossResultStruct()
        check(
            self._lib.gs_image_loss(self.handle, ct.byref(args), ct.byref(result), v_image or None)
        )
        return result

    def stats(self) -> StatsStruct:
        """gs_raster_stats"""
        stats = StatsStruct()
        check(self._lib.gs_raster_stats(self.handle, ct.byref(stats)))
        return stats

    def projected(self, count: int) -> dict[str, np.ndarray]:
        """gs_raster_projected: means2d, depths, conics, colors, opacities of `count` splats."""
        arrays = {
            "means2d": np.zeros((count, 2), np.float32),
            "depths": np.zeros(count, np.float32),
            "conics": np.zeros((count, 3), np.float32),
            "colors": np.zeros((count, 3), np.float32),
            "opacities": np.zeros(count, np.float32),
        }
        pointers = [a.ctypes.data for a in arrays.values()]
        check(self._lib.gs_raster_projected(self.handle, *pointers))
        return arrays


class RasterPool:
    """Lends workspaces, so that their buffers are kept between calls.

    Without a lock: workspaces also come back from destructors, which the garbage collector may run
    at any point, inside `take` too. A deque's ends are safe to use from several threads.
    """

    def __init__(self) -> None:
        # The oldest are dropped: a graph that held many must not keep their memory for ever.
        self._free: deque[Raster] = deque(maxlen=8)

    def take(self) -> Raster:
        """A workspace nobody else uses; give it back."""
        try:
            return self._free.pop()
        except IndexError:
            return Raster()

    def give_back(self, raster: Raster) -> None:
        """Return a workspace taken before."""
        self._free.append(raster)

    @contextmanager
    def lend(self) -> Iterator[Raster]:
        """A workspace for the duration of a block."""
        raster = self.take()
        try:
            yield raster
        finally:
            self.give_back(raster)


pool = RasterPool()


def adam_step(
    tensors: Sequence[AdamTensorStruct], count: int, radii: int | None, threads: int
) -> int:
    """gs_adam_step: one step for `count` rows; `radii` is an address or None.

    Returns the number of rows with gradients that were not finite.
    """
    array = (AdamTensorStruct * len(tensors))(*tensors)
    args = AdamStruct(count, len(tensors), array, radii, threads)
    bad = ct.c_int64(0)
    check(library().gs_adam_step(ct.byref(args), ct.byref(bad)))
    return bad.value


def add_pull(
    count: int,
    v_means2d: int,
    radii: int,
    pull: int,
    seen: int,
    scale: tuple[float, float],
    threads: int,
) -> None:
    """gs_add_pull; arrays are addresses."""
    check(library().gs_add_pull(count, v_means2d, radii, pull, seen, *scale, threads))


def adam_catch_up(
    tensor: AdamTensorStruct,
    splats: SplatsStruct,
    camera: CameraStruct | None,
    *,
    eps2d: float,
    out: int | None,
    threads: int,
) -> None:
    """gs_adam_catch_up; `out` is an address or None."""
    view = None if camera is None else ct.byref(camera)
    check(
        library().gs_adam_catch_up(
            ct.byref(tensor), ct.byref(splats), view, eps2d, out or None, threads
        )
    )


def check_size(width: int, height: int) -> None:
    """Raise ShapeError for a picture the library would refuse, before memory is taken for it."""
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise ShapeError(f"The image must be 1 to {MAX_SIDE} px a side, got {width} x {height}.")


def camera_struct(
    viewmat: np.ndarray,
    K: np.ndarray,
    width: int,
    height: int,
    near: float,
    far: float,
    *,
    orthographic: bool = False,
) -> CameraStruct:
    """A gs_camera from [4, 4] and [3, 3] arrays; ShapeError where K has skew."""
    if viewmat.shape != (4, 4):
        raise ShapeError(f"viewmat must be [4, 4], got {list(viewmat.shape)}.")
    if K.shape != (3, 3):
        raise ShapeError(f"K must be [3, 3], got {list(K.shape)}.")
    if K[0, 1] != 0 or K[1, 0] != 0 or K[2, 0] != 0 or K[2, 1] != 0 or K[2, 2] != 1:
        raise ShapeError(
            "K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; skew is not supported, "
            f"got {K.tolist()}."
        )
    camera = CameraStruct(
        fx=K[0, 0], fy=K[1, 1], cx=K[0, 2], cy=K[1, 2], width=width, height=height
    )
    camera.viewmat = (ct.c_float * 16)(*np.asarray(viewmat, np.float32).ravel().tolist())
    camera.near_plane, camera.far_plane = near, far
    camera.orthographic = int(orthographic)
    return camera


class CancelFlag:
    """Stops a running call from another thread: pass it to the call, `set()` it to stop."""

    def __init__(self) -> None:
        self.value = ct.c_int32(0)

    def set(self) -> None:
        """The call it was passed to raises Cancelled soon, and so do later ones."""
        self.value.value = 1


def options_struct(
    *,
    eps2d: float,
    antialias: bool,
    background: tuple[float, float, float],
    outputs: int,
    threads: int,
    disable: int = 0,
    cancel: CancelFlag | None = None,
    tiles: int | None = None,
) -> OptionsStruct:
    """A gs_options; `cancel` and the array at the address `tiles` must outlive the call."""
    options = OptionsStruct(
        eps2d=eps2d, antialias=int(antialias), outputs=outputs, disable=disable, threads=threads
    )
    options.background = (ct.c_float * 3)(*background)
    if cancel is not None:
        options.cancel = ct.pointer(cancel.value)
    options.tiles = tiles
    return options
