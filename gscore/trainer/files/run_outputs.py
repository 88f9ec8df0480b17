"""Run outputs: splats, metrics and reports, each file written atomically."""

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...config import Background, DataConfig
from ...config_file import config_json
from ...errors import GsError
from ...events import Decision
from ...io.block_record import RUN_BLOCK, read_block
from ...io.cameras_json import write_cameras
from ...io.exposure_json import EXPOSURE_FILE, write_exposures
from ...io.images.pixels import as_uint8
from ...io.images.png import write_png
from ...io.ply.comments import near_comment
from ...io.ply.splats import MIP_COMMENT, origin_comment, write_splat_parts
from ...io.poses_json import POSES_FILE, write_poses
from ...io.runs import snapshots_in
from ...metrics import Course, Evaluation, Metrics
from ...photo_exposure import PhotoExposure
from ...report import (
    MOST_PICTURES,
    MaskedPhoto,
    PictureCollector,
    cameras_section,
    splat_histograms,
    write_results,
)
from ..depth.report import DepthReport
from ..distributed.process_group import ProcessGroup
from ..evaluation import Evaluator
from ..stopping.progress_meter import ProgressMeter
from ..trainer import Trainer
from ..views.photo_poses import PhotoPoses
from ..views.pose_math import pose_distances
from .run_folder import RunFolder

_SNAPSHOTS_KEPT = 2


