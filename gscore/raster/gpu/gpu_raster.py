"""GPU raster: an open device that draws splats, with the interface of the native workspace."""

import atexit
import ctypes as ct
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from weakref import WeakSet

import numpy as np

from ...errors import BackendError
from .. import arguments
from ..buffers import UINT32, Array, address
from ..header import DEPTH_OUTPUTS, OK
from ..request import Frustum, Settings
from . import header
from .devices import Device
from .library import DeviceLostError, DeviceMemoryError, DeviceTimeoutError, library, raise_status

_pointer = ct.c_void_p


@dataclass(frozen=True)
class _Uploaded:
    """Splats on the device."""

    handle: ct.c_void_p
    arrays: tuple[Array, ...]
    """The arrays they were copied from: while these live, no other array has their addresses."""


class GpuRaster:
    """An open device; close it, or use it in a `with`. Threads take turns.

    A forked process must open its own.
    """

    def __init__(self, number: int) -> None:
        """Open a device and compile its pipelines, which takes up to a minute the first time.

        Args:
            number: Number of the device, as `find_devices` lists it.

        Raises:
            BackendError: there is no such device, or it lacks something or fails.
        """
        self.handle = _pointer()
        self._lock = threading.RLock()
        self._process = os.getpid()
        self._kept: dict[tuple[Any, ...], _Uploaded] = {}
        self._last: _Uploaded | None = None
        self._drawn: tuple[Any, ...] = ()
        """Splats, settings and view of the last `forward`; empty: none, or something else since."""
        self.content: WeakSet[Any] = WeakSet()
        """Rows and photos on the device, which are closed with it."""
        self.wait_for_steps: Callable[[], None] = lambda: None
        """Waits for steps in flight."""
        self.make_room: Callable[[], bool] = lambda: False
        """Frees memory that calls can do without; returns whether there was any."""
        self.uploads = 0
        """Number of copies of splats to the device so far."""
        self._lib = self.library = library()
        raise_status(self._lib.gs_gpu_open(number, ct.byref(self.handle)))

    def __enter__(self) -> "GpuRaster":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        if getattr(self, "_lib", None) is not None:
            self.close()

    def close(self) -> None:
        """Free all memory and the device; twice does no harm."""
        for one in list(self.content):
            one.close()
        handle, self.handle = self.handle, _pointer()
        if not handle or self._process != os.getpid():  # those of a parent process are not ours
            return
        for one in (*self._kept.values(), *([self._last] if self._last else [])):
            self._lib.gs_gpu_release(one.handle)
        self._kept, self._last = {}, None
        self._lib.gs_gpu_close(handle)

    @contextmanager
    def lend(self) -> Iterator["GpuRaster"]:
        """The device for several calls of this thread in a row, such as `forward` and `stats`."""
        with self._lock:
            yield self

    def keep(self, splats: Sequence[Array], settings: Settings) -> None:
        """Copy splats to the device once, for all following `forward` calls with these arrays.

        The arrays must not change until `release`. Nothing happens if they are kept already.

        Raises:
            As `forward`.
        """
        with self._lock:
            key = _key(splats, settings)
            if key not in self._kept:
                self._kept[key] = self._upload(splats, settings)

    def release(self, splats: Sequence[Array], settings: Settings) -> None:
        """Free the memory of kept splats."""
        with self._lock:
            if found := self._kept.pop(_key(splats, settings), None):
                self._lib.gs_gpu_release(found.handle)

    def release_all(self) -> None:
        """Free the memory of all kept splats."""
        with self._lock:
            self._make_room()

    def forward(
        self,
        splats: Sequence[Array],
        view: Frustum,
        settings: Settings,
        pictures: Mapping[str, Array],
    ) -> None:
        """gs_gpu_draw.

        Args:
            splats: `PARAMETERS`, in their order; copied to the device unless they are kept. Other
                kept splats are released if memory is short.
            view: Camera and picture size.
            settings: Render settings; `threads` and `disable` have no effect.
            pictures: Output arrays, by the names of gs_image.

        Raises:
            DeviceLostError: the driver gave the device up; open it again.
            DeviceTimeoutError: the device did not finish in time; open it again.
            DeviceMemoryError: the device has too little memory.
            ShapeError: an array or a setting is invalid.
            Cancelled: `settings.cancel` was set.
        """
        image = arguments.image(pictures, view, settings.outputs, len(splats[0]))
        degree = arguments.evaluated_degree(splats[5], settings)
        camera = arguments.view(view, settings, degree)
        host = arguments.host(view, settings)
        with self._lock:
            self._drawn = ()
            drawn = self._on_device(splats, settings)
            given = drawn.handle, ct.byref(camera), ct.byref(host), ct.byref(image)
            try:
                self._check(self._lib.gs_gpu_draw(self._open(), *given))
            except DeviceMemoryError:
                if not self._make_room(besides=drawn):
                    raise
                self._check(self._lib.gs_gpu_draw(self._open(), *given))
            self._drawn = _key(splats, settings), view, settings

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
        """gs_gpu_backward of a `forward` whose settings had the output `header.GRADIENTS`. It is
        drawn again if it was not the last one.

        Args:
            splats: As in that call.
            view: As in that call.
            settings: As in that call.
            v_pictures: Gradients of a loss by picture: `rgb`, `alpha`, `inverse_depth`,
                `depth` (undivided); None: 0.
            grads: Output arrays by parameter, and optionally `means2d` [N, 2], `viewmat` [4, 4].
            add_shN: True: add to `shN`.
        """
        v_image = arguments.image_grads(v_pictures, view, settings.outputs)
        count, rest = len(splats[0]), splats[5].shape[1]
        out = arguments.splat_grads(grads, count, rest, add_shN=add_shN)
        with self._lock:
            if not self._was_drawn(splats, view, settings):
                self.forward(splats, view, settings, _unused_pictures(view, settings))
            drawn = self._kept.get(_key(splats, settings)) or self._last
            handle = drawn.handle if drawn else None
            found = ct.byref(v_image), ct.byref(out)
            self._check(self._lib.gs_gpu_backward(self._open(), handle, *found))

    def _was_drawn(self, splats: Sequence[Array], view: Frustum, settings: Settings) -> bool:
        """Whether the last drawing was a `forward` with these arguments."""
        if not self._drawn:
            return False
        key, last_view, last_settings = self._drawn
        return key == _key(splats, settings) and last_view is view and last_settings is settings

    def weights(
        self, splats: Sequence[Array], settings: Settings, shares: Array, view: Frustum
    ) -> np.ndarray:
        """gs_gpu_weights of the last `forward`.

        Args:
            splats: As in that call.
            settings: As in that call.
            shares: [H, W, 3] float32, pixel weights of three sums.
            view: As in that call.

        Returns:
            [N, 3] float32, blending weights summed over pixels, px.
        """
        sums = np.zeros((len(splats[0]), 3), np.float32)
        found = address("shares", shares, (view.height, view.width, 3))
        with self._lock:
            drawn = self._kept.get(_key(splats, settings)) or self._last
            handle = drawn.handle if drawn else None
            status = self._lib.gs_gpu_weights(self._open(), handle, found, sums.ctypes.data)
            self._check(status)
        return sums

    def stats(self) -> dict[str, float]:
        """gs_gpu_draw_stats: counts, bytes and milliseconds by name."""
        stats = header.GpuStatsStruct()
        with self._lock:
            self._check(self._lib.gs_gpu_draw_stats(self._open(), ct.byref(stats)))
        return {name: getattr(stats, name) for name, *_ in stats._fields_}

    def profile(self, on: bool) -> None:
        """gs_gpu_profile: start or stop measuring each kernel, from zero."""
        with self._lock:
            self._check(self._lib.gs_gpu_profile(self._open(), on))

    def kernel_times(self) -> dict[str, tuple[float, int]]:
        """Milliseconds and calls of each kernel since `profile`, by its name."""
        found: dict[str, tuple[float, int]] = {}
        name, time, calls = ct.c_char_p(), ct.c_double(), ct.c_int64()
        values = ct.byref(name), ct.byref(time), ct.byref(calls)
        with self._lock:
            handle = self._open()
            while self._lib.gs_gpu_kernel_time(handle, len(found), *values) == OK:
                found[(name.value or b"").decode()] = time.value, calls.value
        return found

    def projected(self, count: int) -> dict[str, np.ndarray]:
        """gs_gpu_projected: means2d, depths, conics, colors, opacities of `count` splats."""
        widths = {"means2d": (2,), "depths": (), "conics": (3,), "colors": (3,), "opacities": ()}
        arrays = {name: np.zeros((count, *wide), np.float32) for name, wide in widths.items()}
        found = [address(name, a, a.shape) for name, a in arrays.items()]
        with self._lock:
            self._check(self._lib.gs_gpu_projected(self._open(), *found))
        return arrays

    def loss(
        self,
        args: ct.Structure,
        terms: ct.Structure,
        v_image: int | None,
        v_alpha: int | None,
    ) -> Any:
        """gs_gpu_loss: its result; the gradients are addresses of arrays or None, see
        `gpu_loss.gpu_image_loss`."""
        result = header.GpuLossResultStruct()
        given = ct.byref(args), ct.byref(terms), ct.byref(result), v_image, v_alpha
        with self._lock:
            self._check(self._lib.gs_gpu_loss(self._open(), *given))
        return result

    def test(self, kernel: int, a: np.ndarray, b: np.ndarray | None = None) -> np.ndarray:
        """gs_gpu_test: the words that a kernel of the self-test makes of `a` and `b`, [N] uint32.

        Args:
            kernel: One of `header.TEST_*`.
            a: [N], uint32 or float32.
            b: [N], of the same type; None: not used by this kernel.
        """
        first = a.view(np.uint32)
        second = first if b is None else b.view(np.uint32)
        out = np.zeros(len(a), np.uint32)
        named = (("a", first), ("b", second), ("out", out))
        found = [address(name, words, a.shape, UINT32) for name, words in named]
        with self._lock:
            self._check(self._lib.gs_gpu_test(self._open(), kernel, *found, len(a)))
        return out

    def memory(self) -> tuple[int, int]:
        """Most bytes of memory in use so far, and those that it may take: GSCORE_GPU_MEMORY, or
        what was free when it was opened."""
        found = header.GpuMemoryStruct()
        with self._lock:
            self._check(self._lib.gs_gpu_memory_use(self._open(), ct.byref(found)))
        return found.peak, found.limit

    @property
    def usable(self) -> bool:
        """Whether the device is open and of this process."""
        return bool(self.handle) and self._process == os.getpid()

    def call(
        self,
        function: Callable[..., int],
        *values: Any,
        handle: ct.c_void_p | None = None,
        waits: bool = True,
    ) -> None:
        """Call a function of the library, whose first argument is the device or `handle`.

        `waits`: wait for steps in flight first, and make room if memory is short.

        Raises:
            As `forward`.
        """
        with self._lock:
            device = self._open()
            self._drawn = ()
            if waits:
                self.wait_for_steps()
            first = device if handle is None else handle
            try:
                self._check(function(first, *values))
            except DeviceMemoryError:
                if not waits or not self.make_room():
                    raise
                self._check(function(first, *values))

    def _open(self) -> ct.c_void_p:
        """The handle; BackendError after `close` and in a forked process."""
        if self._process != os.getpid():
            raise BackendError("A forked process must open the graphics card itself.")
        if not self.handle:
            raise BackendError("The graphics card is closed; open it again.")
        return self.handle

    def _on_device(self, splats: Sequence[Array], settings: Settings) -> _Uploaded:
        """Kept splats, or a copy of these that lives until the next call."""
        if found := self._kept.get(_key(splats, settings)):
            return found
        if self._last:
            self._lib.gs_gpu_release(self._last.handle)
            self._last = None
        self._last = self._upload(splats, settings)
        return self._last

    def _upload(self, splats: Sequence[Array], settings: Settings) -> _Uploaded:
        """Copy splats; kept ones make room if memory is short."""
        handle, content = _pointer(), arguments.splats(splats, settings)
        device = self._open()
        try:
            self._check(self._lib.gs_gpu_upload(device, ct.byref(content), ct.byref(handle)))
        except DeviceMemoryError:
            if not self._make_room():
                raise
            self._check(self._lib.gs_gpu_upload(device, ct.byref(content), ct.byref(handle)))
        self.uploads += 1
        return _Uploaded(handle, tuple(splats))

    def _make_room(self, besides: _Uploaded | None = None) -> bool:
        """Release kept splats; returns whether there were any."""
        others = [key for key, one in self._kept.items() if one is not besides]
        for key in others:
            self._lib.gs_gpu_release(self._kept.pop(key).handle)
        return bool(others)

    def _check(self, status: int) -> None:
        """Raise the exception for a status; a lost device is closed."""
        if status == OK:
            return
        try:
            raise_status(status)
        except (DeviceLostError, DeviceTimeoutError):
            self.close()
            raise


