"""Visible splats of an object in a view: their positions, occlusion, and pixel colours."""

from collections.abc import Iterator
from dataclasses import dataclass

import bpy
import numpy as np

from .. import attributes, compat
from ..cameras.camera_math import project
from ..cameras.render_camera import RenderCamera
from ..core import Rendered, render
from ..process.incremental_tasks import Steps, run_in_thread
from ..render.viewport import smaller
from ..splats import filters, objects
from ..splats.read_chunked import read_chunked

LARGEST = 512
"""Larger side of the depth picture for the occlusion test, pixels."""
_SLACK = 4.0
"""Tolerance behind the surface in pixel widths of that picture, in addition to a splat's own size,
because surfaces are slanted."""
_BLOCK = 1 << 15
"""Splats per block."""
_FAINTEST = 0.05
"""Smallest opacity of a visible pixel."""
_OUTSIDE = "There is no view under the cursor: click inside the 3D view."


@dataclass(frozen=True, kw_only=True, eq=False)
class VisibleSplats:
    """The splats of an object and a view, copied out of Blender; no bpy."""

    name: str
    """Name of the object."""
    view: RenderCamera | None
    """Camera of the view; None: points are in Blender's world."""
    matrix: np.ndarray
    """[4, 4] float64, object to world."""
    limits: filters.Filters
    """Display filters."""
    antialias: bool
    columns: dict[str, np.ndarray]
    """Attributes of N splats, as for `attributes.as_splats`; some may be missing."""

    def shown(self) -> np.ndarray:
        """Splats that pass the filters, [N] bool."""
        if not self.limits.leave_out_anything:
            return np.ones(len(self.columns[attributes.BASE]), bool)
        return filters.passing(self.columns, self.limits)

    def pixels(self, shift: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Projected means.

        Args:
            shift: [3] added to them, in the object's space.

        Returns:
            [N, 2] float32, pixels from the top left, and [N] bool: those beyond the view's near
            plane and inside its picture.
        """
        view, means = self.view, self.columns[attributes.POSITION]
        K, viewmat = (matrix.astype(np.float32) for matrix in (view.K, self._viewmat))
        if shift is not None:
            viewmat = viewmat.copy()
            viewmat[:3, 3] += viewmat[:3, :3] @ shift.astype(np.float32)
        found, there = np.zeros((len(means), 2), np.float32), np.zeros(len(means), bool)
        for part in _blocks(len(means)):
            with np.errstate(all="ignore"):  # splats behind the view are left out
                at, depths = project(means[part], K, viewmat, orthographic=view.orthographic)
                inside = depths > view.near
                for axis, end in enumerate((view.width, view.height)):
                    inside &= (at[:, axis] >= 0) & (at[:, axis] < end)
            found[part], there[part] = np.where(inside[:, None], at, 0), inside
        return found, there

    def in_front(self, at: np.ndarray) -> np.ndarray:
        """Splats whose mean is not behind the visible surface, [N] bool.

        The surface is at the median depth of the object's own filtered splats, rendered at
        `LARGEST` pixels. The tolerance behind it is a splat's largest standard deviation plus the
        width of `_SLACK` pixels of that picture at this depth.

        Args:
            at: [N, 2], as from `pixels`.
        """
        view = self.view
        small = smaller(view, -(-max(view.width, view.height) // LARGEST))
        surface = self._drawn(small, depths=True).median_depth
        assert surface is not None
        means, scales = self.columns[attributes.POSITION], self.columns[attributes.SCALE]
        row = self._viewmat[2].astype(np.float32)
        larger = np.float32(np.cbrt(abs(np.linalg.det(self._viewmat[:3, :3]))))
        found = np.empty(len(means), bool)
        for part in _blocks(len(means)):
            before = _looked_up(surface, at[part], view)
            pixel = (1 if view.orthographic else before) / np.float32(small.K[0, 0])
            # By axis, which is faster than by splat.
            size = larger * np.abs(scales[part].T.copy()).max(axis=0)
            depths = means[part] @ row[:3] + row[3]
            # Pixels without a median depth have no surface.
            found[part] = (before <= 0) | (depths <= before + _SLACK * pixel + size)
        return found

    def color_at(self, point: np.ndarray) -> np.ndarray:
        """sRGB values of the splats at a pixel without view dependence, [3].

        Args:
            point: [2] pixels from the top left, inside the view.

        Raises:
            ValueError: there are no splats.
        """
        left, top = (int(v) for v in np.floor(point))
        drawn = self._drawn(self.view, depths=False, window=(left, top, 1, 1))
        if drawn.alpha[0, 0] < _FAINTEST:
            raise ValueError(f"There are no splats of {self.name} under the cursor.")
        return np.clip(drawn.rgb[0, 0] / drawn.alpha[0, 0], 0, 1)

    def place_at(self, point: np.ndarray) -> np.ndarray | None:
        """Position of the visible surface at a pixel in Blender's world, [3]; None: there is none.

        Args:
            point: [2] pixels from the top left, inside the view.
        """
        left, top = (int(v) for v in np.floor(point))
        drawn = self._drawn(self.view, depths=True, window=(left, top, 1, 1))
        assert drawn.median_depth is not None
        depth = float(drawn.median_depth[0, 0])
        return self.unprojected(point, depth) if depth > 0 else None

    def unprojected(self, point: np.ndarray, depth: float) -> np.ndarray:
        """Position in Blender's world, [3], of a pixel [2] at a depth."""
        view = self.view
        ray = (point - view.K[:2, 2]) / view.K[[0, 1], [0, 1]]
        place = np.append(ray if view.orthographic else depth * ray, depth)
        return (place - view.viewmat[:3, 3]) @ view.viewmat[:3, :3]

    def _drawn(
        self,
        view: RenderCamera,
        *,
        depths: bool,
        window: tuple[int, int, int, int] | None = None,
    ) -> Rendered:
        """Rendered picture of the object alone, with its filters applied."""
        splats = attributes.as_splats({name: v.copy() for name, v in self.columns.items()})
        if self.limits.leave_out_anything:
            splats = splats.subset(self.shown())
        return render(
            splats,
            view.K,
            view.viewmat @ self.matrix,
            view.width,
            view.height,
            near=view.near,
            antialias=self.antialias,
            orthographic=view.orthographic,
            depths=depths,
            window=window,
            device="cpu",
        )

    @property
    def _viewmat(self) -> np.ndarray:
        """[4, 4] float64, object to camera."""
        return self.view.viewmat @ self.matrix


def copy_visible(
    ob: bpy.types.Object, view: RenderCamera | None, *, drawn: bool
) -> Steps[VisibleSplats]:
    """Copy the splats of an object in Object Mode for a view.

    Args:
        ob: A splat object.
        view: As `VisibleSplats.view`.
        drawn: Copy all that rendering needs, without view dependence.

    Raises:
        ValueError: attributes are missing or not finite, or `drawn`, and the object is scaled
            unevenly.
    """
    matrix, limits = compat.matrix_to_numpy(ob.matrix_world), filters.filters_of(ob)
    if drawn:
        objects.moved(attributes.NO_SPLATS, matrix, ob.name)  # raises for an uneven scale
    names = {attributes.BASE, attributes.POSITION}
    if limits.leave_out_anything:
        names.update(filters.ATTRIBUTES)
    if drawn:
        names.update((attributes.SCALE, attributes.ROTATION))
    name, antialias = ob.name, bool(ob.get(objects.ANTIALIAS, False))
    columns = yield from read_chunked(ob, sorted(names))
    columns.setdefault(attributes.POSITION, np.zeros((0, 3), np.float32))
    return VisibleSplats(
        name=name, view=view, matrix=matrix, limits=limits, antialias=antialias, columns=columns
    )


def _looked_up(picture: np.ndarray, at: np.ndarray, view: RenderCamera) -> np.ndarray:
    """Values [B] of a downscaled picture [H, W] at pixels [B, 2] of the view."""
    height, width = picture.shape
    column = np.clip(at[:, 0] * np.float32(width / view.width), 0, width - 1).astype(np.int32)
    line = np.clip(at[:, 1] * np.float32(height / view.height), 0, height - 1).astype(np.int32)
    return picture[line, column]


def _blocks(count: int) -> Iterator[slice]:
    """Blocks of `count` splats that fit the cache, several times faster than all at once."""
    return (slice(at, at + _BLOCK) for at in range(0, count, _BLOCK))


def color_at(ob: bpy.types.Object, view: RenderCamera, point: np.ndarray) -> Steps[np.ndarray]:
    """sRGB values of an object's splats at a pixel without view dependence, [3].

    Args:
        ob: A splat object in Object Mode.
        view: Camera of the view.
        point: [2] pixels from the top left.

    Raises:
        ValueError: there are no splats, or as `copy_visible`.
    """
    check_inside(view, point, _OUTSIDE)
    splats = yield from copy_visible(ob, view, drawn=True)
    return (yield from run_in_thread(lambda check: splats.color_at(point), "Picking the color"))


def place_at(ob: bpy.types.Object, view: RenderCamera, point: np.ndarray) -> Steps[np.ndarray]:
    """Position of an object's visible surface at a pixel in Blender's world, [3].

    Args:
        ob: A splat object in Object Mode.
        view: Camera of the view.
        point: [2] pixels from the top left.

    Raises:
        ValueError: there are no splats, or as `copy_visible`.
    """
    check_inside(view, point, _OUTSIDE)
    splats = yield from copy_visible(ob, view, drawn=True)
    place = yield from run_in_thread(lambda check: splats.place_at(point), "Finding the surface")
    if place is None:
        raise ValueError(f"There are no splats of {ob.name} under the cursor.")
    return place


def check_inside(view: RenderCamera, point: np.ndarray, problem: str) -> None:
    """Raise ValueError with a sentence unless a pixel [2] is inside a view."""
    left, top = np.floor(point)
    if not (0 <= left < view.width and 0 <= top < view.height):
        raise ValueError(problem)
