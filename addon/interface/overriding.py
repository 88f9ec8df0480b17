"""Operators that are called beside a click: in which window and scene they act."""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy


@contextmanager
def acting_in(scene: bpy.types.Scene | None = None) -> Iterator[bool]:
    """Operators called within have a window, and act on a scene; yields whether they have one.

    Nothing is overridden that is so already. With Python 3.11, which Blender has up to 5.0, an
    operator looks up what was overridden without holding Python's lock: Blender crashes now and
    then where a thread runs meanwhile.

    Args:
        scene: None: that of the window.
    """
    context = bpy.context
    windows = list(context.window_manager.windows)
    if scene is None or context.scene == scene:
        if context.window is not None:
            yield True
        elif windows:
            with context.temp_override(window=windows[0]):
                yield True
        else:
            yield False
        return
    shown = [window for window in windows if window.scene == scene]
    place = {"window": shown[0]} if shown else {"scene": scene}
    with context.temp_override(**place, view_layer=scene.view_layers[0]):
        yield True
