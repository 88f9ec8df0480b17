"""Train a region: write its files in steps, start, show the result; functions for scripts,
operators and settings.
"""

import itertools
import shutil
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from .. import attributes, preferences, stored_paths
from ..cameras.capture_transform import box_of_capture, origin_of
from ..core import (
    EXPOSURE_FILE,
    Done,
    Progress,
    Switch,
    TrainConfig,
    headline_psnr,
    write_region,
    write_splat_file,
)
from ..interface.base_operator import Condition
from ..interface.windows import push_undo
from ..paths import capture_folder, output_folder
from ..process.incremental_tasks import Check, Steps, run_in_thread
from ..splats import objects, splat_files
from ..splats.error_maps import is_map
from ..splats.filters import SPHERE, crop_matrix, is_cropped
from ..splats.heal_operators import has_added
from ..splats.objects import active_splats, has_splats
from ..splats.read_chunked import ChunkedRead
from ..splats.splat_files import source_matrix_of_data
from ..splats.write_chunked import check_replaceable, replace
from ..training import guides, lookups, options, start_training
from ..training.properties import declared
from ..training.results import signature
from ..training.verb_job import Verb, VerbJob
from ..training.verb_jobs import JOBS, Cancelling, Starting, mesh_of


def _message(job: VerbJob) -> str:
    """A sentence on the result."""
    psnr = headline_psnr(job.done.metrics)
    quality = "" if psnr is None else f", PSNR {psnr:.2f} dB"
    return f"The region is trained: {job.done.step:,} steps{quality}. Results are in {job.output}."


VERB = Verb(
    running="A region of {} is being trained already; wait, or stop it.",
    kept="Stopped; the splats stay as they were.",
    less="choose a smaller region or smaller photos, then train it again",
    progress=(Progress,),
    done=Done,
    message=_message,
    complete=("finished", "converged", "target"),
    expires=(lookups.runs,),
)
"""`gscore train` of one region of one splat object."""


class _Options:
    """The scene's training options, overridden by those of the region."""

    def __init__(self, settings: Any, ob: bpy.types.Object, steps: int) -> None:
        self._settings = settings
        self.iterations = steps
        self.time_budget = self.target_psnr = 0.0
        self.early_stop = False
        self.sky = Switch.AUTO  # a region starts from existing splats, which have the sky
        self.max_splats = max(settings.max_splats, 2 * len(ob.data.vertices))
        degree = attributes.SH_COUNTS.index(attributes.sh_count(ob.data))
        self.sh_degree = max(settings.sh_degree, degree)
        self.antialias = bool(ob.get(objects.ANTIALIAS))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._settings, name)


def train_region(
    scene: bpy.types.Scene,
    ob: bpy.types.Object,
    *,
    box_of: Callable[[bpy.types.Object], np.ndarray] | None = None,
    wait: bool = False,
) -> VerbJob:
    """Train the splats in a box again, by default an object's crop; all others are frozen.

    The current splats, the box and all results are written to a new folder next to the scene's
    output folder, so that earlier runs are kept.

    Args:
        scene: Its settings are used.
        ob: A splat object.
        box_of: Its region, [4, 4] as from `region_of`, which is the default.
        wait: Return when the job has ended and its splats are imported.

    Raises:
        ValueError: something is missing or in the way; the message says what to do.
        GsError: the scene's guides cannot be written.
    """
    source = capture_folder(scene)
    JOBS.check_free(VERB, source)
    if is_map(ob):
        raise ValueError(f"{ob.name} shows errors, not splats; press Show Splats first.")
    check_replaceable(ob)
    objects.catch_up(ob)
    box = (box_of or region_of)(ob)
    found = start_training.check_capture(scene)
    folder = output_folder(scene, preferences.get().output_folder)
    numbered = (folder.with_name(f"{folder.name}_region_{n}") for n in itertools.count(1))
    output = next(path for path in numbered if not path.exists())
    start_file, region_file = output / "start" / "start.ply", output / "region.json"
    settings = _Options(scene.gscore, ob, scene.gscore_steer.region_steps)
    line = options.new_run(
        settings,
        source=source,
        output=output,
        machine=start_training.machine(),
        depths=found.depths > 0,
    )
    line += guides.arguments(scene, output)
    line += ["--start-splats", str(start_file), "--region", str(region_file)]
    return JOBS.start(
        VERB,
        line,
        source=source,
        output=output,
        prepare=partial(start_files, ob, box, splats_file=start_file, region_file=region_file),
        arrive=partial(_arriving, ob.session_uid, signature(ob)),
        wait=wait,
    )


