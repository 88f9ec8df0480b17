"""metrics.json: what a run reached, how it was measured and on what machine."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .._version import __version__
from ..io.files import atomic_write
from .machine import machine, peak_memory_bytes


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
    isa: str,
    threads: int,
) -> dict[str, Any]:
    """The content of metrics.json.

    Args:
        evaluation: Result of `evaluate`.
        split: `test` if the scored views were held out of the training, `train` if not.
        train_views, test_views: Names of the views of both splits.
        mask_mode, background: How masks counted, as in `evaluate`.
        splats, sh_degree: Size of the model.
        storage_bytes: Size of its PLY.
        steps, train_seconds: Length of the training without evaluation; None if not known.
        isa, threads: What the rasterizer ran with.

    Returns:
        Means first (psnr, psnr_u8, ssim, ssim_valid, d_ssim, ms_ssim, lpips, lpips_net,
        lpips_<net>, fps), then the model, the training, peak_memory_bytes of this process, the
        split, the machine, and one entry a view under `views`. A value that is not known is None;
        `<key>_reason` says why.
    """
    return {
        **evaluation["mean"],
        "splats": splats,
        "sh_degree": sh_degree,
        "storage_bytes": storage_bytes,
        "steps": steps,
        "train_seconds": train_seconds,
        "peak_memory_bytes": peak_memory_bytes(),
        "split": split,
        "train_views": list(train_views),
        "test_views": list(test_views),
        "mask_mode": mask_mode,
        "background": [float(x) for x in background],
        "gscore": __version__,
        "machine": machine() | {"isa": isa, "threads": threads},
        "views": evaluation["views"],
    }


def headline(metrics: dict[str, Any]) -> dict[str, Any]:
    """metrics.json without the long lists: what `--json` prints."""
    return {k: v for k, v in metrics.items() if k not in ("views", "train_views", "test_views")}


def write_metrics(path: Path, metrics: dict[str, Any]) -> None:
    """Write metrics.json completely or not at all; strict JSON, a number or null.

    Raises:
        GsError: The file cannot be written.
    """
    atomic_write(path, (json.dumps(metrics, indent=1, allow_nan=False) + "\n").encode())
