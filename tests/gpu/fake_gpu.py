"""A library for graphics cards that draws nothing: it counts calls and answers with statuses."""

from typing import Any

from gscore.raster.gpu import header

NVIDIA, AMD = 0x10DE, 0x1002


def card(**facts: Any) -> dict[str, Any]:
    """Facts of a device, by the fields of gs_gpu_info; a discrete card unless others are given."""
    usual = {
        "name": b"Card",
        "driver": b"driver 1.0",
        "uuid": bytes(range(16)),
        "vendor": NVIDIA,
        "device": 0x2204,
        "driver_version": 7,
        "api_version": 1 << 22 | 3 << 12 | 230,
        "kind": header.KINDS.index("discrete"),
        "subgroup": 32,
        "shared_memory": 49152,
        "workgroup": 1024,
        "memory": 24_000_000_000,
        "memory_free": 20_000_000_000,
        "largest_buffer": 4_000_000_000,
    }
    return usual | facts


SOFTWARE = {"name": b"llvmpipe", "kind": header.KINDS.index("software"), "vendor": 0x10005}


class FakeGpu:
    """The functions of csrc/include/gscore_gpu.h."""

    def __init__(self, *cards: dict[str, Any], message: str = "") -> None:
        self.cards = cards
        self.message = message
        self.calls: list[str] = []
        """Names of the functions that were called, in order."""
        self.statuses: dict[str, list[int]] = {}
        """Statuses of the next calls by function; 0 where there are none."""

    def gs_gpu_last_error(self) -> bytes:
        return self.message.encode()

    def gs_gpu_devices(self, out: Any, capacity: int, count: Any) -> int:
        count._obj.value = len(self.cards)
        for i, one in enumerate(self.cards[:capacity]):
            for name, value in one.items():
                field = (header.GpuInfoStruct * 0)._type_.__dict__[name]
                if name == "uuid":
                    value = type(out[i].uuid)(*value)
                field.__set__(out[i], value)
        return 0 if self.cards else header.UNSUPPORTED

    def gs_gpu_open(self, number: int, handle: Any) -> int:
        handle._obj.value = 1000 + number
        return self._called("open")

    def gs_gpu_upload(self, gpu: Any, splats: Any, handle: Any) -> int:
        handle._obj.value = 2000 + len(self.calls)
        return self._called("upload")

    def gs_gpu_draw(self, gpu: Any, splats: Any, view: Any, host: Any, image: Any) -> int:
        return self._called("draw")

    def gs_gpu_backward(self, gpu: Any, splats: Any, v_image: Any, grads: Any) -> int:
        return self._called("backward")

    def gs_gpu_draw_stats(self, gpu: Any, stats: Any) -> int:
        stats._obj.visible = 3
        return 0

    def gs_gpu_release(self, splats: Any) -> None:
        self._called("release")

    def gs_gpu_close(self, gpu: Any) -> None:
        self._called("close")

    def _called(self, name: str) -> int:
        self.calls.append(name)
        statuses = self.statuses.get(name, [])
        return statuses.pop(0) if statuses else 0