def job_of(scene: bpy.types.Scene) -> VerbJob | None:
    """The last region training of the scene's capture, running or ended."""
    try:
        return JOBS.of_source(VERB, capture_folder(scene))
    except ValueError:
        return None


def _arriving(object_uid: int, before: str, job: VerbJob) -> Steps[Iterable[str]]:
    """Import the result, with warnings.

    It replaces the splats that the training started from, and undo restores them. If they were
    edited or deleted meanwhile, the result becomes a new object.

    Args:
        object_uid: Session uid of the object whose splats are trained.
        before: Fingerprint of the splats, to detect later edits.
        job: The finished job.
    """
    mesh = yield from mesh_of(Path(job.done.path))
    try:
        warnings = _show(job, mesh, object_uid, before)
    except ValueError:
        bpy.data.meshes.remove(mesh)
        raise
    push_undo("Train Region")
    return warnings


def _show(job: VerbJob, mesh: bpy.types.Mesh, object_uid: int, before: str) -> list[str]:
    found = (ob for ob in bpy.data.objects if ob.session_uid == object_uid)
    ob = next(filter(objects.is_splats, found), None)
    if ob is None:
        raise ValueError(f"The splats were removed from the scene; results are in {job.output}.")
    try:
        check_replaceable(ob)
    except ValueError as error:
        raise ValueError(
            f"The result could not be put into the scene: {error} It is in {job.output}; Result > "
            f"Import adds {Path(job.done.path).name} from there as a new object."
        ) from error
    warnings = []
    if signature(ob) != before:
        name = ob.name
        ob = _copy_of(ob)
        warnings.append(f"{name} was edited and is kept; the result is {ob.name}.")
    moved = splat_files.source_matrix_of_data(ob)
    replace(ob, mesh)
    if not np.array_equal(moved, np.eye(4)):
        _move_to_source(ob, moved)
    return warnings


def _move_to_source(ob: bpy.types.Object, moved: np.ndarray) -> None:
    """Give an object the transform of its capture's world, in which the new splats are; `moved` was
    the matrix of the old splats to that world. Its crop box stays in place."""
    box = ob.gscore.crop_object
    place = None if box is None else box.matrix_world.copy()
    ob.matrix_world = ob.matrix_world @ Matrix(np.linalg.inv(moved).tolist())
    bpy.context.view_layer.update()
    if box is not None:
        box.matrix_world = place


def _copy_of(ob: bpy.types.Object) -> bpy.types.Object:
    """A copy of an object and its mesh, in the same collections."""
    copy = ob.copy()
    copy.data = ob.data.copy()
    for collection in ob.users_collection:
        collection.objects.link(copy)
    return copy


def start_files(
    ob: bpy.types.Object, box: np.ndarray, *, splats_file: Path, region_file: Path
) -> Steps[None]:
    """Write the current splats of an object and a box: read in chunks, then transformed into their
    capture's world and written in a thread, with the exposures of the photos in their run.

    Args:
        ob: The splat object.
        box: The region, [4, 4], as for `write_region`.
        splats_file: The PLY to write.
        region_file: The JSON to write.

    Raises:
        ValueError: the object has no splats, or they cannot be read or moved to their capture.
        GsError: a file cannot be written.
    """
    if not ob.data.vertices:
        raise ValueError(f"{ob.name} has no splats to train.")
    name, matrix, origin = ob.name, source_matrix_of_data(ob), origin_of(ob)
    objects.moved(attributes.NO_SPLATS, matrix, name)  # raises for a bad matrix
    more = {"antialiased": bool(ob.get(objects.ANTIALIAS)), "origin": origin}
    write: Callable[[attributes.Splats], object] = partial(write_splat_file, splats_file, **more)
    box = box_of_capture(box, ob)
    exposures = Path(stored_paths.read(ob, stored_paths.RUN)) / EXPOSURE_FILE
    columns = yield from ChunkedRead(ob).read()

    def written(check: Check) -> None:
        splats = objects.moved(attributes.as_splats(columns), matrix, name)
        check()
        write(splats)
        if exposures.is_file():  # without them the region would have another brightness
            shutil.copyfile(exposures, splats_file.with_name(EXPOSURE_FILE))
        write_region(region_file, box)

    yield from run_in_thread(written, "Writing the region's splats")


