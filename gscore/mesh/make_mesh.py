"""Mesh of splats: views drawn, fused into a volume, contoured and cleaned."""

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ..camera_neighbours import pairs_with_views_between
from ..config import checked_threads
from ..errors import Cancelled, ConfigError, DatasetError
from ..events import seconds_left
from ..extras import need
from ..io.system_memory import available_memory_bytes
from ..quoting import quoted
from ..raster.api import Rendered, render_camera
from ..sampling import evenly_spaced
from ..scene import Cameras
from ..splats import Splats
from ..text_format import size_text
from ..transforms import quat_to_rotmat, rotmat_to_quat, unit_quats
from .clean import close_holes, reduced, smoothed, used, without_small_parts
from .contour import PURPOSE, contour
from .surface_mesh import SurfaceMesh
from .surface_view import pixel_rays, sure_depth, surface_view
from .texture import Photo, textured
from .volume import (
    BLOCK_BYTES,
    REACH,
    TRUNCATION,
    SurfaceView,
    Volume,
    blocks_near,
    of_double_voxels,
)

HOLES = ("open", "small", "closed")
"""Treatments of holes; `small` closes those of up to `SMALL_HOLE` edges."""
SMALL_HOLE = 80
"""Edges around a hole that no photo can be expected to have left."""
TEXTURED = 50_000
"""Triangles of a textured mesh where no number is requested."""
LARGEST_TEXTURE = 8192
"""Largest side of a texture, px."""
_PIXELS = 2.0
"""Voxel size in pixels' widths on the nearer surfaces: smaller ones leave holes unless splats are
flat."""
_SMOOTH, _SMOOTHEST = 30, 300
"""Steps of smoothing at voxels of `_PIXELS`, and most steps at smaller ones."""
_NEARER = 0.25
"""Share of the seen surfaces that are the nearer ones."""
_FAR = 2.0
"""Farthest fused depth, multiples of that of the nearer surfaces: beyond it pixels are wider than
voxels."""
_COARSE = 2
"""Divisor of the pictures by which blocks are allocated: with smaller ones, surfaces between thin
parts have no pixel away from a silhouette, and no blocks."""
_SAMPLED = 12
"""Views that choose the voxel size and the farthest depth."""
_COMPARED = 5000
"""Points of a sampled view that are compared with the mesh."""
_SPREAD = 2.0
"""Largest difference of mean and median depth, truncations."""
_SHARE = 0.25
"""Share of the free memory that the volume takes at most."""
_DEFAULT_MEMORY = 2e9
"""Memory for the volume where that of the system is unknown."""
_MOST_BETWEEN = 1.0
"""Most views between photos, per photo."""


