"""Start of trainings from scripts and operators; resume, wait, follow and discard; box of a limited
training.
"""

import hashlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .. import preferences, run_links
from ..cameras.capture_transform import box_of_capture
from ..cameras.lookup import panel_root
from ..capture.inspection import ShownFacts
from ..core import GUIDES, Switch, read_course, write_region
from ..nodes import display as display_nodes
from ..paths import absolute, capture_folder, output_folder, relative
from ..process import poll_timer
from ..splats.filters import crop_matrix
from . import display, existing_run, facts, guides, lookups, options, registry, results
from .curve import Curve
from .training_job import Job
from .verb_jobs import launch

_INTERVAL = 0.02
UNSAVED: list[Callable[[Path], list[str]]] = []
"""Functions that return sentences on unsaved data of a capture, which a training would not use."""


def job_of(scene: bpy.types.Scene) -> Job | None:
    """The training of a scene: the one into its output folder, running or ended."""
    try:
        folder = output_folder(scene, preferences.get().output_folder)
    except ValueError:
        return None
    job = registry.by_output(folder)
    return job if job is not None and run_links.belongs_to(scene.gscore, job.source) else None


def train(
    scene: bpy.types.Scene,
    *,
    overwrite: bool = False,
    wait: bool = False,
) -> Job:
    """Start a training of the scene's capture.

    Args:
        scene: Has the `gscore` settings; its output folder is set.
        overwrite: Replace another run in the output folder.
        wait: Return when it has ended and its splats are in the scene.

    Raises:
        ValueError: an input is missing or invalid, or the output folder is in use.
    """
    source = capture_folder(scene)
    output = output_folder(scene, preferences.get().output_folder)
    _check_free(output)
    found = check_capture(scene)
    before = _own_run(output, source)
    if before is not None and not overwrite:
        raise ValueError(
            f"{output} contains another run; press Resume to continue it, Start Over to replace "
            "it, or choose another output folder."
        )
    box = box_arguments(scene, output)
    arguments = options.new_run(
        scene.gscore,
        source=source,
        output=output,
        machine=machine(),
        overwrite=overwrite,
        depths=found.depths > 0,
    )
    arguments += guides.arguments(scene, output) + box
    scene.gscore.output_path = relative(output)
    scene.gscore.outcome_of = scene.gscore.capture_path
    scene.gscore.depth_shown = "RUN"  # once there is one
    job = _start(arguments, source, output, scene=scene, replaces=overwrite)
    if wait:
        wait_for(job)
    return job


def replaced(scene: bpy.types.Scene) -> list[str]:
    """Sentences on files and objects that a new training replaces.

    Raises:
        ValueError: it cannot start in the output folder.
    """
    source = capture_folder(scene)
    output = output_folder(scene, preferences.get().output_folder)
    before = _own_run(output, source)
    lines = [] if before is None else [f"The run in {before.words} is overwritten."]
    ob = results.shown_object(scene.gscore, output, (source,))
    if ob is not None and results.was_edited(ob):
        lines.append(f"Its object {ob.name} was edited and is kept, hidden.")
    elif ob is not None:
        count = len(ob.data.vertices)
        lines.append(f"Its object {ob.name} with {count:,} splats is replaced too.")
    return lines


def unsaved(scene: bpy.types.Scene) -> list[str]:
    """Sentences on data that a training would not use: unsaved, hidden, or no mesh.

    Raises:
        ValueError: no capture is chosen, or it does not exist.
    """
    source = capture_folder(scene)
    lines = [line for list_unsaved in UNSAVED for line in list_unsaved(source)]
    return lines + guides.unused_objects(scene)


def resume(scene: bpy.types.Scene, *, wait: bool = False) -> Job:
    """Resume the run in the scene's output folder from its last checkpoint.

    If the settings have more steps or a longer time budget than the run, it continues up to those.

    Args:
        scene: Its output folder has the run.
        wait: As in `train`.

    Raises:
        ValueError: there is no checkpoint, or the run cannot continue.
    """
    output = output_folder(scene, preferences.get().output_folder)
    _check_free(output)
    before = existing_run.read_existing_run(output, _chosen_capture(scene))
    info = None if before is None else before.info
    if before is None or info is None or info.checkpoint is None:
        raise ValueError(f"{output} contains no checkpoint to resume; press Train instead.")
    if before.foreign:
        raise ValueError(before.foreign_text)
    if info.problem:
        raise ValueError(f"The run cannot continue: {info.problem} Press Start Over instead.")
    changes = options.continuation(scene.gscore, info)
    assert info.data is not None
    source = info.data.source
    if scene.gscore.capture_path.strip():
        source = capture_folder(scene)  # it may have moved
    elif not source.exists():
        raise ValueError(f"The capture of the run, {source}, is missing; choose its folder.")
    arguments = options.resumed_run(
        source=source,
        output=output,
        machine=machine(),
        changes=changes,
    )
    began_from = info.data.source
    course = read_course(info.checkpoint)
    job = _start(arguments, source, output, scene=scene, earlier_source=began_from)
    job.state.curve = Curve.of(course)
    if wait:
        wait_for(job)
    return job


def follow(scene: bpy.types.Scene, job: Job) -> None:
    """Show a training of another scene or file in a scene."""
    scene.gscore.capture_path = relative(job.source)
    scene.gscore.output_path = relative(job.output)


