"""Shutter and lens of a frame: the views that depth of field and motion blur average."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property

import bpy
import numpy as np

from .. import attributes
from ..cameras.panorama import Panorama, panorama_of
from ..cameras.render_camera import Eye, RenderCamera, render_camera
from ..compat import matrix_to_numpy
from ..equality import same
from ..timeline import frame_sync
from .compositing_scene import main_scene
from .geometry_passes import Placement
from .holdout_meshes import Hidden, HoldoutMesh, HoldoutMeshes, hidden
from .mesh_copies import Frozen
from .model import Model, SplatCache
from .samples import Aperture, Sample, Shutter, samples
from .scene import NO_SPLATS, Placed, Source, place, sources
from .splat_values import NUMBER, values_of

_OPENINGS = {"START": 0.0, "CENTER": -0.5, "END": -1.0}
"""Opening time relative to the frame, in exposure times, by Blender's names."""
_CURVE_POINTS = 65
_NARROWEST = 1e-5
"""Smallest f-stop, as in Cycles."""


@dataclass(frozen=True, kw_only=True)
class View:
    """Content of one picture: model, camera and holdout meshes."""

    model: Model
    camera: RenderCamera | Panorama
    holdouts: tuple[HoldoutMesh, ...] = ()
    """Meshes that hide the splats behind them."""

    @cached_property
    def hidden(self) -> Hidden | None:
        """The parts that `holdouts` hide; None for panoramas, whose patches have their own."""
        flat = isinstance(self.camera, RenderCamera)
        return hidden(self.holdouts, self.camera) if self.holdouts and flat else None

    def same(self, other: "View") -> bool:
        """Whether the other view gives the same picture."""
        (mine, *ours), (others, *theirs) = (
            (view.model.splats, view.model.owners, view.model.matrix, view.camera, view.holdouts)
            for view in (self, other)
        )
        return mine is others and same(ours, theirs)


