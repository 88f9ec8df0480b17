"""Summary of metrics: metrics.json, with results, method and machine of a run."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from .._version import __version__
from ..events import Decision
from ..io.files import atomic_write
from .evaluate import Evaluation
from .machine import machine, peak_memory_bytes

_LISTS = frozenset(
    (
        "views",
        "train_views",
        "test_views",
        "history",
        "evals",
        "decided",
        "decisions",
        "trust",
        "blurs",
        "transients",
    )
)
_PARTS = (
    "device_peak_bytes",
    "models",
    "depth",
    "exposure",
    "poses",
    "blurs",
    "transients",
    "ranks",
    "asked",
)
"""Fields of a `Course` that are omitted when empty."""


@dataclass(frozen=True, kw_only=True)
class Course:
    """Facts of a training that a later evaluation cannot measure. None: unknown."""

    steps: int | None = None
    train_seconds: float | None = None
    """Training time without evaluation, s."""
    reason: str | None = None
    """Why it ended, as in `events.Done`."""
    trained_at: str | None = None
    """Time of its end, ISO 8601 with the time zone."""
    history: Sequence[dict[str, Any]] = ()
    """Fields of `events.Progress` over the training, and `photo_factor`, the divisor of the photos'
    sides."""
    evals: Sequence[dict[str, Any]] = ()
    """{"step", "elapsed_s", "psnr"}, measured on the same split during the training."""
    peak_memory_bytes: int | None = None
    """Peak memory of the training, bytes; None: use that of this process."""
    device_peak_bytes: int | None = None
    """Peak memory of the device that trained, bytes; None: it has none of its own."""
    models: int | None = None
    """Number of models merged into one; None: a single model."""
    depth: dict[str, Any] | None = None
    """Numbers of `DepthReport`; None: there were no maps."""
    exposure: dict[str, Any] | None = None
    """Spread of the exposure of photos; None: not measured."""
    poses: dict[str, Any] | None = None
    """Corrections of the training cameras' poses, and the reason; None: no correction."""
    blurs: Mapping[str, float] | None = None
    """Standard deviations of the blurred training photos, px at full size, by name; None: no
    blurred photos were found."""
    transients: Mapping[str, float] | None = None
    """Shares of training photos that were left out as transient, by name; None: there were none."""
    ranks: dict[str, Any] | None = None
    """Distributed training: `count`, `batches` since the start or the last resumption, and per rank
    the bytes sent, working time and waiting time per batch."""
    decisions: Sequence[Decision] = ()
    """Decisions of the run for its photos and options; empty: none, or unknown."""
    asked: Mapping[str, int] | None = None
    """Requested values of options that were limited by the number of photos; None: none was."""

    @classmethod
    def of_file(cls, metrics: Mapping[str, Any]) -> "Course":
        """Course from the metrics.json of a training, as returned by `read_metrics`."""
        names = [each.name for each in fields(cls) if metrics.get(each.name) is not None]
        values: dict[str, Any] = {name: metrics[name] for name in names}
        values["decisions"] = _decisions_of(metrics)
        return cls(**values)


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """Contents of metrics.json."""

    evaluation: Evaluation
    split: str
    """`test` if the scored views were held out of the training, `train` if not, `all` for both."""
    train_views: Sequence[str]
    """Names."""
    test_views: Sequence[str]
    """Names."""
    mask_mode: str
    """Meaning of masks, as in `evaluate`."""
    background: Sequence[float]
    """RGB in [0, 1], as in `evaluate`."""
    splats: int
    sh_degree: int
    storage_bytes: int
    """Size of the PLY."""
    isa: str
    """Instruction set of the rasterizer."""
    threads: int
    course: Course = field(default_factory=Course)
    model: str = ""
    """Path of the splats, if metrics.json is not in the folder of their run; else empty."""

    def content(self) -> dict[str, Any]:
        """Contents of the file: means first (psnr, psnr_u8, psnr_cc, ssim, ssim_cc, ssim_valid,
        d_ssim, ms_ssim, lpips, lpips_cc, lpips_net, lpips_<net>, fps), then model, training, split,
        machine, views, curves and depth. An unknown value is None, with its reason in
        `<key>_reason`."""
        course = self.course
        content = {
            **self.evaluation.mean,
            "splats": self.splats,
            "sh_degree": self.sh_degree,
            "storage_bytes": self.storage_bytes,
            "steps": course.steps,
            "train_seconds": course.train_seconds,
            "reason": course.reason,
            "trained_at": course.trained_at,
            "peak_memory_bytes": course.peak_memory_bytes or peak_memory_bytes(),
            "split": self.split,
            "train_views": list(self.train_views),
            "test_views": list(self.test_views),
            "mask_mode": self.mask_mode,
            "background": [float(x) for x in self.background],
            "gscore": __version__,
            "machine": machine() | {"isa": self.isa, "threads": self.threads},
            "views": self.evaluation.views,
            "history": [_finite_row(row) for row in course.history],
            "evals": [dict(row) for row in course.evals],
        }
        parts = {name: getattr(course, name) for name in _PARTS}
        parts["model"] = self.model or None
        if course.decisions:
            # `decided` is for readers of versions without `decisions`.
            parts["decided"] = [one.text for one in course.decisions]
            parts["decisions"] = [asdict(one) for one in course.decisions]
        return content | {key: part for key, part in parts.items() if part is not None}


def _decisions_of(metrics: Mapping[str, Any]) -> list[Decision]:
    """Decisions of a metrics.json. A version without `decisions` stored texts alone, some of them
    again as the reason of a part, which gives their topic."""
    if metrics.get("decisions") is not None:
        return [Decision(one["topic"], one["text"]) for one in metrics["decisions"]]
    reasons = {
        part: (metrics.get(part) or {}).get("why") for part in ("depth", "exposure", "poses")
    }
    return [
        Decision(next((part for part, why in reasons.items() if why == text), ""), text)
        for text in metrics.get("decided") or ()
    ]


def _finite_row(row: dict[str, Any]) -> dict[str, Any]:
    """The row with None in place of numbers that are not finite, for JSON."""
    odd = {k for k, v in row.items() if isinstance(v, float) and not math.isfinite(v)}
    return {key: None if key in odd else value for key, value in row.items()}


def headline(metrics: dict[str, Any]) -> dict[str, Any]:
    """metrics.json for `--json`, without long lists, also in depth and poses."""
    short = {key: value for key, value in metrics.items() if key not in _LISTS}
    if "depth" in short:
        short["depth"] = {k: v for k, v in short["depth"].items() if k not in _LISTS}
    if "poses" in short:
        short["poses"] = {k: v for k, v in short["poses"].items() if k != "cameras"}
    return short


def write_metrics(path: Path, metrics: dict[str, Any]) -> None:
    """Write metrics.json atomically, as strict JSON.

    Raises:
        GsError: The file cannot be written.
    """
    atomic_write(path, (json.dumps(metrics, indent=1, allow_nan=False) + "\n").encode())
