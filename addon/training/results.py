"""Result object of a run: the object with its splats, and the file that they came from."""

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
from ..splats import objects, replay, splat_files
from ..splats.error_maps import drop_maps
from ..splats.objects import ANTIALIAS
from ..splats.write_chunked import check_replaceable, replace
from .existing_run import EarlierRun
from .loader import Loaded
from .training_job import Job

_FILLED = "gs_filled"
"""Custom property of a result: its `signature` at the import, to detect edits."""
_FILLED_BY = "gs_job"
"""Custom property of a result: id of the job that wrote its splats last."""
_CONTENT = "gs_content"
"""Custom property of a result: `content` of its file; empty: a snapshot."""


@dataclass(frozen=True)
class Place:
    """Place of a job's results in the open file."""

    scene: bpy.types.Scene
    holder: Any
    """Has `result` and `preview`: the scene's settings, or the links of another capture."""


def result_object(place: Place, job: Job, loaded: Loaded) -> bpy.types.Object:
    """The object for the splats of a run: the existing one, or a new, empty one.

    An object that was edited is kept, and one of an earlier run that is not to be replaced; the
    splats then go into a new object.
    """
    scene = place.scene
    ob = shown_object(place.holder, job.output, job.sources)
    if ob is not None and scene.objects.get(ob.name) is ob:
        own = job.may_replace or ob.get(_FILLED_BY) == job.id
        edited = was_edited(ob)
        if own and not edited:
            _note_antialias(ob, job.antialias)
            return ob
        _release(scene, ob)
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
        # Without an alignment assume a level first camera: COLMAP's worlds have no up direction.
        splat_files.place(
            ob, splat_files.UP_AXES["-Y"] if loaded.upright is None else loaded.upright
        )
    place.holder.result = ob
    return ob


def shown_object(holder: Any, output: Path, sources: Sequence[Path]) -> bpy.types.Object | None:
    """The object with the splats of a run, if a holder has it.

    Args:
        holder: See `Place`.
        output: Folder of the run.
        sources: Current and earlier folders of the capture; objects of others are not the run's.
    """
    ob = holder.result
    if ob is None:
        return None
    source = stored_paths.read(ob, stored_paths.SOURCE)
    of_capture = bool(source) and any(same_folder(Path(source), known) for known in sources)
    return ob if is_of_run(ob, output) and of_capture else None


def is_of_run(ob: bpy.types.Object, output: Path) -> bool:
    """True if an object has splats of the run in a folder."""
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
    """Store the job and the signature of an object's splats."""
    ob[_FILLED], ob[_FILLED_BY], ob[_CONTENT] = signature(ob), job.id, loaded.content
    replay.note_replaced(ob)


def is_own(ob: bpy.types.Object, job: Job) -> bool:
    """True if the splats of an object came from a job."""
    return ob.get(_FILLED_BY) == job.id


def adopt(
    scene: bpy.types.Scene, made: bpy.types.Object, run: EarlierRun, source: Path
) -> bpy.types.Object:
    """Make an imported object with the splats of a run the scene's result.

    An existing result object of the run gets the splats, unless it was edited: then it is released
    and hidden.

    Returns:
        The object with the splats; `made` is removed if it is another.

    Raises:
        ValueError: the existing object cannot be written now; `made` is removed.
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
        splat_files.match_capture_origin(ob, noted_origin(made))
        _note_antialias(ob, bool(made.get(ANTIALIAS)))
        bpy.data.objects.remove(made)
        drop_maps(ob)  # of the previous splats
    else:
        if ob is not None:
            _release(scene, ob)
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
    replay.note_replaced(ob)
    return ob


def is_outdated(ob: bpy.types.Object, run: EarlierRun) -> bool:
    """True if an object's splats are known to differ from the current ones of a run."""
    known = ob.get(_CONTENT)
    return known is not None and run.info.splats is not None and known != run.content


def _release(scene: bpy.types.Scene, ob: bpy.types.Object) -> None:
    """Unlink an object from its run and hide it, because another one replaces it."""
    for key in (stored_paths.RUN, _FILLED, _FILLED_BY, _CONTENT):
        ob.pop(key, None)
    objects.hide(ob, scene)
    ob.hide_render = True


def was_edited(ob: bpy.types.Object) -> bool:
    """True if splats of a result were deleted, added or moved since the import."""
    return ob.get(_FILLED, "") not in ("", signature(ob))


def signature(ob: bpy.types.Object) -> str:
    """Hash that changes if splats are deleted, added or moved; 15 ms for a million."""
    positions = np.empty(3 * len(ob.data.vertices), np.float32)
    ob.data.attributes["position"].data.foreach_get("vector", positions)
    return f"{len(positions) // 3}-{zlib.crc32(positions):08x}"


def capture_of(scene: bpy.types.Scene, source: Path) -> bpy.types.Object | None:
    """The empty of a capture, if the scene has it."""
    for ob in scene.objects:
        text = stored_paths.read(ob, stored_paths.SOURCE)
        if is_kind(ob, "capture") and text and same_folder(Path(text), source):
            return ob
    return None