@dataclass(eq=False)
class RunOutputs:
    """Writer of the files of one run."""

    trainer: Trainer
    """The trainer."""
    folder: RunFolder
    """The run folder."""

    def write_inputs(self, data: DataConfig) -> None:
        """Write the options and cameras, before the first step."""
        folder, config = self.folder, self.trainer.config
        folder.write_text("config.json", config_json(data, config))
        if (block := read_block(data.source)) is not None:
            block.write(folder.path, RUN_BLOCK)
        write_cameras(folder.path / "cameras.json", self.trainer.photos.scene.cameras)
        # The viewers of the 3DGS authors read the SH degree and background from this file.
        arguments = {
            "sh_degree": config.sh_degree,
            "source_path": str(data.source.resolve()),
            "model_path": str(folder.path.resolve()),
            "images": data.images,
            "resolution": data.resolution,
            "white_background": config.background is Background.WHITE,
            "data_device": "cpu",
            "eval": data.eval,
        }
        text = ", ".join(f"{name}={value!r}" for name, value in arguments.items())
        folder.write_text("cfg_args", f"Namespace({text})")

    def write_splats(self, path: Path) -> None:
        """Write the current splats in COLMAP world units."""
        trainer = self.trainer
        # Viewers that know this comment compensate opacities as in training.
        comments = (MIP_COMMENT,) if trainer.config.antialias else ()
        origin = trainer.photos.scene.cameras.origin
        comments += () if origin is None else (origin_comment(origin),)
        near = trainer.frame.world_near
        comments += (near_comment(near),) if near < trainer.config.near else ()
        write_splat_parts(
            path,
            trainer.models.parts(),
            count=trainer.splat_count,
            sh_degree=trainer.model.sh_degree,
            comments=comments,
        )

    def write_snapshot(self) -> Path:
        """Write the current splats for a front end; the last two files are kept."""
        path = self.folder.snapshot(self.trainer.steps)
        self.write_splats(path)
        for old in list(snapshots_in(self.folder.path).values())[:-_SNAPSHOTS_KEPT]:
            old.unlink(missing_ok=True)
        return path

    def write_preview(self, picture: np.ndarray) -> Path:
        """Write a rendered image, [H, W, 3] float, as a preview."""
        path = self.folder.preview(self.trainer.steps)
        write_png(path, as_uint8(picture))
        return path

    def write_summary(
        self,
        data: DataConfig,
        evaluation: Evaluation | None,
        *,
        evaluator: Evaluator,
        collector: PictureCollector,
        meter: ProgressMeter,
        evals: list[dict[str, Any]],
        warnings: list[str],
        depth: DepthReport | None = None,
        photo_parameters: dict[str, Any] | None = None,
        decisions: Sequence[Decision] = (),
        requested: Mapping[str, int] | None = None,
        reason: str,
    ) -> dict[str, Any]:
        """Write report.html and metrics.json; return the metrics.

        Args:
            data: Capture options.
            evaluation: Final evaluation; None: there was none.
            evaluator: Its evaluator.
            collector: Images for the report.
            meter: Clock and history of the run.
            evals: Evaluations during the run.
            warnings: Warnings for the report, as sentences.
            depth: Depth report; None: there are no depth maps.
            photo_parameters: Result of `write_photo_parameters`.
            decisions: Decisions of the run for its photos and options.
            requested: Requested values of options that the number of photos limited.
            reason: Reason why training ended.
        """
        trainer, folder, photos = self.trainer, self.folder, self.trainer.photos
        names = photos.scene.cameras.names
        course = Course(
            steps=trainer.steps,
            train_seconds=meter.train_seconds,
            reason=reason,
            device_peak_bytes=trainer.engine.peak_memory() or None,
            trained_at=datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
            history=meter.history,
            evals=evals,
            models=trainer.plan.models if trainer.plan.models > 1 else None,
            depth=None if depth is None else depth.numbers,
            ranks=_of_ranks(trainer.group),
            decisions=decisions,
            asked=dict(requested or {}) or None,
            **(photo_parameters or {}),
        )
        stopped = Evaluation.none("training was stopped before its evaluation")
        metrics = Metrics(
            evaluation=evaluation or stopped,
            split=evaluator.split,
            train_views=[names[i] for i in photos.train],
            test_views=[names[i] for i in photos.test],
            mask_mode=photos.mask_mode,
            background=trainer.renderer.background,
            splats=trainer.splat_count,
            sh_degree=trainer.model.sh_degree,
            storage_bytes=folder.point_cloud.stat().st_size,
            isa=trainer.engine.info.numerics,
            threads=trainer.engine.info.threads,
            course=course,
        )
        return write_results(
            folder.path,
            metrics,
            data=data,
            run=folder.path,
            trained=(data, trainer.config),
            resolved=_resolved(trainer),
            views=collector.views if evaluation else (),
            warnings=warnings,
            depth=None if depth is None else depth.section,
            masked=self._masked_photos(),
            cameras=cameras_section(data.source, photos.scene),
            histograms=splat_histograms(trainer.models.parts()),
        )

    def write_photo_parameters(self, exposure: dict[str, Any] | None, poses: str) -> dict[str, Any]:
        """Write exposure.json and poses.json; return their entries of metrics.json.

        Args:
            exposure: Estimated exposures of the photos; None: not estimated.
            poses: Reason for pose refinement.
        """
        trainer, entries = self.trainer, {}
        if exposure is not None:
            entries["exposure"] = exposure | {"learnt": trainer.photo_parameters.gains is not None}
        gains, names = trainer.photo_parameters.all_gains(), trainer.photos.scene.cameras.names
        if gains is not None:
            views = [*trainer.photos.train, *trainer.photos.test]
            by_name = {names[i]: PhotoExposure.of(gains[i]) for i in views}
            write_exposures(self.folder.path / EXPOSURE_FILE, by_name)
        if trainer.photo_parameters.poses is not None:
            entries["poses"] = {
                "why": poses,
                "cameras": self._write_poses(trainer.photo_parameters.poses),
            }
        blurs = trainer.photo_parameters.blurs
        if blurred := blurs and blurs.blurred:
            entries["blurs"] = {names[i]: deviation for i, deviation in blurred.items()}
        transients = trainer.photo_parameters.transients
        if shares := transients and transients.shares:
            entries["transients"] = {names[i]: share for i, share in shares.items()}
        return entries

    def _masked_photos(self) -> list[MaskedPhoto]:
        """Pictures of the photos with the largest transients."""
        photos, transients = self.trainer.photos, self.trainer.photo_parameters.transients
        if transients is None:
            return []
        shares, found = transients.shares, []
        for index in sorted(shares, key=shares.__getitem__, reverse=True)[:MOST_PICTURES]:
            try:
                photo = photos.image(index)
            except GsError:  # the file is gone; the results are complete without its picture
                continue
            mask = transients.of(index, photo.shape[1], photo.shape[0])
            assert mask is not None
            found.append(MaskedPhoto.of(photos.scene.cameras.names[index], photo, mask))
        return found

    def _write_poses(self, poses: PhotoPoses) -> dict[str, dict[str, float]]:
        """Write poses.json; return the displacement of each training camera from the capture."""
        frame, photos = self.trainer.frame, self.trainer.photos
        cameras, train = photos.scene.cameras, list(photos.train)
        now = replace(cameras, viewmats=poses.viewmats)
        viewmats = frame.similarity.cameras_from_training(now).viewmats[train]
        turned, moved = pose_distances(viewmats, cameras.viewmats[train])
        degrees, names = np.degrees(turned), [cameras.names[i] for i in train]
        path = self.folder.path / POSES_FILE
        write_poses(path, names, viewmats, degrees, moved, origin=cameras.origin)
        extents = moved * frame.similarity.scale / frame.extent
        return {
            name: {"degrees": float(degrees[i]), "extents": float(extents[i])}
            for i, name in enumerate(names)
        }


def _resolved(trainer: Trainer) -> dict[str, Any]:
    """Return the trainer's plan under the names of the options, with the effective rates."""
    values = asdict(trainer.plan)
    del values["stages"], values["kept"]  # combine several options
    values["ensemble"] = values.pop("models")
    values["max_splats"] = trainer.config.max_splats  # the plan has that of one model
    values["means_lr"], values["means_lr_final"] = values["means_lr"]
    return values | {f"{name}_lr": rate for name, rate in values.pop("rates").items()}


def _of_ranks(group: ProcessGroup | None) -> dict[str, Any] | None:
    """Return mean traffic and times of a batch by rank, on rank 0; None: a single process."""
    if group is None or group.batches < 2:
        return None
    before = group.batches - 1  # the accounts cover all batches but the last
    sent, worked, waited = (group.accounts / before).T.tolist()
    return {
        "count": group.size,
        "batches": group.batches,
        "sent_bytes_per_batch": [round(n) for n in sent],
        "worked_seconds_per_batch": worked,
        "waited_seconds_per_batch": waited,
    }
