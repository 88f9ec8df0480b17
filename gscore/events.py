"""Events of a training, one JSON object per line: the contract with every front end."""

import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

from .json_text import parse_json

FINISHED, TARGET, CONVERGED = "finished", "target", "converged"
"""Reasons: all steps were taken; the target PSNR was reached; the PSNR no longer rose."""
ENDED = (FINISHED, TARGET, CONVERGED)
"""Reasons of trainings that need no more steps."""


@dataclass(frozen=True, kw_only=True)
class Event:
    """Base of all events; `kind` is the value of the JSON key "event"."""

    kind: ClassVar[str] = ""

    def __init_subclass__(cls, *, kind: str) -> None:
        cls.kind = kind
        KINDS[kind] = cls


KINDS: dict[str, type[Event]] = {}
"""All events by their kinds."""


Show = Callable[[Event], None]
"""Receives each event."""


def seconds_left(began: float, done: int, total: int) -> float:
    """Remaining seconds of `total` equal pieces of work, of which `done` were finished since
    `began`, a time of `time.monotonic`; NaN: unknown."""
    if not 0 < done <= total:
        return math.nan
    return (time.monotonic() - began) / done * (total - done)


TOPICS = {
    "chosen_device": "Device",
    "region": "Region",
    "masks": "Masks",
    "enough": "Caps",
    "points": "Points",
    "stereo": "Stereo",
    "sky": "Sky",
    "opacity": "Opacity",
    "drops": "Dropout",
    "ensemble": "Ensemble",
    "depth": "Depth",
    "guide": "Guide meshes",
    "exposure": "Exposure",
    "poses": "Camera poses",
    "blur": "Blurred photos",
    "transients": "Transients",
    "viewer": "Viewer",
}
"""Topics of decisions with their labels, in the order in which they are shown. Each topic is also a
key of a `started` event in JSON, for versions without `decisions`."""


@dataclass(frozen=True)
class Decision:
    """Decision of a training for its photos and options."""

    topic: str
    """One of `TOPICS`; empty for a file of a version that stored no topics."""
    text: str
    """Sentences for people, with marked options."""

    @property
    def label(self) -> str:
        """The label of the topic; empty if the topic is unknown."""
        return TOPICS.get(self.topic, "")


@dataclass(frozen=True, kw_only=True)
class Started(Event, kind="started"):
    """Training is about to take its first step (also after a resume, then `step` > 0)."""

    source: str
    output: str
    iterations: int
    step: int
    train_views: int
    test_views: int
    splats: int
    """Number of splats of all models."""
    width: int
    height: int
    isa: str
    threads: int
    device: str = "cpu"
    """`cpu`, or the name of the graphics card that trains."""
    models: int = 1
    """Number of models of an ensemble, trained in parallel from the same splats."""
    left_s: float = math.nan
    """Seconds of training to expect up to the last step; NaN: not known."""
    mask_mode: str = "none"
    """Use of the capture's masks: `composite`, `ignore` or `none`."""
    decisions: list[Decision] = field(default_factory=list)
    """Decisions for these photos and options, in the order in which they are shown."""
    config: dict[str, Any] = field(default_factory=dict)

    def decision(self, topic: str) -> str:
        """Text of the decision on `topic`; empty: there is none."""
        return next((one.text for one in self.decisions if one.topic == topic), "")


@dataclass(frozen=True, kw_only=True)
class Estimated(Event, kind="estimate"):
    """Expected time and memory of a training, before photos are read; not on resume."""

    seconds: float
    """Training time without reading, measuring and writing, s."""
    peak_bytes: int
    """Largest resident memory."""
    free_bytes: int | None
    """Available memory; null if unknown."""
    photos_kept: bool
    """Whether all photos stay in memory; else some are read repeatedly."""
    photo_bytes: int
    """Memory of photos."""
    max_splats: int
    """The number of splats of this estimate."""
    reading_seconds: float = 0.0
    """Time before the first step: reading points and photos, neighbours of points, s."""
    device_bytes: int = 0
    """Largest memory of the device that trains, without photos that may stay there; 0: it has none
    of its own."""
    device_free_bytes: int = 0
    """Memory that the training may take there."""


@dataclass(frozen=True, kw_only=True)
class Progress(Event, kind="progress"):
    """Progress of a training; at most a few per second."""

    step: int
    iterations: int
    loss: float
    psnr: float
    """PSNR of the unmasked pixels of the training views, smoothed, dB."""
    splats: int
    steps_per_s: float
    eta_s: float
    elapsed_s: float
    phase: str
    """Current activity: `reading photos 3/60`, `adding splats`, `refining` once no more splats are
    added, `comparing photos` with renders for blur and transients, `measuring` or `paused`."""


@dataclass(frozen=True, kw_only=True)
class Preview(Event, kind="preview"):
    """A picture of one test view was written."""

    step: int
    view: str
    path: str


@dataclass(frozen=True, kw_only=True)
class Snapshot(Event, kind="snapshot"):
    """The current splats were written as a PLY."""

    step: int
    path: str
    splats: int


