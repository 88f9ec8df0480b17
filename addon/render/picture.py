"""Picture of a model from one camera, rendered in its own thread so that it can be cancelled."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..cameras.render_camera import RenderCamera
from ..core import CancelFlag, Rendered, render
from ..process.background_task import Cancelled as TaskCancelled
from ..process.incremental_tasks import Check
from .device import RenderDevice
from .model import Model

Window = tuple[int, int, int, int]
"""Left, top, width and height of a part of a picture, pixels."""
AUTO, ON, OFF = "AUTO", "ON", "OFF"
POLL = 0.02
"""Seconds between two calls of `stop`."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of a picture."""

    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """sRGB values, as the splats' own."""
    depths: bool = False
    """Whether to render depths too."""
    normals: bool = False
    """Whether to render normals too."""
    median_splats: bool = False
    """Whether to render median splats too."""
    antialias: str = AUTO
    """ON, OFF, or AUTO: as the objects were trained."""
    window: Window | None = None
    """The part to draw; None: everything."""
    device: RenderDevice | None = None
    """Device that draws; None: the CPU."""


def compensates(setting: str, *, trained: tuple[str, ...], plain: tuple[str, ...]) -> bool:
    """Whether opacities of small splats are compensated (antialias).

    Args:
        setting: ON, OFF or AUTO.
        trained: Names of the objects that were trained with anti-aliasing.
        plain: Names of the others.

    Raises:
        ValueError: AUTO, and the objects were trained differently.
    """
    if setting != AUTO:
        return setting == ON
    if trained and plain:
        raise ValueError(
            f"{trained[0]} was trained with anti-aliasing and {plain[0]} without, "
            f"but a picture uses one setting: set Anti-Aliasing in the render settings to On or "
            f"Off, or render them in two scenes."
        )
    return bool(trained)


def draw(
    model: Model,
    camera: RenderCamera,
    options: Options,
    *,
    far_depths: np.ndarray | None = None,
    stop: Callable[[], bool] = lambda: False,
    cancel: CancelFlag | None = None,
) -> Rendered:
    """Rasterize a model.

    Args:
        model: The splats.
        camera: The camera.
        options: The options.
        far_depths: [H, W] float32, z behind which a pixel shows no splat; NaN: it shows all.
        stop: Called every `POLL` seconds on the calling thread; True cancels.
        cancel: Flag to cancel from another thread.

    Raises:
        Cancelled: `stop` returned True, or `cancel` was set.
        GsError: the library is missing or out of memory.
        ValueError: the objects were trained with and without anti-aliasing.
    """
    antialias = compensates(options.antialias, trained=model.antialias, plain=model.plain)
    flag = CancelFlag() if cancel is None else cancel
    drawn_by = partial(render, device="cpu") if options.device is None else options.device.render
    done: list[Rendered | BaseException] = []

    def work() -> None:
        try:
            done.append(
                drawn_by(
                    model.splats,
                    camera.K,
                    # A similarity in the view matrix keeps the picture exact, colours too, because
                    # they depend on directions in the splats' own space.
                    camera.viewmat @ model.matrix,
                    camera.width,
                    camera.height,
                    background=options.background,
                    near=camera.near,
                    antialias=antialias,
                    depths=options.depths,
                    normals=options.normals,
                    median_splats=options.median_splats,
                    orthographic=camera.orthographic,
                    window=options.window,
                    far_depths=far_depths,
                    cancel=flag,
                )
            )
        except BaseException as error:
            done.append(error)

    thread = threading.Thread(target=work, name="gscore picture", daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(POLL)
        if stop():
            flag.set()
    if isinstance(done[0], BaseException):
        raise done[0]
    return done[0]


def stopped(check: Check) -> Callable[[], bool]:
    """A function for `stop` from the cancellation point of a task."""

    def stop() -> bool:
        try:
            check()
        except TaskCancelled:
            return True
        return False

    return stop


def crop(array: np.ndarray, left: int, bottom: int, width: int, height: int) -> np.ndarray:
    """A contiguous window of [H, W, ...], whose first row is the bottom one."""
    return np.ascontiguousarray(array[bottom : bottom + height, left : left + width])
