"""Preparation of a training: creates the trainer from options and capture, equal on every rank."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import torch

from ..config import LIFTED_BY, DataConfig, Switch, TrainConfig
from ..control import Control
from ..datasets import load_dataset
from ..datasets.dataset import Dataset
from ..depth.maps import MapFolder
from ..engine.base import Engine
from ..errors import BackendError, ConfigError
from ..events import TOPICS, Decision, Event
from ..formats import Decoded
from ..io.block_record import read_block
from ..io.region_file import read_region
from ..splats import Splats
from .analysis.analysis import Analysis
from .analysis.exposure import Exposure, decide_exposure
from .analysis.photo_loading import check_masks, load_photos, progress_of
from .analysis.pose_check import check_poses
from .depth.setup import DepthSetup, prepare_depth
from .depth.stereo import StereoStart, stereo_start
from .distributed.consistency import crc_of
from .distributed.process_group import ProcessGroup
from .distributed_trainer import DistributedTrainer
from .guide.setup import GuideSetup, prepare_guide
from .model.training_frame import TrainingFrame, checkpoint_origin
from .photos.sky import check_sky
from .photos.sky_search import decide_sky
from .region.region_photos import RegionBox, RegionPhotos
from .schedule.caps import cap_by_photos, expected_points
from .schedule.lacking_options import lacking_options, refuse
from .trainer import Trainer
from .views.photo_poses import PoseCheck

_MASKS = {
    "ignore": Decision(
        "masks",
        "Masks are used: masked pixels are neither trained nor measured. `--mask-mode none` trains "
        "whole photos, `--mask-mode composite` only the subject.",
    ),
    "composite": Decision(
        "masks",
        "Masks are used as the opacity of the subject, and only the subject is trained. "
        "`--mask-mode none` trains whole photos, `--mask-mode ignore` does not constrain masked "
        "pixels.",
    ),
}
"""Decision on masks, by `mask_mode`."""
_KEPT = ("points", "stereo", "drops", "ensemble", "exposure", "poses")
"""Topics that a resumed run may not decide again: its earlier decisions still apply."""


@dataclass(frozen=True, kw_only=True)
class StartState:
    """Facts of a checkpoint, if any, and start splats."""

    taken: int = 0
    """Steps that a resumed run has already taken."""
    stereo: bool = True
    """Whether to compute start points by stereo."""
    frame: dict[str, Any] | None = None
    """Training frame of the checkpoint, as `TrainingFrame.to_dict`; None: fit a new one."""
    splats: Decoded | None = None
    """Start splats, COLMAP world; None: start from points."""

    def facts(self) -> dict[str, Any]:
        """All but the splats, as JSON values."""
        return {"taken": self.taken, "stereo": self.stereo, "frame": self.frame}

    @property
    def origin(self) -> np.ndarray | None:
        """Local origin of the checkpoint, zeros if it has none; else that of the start splats, so
        that consecutive models share their origin; None: neither."""
        if self.frame is not None:
            return checkpoint_origin(self.frame)
        return None if self.splats is None else self.splats.origin

    @property
    def training_frame(self) -> TrainingFrame | None:
        """The training frame of the checkpoint; None: fit a new one.

        Raises:
            ValueError, KeyError: it is invalid.
        """
        return None if self.frame is None else TrainingFrame.from_dict(self.frame)


@dataclass(kw_only=True)
class Prepared:
    """A trainer before its first step, with the decisions and reports of its preparation."""

    trainer: Trainer
    warnings: Sequence[str] = ()
    """Warnings of reading the photos."""
    device: Decision | None = None
    """Choice of the device; None: the options name it."""
    caps: Decision | None = None
    """Caps of steps and splats; None: none applies."""
    requested: dict[str, int] = field(default_factory=dict)
    """Requested values of the options that were capped by the number of photos."""
    depth: DepthSetup = field(default_factory=DepthSetup)
    guide: GuideSetup = field(default_factory=GuideSetup)
    stereo: StereoStart = field(default_factory=StereoStart)
    sky: Decision | None = None
    """Decision on the splats of a sky; None: there are none."""
    sky_digest: int = 0
    """Hash of the parts of photos that show the sky."""
    exposure: Exposure = field(default_factory=Exposure)
    pose_check: PoseCheck = field(default_factory=PoseCheck)

    @property
    def mask_mode(self) -> str:
        """Meaning of the capture's masks; `none` for a region, whose masks are computed."""
        return "none" if self.trainer.region is not None else self.trainer.photos.mask_mode

    def decisions(self, earlier: Sequence[Decision] = ()) -> list[Decision]:
        """Decisions in the order of `TOPICS`; `earlier`: those of the resumed run."""
        rules = (self.stereo, self.depth, self.guide, self.exposure, self.pose_check)
        models = self.trainer.models
        counts = {"trained": models.trained_count, "frozen": models.frozen_count}
        found = [
            self.device,
            *self.trainer.rules.decisions(**counts),
            self.caps,
            _MASKS.get(self.mask_mode),
            self.sky,
        ]
        found += [rule.decision for rule in rules]
        names = self.trainer.photos.scene.cameras.names
        found += self.trainer.photo_parameters.decisions(names)
        by_topic = {one.topic: one for one in found if one is not None}
        by_topic |= {one.topic: one for one in earlier if one.topic in _KEPT}
        return [by_topic[topic] for topic in TOPICS if topic in by_topic]

    def facts(self) -> dict[str, Any]:
        """Values that must be equal on all ranks, JSON values by name."""
        trainer, photos = self.trainer, self.trainer.photos
        return {
            "photos": f"{len(photos.scene.cameras.names)} of hash {photos.content_hash()}",
            "which photos are held out": crc_of(
                {"train": torch.tensor(list(photos.train), dtype=torch.int64, device="cpu")}
            ),
            "the plan": repr(trainer.plan),
            "the dropout rate": trainer.rules.drop_rate,
            "the number of models": len(trainer.models.members),
            "the guide meshes": trainer.guide_digest,
            "the sky": self.sky_digest,
            "the initial splats": crc_of(trainer.tensors()),
        }


