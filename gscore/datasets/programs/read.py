"""Camera files of other programs, found by content, and read with the photos in their folder."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np

from ...config import DataConfig
from ...errors import DatasetError, FormatError
from ...io.colmap.folder import is_safe_name
from ...io.colmap.lenses import NO_PINHOLE
from ...io.files import read_bytes
from ...io.images.read_image import IMAGE_ENDINGS, read_info
from ...io.npy import read_npy
from ...io.ply.points import read_point_cloud
from ...quoting import first_few
from ...scene import PointCloud, camera_centers
from ...text_format import count_text
from ...transforms import invert_rigid
from ..capture import Capture, View, repeated
from ..folder import is_marked_mask, masks_by_photos, same_name
from ..poses import rigid_matrix
from . import metashape, realityscan
from .metashape import read_metashape
from .opensfm import read_opensfm
from .posed import PosedPhoto, PosedPhotos, Size, brown_camera
from .realityscan import read_csv, read_xmps, sidecars_in

_HEAD = 1 << 13
"""Bytes read from the start of a file."""
_RECONSTRUCTIONS = ("reconstruction.json", "opensfm/reconstruction.json")
_BOUNDS = "poses_bounds.npy"


@dataclass(frozen=True, kw_only=True)
class ProgramFile:
    """A supported camera file."""

    program: str
    """`RealityScan CSV`, `Metashape XML`, `OpenSfM`, `LLFF` or `RealityScan XMP`."""
    path: Path
    """The file; for XMP sidecars their common folder."""
    root: Path
    """Folder of the capture."""
    others: tuple[Path, ...] = ()
    """Other camera files in the folder, which are not read."""


def find_program(source: Path, images: str = "images", *, below: bool = True) -> ProgramFile | None:
    """The camera file at or in `source` or its folder of photos, or None; XMP sidecars if there is
    no other.

    Args:
        source: A file, or the folder of a capture.
        images: Folder of the photos in it.
        below: Search sidecars in all folders below; else only in those two, for folders with
            unknown content.
    """
    if source.is_file():
        return _of_file(source, source.parent)
    if not source.is_dir():
        return None
    known = [
        found
        for folder in dict.fromkeys((source, source / images, source / "input"))
        if folder.is_dir()
        for path in _candidates(folder)
        if (found := _of_file(path, source))
    ]
    if known:
        return replace(known[0], others=tuple(other.path for other in known[1:]))
    photos = source / images if (source / images).is_dir() else source
    if any(realityscan.sidecars_in(photos, below=below)):
        return ProgramFile(program="RealityScan XMP", path=photos, root=source)
    return None


def _candidates(folder: Path) -> list[Path]:
    files = sorted(p for p in folder.iterdir() if p.suffix.lower() in (".csv", ".xml"))
    return files + [folder / name for name in (*_RECONSTRUCTIONS, _BOUNDS)]


def _of_file(path: Path, root: Path) -> ProgramFile | None:
    if not path.is_file():
        return None
    ending, program = path.suffix.lower(), ""
    if ending == ".csv" and realityscan.is_csv(_head(path)):
        program = "RealityScan CSV"
    elif ending == ".xml" and metashape.is_xml(_head(path)):
        program = "Metashape XML"
    elif path.name == "reconstruction.json" and '"cameras"' in _head(path):
        program = "OpenSfM"
    elif path.name == _BOUNDS:
        program = "LLFF"
    return ProgramFile(program=program, path=path, root=root) if program else None


def _head(path: Path) -> str:
    """First bytes of a file as text, in any encoding with ASCII letters."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    return head.replace(b"\0", b"").decode("latin-1").removeprefix("\u00ef\u00bb\u00bf")


_POINTS = ("points3D.ply", "points3d.ply", "sparse_pc.ply", "points.ply", "pointcloud.ply")
"""Names of point clouds; else the only PLY of the folder is used."""
_SAMPLED = 1000
"""Most points that are projected into the photos."""
_MARGIN = 1.2
"""Half sizes of the picture, from its middle, within which a point counts as visible; above 1
because of lens distortion."""
_FARTHEST = 1000.0
"""Largest depth of a visible point, in extents of the cameras."""


def read_program(
    config: DataConfig, found: ProgramFile, *, photos_required: bool = True
) -> Capture:
    """Read the camera file and find its photos in `config.images`, or in the folder itself.

    Without `photos_required` views without a photo stay if the file states their size.

    Raises:
        DatasetError: photos are missing or ambiguous.
        FormatError: the file is damaged, or COLMAP has no model of a lens.
    """
    folder = found.root / config.images
    photos = _Photos(folder if folder.is_dir() else found.root)
    listed = _read(found, photos)
    files = [photos.find(shot.name, found.path) for shot in listed.photos]
    missing = [s.name for s, file in zip(listed.photos, files, strict=True) if file is None]
    warnings = (
        [
            f"{count_text(len(found.others), 'further camera file')} in {found.root} not read: "
            f"{first_few([path.name for path in found.others])}; {found.path.name} is."
        ]
        if found.others
        else []
    )
    warnings += _missing_warnings(found, photos, missing, len(files), photos_required)
    views = [
        view
        for shot, file, mask in zip(listed.photos, files, masks_by_photos(files), strict=True)
        if (view := _view(photos, shot, file, mask, photos_required)) is not None
    ]
    if twice := repeated([view.name for view in views]):
        raise DatasetError(
            f"{found.path} has several cameras for {first_few(twice)}. Export again."
        )
    if any(shot.size is None for shot in listed.photos):
        warnings += _rotation_warnings(found, views)
    points, point_warnings = _points(found, listed.points, views)
    return Capture(
        root=found.root,
        views=views,
        points=points,
        up=listed.up,
        warnings=(*listed.warnings, *warnings, *point_warnings),
    )