class ShutterLens:
    """The views of one rendered frame.

    Args:
        depsgraph: Depsgraph of the render.
        camera: The camera.
        size: Width and height, pixels.
        cache: Cache of decoded splats.
        frame_set: Evaluates the depsgraph at a frame and a fraction of one.
        eye: The eye of a stereo pair; None: a single picture.
        values: Names of `splat_values` that the models have.
    """

    def __init__(
        self,
        depsgraph: bpy.types.Depsgraph,
        camera: bpy.types.Object,
        size: tuple[int, int],
        cache: SplatCache,
        frame_set: Callable[[int, float], None],
        eye: Eye | None = None,
        values: tuple[str, ...] = (),
    ) -> None:
        self._eye, self._values = eye, values
        self._valued: Model | None = None
        """The last model with its values."""
        self._depsgraph, self._camera, self._size = depsgraph, camera, size
        self._cache, self._frame_set = cache, frame_set
        self._frame = float(depsgraph.scene.frame_current_final)
        opens = depsgraph.view_layer_eval.use_motion_blur
        self._shutter = shutter_of(depsgraph.scene) if opens else None
        self._frozen: dict[int, Frozen] = {}
        self._resting: list[Placed] | None = None
        """Objects without motion blur, as at the frame itself; None: not yet known."""
        self._resting_holdouts: tuple[HoldoutMesh, ...] | None = None
        self._own_lens: tuple[RenderCamera | Panorama, Aperture | None] | None = None
        """Camera and aperture at the frame itself, if the camera has no motion blur."""

    @property
    def blurs(self) -> bool:
        """Whether a picture is the mean of several."""
        camera = self._camera.evaluated_get(self._depsgraph)
        return self._shutter is not None or has_depth_of_field(camera)

    def view(self) -> View:
        """The view of a pinhole in the middle of the lens at the frame itself.

        Raises:
            ValueError: there is nothing to draw, an object cannot be drawn, or the camera object
                is not a camera.
        """
        view = self._view()
        if view is None:
            if main_scene(self._depsgraph.scene) is None:
                raise ValueError(NO_SPLATS)
            return self._empty()  # only the meshes of the main scene show
        return view

    def views(self, count: int) -> Iterator[View]:
        """Views from `count` samples over lens and exposure; errors as `view`.

        The scene returns to its own frame when the iterator ends or is closed.
        """
        if self._shutter is None:
            yield from self._through(samples(count))
            return
        with self._other_moments():
            yield from self._through(samples(count))

    def neighbours(self) -> list[Placement]:
        """Camera and objects at the previous frame, the frame itself, and the next; without motion
        blur of lens and shutter."""
        found = []
        with self._other_moments():
            for offset in (-1, 0, 1):
                self._go(self._frame + offset)
                matrices = {one.identity: one.matrix for one in sources(self._depsgraph)}
                found.append(Placement(camera=self._pinhole(), matrices=matrices))
        return found

    def shares(self, count: int, rows: np.ndarray) -> np.ndarray | None:
        """`Shutter.shares` of the views."""
        return None if self._shutter is None else self._shutter.shares(count, rows)

    def _through(self, at: list[Sample]) -> Iterator[View]:
        still = None
        if self._shutter is None:
            still = self.view()
        elif self._resting is None:
            self.view()  # at the frame itself, for objects without motion blur
        for sample in at:
            if self._shutter is not None:
                self._go(self._frame + self._shutter.time(sample))
            view = still or self._view()
            if view is None:  # objects may be hidden for a part of the exposure
                view = self._empty()
            aperture = self._lens()[1]
            if aperture is not None and isinstance(view.camera, RenderCamera):
                view = replace(view, camera=through(view.camera, *aperture.point(sample), aperture))
            yield view

    def _view(self) -> View | None:
        camera = self._lens()[0]
        placed = self._placed()
        if not placed:
            return None
        model = self._cache.model(placed)
        if self._values:
            if self._valued is None or self._valued.splats is not model.splats:
                values = {name: values_of(name, placed) for name in self._values}
                self._valued = replace(model, values=values)
            model = replace(model, values=self._valued.values)
        return View(model=model, camera=camera, holdouts=self._holdouts())

    def _placed(self) -> list[Placed]:
        """The visible objects at the current time; objects without motion blur as at the first
        call, which is at the frame itself."""
        found, moving, resting = sources(self._depsgraph), [], []
        for source in found:
            rests = self._shutter is not None and not _moves(source.ob, source.shown_by)
            if rests and self._resting is not None:
                continue
            # A mesh has the same splats during an exposure; a sequence has not.
            known = None if self._changes(source) else self._frozen.get(source.uid)
            one = place(source, known)
            if not self._changes(source):
                self._frozen[source.uid] = one.frozen
            (resting if rests else moving).append(one)
        if self._resting is None:
            self._resting = resting
        return moving + self._resting

    def _holdouts(self) -> tuple[HoldoutMesh, ...]:
        """The holdout meshes at the current time, in the same way."""
        if self._shutter is None:
            return HoldoutMeshes().of(self._depsgraph)
        if self._resting_holdouts is None:
            self._resting_holdouts = HoldoutMeshes().of(
                self._depsgraph, lambda *owners: not _moves(*owners)
            )
        return HoldoutMeshes().of(self._depsgraph, _moves) + self._resting_holdouts

    def _changes(self, source: Source) -> bool:
        """Whether an object may have other splats at another time of the exposure."""
        settings = getattr(source.ob, "cycles", None)
        return source.moment is not None and getattr(settings, "use_deform_motion", True)

    def _lens(self) -> tuple[RenderCamera | Panorama, Aperture | None]:
        """The pinhole camera in the lens's middle, and the aperture."""
        if self._own_lens is not None:
            return self._own_lens
        camera = self._camera.evaluated_get(self._depsgraph)
        lens = self._pinhole(), aperture_of(camera, self._depsgraph)
        if self._shutter is None or not _moves(camera):
            self._own_lens = lens
        return lens

    def _empty(self) -> View:
        nothing = Model(splats=attributes.NO_SPLATS, matrix=np.eye(4), antialias=(), plain=())
        shapes = {NUMBER: (0,)}
        values = {name: np.zeros(shapes.get(name, (0, 3))) for name in self._values}
        nothing = replace(nothing, values=values)
        return View(model=nothing, camera=self._lens()[0], holdouts=self._holdouts())

    def _pinhole(self) -> RenderCamera | Panorama:
        width, height = self._size
        own = self._camera.evaluated_get(self._depsgraph)
        if own.type == "CAMERA" and own.data.type == "PANO":
            return panorama_of(own, self._depsgraph.scene, width=width, height=height)
        scene = self._depsgraph.scene
        size = {"width": width, "height": height}
        return render_camera(self._camera, scene, depsgraph=self._depsgraph, **size, eye=self._eye)

    def _go(self, frame: float) -> None:
        whole = math.floor(frame)
        self._frame_set(whole, frame - whole)

    @contextmanager
    def _other_moments(self) -> Iterator[None]:
        with frame_sync.suspended_sync():
            try:
                yield
            finally:
                self._go(self._frame)


