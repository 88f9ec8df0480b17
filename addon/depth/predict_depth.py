"""Depth maps: predict, check, cancel, and the shown report; functions for scripts, operators."""

from pathlib import Path

import bpy
from bpy.props import BoolProperty, StringProperty

from .. import preferences
from ..capture import depth_maps
from ..capture.depth_maps import DepthReport
from ..core import DepthDone, DepthProgress
from ..interface.base_operator import BaseOperator, ConfirmMixin, browse
from ..interface.images import show_image
from ..interface.option_labels import panel_text
from ..paths import absolute, capture_folder, output_folder
from ..training import facts, lookups, options
from ..training.verb_job import Verb, VerbJob
from ..training.verb_jobs import JOBS, Cancelling, Starting
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
) -> VerbJob:
    """Predict the depth maps of the scene's capture with a network, and align them.

    Args:
        scene: Its `gscore` settings name the capture, its photos and masks.
        model: ONNX file or name of the network; empty: the network of the preferences.
        overwrite: Predict all views again; else only views without a map of this network.
        download: Download a named network if it is not on this computer.
        wait: Return when the job has ended.

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
    return JOBS.start(VERB, arguments, source=source, wait=wait)


def replaced(scene: bpy.types.Scene) -> list[str]:
    """Sentences on the maps that a prediction of all views overwrites.

    Raises:
        ValueError: there is no capture.
    """
    source = capture_folder(scene)
    found = facts.capture(scene)[0]
    count = 0 if found is None else found.depths
    return [f"{count or 'All'} depth maps in {source / options.DEPTHS} are overwritten."]


def check(scene: bpy.types.Scene, *, wait: bool = False) -> VerbJob:
    """Compare the maps of the scene's capture with its points, as a training would.

    No files are written. Arguments and errors as in `predict`.
    """
    source = capture_folder(scene)
    arguments = options.depth_run(scene.gscore, source=source, threads=preferences.get().threads)
    _show(scene, MAPS)
    return JOBS.start(VERB, arguments, source=source, wait=wait)


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
    return facts.ask(lookups.depth_runs, folder)


def sheet(scene: bpy.types.Scene) -> Path:
    """Path of the contact sheet in the folder of a scene's depth maps.

    Raises:
        ValueError: there is none.
    """
    path = capture_folder(scene) / options.DEPTHS / "contact_sheet.png"
    if not path.is_file():
        raise ValueError(f"There is no {path}; Predict Depth Maps makes it with the maps.")
    return path


def _show(scene: bpy.types.Scene, which: str) -> None:
    if scene.gscore.depth_shown != which:
        scene.gscore.depth_shown = which


class PredictDepth(ConfirmMixin, Starting, bpy.types.Operator):
    """Predict depth maps of all photos with a network, in the background"""

    bl_idname = "gscore.predict_depth"
    bl_label = "Predict Depth Maps"

    filepath: StringProperty(
        name="Network",
        description="ONNX file of the network; empty: the network of the preferences",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )
    confirm = "Predict Again"
    filter_glob: StringProperty(default="*.onnx", options={"HIDDEN"})
    overwrite: BoolProperty(
        name="Replace All",
        description="Replace existing maps; off: predict only photos without a map",
        options={"SKIP_SAVE"},
    )

    download: BoolProperty(
        name="Download",
        description="Download the network if it is not on this computer",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser if no network is chosen, else confirm the replacement of maps."""
        prefs = preferences.get()
        if not (self.filepath or networks.chosen() or prefs.depth_model.strip()):
            return browse(context, self)
        return super().invoke(context, event)

    def confirm_lines(self, context: bpy.types.Context) -> list[str]:
        """List the replaced maps and the download."""
        lines = replaced(context.scene) if self.overwrite else []
        network = networks.chosen()
        if self.download and network is not None:
            networks.check_download(network, True)
            self.confirm = "Download"
            lines += networks.confirm_lines(network)
        return lines

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the confirmation, or the options of the file browser."""
        super().draw(context)
        if not getattr(self, "lines", ()):
            self.layout.prop(self, "overwrite")

    def start(self, context: bpy.types.Context) -> VerbJob:
        """Start the job, and store the network in the preferences."""
        chosen = self.filepath
        job = predict(
            context.scene,
            chosen,
            overwrite=self.overwrite,
            download=self.download,
            wait=self.wait,
        )
        if chosen:
            preferences.get().depth_model = chosen
        return job


class CheckDepth(Starting, bpy.types.Operator):
    """Compare the depth maps with the SfM points, as a training does; no files are written"""

    bl_idname = "gscore.check_depth"
    bl_label = "Check Maps"

    def start(self, context: bpy.types.Context) -> VerbJob:
        """Start the job."""
        return check(context.scene, wait=self.wait)


class CancelDepth(Cancelling, bpy.types.Operator):
    """Cancel the depth job; finished maps are kept, and the next prediction continues"""

    bl_idname = "gscore.cancel_depth"
    bl_label = "Cancel"
    none = "No depth job is running."
    job_of = staticmethod(job_of)


class ShowDepthSheet(BaseOperator, bpy.types.Operator):
    """Show photos and depth maps side by side in an image editor"""

    bl_idname = "gscore.show_depth_sheet"
    bl_label = "Contact Sheet"

    def run(self, context: bpy.types.Context) -> str:
        """Reload the picture and show it."""
        image = bpy.data.images.load(str(sheet(context.scene)), check_existing=True)
        image.reload()
        if show_image(context, image, new_window=True):
            return ""
        return f"Loaded {image.name}; there is no window to show it."