def _missing_warnings(
    found: ProgramFile, photos: "_Photos", missing: list[str], count: int, photos_required: bool
) -> list[str]:
    """Warning about missing photos.

    Raises:
        DatasetError: most are missing.
    """
    if not count or (photos_required and 2 * len(missing) > count):
        raise DatasetError(
            f"{len(missing)} of the {count_text(count, 'photo')} of {found.path} are missing in "
            f"{photos.root}: {first_few(missing)}. Put them there, or give their folder with "
            "`--images`."
        )
    if not missing:
        return []
    rest = f"; going on with the other {count - len(missing)}" if photos_required else ""
    return [
        f"{len(missing)} of the {count_text(count, 'photo')} of {found.path} are missing in "
        f"{photos.root}: {first_few(missing)}{rest}."
    ]


def _read(found: ProgramFile, photos: "_Photos") -> PosedPhotos:
    if found.program == "RealityScan CSV":
        return read_csv(found.path)
    if found.program == "RealityScan XMP":
        return read_xmps(list(sidecars_in(found.path)), found.path)
    if found.program == "Metashape XML":
        return read_metashape(found.path)
    if found.program == "OpenSfM":
        return read_opensfm(found.path)
    return read_llff(found.path, photos.names)


def _rotation_warnings(found: ProgramFile, views: list[View]) -> list[str]:
    """Warning about photos with an EXIF rotation if the file states no size, so that the
    orientation in the program is unknown."""
    turned = [view.name for view in views if read_info(view.image).is_sideways]
    if not turned:
        return []
    return [
        f"EXIF rotates {count_text(len(turned), 'photo')} by 90 degrees ({first_few(turned)}), but "
        f"{found.path} does not state whether its cameras include the rotation; they are used as "
        "stored. If that is wrong, save the photos rotated, and align them again."
    ]


class _Photos:
    """Photos below a folder, found by names that may be paths of another machine."""

    def __init__(self, root: Path) -> None:
        self.root = root
        below = (p for p in root.rglob("*") if p.suffix.lower() in IMAGE_ENDINGS)
        files = [p.relative_to(root) for p in below if not _is_separate(p.relative_to(root))]
        self.names = sorted(path.as_posix() for path in files)
        self._by_end = defaultdict[str, list[str]](list)
        for name in self.names:
            last = _plain(name)[-1]
            for key in {last, PurePosixPath(last).stem}:
                self._by_end[key].append(name)

    def find(self, name: str, of: Path) -> Path | None:
        """The photo of a name with or without ending; among several in sub-folders the one with
        the most matching folders.

        Raises:
            DatasetError: several match equally.
        """
        wanted = _plain(name)
        last = wanted[-1] if wanted else ""
        found = self._by_end.get(last) or self._by_end.get(PurePosixPath(last).stem) or []
        if len(found) < 2:
            return self.root / found[0] if found else None
        shared = [_agreeing(_plain(other)[:-1], wanted[:-1]) for other in found]
        best = [other for other, n in zip(found, shared, strict=True) if n == max(shared)]
        if len(best) > 1:
            raise DatasetError(
                f"{of} lists the photo {name}, which may be any of {first_few(best)} in "
                f"{self.root}. Give the photos different names, and export the cameras again."
            )
        return self.root / best[0]


def _plain(name: str) -> tuple[str, ...]:
    """Parts of a path for comparison, without case and Unicode form."""
    return PurePosixPath(same_name(name).replace("\\", "/").lower()).parts


def _agreeing(one: tuple[str, ...], other: tuple[str, ...]) -> int:
    """Number of equal folders, from the last on."""
    count = 0
    for a, b in zip(reversed(one), reversed(other), strict=False):
        if a != b:
            break
        count += 1
    return count


def _is_separate(path: Path) -> bool:
    """True for masks and hidden files."""
    hidden = any(part.startswith(".") for part in path.parts)
    return hidden or path.parts[0].lower() in ("masks", "mask", "depths") or is_marked_mask(path)


