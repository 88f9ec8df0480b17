"""Result object of a run: which object shows its splats, and which file of the run it shows."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .. import stored_paths
from ..attributes import NO_SPLATS
from ..cameras.capture_transform import noted_origin
from ..cameras.objects import is_kind
from ..capture.folders import same_folder
from ..interface import editable_check
from ..splats import objects, splat_files
from ..splats.error_maps import drop_maps
from ..splats.objects import ANTIALIAS
from ..splats.write_chunked import check_replaceable, replace
from .existing_run import EarlierRun
from .loader import Loaded
from .training_job import Job

_FILLED = "gs_filled"
"""Custom property of a result: its `signature` as it came, to know whether it was edited."""
_FILLED_BY = "gs_job"
"""Custom property of a result: the id of the job that filled it last."""
_CONTENT = "gs_content"
"""Custom property of a result: `content` of the file that it shows; empty: a snapshot's."""


@dataclass(frozen=True)
class Place:
    """Where the open file shows what a job makes."""

    scene: bpy.types.Scene
    holder: Any
    """Has `result` and `preview`: the scene's settings, or the outcome of a capture that is not the
    chosen one."""


def result_object(place: Place, job: Job, loaded: Loaded) -> bpy.types.Object:
    """The object that shows the splats of a run: the one it has, or a new and empty one.

    One that was edited stays as it is, as does one of an earlier run that this one was not asked to
    replace; the splats go into a new one.
    """
    scene = place.scene
    ob = shown_object(place.holder, job.output, job.sources)
    if ob is not None and scene.objects.get(ob.name) is ob:
        own = job.may_replace or ob.get(_FILLED_BY) == job.id
        edited = was_edited(ob)
        if own and not edited:
            _note_antialias(ob, job.antialias)
            return ob
        _let_go(scene, ob)
        why = "was edited" if edited else "is of an earlier training"
        job.state.warn(f"{ob.name} {why} and is kept, hidden; the training goes into a new object.")
    root = capture_of(scene, job.source)
    collection = root.users_collection[0] if root and root.users_collection else scene.collection
    name = _name(job.source)
    ob = objects.create(NO_SPLATS, name, collection=collection, parent=root)
    _note_run(ob, job.output, job.source)
    if loaded.typical_size:
        ob.gscore.point_size = 0.5 * loaded.typical_size
    _note_antialias(ob, job.antialias)
    if root is None:
        # Else as a first camera that was held level: COLMAP's own worlds have no up.
        splat_files.place(
            ob, splat_files.UP_AXES["-Y"] if loaded.upright is None else loaded.upright
        )
    place.holder.result = ob
    return ob


def shown_object(holder: Any, output: Path, sources: Sequence[Path]) -> bpy.types.Object | None:
    """The object that shows the splats of a run, if a holder has it.

    Args:
        holder: See `Place`.
        output: Folder of the run.
        sources: Folders that the capture has, and had; an object of any other is not the run's.
    """
    ob = holder.result
    if ob is None:
        return None
    source = stored_paths.read(ob, stored_paths.SOURCE)
    of_capture = bool(source) and any(same_folder(Path(source), known) for known in sources)
    return ob if is_of_run(ob, output) and of_capture else None


def is_of_run(ob: bpy.types.Object, output: Path) -> bool:
    """Whether an object holds splats of the run in a folder."""
    run = stored_paths.read(ob, stored_paths.RUN)
    return bool(run) and same_folder(Path(run), output)


def _note_antialias(ob: bpy.types.Object, antialias: bool) -> None:
    ob.pop(ANTIALIAS, None)
    if antialias:
        ob[ANTIALIAS] = True


def _note_run(ob: bpy.types.Object, output: Path, source: Path) -> None:
    stored_paths.write(ob, stored_paths.RUN, output)
    stored_paths.write(ob, stored_paths.SOURCE, source)


def _name(source: Path) -> str:
    return f"{source.name} splats"


def note_filled(ob: bpy.types.Object, job: Job, loaded: Loaded) -> None:
    """Note whose splats an object has got, and as which they came."""
    ob[_FILLED], ob[_FILLED_BY], ob[_CONTENT] = signature(ob), job.id, loaded.content


def is_own(ob: bpy.types.Object, job: Job) -> bool:
    """Whether the splats of an object came from a job."""
    return ob.get(_FILLED_BY) == job.id


def adopt(
    scene: bpy.types.Scene, made: bpy.types.Object, run: EarlierRun, source: Path
) -> bpy.types.Object:
    """Let an imported object with the splats of a run be what a scene shows of it.

    An object that shows the run already gets the splats, unless it was edited: then it is let go
    and hidden.

    Returns:
        The object that has the splats now; `made` is gone where it is another.

    Raises:
        ValueError: the object that is there cannot be written now; `made` is gone.
    """
    output = run.info.path
    ob = shown_object(scene.gscore, output, (source,))
    if ob is not None:
        try:
            objects.check_writable(ob)
            if not was_edited(ob):
                check_replaceable(ob)
        except ValueError:
            bpy.data.meshes.remove(made.data)
            raise
    if ob is not None and not was_edited(ob):
        replace(ob, made.data)
        splat_files.stand(ob, noted_origin(made))
        _note_antialias(ob, bool(made.get(ANTIALIAS)))
        bpy.data.objects.remove(made)
        drop_maps(ob)  # of what it showed before
    else:
        if ob is not None:
            _let_go(scene, ob)
        ob = made
        ob.name = ob.data.name = _name(source)
        _note_run(ob, output, source)
        scene.gscore.result = ob
        if (root := capture_of(scene, source)) is not None:
            for collection in ob.users_collection:
                collection.objects.unlink(ob)
            editable_check.link_like(ob, root)
            objects.hide_points(scene, root)
    ob[_FILLED], ob[_CONTENT] = signature(ob), run.content
    return ob


def is_outdated(ob: bpy.types.Object, run: EarlierRun) -> bool:
    """Whether an object shows other splats of a run than it has now, as far as is known."""
    known = ob.get(_CONTENT)
    return known is not None and run.info.splats is not None and known != run.content


def _let_go(scene: bpy.types.Scene, ob: bpy.types.Object) -> None:
    """Make the result of a run an object like any other, hidden: another one stands there now."""
    for key in (stored_paths.RUN, _FILLED, _FILLED_BY, _CONTENT):
        ob.pop(key, None)
    objects.hide(ob, scene)
    ob.hide_render = True


def was_edited(ob: bpy.types.Object) -> bool:
    """Whether splats of a result were deleted, added or moved since they came."""
    return ob.get(_FILLED, "") not in ("", signature(ob))


def signature(ob: bpy.types.Object) -> str:
    """Tells whether splats were deleted, added or moved; 15 ms for a million."""
    positions = np.empty(3 * len(ob.data.vertices), np.float32)
    ob.data.attributes["position"].data.foreach_get("vector", positions)
    return f"{len(positions) // 3}-{zlib.crc32(positions):08x}"


def capture_of(scene: bpy.types.Scene, source: Path) -> bpy.types.Object | None:
    """The empty that carries the alignment of a capture, if the scene has it."""
    for ob in scene.objects:
        text = stored_paths.read(ob, stored_paths.SOURCE)
        if is_kind(ob, "capture") and text and same_folder(Path(text), source):
            return ob
    return None
