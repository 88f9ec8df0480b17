"""Predict depth maps from scripts and operators: predict, check, cancel, and the shown report."""

from pathlib import Path

import bpy

from .. import preferences
from ..capture import depth_maps
from ..capture.depth_maps import DepthReport
from ..core import DepthDone, DepthProgress
from ..interface.option_labels import panel_text
from ..paths import absolute, capture_folder, output_folder
from ..process import poll_timer
from ..training import facts, lookups, options
from ..training.verb_job import Verb, VerbJob
from ..training.verb_jobs import JOBS
from . import networks

MAPS, RUN = "MAPS", "RUN"
"""Reports of a scene: of the current maps, of the last training."""


def _message(job: VerbJob) -> str:
    """Read the report; a sentence with the number of maps, and of accepted maps."""
    done = job.done
    job.report = depth_maps.from_table(done.table, why=panel_text(done.why))
    maps = len(job.report.rows) - job.report.counts[depth_maps.MISSING]
    made = f"{done.predicted} maps predicted. " if done.predicted else ""
    return f"{made}{done.accepted} of {maps} maps are accepted."


VERB = Verb(
    running="A depth job of {} is running already; cancel it first.",
    kept="Cancelled; finished maps are kept.",
    less="choose a smaller network, then predict again",
    progress=(DepthProgress,),
    done=DepthDone,
    message=_message,
    waits=True,
    expires=(lookups.captures, lookups.networks),
)
"""`gscore depth`, which never leaves a partly written map."""


def predict(
    scene: bpy.types.Scene,
    model: str | Path = "",
    *,
    overwrite: bool = False,
    download: bool = False,
    wait: bool = False,
    python: str | Path | None = None,
) -> VerbJob:
    """Predict the depth maps of the scene's capture with a network, and align them.

    Args:
        scene: Its `gscore` settings name the capture, its photos and masks.
        model: ONNX file or name of the network; empty: the network of the preferences.
        overwrite: Predict all views again; else only views without a map of this network.
        download: Download a named network if it is not on this computer.
        wait: Return when the job has ended.
        python: The Python that predicts; None: the one of the preferences.

    Raises:
        ValueError: an input is missing, a download is not allowed, or a job is running.
    """
    prefs = preferences.get()
    known = networks.known(str(model) or prefs.depth_network)
    if known is not None:
        networks.check_download(known, download)
        network: Path | str = known.name
    else:
        network = absolute(str(model) or prefs.depth_model, "Depth Network")
        if not network.is_file():
            raise ValueError(f"There is no depth network {network}; choose an ONNX file.")
    source = capture_folder(scene)
    arguments = options.depth_run(
        scene.gscore,
        source=source,
        threads=prefs.threads,
        model=network,
        download=download and known is not None,
        overwrite=overwrite,
    )
    _show(scene, MAPS)
    return JOBS.start(VERB, arguments, source=source, wait=wait, python=python)


def replaced(scene: bpy.types.Scene) -> list[str]:
    """Sentences on the maps that a prediction of all views overwrites.

    Raises:
        ValueError: there is no capture.
    """
    source = capture_folder(scene)
    found = facts.capture(scene)[0]
    count = 0 if found is None else found.depths
    return [f"{count or 'All'} depth maps in {source / options.DEPTHS} are overwritten."]


def check(
    scene: bpy.types.Scene, *, wait: bool = False, python: str | Path | None = None
) -> VerbJob:
    """Compare the maps of the scene's capture with its points, as a training would.

    No files are written. Arguments and errors as in `predict`.
    """
    source = capture_folder(scene)
    arguments = options.depth_run(scene.gscore, source=source, threads=preferences.get().threads)
    _show(scene, MAPS)
    return JOBS.start(VERB, arguments, source=source, wait=wait, python=python)


def job_of(scene: bpy.types.Scene) -> VerbJob | None:
    """The last depth job of a scene's capture, running or ended."""
    found = facts.capture(scene)[0]
    return None if found is None else JOBS.of_source(VERB, found.source)


def reports(scene: bpy.types.Scene) -> dict[str, DepthReport]:
    """The depth reports of a scene that are loaded, by MAPS and RUN; never blocks."""
    known = {}
    found = facts.capture(scene)[0]
    if found is not None and found.kind:
        job = JOBS.of_source(VERB, found.source)
        if job is not None and job.report is not None:
            known[MAPS] = job.report
        elif found.depths:
            known[MAPS] = found.depth_report
    run = run_report(scene)[0]
    return known if run is None else known | {RUN: run}


def report(scene: bpy.types.Scene) -> DepthReport | None:
    """The report chosen in the scene's settings, or another one that is loaded."""
    known = reports(scene)
    return known.get(scene.gscore.depth_shown) or next(iter(known.values()), None)


def run_report(scene: bpy.types.Scene) -> tuple[DepthReport | None, str]:
    """The report of the run in the scene's output folder, and an error message; (None, "") if
    there is none or it is still loading."""
    try:
        folder = output_folder(scene, preferences.get().output_folder)
    except ValueError:
        return None, ""
    answer = lookups.depth_runs.get(folder)
    poll_timer.ensure()
    return answer


def sheet(scene: bpy.types.Scene) -> Path:
    """Path of the contact sheet in the folder of a scene's depth maps.

    Raises:
        ValueError: there is none.
    """
    path = capture_folder(scene) / options.DEPTHS / "contact_sheet.png"
    if not path.is_file():
        raise ValueError(f"There is no {path}; Predict makes it together with the maps.")
    return path


def _show(scene: bpy.types.Scene, which: str) -> None:
    if scene.gscore.depth_shown != which:
        scene.gscore.depth_shown = which
