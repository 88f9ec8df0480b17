"""Capture import: cameras with their photos, SfM points, and the empty that aligns them.

All children of the empty are in the capture's own world; up direction, ground and scale are in the
empty's matrix alone.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import bpy
from mathutils import Matrix

from .. import attributes, stored_paths
from ..interface import editable_check
from ..interface.blocks import block_of
from ..interface.incremental_removal import clear, clearing
from ..interface.temporary_data import Temporary, release
from ..process import incremental_tasks
from ..process.incremental_tasks import BUDGET, Steps, run_in_thread
from . import capture_transform, sfm_points, undistort_jobs
from . import objects as co
from .backgrounds import KnownImages, set_photo, shows_photo
from .capture_transform import PHOTO_UP, UP, note_origin, root_scale, set_root_matrix, size_drawing
from .find_imported import (
    Present,
    constrained_warning,
    find_present,
    in_another_world,
    known_origins,
    other_origins,
    uid_of,
)
from .lookup import roots_of
from .reading import ReadCamera, ReadCapture, ReadPoints, read

_NO_SCENE = "The scene of this import was removed; import the cameras again."


@dataclass(frozen=True, kw_only=True)
class ImportedCapture:
    """Result of an import."""

    scene: bpy.types.Scene
    root: bpy.types.Object
    """The empty with the alignment."""
    collection: bpy.types.Collection
    """Collection of the capture."""
    cameras: list[bpy.types.Object]
    """Camera objects, sorted by image name."""
    points: bpy.types.Object | None
    """The SfM points."""
    renewed: bool
    """True if the capture was already in the scene."""
    warnings: tuple[str, ...] = ()
    """Warnings for the user."""


def importing(
    scene: bpy.types.Scene,
    path: str | Path,
    *,
    images: str = "images",
    photos: bool = True,
    points: bool = True,
    align: bool = True,
    into: bpy.types.Object | None = None,
) -> Steps[ImportedCapture]:
    """Import a capture into the scene, in one change at the end.

    If the scene has the capture already, its cameras and points are updated from the files;
    cameras without a photo are removed. The empty and its other children stay unchanged.

    Args:
        scene: Receives the objects.
        path: A capture's folder, or a folder or file inside it.
        images: Folder of the photos in a COLMAP capture.
        photos: Set the photos as the cameras' backgrounds; Blender decodes them when drawn. Photos
            with lens distortion are undistorted in the background, unless Blender has no window.
        points: Create an object of the SfM points.
        align: Put z up and the ground at z = 0, next to other captures; else the empty keeps
            COLMAP's axes.
        into: The empty of the capture to update; None: a capture of the same folder.

    Raises:
        GsError: the capture cannot be read.
        ValueError: none of its views can be a Blender camera, or the scene was removed.
    """
    uid, place = scene.session_uid, Path(bpy.path.abspath(str(path)))
    there = 0 if into is None else into.session_uid
    choices = {"images": images, "photos": photos, "points": points, "align": align}
    origins = known_origins(scene, there)
    with incremental_tasks.defer_collections():
        capture = yield from run_in_thread(
            partial(read, place, **choices, origins=origins), f"Reading {place}"
        )
        while True:
            yield from clearing()
            known = KnownImages()
            pending = _PendingCapture(capture, known, there, align)
            try:
                scene = block_of(bpy.data.scenes, uid, _NO_SCENE)
                yield from pending.fill(find_present(scene, capture.source, there))
                made = pending.link(block_of(bpy.data.scenes, uid, _NO_SCENE))
            finally:
                clear(chain(pending.dropping(), known.dropping()))
            if made is not None:
                if not bpy.app.background:
                    undistort_jobs.begin(capture.copies)
                return made


@dataclass(frozen=True, kw_only=True)
class _Compared:
    """A camera and its differences from the files."""

    state: tuple[Any, ...]
    """`_state_of` the object."""
    changes: co.CameraChanges | None
    """Changes to write; None: none."""
    has_photo: bool
    """True if it shows the photo named in the files."""


def _state_of(ob: bpy.types.Object) -> tuple[Any, ...]:
    """Identity of a camera, and properties that users are likely to change."""
    return ob.session_uid, ob.matrix_basis.copy().freeze(), ob.data.lens


class _PendingCapture:
    """Cameras and points being created, in a collection outside all scenes."""

    def __init__(self, read: ReadCapture, known: KnownImages, into: int, align: bool) -> None:
        """Create the collection with the capture's empty."""
        self._read, self._known, self._into, self._align = read, known, into, align
        self._there = 0
        """Session uid of the capture's empty in the scene when `fill` starts."""
        self._compared: dict[str, _Compared] = {}
        """Existing cameras, by image."""
        outer = bpy.data.collections.new(read.name)
        self._temporary = Temporary(outer)
        inner = bpy.data.collections.new(f"{read.name} cameras")
        outer.children.link(inner)
        root = bpy.data.objects.new(read.name, None)
        root[co.KIND] = "capture"
        root.empty_display_size = 0.1 * read.drawing.extent
        set_root_matrix(root, read.matrix)
        outer.objects.link(root)
        for one in (inner, root):
            self._temporary.mark(one)

    def fill(self, there: Present | None) -> Steps[None]:
        """Create everything that `there` lacks."""
        self._there = uid_of(there)
        have = {} if there is None else _by_image(there.cameras)
        known = {image: (ob.name, ob.session_uid) for image, ob in have.items()}
        until = time.perf_counter() + BUDGET
        for done, one in enumerate(self._read.cameras):
            if time.perf_counter() > until:
                yield f"Importing cameras: {done} of {len(self._read.cameras)}"
                until = time.perf_counter() + BUDGET
            if (outer := self._temporary.found()) is None:
                return
            name, uid = known.get(one.setup.own.image, ("", 0))
            if not uid:
                self._make(one, outer)
            elif (ob := bpy.data.objects.get(name)) is not None and ob.session_uid == uid:
                self._compare(one, ob)
        if self._read.points is not None:
            yield from self._fill_points(self._read.points)

    def link(self, scene: bpy.types.Scene) -> ImportedCapture | None:
        """Put everything into the scene in one change; None if it must be created again, because
        undo or the user removed it, or the capture was added to the scene or removed meanwhile.

        Raises:
            ValueError: the capture's points are being edited.
        """
        outer, read = self._temporary.found(), self._read
        if outer is None:
            return None
        before, warnings = find_present(scene, read.source, self._into), read.warnings
        if self._there != uid_of(before):
            return None
        if before is None:
            there = self._add(outer, scene)
        else:
            there, more = self._renew(before, outer, scene)
            warnings += more
        root = there.root
        root["gs_images"] = read.images
        for key, up in ((UP, read.up), (PHOTO_UP, read.photo_up)):
            root.pop(key, None)
            if up is not None:
                root[key] = up.tolist()
        note_origin(root, read.origin)
        warnings += other_origins(scene, root)
        stored_paths.write(root, stored_paths.SOURCE, read.source)
        return ImportedCapture(
            scene=scene,
            root=root,
            collection=root.users_collection[0],
            cameras=there.cameras,
            points=there.points,
            renewed=before is not None,
            warnings=warnings,
        )

    def dropping(self) -> Iterator[None]:
        """Remove objects that did not enter the scene or were taken out of it, some per step."""
        return self._temporary.dropping()

    def _make(self, one: ReadCamera, outer: bpy.types.Collection) -> bpy.types.Object:
        ob = co.make(one.setup, one.name, outer.children[0])
        self._temporary.mark(ob)
        size_drawing(ob.data, self._read.drawing, 1.0)
        self._set_photo(ob, one)
        return ob

    def _set_photo(self, ob: bpy.types.Object, one: ReadCamera) -> None:
        if one.photo is not None:
            set_photo(ob, one.photo, self._known)
        else:
            stored_paths.write(ob, stored_paths.PHOTO, one.setup.own.photo)

    def _compare(self, one: ReadCamera, ob: bpy.types.Object) -> None:
        """Collect the changes that the final step writes."""
        image, same = one.setup.own.image, co.is_as_stated(ob, one.setup)
        changes = None if same else co.changes_of(ob, one.setup)
        self._compared[image] = _Compared(
            state=_state_of(ob),
            changes=changes,
            has_photo=one.photo is not None and shows_photo(ob, one.photo),
        )

    def _fill_points(self, points: ReadPoints) -> Steps[None]:
        name = f"{self._read.name} points"
        if (outer := self._temporary.found()) is None:
            return
        ob = bpy.data.objects.new(name, bpy.data.meshes.new(name))
        ob[co.KIND] = "points"
        outer.objects.link(ob)
        self._temporary.mark(ob)
        attributes.add_points(ob.data, points.count)
        for step in _steps(points):
            yield f"Importing {points.count:,} points"
            if (outer := self._temporary.found()) is None:
                return
            step(co.find_points(outer.objects))

    def _add(self, outer: bpy.types.Collection, scene: bpy.types.Scene) -> Present:
        """Link the collection to the scene."""
        root = next(ob for ob in outer.objects if co.is_kind(ob, "capture"))
        for ob in outer.all_objects:
            if ob != root:
                ob.parent = root
        cameras, points = co.by_image(outer.children[0].objects), co.find_points(outer.objects)
        if self._align and (others := roots_of(scene)):
            matrix = self._read.matrix
            reach = capture_transform.reach_of(matrix, cameras, points)
            set_root_matrix(root, capture_transform.place_next_to(matrix, reach, others))
        self._temporary.take()
        scene.collection.children.link(outer)
        return Present(root=root, cameras=cameras, points=points)

    def _restate(self, one: ReadCamera, ob: bpy.types.Object, root: bpy.types.Object) -> None:
        image = one.setup.own.image
        compared = self._compared.get(image)
        if compared is None or compared.state != _state_of(ob):  # changed meanwhile
            self._compare(one, ob)
            compared = self._compared[image]
        if compared.changes is not None:
            co.apply_changes(ob, compared.changes)
            _parent(ob, root)
        if not compared.has_photo:
            self._set_photo(ob, one)

    def _take_away(self, gone: set[bpy.types.Object], outer: bpy.types.Collection) -> None:
        """Unlink cameras from the scene; their removal takes longer and follows later."""
        # `users_collection` would search all of this for each camera.
        for collection in [*bpy.data.collections, *(one.collection for one in bpy.data.scenes)]:
            for ob in [ob for ob in collection.objects if ob in gone]:
                collection.objects.unlink(ob)
        for ob in gone:
            ob.parent = None
            outer.children[0].objects.link(ob)
            self._temporary.mark(ob)

    def _renew(
        self, capture: Present, outer: bpy.types.Collection, scene: bpy.types.Scene
    ) -> tuple[Present, tuple[str, ...]]:
        """Update a capture to the read state; returns the result with warnings."""
        root, cameras = capture.root, capture.cameras
        old, new = capture.points, co.find_points(outer.objects)
        if new is not None and old is not None and old.mode == "EDIT":
            raise ValueError(
                f"{old.name} is in Edit Mode: leave it before its capture is imported."
            )
        there = _by_image(cameras)
        place = _collection_of(cameras[0] if cameras else root, scene)
        made = _by_image(outer.children[0].objects)
        others = in_another_world(self._read.cameras, there)
        scale, added = root_scale(root), []
        for one in self._read.cameras:
            image = one.setup.own.image
            ob = there.get(image)
            if ob is None:
                ob = made.get(image) or self._make(one, outer)
                _move(ob, outer.children[0], place)
                _parent(ob, root)
                size_drawing(ob.data, self._read.drawing, scale)
                added.append(ob)
            else:
                self._restate(one, ob, root)
                if others:  # else keep the user's display size
                    size_drawing(ob.data, self._read.drawing, scale)
        images = {one.setup.own.image for one in self._read.cameras}
        gone = {ob for ob in cameras if ob.get("gs_image") not in images}
        if gone:
            self._take_away(gone, outer)
        if new is not None and old is not None:
            mesh, name = old.data, old.data.name  # display settings stay
            old.data, new.data = new.data, mesh
            if mesh.users == 1:
                mesh.name = new.name  # frees the name now; removal scans the whole file, later
            old.data.name = name
        elif new is not None:
            _move(new, outer, _collection_of(root, scene))
            _parent(new, root)
        now = Present(
            root=root,
            cameras=co.by_image([*(ob for ob in cameras if ob not in gone), *added]),
            points=old or new,
        )
        return now, others + constrained_warning(
            [there[image] for image in images if image in there]
        )


