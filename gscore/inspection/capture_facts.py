"""Capture facts: the findings of an inspection before a training."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from ..datasets.shots import stem_of
from ..depth.stated import StatedDepth
from ..errors import GsError
from ..io.images.read_image import read_info
from ..io.unsupported_formats import unread_cameras
from ..quoting import first_few
from ..sfm.heic import conversion_hint, readable, size_of
from ..sfm.photos import LEAST, list_photos, mask_folder, photo_folder, photo_folder_warning
from ..text_format import count_text
from ..video import is_video


@dataclass(frozen=True, kw_only=True)
class Problem:
    """An error or note before training."""

    is_error: bool
    """Training cannot start."""
    text: str
    """Problem, place and remedy, with the training's own sentence if it has one."""


@dataclass(frozen=True, kw_only=True)
class CaptureFacts:
    """Facts of a capture's files, without decoding photos."""

    source: Path
    """The folder (or transforms file) to train on."""
    kind: str = ""
    """`COLMAP`, `transforms.json`, `video`, or a `ProgramFile.program`; empty: no capture."""
    bare: str = ""
    """`photos` or `a video` without cameras, for SfM; empty: there are cameras, or no
    photos."""
    model: Path | None = None
    """Folder of the COLMAP model, or the file of the cameras; None for videos."""
    photos: int = 0
    """Number of existing photos."""
    missing: tuple[str, ...] = ()
    """Names of missing photos."""
    without_camera: int = 0
    """Photos in the folder without a camera in the model."""
    points: int = 0
    """Usable SfM points: finite, and within `scene.FARTHEST`."""
    error_px: float | None = None
    """Mean reprojection error of the points, pixels; None: not stated."""
    cameras: dict[str, int] = field(default_factory=dict)
    """Number of distinct intrinsics by COLMAP camera model."""
    camera_models: dict[str, int] = field(default_factory=dict)
    """Number of views by COLMAP camera model."""
    sizes: dict[tuple[int, int], int] = field(default_factory=dict)
    """Number of photos by width and height, px, in the orientation of their cameras. A photo whose
    header cannot be read here counts with the size of its camera."""
    decoding_pixels: int = 0
    """Number of pixels of all photos as stored, in the time of JPEG (`Dataset.decoding_pixels`); 0
    without cameras."""
    sideways: int = 0
    """Photos that are rotated according to EXIF."""
    distorted: dict[str, int] = field(default_factory=dict)
    """Number of views with lens distortion by camera model."""
    not_square: int = 0
    """Cameras whose focal lengths differ by more than 0.1 %."""
    aspect: float = 0.0
    """Largest |fy / fx - 1|."""
    masks: int = 0
    """Photos with a mask file."""
    alphas: int = 0
    """Photos with transparency."""
    depth: StatedDepth | None = None
    """Facts of the depth maps without reading them; None: no capture."""
    problems: tuple[Problem, ...] = ()
    """Errors first."""

    @property
    def can_train(self) -> bool:
        """Whether there is a capture without errors."""
        return bool(self.kind) and not any(problem.is_error for problem in self.problems)

    @property
    def depths(self) -> int:
        """Photos with a depth map."""
        rows = () if self.depth is None else self.depth.table
        return sum(1 for row in rows if row["map"] is not None)

    @property
    def depth_params(self) -> int:
        """Photos with an entry in depth_params.json."""
        return 0 if self.depth is None else self.depth.entries


PHOTOS, VIDEO = "photos", "a video"
"""Values of `CaptureFacts.bare`."""


def photo_folder_facts(source: Path) -> CaptureFacts:
    """Facts of a source without cameras (`has_no_cameras`), from the headers of photos.

    Args:
        source: A video, or a folder of photos.
    """
    if is_video(source):
        return CaptureFacts(source=source, bare=VIDEO)
    root = photo_folder(source)
    masks = mask_folder(root, None)
    names, unread = list_photos(root, (masks,) if masks else ())
    sizes: Counter[tuple[int, int]] = Counter()
    problems = []
    for name in names:
        try:
            info = read_info(root / name)
            sizes[info.width, info.height] += 1
        except GsError as error:
            problems.append(Problem(is_error=True, text=str(error)))
    stems = set(map(stem_of, names))
    changed, unread = readable([name for name in unread if stem_of(name) not in stems])
    sizes.update(size_of(root / name) for name in changed)
    names += changed
    if len(names) < LEAST:
        few = f"Only {count_text(len(names), 'photo')}: at least {LEAST} that overlap are needed, "
        problems.append(Problem(is_error=True, text=f"{few}30 or more are good."))
    for text in filter(
        None, (unread_cameras(source), photo_folder_warning(root, names, len(sizes)))
    ):
        problems.append(Problem(is_error=False, text=text))
    if unread:
        left = count_text(len(unread), "photo is of a kind", "photos are of kinds")
        hint = conversion_hint(unread)
        text = f"{left} that is not read: {first_few(unread, 2)}. To use them, {hint}."
        problems.append(Problem(is_error=False, text=text))
    return CaptureFacts(
        source=source,
        bare=PHOTOS,
        photos=len(names),
        sizes=dict(sizes.most_common()),
        problems=tuple(problems[:3]),
    )
