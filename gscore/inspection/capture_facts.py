"""Capture facts: the findings of an inspection before a training."""

from dataclasses import dataclass, field
from pathlib import Path

from ..depth.stated import StatedDepth


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Something to mend, or to know, before training."""

    is_error: bool
    """Training cannot start."""
    text: str
    """What, where and what to do: the training's own sentence where it has one."""


@dataclass(frozen=True, kw_only=True)
class CaptureFacts:
    """What a capture's files say, without decoding a photo."""

    source: Path
    """The folder (or transforms file) to train on."""
    kind: str = ""
    """`COLMAP`, `transforms.json`, `video`, or a `ProgramFile.program`; empty: no capture."""
    bare: str = ""
    """`photos` or `a video`: these are all there is, and cameras can be found from them; empty:
    they are there, or it is no source at all."""
    model: Path | None = None
    """Folder of the COLMAP model, or the file of the cameras; None for videos."""
    photos: int = 0
    """Photos that are there."""
    missing: tuple[str, ...] = ()
    """Names of photos that are not."""
    without_camera: int = 0
    """Photos in the folder that the model has no camera for."""
    points: int = 0
    """SfM points that can be used: finite, and not beyond reach."""
    error_px: float | None = None
    """Mean reprojection error of the points, pixels; None: not stated."""
    cameras: dict[str, int] = field(default_factory=dict)
    """Number of sets of intrinsics by COLMAP's name of the camera model."""
    camera_models: dict[str, int] = field(default_factory=dict)
    """Number of views by the same."""
    sizes: dict[tuple[int, int], int] = field(default_factory=dict)
    """Number of photos by width and height, turned as their cameras want them, pixels. A photo
    whose header cannot be read here counts with the size of its camera."""
    sideways: int = 0
    """Photos that are stored on their side, as EXIF says, and turned."""
    distorted: dict[str, int] = field(default_factory=dict)
    """Number of views with lens distortion by camera model."""
    not_square: int = 0
    """Cameras whose focal lengths differ by more than 0.1 %."""
    aspect: float = 0.0
    """The largest |fy / fx - 1| of them."""
    masks: int = 0
    """Photos with a mask file."""
    alphas: int = 0
    """Photos with transparency."""
    depth: StatedDepth | None = None
    """What is known of the depth maps without reading them; None: no capture."""
    problems: tuple[Problem, ...] = ()
    """Errors first."""

    @property
    def can_train(self) -> bool:
        """Whether nothing stands in the way."""
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
