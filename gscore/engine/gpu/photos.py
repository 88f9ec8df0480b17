"""Photos on a device: some stay there, the others are sent for each step."""

import ctypes as ct
from dataclasses import dataclass

from ...raster.gpu.gpu_raster import GpuRaster
from ...raster.gpu.library import DeviceMemoryError
from ..base import StepPhoto

_pointer = ct.c_void_p


@dataclass
class _Kept:
    """A photo that stays."""

    handle: ct.c_void_p
    nbytes: int
    size: tuple[int, ...]
    has_mask: bool
    version: int


class KeptPhotos:
    """Photos that stay on a device, the first ones that fit into `room`.

    None makes room for another: each photo is used once an epoch, so that the least recently used
    one is the next to be needed. All are dropped where one comes in another size, as all others
    will; one with another mask alone.
    """

    def __init__(self, raster: GpuRaster) -> None:
        """Keep nothing yet."""
        self.room = 0
        """Bytes for photos."""
        self._raster = raster
        self._kept: dict[int, _Kept] = {}
        raster.content.add(self)

    def __len__(self) -> int:
        return len(self._kept)

    def handle_of(self, key: int, photo: StepPhoto) -> tuple[ct.c_void_p | None, bool]:
        """The handle of a photo that stays, and whether the device has its content already; None:
        it does not stay."""
        found = self._kept.get(key)
        has_mask = photo.mask is not None
        if found and found.size != photo.image.shape:
            self.free()
        elif found and (found.has_mask, found.version) != (has_mask, photo.version):
            self._raster.wait_for_steps()
            self.forget(key)
        elif found:
            return found.handle, True
        nbytes = photo.image.nbytes + (0 if photo.mask is None else photo.mask.nbytes)
        used = sum(one.nbytes for one in self._kept.values())
        if used + nbytes > self.room:
            return None, False
        handle = _pointer()
        height, width = photo.image.shape[:2]
        create = self._raster.library.gs_gpu_photo_create
        try:
            self._raster.call(create, width, height, has_mask, ct.byref(handle), waits=False)
        except DeviceMemoryError:
            self.room = used
            return None, False
        self._kept[key] = _Kept(handle, nbytes, photo.image.shape, has_mask, photo.version)
        return handle, False

    def forget(self, key: int) -> None:
        """Free a photo that was not written after all."""
        if found := self._kept.pop(key, None):
            self._free(found)

    def free(self) -> None:
        """Free all photos, after the steps in flight."""
        if self._kept:
            self._raster.wait_for_steps()
        self.close()

    def make_room(self) -> bool:
        """Free all photos for good; returns whether there were any."""
        had_any = bool(self._kept)
        self.free()
        self.room = 0
        return had_any

    def close(self) -> None:
        """Free all photos; there are no steps in flight."""
        kept, self._kept = self._kept, {}
        for one in kept.values():
            self._free(one)

    def _free(self, one: _Kept) -> None:
        if self._raster.usable:
            with self._raster.lend():
                self._raster.library.gs_gpu_photo_free(one.handle)