@dataclass(frozen=True, kw_only=True)
class MeshRequest:
    """Options of a mesh.

    Raises:
        ConfigError: a value is out of range.
    """

    voxel: float | None = None
    """Distance between voxels, world units; None: two pixels, or more to fit into memory."""
    far: float | None = None
    """Farthest depth that is fused, world units; None: twice that of the nearer surfaces."""
    region: np.ndarray | None = None
    """[4, 4] float64, maps the cube [-1, 1]^3 to the box that is kept, in the world of the splats;
    None: everything."""
    between: bool = False
    """Use views between neighbouring photos too."""
    holes: str = "small"
    """One of `HOLES`."""
    min_part: float = 0.01
    """Least part that is kept, as a share of the largest one's triangles."""
    smooth: int | None = None
    """Steps of smoothing; None: by the size of voxels in pixels, see `_Scale.smooth`."""
    triangles: int | None = None
    """Number of triangles; None: all."""
    texture: int | None = None
    """Side of a texture baked from the photos, px; None: colours at vertices. Where `triangles` is
    None, the mesh is reduced to `TEXTURED` ones, as an atlas of more takes minutes."""
    memory: float | None = None
    """Most bytes of the volume; None: a quarter of the free memory."""

    def __post_init__(self) -> None:
        for name in ("voxel", "far", "memory"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise ConfigError(f"`--{name}` must be above 0, got {value:g}.")
        if self.holes not in HOLES:
            raise ConfigError(f"`--holes` is {', '.join(HOLES)}, got {quoted(self.holes)}.")
        if not 0 <= self.min_part <= 1:
            raise ConfigError(f"`--min-part` must be from 0 to 1, got {self.min_part:g}.")
        if self.smooth is not None and not 0 <= self.smooth <= 1000:
            raise ConfigError(f"`--smooth` must be from 0 to 1000, got {self.smooth}.")
        if self.triangles is not None and self.triangles < 4:
            raise ConfigError(f"`--triangles` must be at least 4, got {self.triangles}.")
        if self.texture is not None and not 16 <= self.texture <= LARGEST_TEXTURE:
            raise ConfigError(
                f"`--texture` must be from 16 to {LARGEST_TEXTURE} px, got {self.texture}."
            )

    @property
    def most(self) -> int | None:
        """Triangles to keep; None: all."""
        return TEXTURED if self.texture and self.triangles is None else self.triangles


Report = Callable[[str, int, int, float], None]
"""Receives phase, completed and all steps of the phase, and seconds left in it (NaN: unknown)."""


def make_mesh(
    splats: Splats,
    cameras: Cameras,
    request: MeshRequest | None = None,
    *,
    masks: Callable[[int], np.ndarray | None] = lambda index: None,
    mask_mode: str = "none",
    photos: Callable[[int], Photo] | None = None,
    origin: np.ndarray | None = None,
    report: Report = lambda phase, done, total, eta: None,
    on_plan: Callable[[dict[str, Any]], None] = lambda facts: None,
    cancelled: Callable[[], bool] = lambda: False,
    threads: int = 0,
    **how: Any,
) -> SurfaceMesh:
    """The surface of splats in the pictures of cameras, as triangles with colours.

    Median depths and normals of the cameras are fused into truncated signed distances (Curless and
    Levoy 1996), whose zero level is contoured (Lorensen and Cline 1987; Lewiner et al. 2003).

    Args:
        splats: The model.
        cameras: Cameras in its world; each picture has its camera's size.
        request: What mesh; None: the defaults.
        masks: Returns the mask of a camera, [H, W] uint8, 255 = keep, or None.
        mask_mode: `composite`: nothing is where masks hide; `ignore`: they hide what is not to be
            used; `none`.
        photos: Returns the photo of a camera, for a texture.
        origin: [3], local origin of the splats in the coordinates of the capture, for the result.
        report: Receives the progress.
        on_plan: Receives the figures of the volume before it is allocated, those of
            `SurfaceMesh.facts`.
        cancelled: Polled between steps; True stops.
        threads: CPU threads; 0: all cores. The result has the same bits for any number.
        how: Arguments of `gscore.render`: near, antialias, device.

    Raises:
        BackendError: a package is missing, or the device cannot draw.
        Cancelled: `cancelled` returned True.
        ConfigError: the volume does not fit into memory.
        DatasetError: there are no cameras, or no surface in their pictures.
    """
    request = request or MeshRequest()
    need("skimage.measure", PURPOSE)
    if request.most is not None:
        need("fast_simplification", "A reduced mesh")
    if request.texture is not None:
        need("xatlas", "A texture")
        if photos is None:
            raise ConfigError("`--texture` needs the photos of the capture; give it with -s.")
    if not len(cameras):
        raise DatasetError("There are no cameras to render depths from; give a capture with some.")
    steps = _Steps(report, cancelled)
    count = len(cameras)
    if request.between and mask_mode == "none":
        cameras = _with_between(cameras)
    draw = _Draw(splats, cameras, {**how, "threads": threads})
    scale, seen = _measured(draw, masks, mask_mode, request, steps)
    keys, scale = _allocated(draw, masks, mask_mode, request, scale, steps)
    facts = {
        "voxel": scale.voxel,
        "far": scale.far,
        "views": len(cameras),
        "blocks": len(keys),
        "volume_bytes": len(keys) * BLOCK_BYTES,
    }
    on_plan(facts)
    volume = Volume(keys, scale.voxel)
    with ThreadPoolExecutor(checked_threads(threads) or None) as pool:
        for index in steps.count("fusing", range(len(cameras))):
            mask = _mask(masks, mask_mode, index)
            volume.fuse(_view(draw, index, scale, mask, hides=mask_mode == "composite"), pool)
    mesh, covered = _surface(volume, request, scale, seen, steps)
    if request.texture is not None and photos is not None:
        steps.report("unwrapping")
        shown = cameras.subset(range(count))
        baking = partial(steps.count, "baking")
        mesh = textured(mesh, shown, photos, request.texture, scale.voxel, baking)
    return replace(mesh, origin=origin, facts=facts | {"covered": covered})


class _Steps:
    """Progress and cancellation."""

    def __init__(self, report: Report, cancelled: Callable[[], bool]) -> None:
        self._report, self._cancelled = report, cancelled

    def report(self, phase: str, done: int = 0, total: int = 0, left: float = math.nan) -> None:
        """The progress of a phase; it has just begun where nothing is done."""
        if self._cancelled():
            raise Cancelled("Making the mesh was stopped.")
        self._report(phase, done, total, left)

    def count(self, phase: str, items: Sequence[int]):
        """Yield the items of a phase, with progress after each."""
        self.report(phase, 0, len(items))
        began = time.monotonic()
        for done, item in enumerate(items, start=1):
            yield item
            self.report(phase, done, len(items), seconds_left(began, done, len(items)))


@dataclass(frozen=True)
class _Draw:
    """Pictures of the cameras."""

    splats: Splats
    cameras: Cameras
    how: dict[str, Any]

    def whole(self, index: int) -> Rendered:
        """The picture with depths and normals."""
        return render_camera(
            self.splats, self.cameras, index, depths=True, normals=True, **self.how
        )

    def coarse(
        self, index: int, *, spread: float = math.inf, far: float = math.inf
    ) -> tuple[np.ndarray, np.ndarray]:
        """K [3, 3] of a small picture and its depth, see `sure_depth`."""
        one = self.cameras.subset([index])
        sizes = [np.maximum(side // _COARSE, 1) for side in (one.widths, one.heights)]
        Ks = one.Ks.copy()
        Ks[:, 0] *= sizes[0][0] / one.widths[0]
        Ks[:, 1] *= sizes[1][0] / one.heights[0]
        small = replace(one, Ks=Ks, widths=sizes[0], heights=sizes[1])
        drawn = render_camera(self.splats, small, 0, depths=True, **self.how)
        return Ks[0], sure_depth(drawn, Ks[0], spread=spread, far=far)


@dataclass(frozen=True, kw_only=True)
class _Scale:
    """Sizes in world units."""

    voxel: float
    far: float
    pixel: float
    """Width of a pixel on the nearer surfaces."""

    @property
    def smooth(self) -> int:
        """Steps of smoothing. Noise of depths has a size in pixels, and the reach of smoothing
        grows with the voxel and with the root of the steps."""
        return round(min(_SMOOTH * max(_PIXELS * self.pixel / self.voxel, 1) ** 2, _SMOOTHEST))

    @property
    def spread(self) -> float:
        """Largest difference of mean and median depth."""
        return _SPREAD * TRUNCATION * self.voxel


def _measured(
    draw: _Draw,
    masks: Callable[[int], np.ndarray | None],
    mask_mode: str,
    request: MeshRequest,
    steps: _Steps,
) -> tuple[_Scale, np.ndarray]:
    """The scale, and points [P, 3] of the surfaces in some views, at any depth."""
    chosen = evenly_spaced(range(len(draw.cameras)), _SAMPLED)
    depths, widths, points = [], [], []
    for index in steps.count("measuring", chosen):
        K, depth = draw.coarse(index)
        depths.append(depth[depth > 0])
        widths.append(depths[-1] / (K[0, 0] * _COARSE))
        found = _points(draw.cameras.viewmats[index], K, depth, _mask(masks, mask_mode, index))
        points.append(found[:: max(1, len(found) // _COMPARED)])
    seen = np.concatenate(depths)
    if not len(seen):
        raise DatasetError(
            "The cameras show no surface: the splats are transparent, or outside the pictures. "
            "Give the capture of these splats."
        )
    near = float(np.quantile(seen, _NEARER))
    width = float(np.quantile(np.concatenate(widths), _NEARER))
    voxel, far = request.voxel or _PIXELS * width, request.far or _FAR * near
    return _Scale(voxel=voxel, far=far, pixel=width), np.concatenate(points)


def _allocated(
    draw: _Draw,
    masks: Callable[[int], np.ndarray | None],
    mask_mode: str,
    request: MeshRequest,
    scale: _Scale,
    steps: _Steps,
) -> tuple[np.ndarray, _Scale]:
    """Keys of the blocks near surfaces, and the scale, whose voxel fits into memory."""
    limit = request.memory
    if limit is None:
        limit = _SHARE * (available_memory_bytes() or _DEFAULT_MEMORY / _SHARE)
    keys = np.zeros(0, np.int64)
    for index in steps.count("looking for surfaces", range(len(draw.cameras))):
        K, depth = draw.coarse(index, spread=scale.spread, far=scale.far)
        mask = _mask(masks, mask_mode, index)
        points = _points(draw.cameras.viewmats[index], K, depth, mask)
        if request.region is not None:
            points = points[_inside(points, request.region, slack=2 * scale.voxel)]
        while len(points) and np.abs(points).max() >= REACH * scale.voxel:
            keys, scale = _coarser(keys, scale, request, "the scene is too large for it")
        keys = np.union1d(keys, blocks_near(points, scale.voxel))
        while len(keys) * BLOCK_BYTES > limit:
            why = f"its volume takes more than {size_text(int(limit))} of memory"
            keys, scale = _coarser(keys, scale, request, why)
    if not len(keys):
        raise DatasetError(
            "The cameras show no surface within the region, the masks and the farthest depth; "
            "check these options."
        )
    return keys, scale


def _coarser(
    keys: np.ndarray, scale: _Scale, request: MeshRequest, why: str
) -> tuple[np.ndarray, _Scale]:
    if request.voxel is not None:
        raise ConfigError(
            f"`--voxel {request.voxel:g}` is too small: {why}. Give {2 * scale.voxel:g} or more, a "
            "smaller `--region`, or leave it out."
        )
    if 2 * scale.voxel > scale.far:
        raise ConfigError(
            f"No voxel fits: {why}. Give more `--memory`, a smaller `--region`, or a shorter "
            "`--far`."
        )
    return of_double_voxels(keys), replace(scale, voxel=2 * scale.voxel)


def _mask(
    masks: Callable[[int], np.ndarray | None], mask_mode: str, index: int
) -> np.ndarray | None:
    return masks(index) if mask_mode != "none" else None  # there are masks of photos alone


def _points(
    viewmat: np.ndarray, K: np.ndarray, depth: np.ndarray, mask: np.ndarray | None
) -> np.ndarray:
    """[P, 3] float64, world, surface points of a small picture where a mask keeps them."""
    sure = depth > 0
    if mask is not None:
        rows = ((np.arange(len(depth)) + 0.5) * mask.shape[0] / len(depth)).astype(int)
        columns = ((np.arange(depth.shape[1]) + 0.5) * mask.shape[1] / depth.shape[1]).astype(int)
        sure &= mask[rows[:, None], columns] >= 128
    points = (pixel_rays(K, *depth.shape) * depth[..., None])[sure].astype(np.float64)
    return (points - viewmat[:3, 3]) @ viewmat[:3, :3]


def _inside(points: np.ndarray, region: np.ndarray, *, slack: float = 0.0) -> np.ndarray:
    """[P] bool, the points within `slack` world units of a region's box."""
    inverse = np.linalg.inv(region)
    local = points @ inverse[:3, :3].T + inverse[:3, 3]
    most = 1 + slack * np.linalg.norm(inverse[:3, :3], axis=1)
    return np.asarray((np.abs(local) <= most).all(axis=1))


def _view(
    draw: _Draw, index: int, scale: _Scale, mask: np.ndarray | None, *, hides: bool
) -> SurfaceView:
    K, viewmat = draw.cameras.Ks[index], draw.cameras.viewmats[index]
    how = {"spread": scale.spread, "far": scale.far, "mask": mask, "hides": hides}
    return surface_view(draw.whole(index), K, viewmat, **how)


def _surface(
    volume: Volume, request: MeshRequest, scale: _Scale, seen: np.ndarray, steps: _Steps
) -> tuple[SurfaceMesh, float | None]:
    """The contoured and cleaned surface of a volume, and the share of the points `seen` [P, 3] on
    it; None: there are none."""
    from scipy.spatial import KDTree

    steps.report("contouring")
    vertices, triangles, colors = contour(volume, partial(steps.report, "contouring"))
    if request.region is not None and len(vertices):
        inside = _inside(vertices, request.region)
        triangles = triangles[inside[triangles].all(axis=1)]
        seen = seen[_inside(seen, request.region)]
    steps.report("cleaning")
    triangles = without_small_parts(vertices, triangles, request.min_part)
    if not len(triangles):
        raise DatasetError(
            f"No surface was found with voxels of {volume.voxel:g} world units: give a smaller "
            "`--voxel`, or check the region."
        )
    rows, triangles = used(vertices, triangles)
    vertices, colors = vertices[rows], colors[rows]
    if request.holes != "open":
        steps.report("closing holes")
        most = SMALL_HOLE if request.holes == "small" else None
        added, filling = close_holes(vertices, triangles, most)
        vertices = np.concatenate([vertices, added])
        triangles = np.concatenate([triangles, filling])
    source = KDTree(vertices[: len(colors)])
    covered = None
    if len(seen):
        distances = source.query(seen, distance_upper_bound=volume.truncation)[0]
        covered = float(np.isfinite(distances).mean())
    smooth = scale.smooth if request.smooth is None else request.smooth
    if smooth:
        steps.report("smoothing")
        vertices = smoothed(vertices, triangles, smooth)
    if request.most is not None:
        steps.report("reducing")
        vertices, triangles = reduced(vertices, triangles, request.most)
        rows, triangles = used(vertices, triangles)
        vertices = vertices[rows]
    if len(vertices) != len(colors):
        colors = colors[source.query(vertices)[1]]
    return SurfaceMesh(vertices=vertices, triangles=triangles, colors=colors), covered


def _with_between(cameras: Cameras) -> Cameras:
    """The cameras, and one in the middle of each pair of neighbours, at most one per camera."""
    pairs = list(pairs_with_views_between(cameras, range(len(cameras))))
    most = round(_MOST_BETWEEN * len(cameras))
    pairs = pairs[:: max(1, -(-len(pairs) // most))]
    if not pairs:
        return cameras
    a, b = np.array(pairs).T
    quats = rotmat_to_quat(cameras.viewmats[:, :3, :3])
    same = np.sign((quats[a] * quats[b]).sum(axis=1, keepdims=True))
    R = quat_to_rotmat(unit_quats(quats[a] + np.where(same < 0, -1, 1) * quats[b]))
    viewmats = np.tile(np.eye(4), (len(pairs), 1, 1))
    viewmats[:, :3, :3] = R
    centers = (cameras.centers[a] + cameras.centers[b]) / 2
    viewmats[:, :3, 3] = -np.einsum("nij,nj->ni", R, centers)
    more = cameras.subset(a.tolist())
    return replace(
        cameras,
        viewmats=np.concatenate([cameras.viewmats, viewmats]),
        Ks=np.concatenate([cameras.Ks, more.Ks]),
        widths=np.concatenate([cameras.widths, more.widths]),
        heights=np.concatenate([cameras.heights, more.heights]),
        names=(*cameras.names, *(f"between_{i}" for i in range(len(pairs)))),
    )