def wait_for(job: Job, *, timeout: float = float("inf")) -> bool:
    """Follow a training until it has ended and its splats are in the scene; for scripts.

    Args:
        job: The training.
        timeout: Seconds after which to return; the training continues.

    Returns:
        True if it has ended.
    """
    until = time.monotonic() + timeout
    while display.waits(job):
        poll_timer.poll()
        if time.monotonic() > until:
            return False
        time.sleep(_INTERVAL)
    return True


def discard(job: Job) -> None:
    """End a training immediately and remove its files and live splats.

    A resumed run goes back to its last checkpoint instead.
    """
    job.discard()
    poll_timer.ensure()


def machine() -> options.Machine:
    """Preferences for this computer.

    Raises:
        ValueError: the LPIPS network does not exist.
    """
    prefs = preferences.get()
    lpips = None
    if prefs.lpips_path.strip():
        lpips = absolute(prefs.lpips_path, "LPIPS Network")
        if not lpips.is_file():
            raise ValueError(
                f"There is no LPIPS network {lpips}; choose it again in the add-on's preferences, "
                "or clear the field."
            )
    return options.Machine(
        threads=prefs.threads,
        device=(prefs.device or preferences.AUTO).lower(),
        gpu_share=prefs.gpu_share if preferences.uses_card() else 1.0,
        lpips=lpips,
        preview_seconds=prefs.preview_seconds,
    )


def run_of(scene: bpy.types.Scene) -> tuple[Path, existing_run.EarlierRun]:
    """Folder of the capture, and the run in the scene's output folder.

    Raises:
        ValueError: there is none, or it belongs to another capture.
    """
    output = output_folder(scene, preferences.get().output_folder)
    before = _own_run(output, _chosen_capture(scene))
    if before is None:
        raise ValueError(f"{output} contains no run; press Train.")
    return capture_folder(scene), before


def _own_run(output: Path, capture: Path | None) -> existing_run.EarlierRun | None:
    """The run in a folder, if there is one; ValueError if it belongs to another capture."""
    before = existing_run.read_existing_run(output, capture)
    if before is not None and before.foreign:
        raise ValueError(before.foreign_text)
    return before


def _check_free(output: Path) -> None:
    other = registry.by_output(output)
    if other is not None and not other.state.ended:
        raise ValueError(f"A training into {output} is running; stop it first.")


def _chosen_capture(scene: bpy.types.Scene) -> Path | None:
    text = scene.gscore.capture_path
    return absolute(text, "Capture") if text.strip() else None


def check_capture(scene: bpy.types.Scene) -> ShownFacts:
    """Facts of the scene's capture; ValueError unless it can be trained."""
    found, problem = facts.capture(scene)
    if found is None or not found.can_train:
        found, problem = facts.refresh(scene)  # it may have changed on disk
    if found is None:
        raise ValueError(problem or "The capture could not be inspected; try again.")
    if found.bare:
        raise ValueError(f"{found.source} has no cameras yet; press Find Cameras first.")
    errors = [p.text for p in found.problems if p.is_error]
    if errors or not found.can_train:
        raise ValueError(errors[0] if errors else f"{found.source} contains no capture.")
    return found


def _start(
    arguments: list[str],
    source: Path,
    output: Path,
    *,
    scene: bpy.types.Scene,
    replaces: bool = False,
    earlier_source: Path | None = None,
) -> Job:
    """Start the trainer; with `earlier_source` it resumes a run."""
    places = {"source": source, "output": output, "scene_uid": scene.session_uid}
    began = {"resumed": earlier_source is not None, "earlier_source": earlier_source}
    job = launch(lambda python: Job(python, arguments, **places, **began, replaces=replaces))
    job.live_most = preferences.get().live_most
    registry.add(job)
    lookups.runs.expire()
    job.preparations = display_nodes.builders()  # while the trainer starts
    poll_timer.ensure()
    return job


def box_problem(settings: Any) -> str:
    """Sentence about conflicting settings of a scene; empty without a conflict."""
    ob = settings.train_within
    if ob is None:
        return ""
    if settings.use_masks and settings.mask_mode == "composite":
        return (
            f"Masks used as opacity already cut out the subject, so {ob.name} cannot limit it: set "
            "Mask Mode to Ignore Masked, or clear Limit to Object."
        )
    if settings.sky != Switch.ON:
        return ""
    return (
        f"Only the inside of {ob.name} is trained, so there is no sky: set Sky to Automatic, "
        "or clear Limit to Object."
    )


def box_arguments(scene: bpy.types.Scene, output: Path) -> list[str]:
    """Write the box of a scene's object into `output`; return the trainer's option for it.

    The file name has a hash of the content, so that the file of an earlier run stays unchanged.

    Raises:
        ValueError: the capture is not in the scene, the object has no volume, or settings conflict.
        GsError: the file cannot be written.
    """
    ob = scene.gscore.train_within
    if ob is None:
        return []
    if conflict := box_problem(scene.gscore):
        raise ValueError(conflict)
    root = panel_root(scene)
    if root is None:
        raise ValueError(
            f"{ob.name} limits the training by its position among the photos: press Import "
            "Cameras first, or clear Limit to Object."
        )
    to_unit = crop_matrix(root, ob)
    if not abs(np.linalg.det(to_unit[:3, :3])) > 0:
        raise ValueError(f"{ob.name} has no volume; scale it up on all axes.")
    box = box_of_capture(np.linalg.inv(to_unit), root)
    path = output / GUIDES / f"within-{hashlib.sha256(box.tobytes()).hexdigest()[:8]}.json"
    if not path.is_file():
        write_region(path, box)
    return ["--region", str(path)]