@dataclass(frozen=True, kw_only=True)
class Eval(Event, kind="eval"):
    """Mean metrics over the held-out views."""

    step: int
    split: str
    metrics: dict[str, Any]
    """Keys of metrics.json; only the PSNR if measured for a stopping criterion. See
    `headline_psnr`."""


@dataclass(frozen=True, kw_only=True)
class Warn(Event, kind="warning"):
    """Something the user should know; training goes on."""

    message: str
    code: str = ""


@dataclass(frozen=True, kw_only=True)
class Saved(Event, kind="saved"):
    """A checkpoint or a result file was written completely."""

    step: int
    path: str


@dataclass(frozen=True, kw_only=True)
class Done(Event, kind="done"):
    """Training ended; `reason` is one of `ENDED`, or why it was stopped."""

    step: int
    reason: str
    splats: int
    train_seconds: float
    path: str
    metrics: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Failed(Event, kind="error"):
    """The command ended with an error; earlier files are untouched."""

    message: str
    type: str = "GsError"
    """Class of the error; `Cancelled`: stopped before a result."""
    package: str = ""
    """The optional package that is missing; empty: none."""
    install: str = ""
    """The command that installs it."""


@dataclass(frozen=True, kw_only=True)
class DepthProgress(Event, kind="depth_progress"):
    """Progress of the depth maps of a capture."""

    done: int
    """Completed views."""
    total: int
    """All views; 0: not known yet."""
    view: str
    """Name of the last view; empty before the first."""
    eta_s: float
    phase: str
    """reading, predicting or aligning."""


@dataclass(frozen=True, kw_only=True)
class DepthDone(Event, kind="depth"):
    """Depth maps were aligned, after prediction if a network was given."""

    views: int
    accepted: int
    predicted: int
    kept: int
    """Views that had a map already."""
    folder: str
    """Folder of the maps."""
    params: str
    """Written depth_params.json; empty: none."""
    sheet: str
    """Written contact sheet; empty: none."""
    table: list[dict[str, Any]] = field(default_factory=list)
    """One row per view, see `gscore.depth.Priors`."""
    why: str = ""
    """A sentence: whether a training on all views would use depth automatically, and why."""


@dataclass(frozen=True, kw_only=True)
class EvalProgress(Event, kind="eval_progress"):
    """Progress of an evaluation."""

    done: int
    """Completed views."""
    total: int
    """All views; 0: not known yet."""
    view: str
    """Name and PSNR of the last view; empty before the first."""
    eta_s: float


@dataclass(frozen=True, kw_only=True)
class EvalDone(Event, kind="evaluated"):
    """A model was measured, and the results were written."""

    split: str
    path: str
    """Folder of metrics.json and report.html."""
    views: dict[str, float | None] = field(default_factory=dict)
    """The PSNR of each view as in `headline_psnr`, dB, by its name; null: infinite or missing."""
    error_map: str = ""
    """Splats coloured by their errors; empty: not requested."""
    error_bright: float = 0.0
    """The error of its brightest colour, 0 to 1."""


@dataclass(frozen=True, kw_only=True)
class RefitProgress(Event, kind="refit_progress"):
    """Progress of a refit for a viewer."""

    phase: str
    """reading, fitting or measuring."""
    done: int
    """Completed steps, or measured pictures."""
    total: int
    """All steps or pictures of the phase; 0: not known yet."""
    eta_s: float
    """Seconds left in the phase; NaN: not known."""


@dataclass(frozen=True, kw_only=True)
class RefitDone(Event, kind="refit"):
    """Splats were fitted to a viewer's rules and written."""

    path: str
    """The splat file."""
    viewer: str
    measured: dict[str, Any] = field(default_factory=dict)
    """Measurements by viewer, `before` and `after`: `psnr` to the photos, dB, and `difference` to
    gscore's own picture, of 255, by the model of its rules."""


@dataclass(frozen=True, kw_only=True)
class MeshPlanned(Event, kind="mesh_plan"):
    """The volume of a mesh, before it is allocated."""

    voxel: float
    """Distance between voxels, world units."""
    far: float
    """Farthest depth that is fused, world units."""
    views: int
    """Number of views that are drawn."""
    blocks: int
    """Number of blocks of voxels near surfaces."""
    volume_bytes: int
    """Memory of the volume."""


@dataclass(frozen=True, kw_only=True)
class MeshProgress(Event, kind="mesh_progress"):
    """Progress of a mesh."""

    phase: str
    """reading, measuring, looking for surfaces, fusing, contouring, cleaning, closing holes,
    smoothing, reducing, unwrapping, baking or writing."""
    done: int
    """Completed views or parts."""
    total: int
    """All views or parts of the phase; 0: it has none."""
    eta_s: float = math.nan
    """Seconds left in the phase; NaN: not known."""