def region_of(ob: bpy.types.Object) -> np.ndarray:
    """Matrix [4, 4] float64 from the cube [-1, 1]^3 to the box of an object's crop object, in the
    world of the object's capture.

    Raises:
        ValueError: there is no crop box, or it has no volume.
    """
    if not is_cropped(ob):
        raise ValueError(f"{ob.name} has no crop object; add a crop box around the region first.")
    settings = ob.gscore
    if settings.crop_shape == SPHERE or settings.crop_invert:
        raise ValueError(
            "A region is the inside of a box: set the shape of the crop to Box, not inverted."
        )
    to_unit = crop_matrix(ob, settings.crop_object)
    if not abs(np.linalg.det(to_unit[:3, :3])) > 0:
        raise ValueError(f"{settings.crop_object.name} has no volume; scale it up on all axes.")
    return source_matrix_of_data(ob) @ np.linalg.inv(to_unit)


class TrainRegion(Starting, bpy.types.Operator):
    """Train the splats in the crop box again, in the background; all others are frozen.
    The result replaces them when it is complete; undo restores the earlier splats"""

    bl_idname = "gscore.train_region"
    bl_label = "Train Region"
    needs = Condition(has_splats, "Select splats, or their crop box")

    def start(self, context: bpy.types.Context) -> VerbJob:
        """Start."""
        self.warn(start_training.unsaved(context.scene))
        return train_region(context.scene, active_splats(context), wait=self.wait)


_MARGIN = 1.1
"""Size of the box around added splats, in sizes of their extent."""


def region_of_added(ob: bpy.types.Object) -> np.ndarray:
    """Box around the splats that Heal and Clone added, as `region_of`.

    Raises:
        ValueError: there are none, or it is in Edit Mode.
    """
    marks = ob.data.attributes.get(attributes.HEALED)
    if ob.mode == "EDIT":
        raise ValueError(f"{ob.name} is in Edit Mode: leave it before training its splats.")
    chosen = np.zeros(len(ob.data.vertices), bool)
    if marks is not None and marks.data_type == "BOOLEAN" and len(marks.data) == len(chosen):
        marks.data.foreach_get("value", chosen)
    if not chosen.any():
        raise ValueError(f"{ob.name} has no splats that Heal or Clone added.")
    places = attributes.column(ob.data, attributes.POSITION)[chosen].astype(np.float64)
    low, high = places.min(axis=0), places.max(axis=0)
    half = _MARGIN * (high - low) / 2
    matrix = np.diag([*np.maximum(half, (_MARGIN - 1) * half.max() + 1e-6), 1.0])
    matrix[:3, 3] = (low + high) / 2
    return source_matrix_of_data(ob) @ matrix


class TrainHealed(Starting, bpy.types.Operator):
    """Train the box around the splats that Heal and Clone added, in the background, so that photos
    correct them; all other splats are frozen. Undo restores the earlier splats"""

    bl_idname = "gscore.train_healed"
    bl_label = "Train Healed Region"
    needs = Condition(has_added, "Select splats that Heal Splats or Clone Splats added to")

    def start(self, context: bpy.types.Context) -> VerbJob:
        """Start."""
        self.warn(start_training.unsaved(context.scene))
        ob = active_splats(context)
        return train_region(context.scene, ob, box_of=region_of_added, wait=self.wait)


class StopRegion(Cancelling, bpy.types.Operator):
    """Cancel the region training; the splats are not changed"""

    bl_idname = "gscore.stop_region"
    bl_label = "Stop"
    none = "No region is being trained."
    job_of = staticmethod(job_of)


class RegionSettings(bpy.types.PropertyGroup):
    """Region training settings of a scene, `Scene.gscore_steer`."""

    region_steps: declared(
        TrainConfig(),
        "iterations",
        "Steps",
        default=2000,
        soft_min=200,
        soft_max=10_000,
        description="Training steps for a region, one photo each",
    )


PROPERTIES = ((bpy.types.Scene, "gscore_steer", bpy.props.PointerProperty(type=RegionSettings)),)