def blurs(scene: bpy.types.Scene, camera: bpy.types.Object) -> bool:
    """Whether pictures of a scene are means of several, by depth of field or motion blur."""
    return has_motion_blur(scene.render) or has_depth_of_field(camera)


def _moves(*owners: bpy.types.Object) -> bool:
    """Whether evaluated objects all have motion blur, by the switches stored by Cycles."""
    settings = (getattr(ob, "cycles", None) for ob in owners)
    return all(getattr(one, "use_motion_blur", True) for one in settings)


def shutter_of(scene: bpy.types.Scene) -> Shutter | None:
    """The shutter of a scene; None without motion blur."""
    render = scene.render
    if not has_motion_blur(render):
        return None
    length = float(render.motion_blur_shutter)
    curve = render.motion_blur_shutter_curve
    curve.initialize()
    points = (curve.evaluate(curve.curves[0], x) for x in np.linspace(0, 1, _CURVE_POINTS))
    return Shutter(
        opens=_OPENINGS[render.motion_blur_position] * length,
        length=length,
        curve=tuple(points),
        row=_row_of(scene),
    )


def _row_of(scene: bpy.types.Scene) -> float | None:
    """`Shutter.row` by Cycles' settings; in compositing only if Cycles renders the meshes."""
    main = main_scene(scene)
    settings = getattr(main or scene, "cycles", None)
    if settings is None or (main is not None and main.render.engine != "CYCLES"):
        return None
    rolls = settings.rolling_shutter_type == "TOP"
    return float(settings.rolling_shutter_duration) if rolls else None


def aperture_of(camera: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Aperture | None:
    """The aperture of an evaluated camera, as in Cycles: focal lengths are in 1/1000 world units.

    None if everything is in focus.
    """
    if not has_depth_of_field(camera):
        return None
    data, dof = camera.data, camera.data.dof
    length = data.lens * 1e-3 if data.type == "PERSP" else 1.0
    return Aperture(
        radius=length / (2 * max(dof.aperture_fstop, _NARROWEST)),
        distance=max(_focus_distance(camera, dof, depsgraph), data.clip_start),
        blades=dof.aperture_blades,
        rotation=dof.aperture_rotation,
        ratio=max(dof.aperture_ratio, 1e-3),
    )


def has_motion_blur(render: bpy.types.RenderSettings) -> bool:
    """Whether the render has motion blur with an exposure time above 0."""
    return render.use_motion_blur and render.motion_blur_shutter > 0


def has_depth_of_field(camera: bpy.types.Object) -> bool:
    """Whether a camera has depth of field; panoramas never have."""
    data = camera.data
    return getattr(data, "type", "") in {"PERSP", "ORTHO"} and data.dof.use_dof


def _focus_distance(
    camera: bpy.types.Object, dof: bpy.types.CameraDOFSettings, depsgraph: bpy.types.Depsgraph
) -> float:
    if dof.focus_object is None:
        return dof.focus_distance
    target = dof.focus_object.original.evaluated_get(depsgraph)
    matrix = matrix_to_numpy(target.matrix_world)
    bone = target.pose.bones.get(dof.focus_subtarget) if target.pose is not None else None
    if bone is not None:
        matrix = matrix @ matrix_to_numpy(bone.matrix)
    eye = matrix_to_numpy(camera.matrix_world)
    axis = eye[:3, 2] / np.linalg.norm(eye[:3, 2])
    return float(abs(axis @ (eye[:3, 3] - matrix[:3, 3])))


def through(camera: RenderCamera, x: float, y: float, aperture: Aperture) -> RenderCamera:
    """A camera at another point of the lens; points in focus keep their place in the picture.

    Args:
        camera: Camera in the lens's middle.
        x: Lens point to the right, world units.
        y: Lens point up, world units.
        aperture: Its focus distance is used.
    """
    moved = np.eye(4)
    moved[:2, 3] = -x, y  # camera axes are OpenCV's, whose y points down
    K = camera.K.copy()
    if camera.orthographic:
        moved[:2, 2] = -moved[:2, 3] / aperture.distance  # rays stay parallel, but are sheared
    else:
        K[:2, 2] -= K[[0, 1], [0, 1]] * moved[:2, 3] / aperture.distance
    return replace(camera, viewmat=moved @ camera.viewmat, K=K)
