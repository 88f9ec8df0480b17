"""Memory bench: peak memory of a whole training on a synthetic capture, in this process."""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..config import DataConfig, TrainConfig
from ..events import Estimated, Event
from ..io.ply.splats import write_splats
from ..metrics.machine import peak_memory_bytes
from ..splats import SH_REST_BY_DEGREE
from ..trainer.run import train
from .child_process import run_child
from .synthetic import SyntheticPhotos

MIN_STEPS = 10
"""So that refinements, a snapshot and a checkpoint each have a step of their own."""
_REFINEMENTS = 3
"""One after the other in the middle of the run: each moves all rows about."""

_WRITER = """
import sys
from pathlib import Path
from gscore.bench.memory import write_capture
write_capture(Path(sys.argv[1]), *map(int, sys.argv[2:]))
"""


@dataclass(frozen=True, kw_only=True)
class MemoryBench:
    """Memory of a run and its parts."""

    splats: int
    views: int
    width: int
    """Of each view, px."""
    height: int
    steps: int
    said_bytes: int
    """Told before the run."""
    peak_bytes: int
    """Largest resident memory."""
    parts: dict[str, int]
    """Bytes at that moment: what the process took before the run, photos, parameters, their
    gradients and moments, and the rest, most of which is the rasterizer's."""


def bench_memory(
    *,
    splats: int,
    views: int,
    width: int,
    height: int,
    steps: int = 40,
    threads: int = 0,
    on_event: Callable[[Event], None] | None = None,
) -> MemoryBench | None:
    """Train for some steps at full size from given splats of SH degree 3, with refinements,
    snapshots, checkpoints and an evaluation: everything that a long run does.

    Call it once in a process that did nothing else: the peak is that of the process so far.

    Args:
        splats: In the cloud, and at most in the training.
        views: Photos of it, of which every eighth is held out.
        width: Of each, px.
        height: Of each, px.
        steps: Of the training, at least MIN_STEPS.
        threads: 0: all cores.
        on_event: Told of the run.

    Returns:
        What was found; None where the system does not tell a process's memory.
    """
    before = peak_memory_bytes()
    said: list[int] = []

    def tell(event: Event) -> None:
        if isinstance(event, Estimated):
            said.append(event.peak_bytes)
        if on_event is not None:
            on_event(event)

    with tempfile.TemporaryDirectory(prefix="gscore-") as name:
        folder = Path(name)
        # In another process, whose memory does not count.
        values = [str(value) for value in (folder, splats, views, width, height)]
        run_child(["-c", _WRITER, *values], what="writes the capture")
        config = TrainConfig(
            iterations=steps,
            max_splats=splats,
            sh_degree=3,
            start_splats=folder / "splats.ply",
            refine_start=steps // 2,
            refine_stop=steps // 2 + _REFINEMENTS,
            refine_every=1,
            coarse_factor=1.0,
            snapshot_every=steps // 2 + 1,
            checkpoint_iterations=(steps // 2 + 2,),
            threads=threads,
        )
        data = DataConfig(source=folder / "capture", resolution=1, eval=True)
        train(config, data, folder / "out", tell)
    peak = peak_memory_bytes()
    if peak is None or before is None:
        return None
    numbers = 4 * splats * (11 + 3 * (1 + SH_REST_BY_DEGREE[3]))
    parts = {
        "before the run": before,
        "photos": 3 * views * width * height,
        "parameters": numbers,
        "gradients": numbers,
        "moments": 2 * numbers,
    }
    return MemoryBench(
        splats=splats,
        views=views,
        width=width,
        height=height,
        steps=steps,
        said_bytes=said[0],
        peak_bytes=peak,
        parts=parts | {"the rest": peak - sum(parts.values())},
    )


def write_capture(folder: Path, splats: int, views: int, width: int, height: int) -> None:
    """Write `splats.ply` and `capture` with photos of it into a folder; arguments as those of
    `bench_memory`."""
    photos = SyntheticPhotos(splats, width, height)
    write_splats(folder / "splats.ply", photos.splats)
    photos.write(folder / "capture", views)
