"""Summary of metrics: metrics.json, with results, method and machine of a run."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from .._version import __version__
from ..io.files import atomic_write
from .evaluate import Evaluation
from .machine import machine, peak_memory_bytes

_LISTS = frozenset({"views", "train_views", "test_views", "history", "evals", "decided"})
_PARTS = ("models", "depth", "exposure", "poses", "ranks", "decided", "asked")
"""Fields of a `Course` that are left out when empty."""


@dataclass(frozen=True, kw_only=True)
class Course:
    """How a training went: what no evaluation after it can know. None: not known."""

    steps: int | None = None
    train_seconds: float | None = None
    """Without evaluation."""
    reason: str | None = None
    """Why it ended, as in `events.Done`."""
    trained_at: str | None = None
    """When it ended, ISO 8601 with the time zone."""
    history: Sequence[dict[str, Any]] = ()
    """Fields of `events.Progress` over the training, and `photo_factor`, what the sides of the
    photos were divided by."""
    evals: Sequence[dict[str, Any]] = ()
    """{"step", "elapsed_s", "psnr"} measured on the same split during it."""
    peak_memory_bytes: int | None = None
    """None: that of this process."""
    models: int | None = None
    """How many are shown as one; None: it is one alone."""
    depth: dict[str, Any] | None = None
    """Numbers of `DepthReport`; None: there were no maps."""
    exposure: dict[str, Any] | None = None
    """Spread of the exposure of photos; None: not measured."""
    poses: dict[str, Any] | None = None
    """How far each training camera was moved, and why; None: none was."""
    ranks: dict[str, Any] | None = None
    """Where many processes trained together: `count`, `batches` that they took since the start or
    the last resumption, and of each rank what it sent, worked and waited for a batch."""

    decided: Sequence[str] | None = None
    """Sentences on what the run decided by itself, for these photos; None: not known."""
    asked: Mapping[str, int] | None = None
    """Value by option of what photos limited, before they did; None: nothing was."""

    @classmethod
    def of_file(cls, metrics: Mapping[str, Any]) -> "Course":
        """The metrics.json of a training, as returned by `read_metrics`."""
        names = (each.name for each in fields(cls))
        return cls(**{name: metrics[name] for name in names if metrics.get(name) is not None})


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """Contents of metrics.json."""

    evaluation: Evaluation
    split: str
    """`test` if the scored views were held out of the training, `train` if not, `all` for views of
    both kinds."""
    train_views: Sequence[str]
    """Names."""
    test_views: Sequence[str]
    """Names."""
    mask_mode: str
    """How masks counted, as in `evaluate`."""
    background: Sequence[float]
    """RGB in [0, 1], as in `evaluate`."""
    splats: int
    sh_degree: int
    storage_bytes: int
    """Size of the PLY."""
    isa: str
    """Settings of the rasterizer."""
    threads: int
    course: Course = field(default_factory=Course)
    model: str = ""
    """Path of the splats, where these numbers lie in another folder than their run's."""

    def content(self) -> dict[str, Any]:
        """The file: means first (psnr, psnr_u8, psnr_cc, ssim, ssim_valid, d_ssim, ms_ssim, lpips,
        lpips_net, lpips_<net>, fps), then the model, the training, the split, the machine, an entry
        a view, curves and depth. A value that is not known is None; `<key>_reason` says why."""
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
        return content | {key: part for key, part in parts.items() if part is not None}


def _finite_row(row: dict[str, Any]) -> dict[str, Any]:
    """None for numbers that are not finite: JSON has no NaN."""
    odd = {k for k, v in row.items() if isinstance(v, float) and not math.isfinite(v)}
    return {key: None if key in odd else value for key, value in row.items()}


def headline(metrics: dict[str, Any]) -> dict[str, Any]:
    """metrics.json without the long lists, those of depth and poses too: what `--json` prints."""
    short = {key: value for key, value in metrics.items() if key not in _LISTS}
    if "depth" in short:
        short["depth"] = {k: v for k, v in short["depth"].items() if k not in _LISTS}
    if "poses" in short:
        short["poses"] = {k: v for k, v in short["poses"].items() if k != "cameras"}
    return short


def write_metrics(path: Path, metrics: dict[str, Any]) -> None:
    """Write metrics.json completely or not at all; strict JSON, a number or null.

    Raises:
        GsError: The file cannot be written.
    """
    atomic_write(path, (json.dumps(metrics, indent=1, allow_nan=False) + "\n").encode())
