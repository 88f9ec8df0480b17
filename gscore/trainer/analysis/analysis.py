"""Analysis: facts about a capture, and the start of its training, before the first step."""

from dataclasses import dataclass, field

from ...io.block_record import BlockRecord
from ...scene import PointCloud
from ...splats import Splats
from ..depth.targets import DepthTargets
from ..guide.setup import GuideSetup
from ..model.training_frame import TrainingFrame
from ..photos.sky_search import Sky
from ..photos.view_sampler import Photos
from ..region.region_photos import RegionBox
from ..views.photo_gains import PhotoGains
from ..views.photo_poses import PoseCheck
from .photo_visit import PhotoFacts


@dataclass(frozen=True, kw_only=True)
class Analysis:
    """A capture as a trainer receives it. Only `photos` is needed; the world is that of COLMAP."""

    photos: Photos
    """The capture; with a `region` and no `start`, masked to the region."""
    frame: TrainingFrame | None = None
    """Training frame; None: fitted to the capture."""
    facts: PhotoFacts = field(default_factory=PhotoFacts)
    """Facts of the training photos."""
    start: Splats | None = None
    """Start splats; None: the run starts from points."""
    points: PointCloud | None = None
    """Start points; None: those of the capture."""
    known: float | None = None
    """Share of the unmasked pixels with stereo depth; None: stereo did not run."""
    gains: PhotoGains | None = None
    """Initial exposure gains; None: photo colours are used unchanged."""
    pose_check: PoseCheck = field(default_factory=PoseCheck)
    """Checked training cameras."""
    depth: DepthTargets | None = None
    """Targets of depth supervision; None: no depth supervision."""
    sky: Sky | None = None
    """The sky of the photos, which gets splats; None: none."""
    guide: GuideSetup = field(default_factory=GuideSetup)
    """Guide meshes."""
    region: RegionBox | None = None
    """Box of the splats of `start` that are trained; None: all."""
    block: BlockRecord | None = None
    """Block whose cell limits where splats are added; None: everywhere."""
    is_part: bool = False
    """True for a region or a block, whose surroundings are other splats."""
    photo_cache: int | None = None
    """Bytes of photos to keep in memory; None: all."""

    @property
    def cloud(self) -> PointCloud:
        """The start points."""
        return self.photos.scene.points if self.points is None else self.points