def _view(
    photos: _Photos,
    shot: PosedPhoto,
    image: Path | None,
    mask: Path | None,
    photos_required: bool,
) -> View | None:
    """View of a posed photo; None if the photo is missing and required, or if the file states no
    size or no valid name for it."""
    if image is not None:
        size = shot.size or _size(image)
        name = image.relative_to(photos.root).as_posix()
        return View(
            name=name, image=image, viewmat=shot.viewmat, camera=shot.camera(size), mask=mask
        )
    name = PurePosixPath(shot.name.replace("\\", "/")).name
    if photos_required or not shot.size or not is_safe_name(name):
        return None
    camera = shot.camera(shot.size)
    return View(name=name, image=photos.root / name, viewmat=shot.viewmat, camera=camera)


def _size(image: Path) -> Size:
    """Width and height of the photo as stored, pixels."""
    info = read_info(image)
    return info.width, info.height


def _points(
    found: ProgramFile, stated: PointCloud | None, views: list[View]
) -> tuple[PointCloud, list[str]]:
    """Points of the file, else of a PLY in the folder if they are visible to the cameras."""
    if stated is not None and len(stated):
        return stated, []
    clouds = sorted(p for p in found.root.glob("*") if p.suffix.lower() == ".ply")
    named = [p for name in _POINTS for p in clouds if p.name == name]
    if not named and len(clouds) > 1:
        return PointCloud.none(), [
            f"{found.root} has {len(clouds)} PLY files, and none is named {_POINTS[0]}: no "
            "points are read. Rename the one with the points."
        ]
    if not clouds:
        return PointCloud.none(), []
    path = (named or clouds)[0]
    points = read_point_cloud(path)
    if (share := _share_seen(points.points, views)) < 0.5:
        return PointCloud.none(), [
            f"Only {100 * share:.0f} % of the points of {path} are in view of a camera, so they "
            "are in other coordinates and are not used. Export points and cameras in the same "
            "coordinate system."
        ]
    return points, []


def _share_seen(points: np.ndarray, views: list[View]) -> float:
    """Share of a sample of the points that is in the picture of any view."""
    some = points[:: max(1, len(points) // _SAMPLED)]
    seen = np.zeros(len(some), bool)
    viewmats = np.array([view.viewmat for view in views]).reshape(-1, 4, 4)
    apart = (float(np.ptp(camera_centers(viewmats), axis=0).max()) if views else 0.0) or np.inf
    for view in views:
        at = some @ view.viewmat[:3, :3].T + view.viewmat[:3, 3]
        near = (at[:, 2] > 0) & (at[:, 2] < _FARTHEST * apart)
        camera = view.camera
        if camera.model not in NO_PINHOLE and not camera.model.endswith("FISHEYE"):
            half = np.array([camera.width, camera.height]) / 2
            with np.errstate(all="ignore"):
                pixels = at[:, :2] / at[:, 2:] * np.diag(camera.K)[:2] + camera.K[:2, 2]
            near &= (np.abs(pixels - half) <= _MARGIN * half).all(axis=1)
        seen |= near
    return float(seen.mean()) if len(seen) else 1.0


_NUMBERS = 17


def read_llff(path: Path, names: Sequence[str]) -> PosedPhotos:
    """Read poses and the shared lens, whose principal point is the middle of the photo.

    Schema: "Using your own poses without running COLMAP" of the readme of Fyusion/LLFF, and its
    `pose_utils.py`: a row for each photo in the order of the sorted names, a 3 x 5 matrix row by
    row and two depths. The first three columns are the camera's axes down, right and backwards in
    the world, the fourth its position, the fifth height, width and focal length in pixels.

    Args:
        path: The file.
        names: Names of all photos, sorted.

    Raises:
        DatasetError: the file is missing, or there are more or fewer photos than poses.
        FormatError: it is not an array of 17 numbers per row, or a pose or size is unusable.
    """
    try:
        rows = read_npy(read_bytes(path)).astype(np.float64)
    except ValueError as error:
        raise FormatError(f"{path} is not an array of poses: {error}. Copy it again.") from error
    if rows.ndim != 2 or rows.shape[1] != _NUMBERS:
        raise FormatError(
            f"{path} has the shape {rows.shape}, expected rows of {_NUMBERS} numbers. Make it "
            "again with LLFF's imgs2poses.py."
        )
    if len(rows) != len(names):
        raise DatasetError(
            f"{path} has {count_text(len(rows), 'pose')} for {count_text(len(names), 'photo')}, "
            "without their names, so they cannot be matched. Keep only the photos that it was made "
            "from."
        )
    return PosedPhotos(photos=[_shot(f"{path}: row {i}", *pair)
                        for i, pair in enumerate(zip(rows, names, strict=True))])  # fmt: skip


def _shot(where: str, row: np.ndarray, name: str) -> PosedPhoto:
    stated = row[:15].reshape(3, 5)
    down, right, back, center, (height, width, focal) = stated.T
    pose = rigid_matrix(where, "the pose", np.column_stack([right, down, -back, center]))
    if not all(0 < side < 2**31 for side in (height, width)):
        raise FormatError(f"{where}: the size {width:g} x {height:g} is invalid. Make it again.")
    size = (round(width), round(height))
    lens = brown_camera(where, size, focal=(focal, focal), center=(size[0] / 2, size[1] / 2))
    return PosedPhoto(name=name, viewmat=invert_rigid(pose), camera=lambda _: lens, size=size)
