"""Loading of splat files: reads and prepares them for Blender; no bpy."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from .. import attributes
from ..cameras import alignment
from ..core import POSES_FILE, GsError, Splats, read_cameras, read_moves, read_splat_file
from ..interface.option_labels import error_text
from .existing_run import content

_GROUND_POINTS = 20_000
"""Number of splats used to find the ground."""


@dataclass(frozen=True, kw_only=True)
class Loaded:
    """A loaded splat file, or the reason of a failure."""

    path: Path
    final: bool
    """True for the result, False for a snapshot."""
    problem: str = ""
    count: int = 0
    """Number of splats."""
    origin: np.ndarray | None = None
    """[3] local origin; None: there is none."""
    content: str = ""
    """`existing_run.content` of a result; empty for snapshots."""
    columns: tuple[tuple[str, str, np.ndarray], ...] = ()
    """`attributes.columns`; empty if there is a problem."""
    typical_size: float = 0.0
    """Median of the largest standard deviations, world units."""
    upright: np.ndarray | None = None
    """[4, 4] that aligns up and ground, from the cameras of the run; None: unknown."""
    moves: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Pose refinement of the run's cameras by image name, degrees and world units; of a result."""


def load(path: Path, *, most: int = 0, final: bool = False) -> Loaded:
    """Read a splat file.

    Args:
        path: The PLY.
        most: Maximum number of splats, sampled evenly and without view-dependent colour, for a
            preview during training; 0: everything.
        final: Returned in `Loaded.final`.
    """
    try:
        file = read_splat_file(path)
        splats = file.splats
        if most:
            splats = splats.subset(np.arange(0, len(splats), max(1, -(-len(splats) // most))))
            splats = replace(splats, shN=np.zeros((len(splats), 0, 3), np.float32))
        return Loaded(
            path=path,
            final=final,
            count=len(splats),
            origin=file.origin,
            content=content(path) if final else "",
            columns=tuple(attributes.columns(splats)),
            typical_size=attributes.typical_size(splats),
            upright=_upright(path, splats, file.origin),
            moves=read_moves(path.with_name(POSES_FILE)) if final else {},
        )
    except GsError as error:
        return Loaded(path=path, final=final, problem=error_text(error))
    except MemoryError:
        problem = f"{path} does not fit into memory; close other programs and import it again."
        return Loaded(path=path, final=final, problem=problem)


def _upright(path: Path, splats: Splats, origin: np.ndarray | None) -> np.ndarray | None:
    """Alignment from the cameras.json of a PLY's run, if it can be read."""
    for folder in (path.parent, path.parent.parent):
        if (folder / "cameras.json").is_file():
            try:
                cameras = read_cameras(folder / "cameras.json").of_splats(origin)
            except GsError:
                return None
            every = max(1, len(splats) // _GROUND_POINTS)
            points = splats.means[::every].astype(np.float64)
            return alignment.align(cameras.viewmats, points, cameras.up).matrix
    return None
