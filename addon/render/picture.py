"""Picture of a model from one camera, rendered in its own thread so that it can be cancelled."""

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..cameras.render_camera import RenderCamera
from ..core import CancelFlag, Rendered, render
from .model import Model

Window = tuple[int, int, int, int]
"""Left, top, width and height of a part of a picture, pixels."""
AUTO, ON, OFF = "AUTO", "ON", "OFF"
POLL = 0.02
"""Seconds between two questions whether to stop."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """How to draw."""

    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """sRGB values, as the splats' own."""
    depths: bool = False
    """Make depths too."""
    antialias: str = AUTO
    """ON, OFF, or AUTO: as the objects were trained."""
    window: Window | None = None
    """The part that is drawn; None: everything."""


def compensates(wish: str, *, trained: tuple[str, ...], plain: tuple[str, ...]) -> bool:
    """Whether opacities are compensated.

    Args:
        wish: ON, OFF or AUTO.
        trained: Names of the objects that were trained with anti-aliasing.
        plain: Names of the others.

    Raises:
        ValueError: AUTO, and the objects were trained differently.
    """
    if wish != AUTO:
        return wish == ON
    if trained and plain:
        raise ValueError(
            f"{trained[0]} was trained with anti-aliasing and {plain[0]} without, "
            f"but a picture is drawn one way: set Anti-Aliasing of the render settings to On or "
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
    """Rasterize.

    Args:
        model: What to draw.
        camera: From where.
        options: How.
        far_depths: [H, W] float32, z behind which a pixel shows no splat; NaN: it shows all.
        stop: Asked every `POLL` seconds on the calling thread.
        cancel: Another way to stop, from another thread.

    Raises:
        Cancelled: `stop` said so, or `cancel` was set.
        GsError: the library is missing or out of memory.
        ValueError: the objects want to be drawn in different ways.
    """
    antialias = compensates(options.antialias, trained=model.antialias, plain=model.plain)
    flag = CancelFlag() if cancel is None else cancel
    done: list[Rendered | BaseException] = []

    def work() -> None:
        try:
            done.append(
                render(
                    model.splats,
                    camera.K,
                    # A similarity in front of the camera leaves the picture exact, colours too:
                    # they depend on directions in the splats' own space.
                    camera.viewmat @ model.matrix,
                    camera.width,
                    camera.height,
                    background=options.background,
                    near=camera.near,
                    antialias=antialias,
                    depths=options.depths,
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


def crop(array: np.ndarray, left: int, bottom: int, width: int, height: int) -> np.ndarray:
    """A window of [H, W, ...], whose first row is the bottom one, contiguous."""
    return np.ascontiguousarray(array[bottom : bottom + height, left : left + width])