def _unused_pictures(view: Frustum, settings: Settings) -> dict[str, Array]:
    """Arrays for the pictures of a drawing of which only gradients are needed."""
    size = view.height, view.width
    found = {"rgb": np.empty((*size, 3), np.float32), "alpha": np.empty(size, np.float32)}
    requested = (n for n, bit in DEPTH_OUTPUTS.items() if settings.outputs & bit)
    return found | {name: np.empty(size, np.float32) for name in requested}


def _key(splats: Sequence[Array], settings: Settings) -> tuple[Any, ...]:
    """Identity of arrays: while they live, their addresses are unique."""
    addresses = (address("splats", a, tuple(a.shape)) if a.shape[0] else 0 for a in splats)
    return (settings.raw, *addresses, *(tuple(a.shape) for a in splats))


_open_devices: dict[str, GpuRaster] = {}
"""Open devices of this process by UUID."""
_opening = threading.Lock()


def opened(device: Device) -> GpuRaster:
    """The device, opened once a process; a lost one is opened again.

    Raises:
        BackendError: it cannot be opened.
    """
    with _opening:
        raster = _open_devices.get(device.uuid)
        if raster is None or not raster.handle:
            raster = _open_devices[device.uuid] = GpuRaster(device.number)
        return raster


def close_all() -> None:
    """Free the memory of all devices that `opened` has opened."""
    with _opening:
        while _open_devices:
            _open_devices.popitem()[1].close()


atexit.register(close_all)  # while the driver's own threads still run


def _forget() -> None:
    """Drop the devices of the parent process."""
    global _opening
    _opening = threading.Lock()
    _open_devices.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
