"""metrics.json: what a run reached, how it was measured and on what machine."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .._version import __version__
from ..io.files import atomic_write
from .machine import machine, peak_memory_bytes

HISTORY = ("step", "elapsed_s", "loss", "psnr", "splats", "photo_factor")
"""Keys of a row of the history."""
_LISTS = frozenset({"views", "train_views", "test_views", "history", "evals"})


def summarize(
    evaluation: dict[str, Any],
    *,
    split: str,
    train_views: Sequence[str],
    test_views: Sequence[str],
    mask_mode: str,
    background: Sequence[float],
    splats: int,
    sh_degree: int,
    storage_bytes: int,
    steps: int | None,
    train_seconds: float | None,
    reason: str | None = None,
    trained_at: str | None = None,
    isa: str,
    threads: int,
    history: Sequence[dict[str, Any]] = (),
    evals: Sequence[dict[str, Any]] = (),
) -> dict[str, Any]:
    """The content of metrics.json.

    Args:
        evaluation: Result of `evaluate`.
        split: `test` if the scored views were held out of the training, `train` if not, `all` for
            views of both kinds.
        train_views, test_views: Names of the views of both splits.
        mask_mode, background: How masks counted, as in `evaluate`.
        splats, sh_degree: Size of the model.
        storage_bytes: Size of its PLY.
        steps, train_seconds: Length of the training without evaluation; None if not known.
        reason: Why the training ended, as in `events.Done`; None if not known.
        trained_at: When it ended, as ISO 8601 with the time zone; None if not known.
        isa, threads: What the rasterizer ran with.
        history: Fields of `events.Progress` over the training, and `photo_factor`, what the sides
            of the photos were divided by; those in `HISTORY` are kept.
        evals: {"step", "elapsed_s", "psnr"} measured on the same split during the training.

    Returns:
        Means first (psnr, psnr_u8, psnr_cc, ssim, ssim_valid, d_ssim, ms_ssim, lpips, lpips_net,
        lpips_<net>, fps), then the model, the training, peak_memory_bytes of this process, the
        split, the machine, one entry a view under `views`, and `history` and `evals`. A value that
        is not known is None; `<key>_reason` says why.
    """
    return {
        **evaluation["mean"],
        "splats": splats,
        "sh_degree": sh_degree,
        "storage_bytes": storage_bytes,
        "steps": steps,
        "train_seconds": train_seconds,
        "reason": reason,
        "trained_at": trained_at,
        "peak_memory_bytes": peak_memory_bytes(),
        "split": split,
        "train_views": list(train_views),
        "test_views": list(test_views),
        "mask_mode": mask_mode,
        "background": [float(x) for x in background],
        "gscore": __version__,
        "machine": machine() | {"isa": isa, "threads": threads},
        "views": evaluation["views"],
        "history": [{key: _finite(row.get(key)) for key in HISTORY} for row in history],
        "evals": [dict(row) for row in evals],
    }


def _finite(value: Any) -> Any:
    """Six digits of a float, None for one that is not finite: JSON has no NaN."""
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value


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
