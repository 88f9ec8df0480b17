"""Search for an imported capture in a scene, and its differences from the files."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import bpy
import numpy as np

from .. import stored_paths
from ..capture.folders import same_folder
from ..core import offset_between, origin_text
from ..interface.blocks import first_few
from . import objects as co
from .capture_transform import noted_origin
from .lookup import roots_of
from .reading import ReadCamera

_SAMPLES = 20
"""Number of compared cameras to detect a changed world of the files."""


@dataclass(frozen=True, kw_only=True)
class Present:
    """A capture in the scene."""

    root: bpy.types.Object
    cameras: list[bpy.types.Object]
    """Cameras by image name."""
    points: bpy.types.Object | None


def find_present(scene: bpy.types.Scene, source: Path, into: int) -> Present | None:
    """A capture of a scene that is local to this file, without overrides.

    Args:
        scene: The scene.
        source: Folder that it was imported from.
        into: Session uid of the capture's empty; 0: any capture of that folder.
    """
    roots = roots_of(scene)
    chosen = [root for root in roots if root.session_uid == into]
    sources = ((root, stored_paths.read(root, stored_paths.SOURCE)) for root in roots)
    of_folder = (root for root, own in sources if own and same_folder(Path(own), source))
    for root in chain(chosen, of_folder):
        cameras, points = co.parts_of(root)
        obs = [root, *cameras, *filter(None, [points])]
        blocks = [*obs, *(ob.data for ob in obs if ob.data is not None)]
        if all(block.library is None and block.override_library is None for block in blocks):
            return Present(root=root, cameras=cameras, points=points)
    return None


def uid_of(there: Present | None) -> int:
    """Session uid of its empty; 0: none."""
    return 0 if there is None else there.root.session_uid


def known_origins(scene: bpy.types.Scene, into: int) -> list[tuple[Path | None, np.ndarray]]:
    """Local origins of the captures of a scene, for `reading.read`."""
    origins: list[tuple[Path | None, np.ndarray]] = []
    for root in roots_of(scene):
        source = stored_paths.read(root, stored_paths.SOURCE)
        folder = None if root.session_uid == into else Path(source)
        if source or folder is None:
            origins.append((folder, offset_between(noted_origin(root), None)))
    return sorted(origins, key=lambda one: one[0] is not None)


def other_origins(scene: bpy.types.Scene, root: bpy.types.Object) -> tuple[str, ...]:
    """Warning if the captures of a scene have different local origins."""
    own = noted_origin(root)
    for other in roots_of(scene):
        apart = offset_between(own, noted_origin(other))
        if other != root and apart.any():
            at, distance = map(origin_text, (offset_between(own, None), apart))
            return (
                f"{root.name} has the local origin {at}, at {distance} from that of {other.name}: "
                f"both are placed near the scene's origin, not in their true relation.",
            )
    return ()


def in_another_world(
    cameras: Sequence[ReadCamera], there: dict[str, bpy.types.Object]
) -> tuple[str, ...]:
    """Warning if most camera poses differ from the imported ones."""
    known = [one.setup.own for one in cameras if one.setup.own.image in there]
    some = known[:: max(1, len(known) // _SAMPLES)]
    moved = 0
    for own in some:
        before = np.array(there[own.image].get("gs_viewmat", ()), np.float64)
        moved += before.shape != (16,) or not np.allclose(before, own.viewmat.ravel(), atol=1e-4)
    if 2 * moved <= len(some):
        return ()
    return (
        "The camera poses in the files have changed. Use Align to Ground again; splats trained "
        "before may no longer fit.",
    )


def constrained_warning(cameras: list[bpy.types.Object]) -> tuple[str, ...]:
    """Warning if constraints or animation also move a camera."""
    names = sorted(ob.name for ob in cameras if not co.is_plain_child(ob))
    if not names:
        return ()
    return (
        f"Keyframes, drivers or constraints may move cameras away from the poses of their photos: "
        f"{first_few(names)}. Clear them, or renders and exports use the moved poses.",
    )