def _by_image(cameras: Sequence[bpy.types.Object]) -> dict[str, bpy.types.Object]:
    """Cameras by image; of copies made by a user the first by name."""
    return {str(ob.get("gs_image")): ob for ob in reversed(list(cameras))}


def _steps(points: ReadPoints) -> Iterator[Callable[[bpy.types.Object], object]]:
    """Steps that complete an object of points."""
    for name, kind, values in points.columns:
        yield lambda ob, name=name, kind=kind: attributes.declare(ob.data, name, kind)
        yield lambda ob, column=(name, kind, values): attributes.fill(ob.data, *column)
    yield lambda ob: sfm_points.complete(ob.data)
    yield lambda ob: sfm_points.display(ob, points.radius)


def _collection_of(ob: bpy.types.Object, scene: bpy.types.Scene) -> bpy.types.Collection:
    """Collection for a new object next to another one in a scene."""
    own = {scene.collection, *scene.collection.children_recursive}
    return editable_check.taking([one for one in ob.users_collection if one in own], scene)[0]


def _move(ob: bpy.types.Object, before: bpy.types.Collection, after: bpy.types.Collection) -> None:
    """Move an object from a temporary collection to one of the scene."""
    release(ob)
    after.objects.link(ob)
    before.objects.unlink(ob)


def _parent(ob: bpy.types.Object, root: bpy.types.Object) -> None:
    """Parent an object to the capture's empty."""
    if ob.parent != root or ob.parent_type != "OBJECT":
        ob.parent, ob.parent_type = root, "OBJECT"
    if ob.matrix_parent_inverse != Matrix.Identity(4):
        ob.matrix_parent_inverse.identity()