@dataclass(frozen=True, kw_only=True)
class MeshDone(Event, kind="mesh"):
    """A mesh was made and written."""

    path: str
    """The mesh file."""
    vertices: int
    triangles: int
    voxel: float
    """Distance between voxels, world units."""


@dataclass(frozen=True, kw_only=True)
class SfmEstimated(Event, kind="sfm_estimate"):
    """Expected time of structure from motion, after the photos are read and before each further
    attempt."""

    photos: int
    seconds: float
    """Time of the whole attempt on an otherwise idle machine, s, by the speed of earlier
    attempts."""


@dataclass(frozen=True, kw_only=True)
class SfmProgress(Event, kind="sfm_progress"):
    """Progress of structure from motion."""

    phase: str
    """reading photos, entering photos, finding features, comparing photos, placing cameras,
    adjusting cameras or writing the capture; a further attempt repeats the middle ones."""
    done: int
    """Completed photos, or pairs of photos while they are compared."""
    total: int
    """All photos or pairs of the phase; 0: unknown."""
    eta_s: float
    """Seconds left in the phase; NaN: not known."""
    left_s: float = math.nan
    """Seconds left in total, without further attempts; NaN: not known."""
    share: float = math.nan
    """Completed share of the attempt's time, 0 to 1; NaN: not known."""


@dataclass(frozen=True, kw_only=True)
class SfmDone(Event, kind="sfm"):
    """Cameras of photos were found and written."""

    photos: int
    registered: int
    """Photos that have a camera."""
    models: int
    """Number of separate models; the largest was written."""
    points: int
    reprojection_px: float
    """Mean over the points."""
    seconds: float
    path: str
    """The capture."""


@dataclass(frozen=True, kw_only=True)
class FramesProgress(Event, kind="frames_progress"):
    """Progress of the extraction of frames."""

    phase: str
    """looking at frames or writing frames."""
    done: int
    """Completed frames."""
    total: int
    """All frames of the phase; 0: unknown."""
    eta_s: float
    """Seconds left in the phase; NaN: not known."""


@dataclass(frozen=True, kw_only=True)
class FramesDone(Event, kind="frames"):
    """Frames of a video were chosen and written."""

    frames: int
    total: int
    """Frames of the video."""
    blurred: int
    repeated: int
    seconds: float
    path: str
    """Folder of the frames."""


@dataclass(frozen=True, kw_only=True)
class FrameStarted(Event, kind="frame"):
    """A sequence begins a frame, whose own events follow until `done`."""

    frame: int
    """Number of the frame."""
    place: int
    """Position of the frame, from 1."""
    frames: int
    """Number of all frames."""
    output: str
    """Folder of its results."""
    iterations: int
    start: str
    """PLY of the previous frame, used as its initial splats; empty: its own points."""
    complete: bool = False
    """It was completed before, so no events of its own follow."""


@dataclass(frozen=True, kw_only=True)
class SequenceDone(Event, kind="sequence"):
    """A sequence ended; `reason` is finished, or why it was stopped."""

    reason: str
    frames: int
    """Number of completed frames."""
    path: str
    """The list of frames, sequence.json."""
    train_seconds: float
    metrics: dict[str, Any] = field(default_factory=dict)


def strict_json(value: Any) -> str:
    """One line of strict JSON without the newline; NaN and infinities become null."""
    return json.dumps(finite(value), allow_nan=False)


def finite(value: Any) -> Any:
    """`value` with None for NaN and infinities, at any depth."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [finite(v) for v in value]
    return value


MASKED_OF = "psnr_masked_of"
"""Key of metrics.json next to `psnr_masked`: what contains its pixels, if not masks."""


def headline_psnr(metrics: Mapping[str, Any]) -> float | None:
    """Headline PSNR of a model, dB: of the pixels inside the masks if those outside do not count
    (`psnr_masked` of metrics.json), else of all (`psnr`); None if there is none."""
    return metrics.get("psnr_masked", metrics.get("psnr"))


def to_line(event: Event) -> str:
    """The event as a line of `strict_json`."""
    data = {"event": event.kind} | asdict(event)
    if isinstance(event, Started):
        data |= {topic: event.decision(topic) for topic in TOPICS}
    return strict_json(data)


def from_line(line: str) -> Event | None:
    """Parse an event; None for other lines, since libraries print too."""
    try:
        data = parse_json(line)
    except ValueError:
        return None
    if not isinstance(data, dict):
        return None
    kind = data.pop("event", None)
    cls = KINDS.get(kind) if isinstance(kind, str) else None
    if cls is None:
        return None
    known = {name: data[name] for name in cls.__dataclass_fields__ if name in data}
    try:
        if cls is Started:
            known["decisions"] = _decisions(data)
        return cls(**known)
    except (KeyError, TypeError):
        return None


def _decisions(data: dict[str, Any]) -> list[Decision]:
    by_key = [{"topic": topic, "text": data[topic]} for topic in TOPICS if data.get(topic)]
    return [Decision(str(one["topic"]), str(one["text"])) for one in data.get("decisions", by_key)]