def prepare(
    config: TrainConfig,
    data: DataConfig,
    start: StartState,
    *,
    check: Callable[[Dataset], None] = lambda photos: None,
    emit: Callable[[Event], None],
    control: Control,
    engine: Engine[Any] | None = None,
    group: ProcessGroup | None = None,
) -> Prepared:
    """Read the photos and create the trainer.

    Args:
        config: Training options.
        data: Capture options.
        start: What the run starts from.
        check: Called with the capture before its photos are read; may raise.
        emit: Receives progress events.
        control: Cancels the preparation.
        engine: Computes the training; None: that of `config.device`.
        group: Process group of a distributed training; None: one process.

    Raises:
        GsError: the capture or the maps cannot be used, or memory is too small.
        Cancelled: `control` requested a stop.
    """
    photos, region, splats = _read(config, data, start, control, group)
    requested, given = config, photos.scene.points.given
    limited = partial(
        cap_by_photos,
        requested,
        photos=len(photos.train),
        points=given,
        mask_mode=photos.mask_mode,
        taken=start.taken,
    )
    config, caps = limited()
    check(photos)
    if config.sky is Switch.ON:
        check_sky(photos, region=region is not None)
    if engine is not None:
        refuse(engine.info, lacking_options(config, engine.info.features, engine.info.skips))
    resumed = start.training_frame
    if data.depths:
        MapFolder(photos.source / data.depths)  # raises for a missing folder
    photo_cache, facts = load_photos(
        photos,
        config,
        points=expected_points(config, given) if splats is None else len(splats),
        depths=bool(data.depths),
        announce=resumed is None,
        emit=emit,
        control=control,
        engine=engine,
    )
    warnings = [*photos.warnings, *check_masks(photos, facts)]
    photos.content_hash()  # computed now, because the files may change during the training
    progress = partial(progress_of, config=config, emit=emit, control=control)
    with readable_memory_errors():
        depth = prepare_depth(data, config, photos, on_progress=progress("depth maps"))
        guide = prepare_guide(config, photos, facts.tracks, on_progress=progress("guide meshes"))
        points = photos.scene.points if depth.points is None else depth.points
        added = StereoStart()
        if start.stereo:
            added = stereo_start(config, photos, points, on_view=progress("depth of photos"))
            config, caps = limited(known=added.known, compared=True)
        block = read_block(photos.source)
        is_part = block is not None or region is not None
        sky, sky_decision = decide_sky(config, photos, facts.cells, is_part=is_part)
        analysis = Analysis(
            photos=photos,
            frame=resumed,
            facts=facts,
            start=splats,
            points=points if added.points is None else added.points,
            known=added.known,
            depth=depth.loss_targets,
            guide=guide,
            region=region,
            # Start splats already cover the surroundings of a cell; merging blocks drops those.
            block=block if splats is not None and region is None else None,
            is_part=is_part,
            sky=sky,
            photo_cache=photo_cache,
        )
        exposure, pose_check = decide_exposure(config, analysis), check_poses(config, analysis)
        analysis = replace(analysis, gains=exposure.gains, pose_check=pose_check)
        trainer = (
            Trainer(config, analysis, engine)
            if group is None
            else DistributedTrainer(config, analysis, group)
        )
    both = {name: (getattr(requested, name), getattr(config, name)) for name in LIFTED_BY}
    return Prepared(
        trainer=trainer,
        warnings=warnings,
        caps=caps,
        requested={name: was for name, (was, now) in both.items() if was != now},
        depth=depth,
        guide=guide,
        stereo=added,
        sky=sky_decision,
        sky_digest=0 if sky is None else sky.digest(),
        exposure=exposure,
        pose_check=pose_check,
    )


def _read(
    config: TrainConfig,
    data: DataConfig,
    start: StartState,
    control: Control,
    group: ProcessGroup | None,
) -> tuple[Dataset, RegionBox | None, Splats | None]:
    """Read the capture without its photos; region box and start splats are in its local world."""
    region = None if config.region is None else RegionBox(read_region(config.region))
    if region is not None and group is not None:
        raise ConfigError(
            "A region can only be trained by one process: start gscore train without torchrun."
        )
    photos = load_dataset(data, origin=start.origin, cancelled=lambda: control.stopping)
    about, given = photos.scene.cameras.origin, start.splats
    splats = None if given is None else given.of_capture(about).about(about).splats
    if region is not None:
        region = region.about(about)
        near = TrainingFrame.of(photos.scene, near=config.near).world_near
        photos = RegionPhotos(photos, region, near=near, narrow=splats is None)
    return photos, region, splats


@contextmanager
def readable_memory_errors() -> Iterator[None]:
    """Context that turns an out-of-memory error into a BackendError."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        # torch raises a RuntimeError with this text instead of a MemoryError.
        if not isinstance(error, MemoryError) and "can't allocate memory" not in str(error):
            raise
        raise BackendError(
            "Out of memory; use fewer splats (`--max-splats`) or smaller photos "
            "(`--resolution 2`), or close programs. The last checkpoint is kept."
        ) from error
