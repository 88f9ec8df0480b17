"""Straightened copies of photos in the background: which are wanted, and what happens when they
are there."""

import os
import sys
import time
from collections.abc import Iterable, Mapping
from importlib.util import find_spec
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ..interface import writable
from ..process import beat
from .backgrounds import copy_needed, file_of, known_images, set_photo
from .objects import is_camera, stated
from .straight_queue import StraightQueue
from .straightener import task_of

QUEUE = StraightQueue()
"""What this Blender has straightened."""
_PAUSE = 0.05
"""Seconds between two looks of a script that waits."""


def ask(cameras: Iterable[bpy.types.Object]) -> int:
    """Have the copies made that the backgrounds of cameras lack, the first camera's first; how many
    they are.

    Without a window nothing is begun until `wait` is called.
    """
    needed = []
    for ob in cameras:
        copy = copy_needed(ob)
        if copy is not None:
            _renew(ob)
            needed.append(task_of(stated(ob), copy))
    QUEUE.ask(needed)
    if needed:
        beat.ensure()
    return len(needed)


def wait() -> None:
    """Return when all copies that were asked for are there, or cannot be made."""
    while QUEUE.busy:
        collect()
        time.sleep(_PAUSE)


def problems_of(cameras: Iterable[bpy.types.Object]) -> list[str]:
    """Why the copies that cameras lack could not be made, sentences."""
    needed = (copy_needed(ob) for ob in cameras)
    told = (QUEUE.problems.get(str(copy)) for copy in needed if copy is not None)
    return [problem for problem in told if problem]


def collect() -> bool:
    """Take in what was made; whether panels have to be drawn anew."""
    if not QUEUE.busy:
        return False
    made = {Path(copy) for copy in QUEUE.poll(_program)}
    if made:
        for image in bpy.data.images:
            if image.source == "FILE" and file_of(image) in made:
                image.reload()
        _redraw_views()
    return bool(made) or not QUEUE.busy


def _renew(ob: bpy.types.Object) -> None:
    """Lead a camera's background to the copy of the photo as it is now."""
    camera = ob.data
    if not writable.keeps(camera) or not writable.keeps(ob):
        return
    shown, opacity = camera.show_background_images, camera.background_images[0].alpha
    set_photo(ob, Path(stated(ob).photo), known_images())
    camera.show_background_images, camera.background_images[0].alpha = shown, opacity


def _program() -> tuple[list[str], Mapping[str, str]]:
    """A Blender without a window and without the user's add-ons, which runs `straightener`."""
    library = find_spec("gscore")
    assert library is not None and library.origin is not None
    path = [str(Path(__file__).parents[2]), str(Path(library.origin).parents[1])]
    code = (
        f"import sys; sys.path[:0] = {path!r}; from addon.cameras.straightener import main; main()"
    )
    if bpy.app.binary_path:
        options = ["--background", "--factory-startup", "--python-exit-code", "1"]
        return [bpy.app.binary_path, *options, "--python-expr", code], {}
    return [sys.executable, "-c", code], {"PYTHONPATH": os.pathsep.join(path)}


def _redraw_views() -> None:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


@persistent
def _file_loaded(*_: object) -> None:
    """Copies may be missing here, or be of photos that have changed."""
    if not bpy.app.background:
        ask(ob for ob in bpy.data.objects if is_camera(ob) and ob.library is None)


_FOLLOWER = beat.Follower(collect, lambda: QUEUE.busy)


def on_register() -> None:
    """Follow the beat, and files that are opened."""
    beat.FOLLOWERS.append(_FOLLOWER)
    bpy.app.handlers.load_post.append(_file_loaded)


def on_unregister() -> None:
    """Follow no more; a copy that is half made is left undone."""
    bpy.app.handlers.load_post.remove(_file_loaded)
    beat.FOLLOWERS.remove(_FOLLOWER)
    QUEUE.kill()
