"""The steps of pycolmap on a database: photos entered, features, matches, a model."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..config import checked_threads
from ..io.files import atomic_write
from .attempts import Attempt
from .pairs import Pair, is_sequential
from .photos import LEAST, Photo, by_camera
from .request import Request
from .watch import colmap

SEED = 0
"""Of all random choices."""
LEAST_MATCHES = 15
"""Matches that fit one geometry without which a pair of photos says nothing; COLMAP's own."""
LARGEST = 3200
"""Longer side, px, to which photos are scaled for features."""
_FEATURES, _RICH_FEATURES = 4096, 12288
_RICH_PEAK = 0.5
"""Strength of the weakest feature in the rich attempt, against COLMAP's usual one."""
_PART = 8
"""Photos whose features are found at a time, at least two a thread: then the database has them."""
HIGH_ERROR = 1.0
"""Mean reprojection error, px, above which the lens model is doubted."""
_SHARP = 2.0
"""Reprojection error, px, above which an observation is left out of the last adjustment."""
_LEAST_ANGLE = 1.5
"""Degrees between the rays of a point."""
_MOST_EXHAUSTIVE = 400
"""Photos up to which the rich attempt compares all with all."""


@dataclass(frozen=True, kw_only=True)
class Work:
    """What the steps work on."""

    request: Request
    root: Path
    """Folder of the photos under their aliases."""
    photos: list[Photo]
    masks: Path | None
    """Folder of masks as COLMAP takes them."""
    folder: Path
    """For databases and models."""

    @property
    def threads(self) -> int:
        """As pycolmap counts: -1 is one a core."""
        return checked_threads(self.request.threads) or -1

    def database(self, attempt: Attempt) -> Path:
        """File of the attempt's features and matches."""
        return self.folder / attempt.database

    def is_sequential(self, attempt: Attempt) -> bool:
        """Whether photos are compared in their order alone."""
        few = attempt.rich and len(self.photos) <= _MOST_EXHAUSTIVE
        by_order = is_sequential(self.request.matching, len(self.photos))
        return by_order and not (few and self.request.matching == "auto")


def enter_photos(work: Work, database: Path) -> None:
    """Make the database with a row for each photo, one camera for those that share one; where it is
    there it stays, since it appears under its name only when it is complete."""
    if database.is_file():
        return
    p = colmap()
    unfinished = database.with_suffix(".new")
    for old in (unfinished, *(Path(f"{unfinished}-{end}") for end in ("wal", "shm"))):
        old.unlink(missing_ok=True)
    p.Database.open(unfinished).close()
    options = p.ImageReaderOptions(camera_model=work.request.camera_model)
    for group in by_camera(work.photos):
        names = [photo.alias for photo in group]
        p.import_images(unfinished, work.root, p.CameraMode.SINGLE, names, options)
    unfinished.replace(database)


def feature_parts(work: Work) -> list[list[str]]:
    """Aliases of the photos whose features are found at a time."""
    threads = checked_threads(work.request.threads) or os.cpu_count() or 1
    size = max(_PART, 2 * threads)
    names = [photo.alias for photo in work.photos]
    return [names[i : i + size] for i in range(0, len(names), size)]


def extract(work: Work, attempt: Attempt, names: list[str], token: Any) -> None:
    """Find features in those of the photos that have none in the database yet."""
    p = colmap()
    p.set_random_seed(SEED)
    reading = p.ImageReaderOptions(camera_model=work.request.camera_model)
    if work.masks is not None:
        reading.mask_path = work.masks
    options = p.FeatureExtractionOptions()
    options.num_threads = work.threads
    options.max_image_size = LARGEST
    options.sift.max_num_features = _RICH_FEATURES if attempt.rich else _FEATURES
    if attempt.rich:
        options.sift.peak_threshold *= _RICH_PEAK
    p.extract_features(
        work.database(attempt),
        work.root,
        names,
        p.CameraMode.AUTO,
        reading,
        options,
        p.Device.cpu,
        token,
    )


def match(work: Work, attempt: Attempt, pairs: list[Pair], token: Any) -> None:
    """Compare those of the pairs that have not been compared in the database yet."""
    p = colmap()
    p.set_random_seed(SEED)
    options, checks = p.FeatureMatchingOptions(), p.TwoViewGeometryOptions()
    options.num_threads = work.threads
    checks.ransac.random_seed = SEED
    listed = work.folder / "pairs.txt"
    atomic_write(listed, "".join(f"{a} {b}\n" for a, b in pairs).encode())
    pairing = p.ImportedPairingOptions(match_list_path=listed, block_size=len(pairs))
    p.match_image_pairs(work.database(attempt), options, pairing, checks, p.Device.cpu, token)


def reconstruct(work: Work, attempt: Attempt, token: Any, on_photo: Any) -> list[Any]:
    """Models made of the matches, as pycolmap's Reconstruction, the largest first.

    `on_photo` is called for each photo that finds its place; the global mapper places all at once.
    """
    p = colmap()
    p.set_random_seed(SEED)
    models = work.folder / "models"
    models.mkdir(exist_ok=True)
    if attempt.mapper == "global":
        options = p.GlobalPipelineOptions(min_model_size=LEAST, num_threads=work.threads)
        options.random_seed = SEED
        found = p.global_mapping(work.database(attempt), work.root, models, options)
    else:
        options = _incremental_options(work, lenient=attempt.lenient)
        found = p.incremental_mapping(
            work.database(attempt),
            work.root,
            models,
            options,
            next_image_callback=on_photo,
            cancellation_token=token,
        )
    kept = [model for model in found.values() if model.num_reg_images() >= LEAST]
    return sorted(kept, key=lambda model: (-model.num_reg_images(), -model.num_points3D()))


def refine(model: Any, *, may_free: bool) -> float | None:
    """Leave out what does not fit well, and adjust cameras and points of pycolmap's Reconstruction
    to the rest, with a loss (soft L1) that single wrong points cannot pull.

    Args:
        model: Changed in place.
        may_free: Give the lenses two focal lengths and more coefficients (OPENCV) where the error
            is above `HIGH_ERROR`: photos that were scaled by other factors across than down need
            two, and one of them bends the whole model.

    Returns:
        The mean error in px before, where lenses were freed.
    """
    p = colmap()
    model.update_point_3d_errors()
    before = model.compute_mean_reprojection_error()
    freed = may_free and before > HIGH_ERROR
    if freed:
        for camera in model.cameras.values():
            f, cx, cy, k = camera.params
            camera.model = p.CameraModelId.OPENCV
            camera.params = [f, f, cx, cy, k, 0.0, 0.0, 0.0]
        _adjust(model)
    p.ObservationManager(model).filter_all_points3D(_SHARP, _LEAST_ANGLE)
    _adjust(model)
    model.update_point_3d_errors()
    return before if freed else None


def _adjust(model: Any) -> None:
    p = colmap()
    options = p.BundleAdjustmentOptions(print_summary=False)
    options.ceres.loss_function_type = p.LossFunctionType.SOFT_L1
    # Not `bundle_adjustment`, which writes a heading whatever its log's level is.
    config = p.BundleAdjustmentConfig()
    for number in model.reg_image_ids():
        config.add_image(number)
    config.fix_gauge(p.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    p.create_default_bundle_adjuster(options, config, model).solve()


def _incremental_options(work: Work, *, lenient: bool) -> Any:
    options = colmap().IncrementalPipelineOptions(min_model_size=LEAST, num_threads=work.threads)
    options.random_seed = SEED
    if lenient:
        options.mapper.init_max_forward_motion = 1.0
        options.mapper.init_min_tri_angle = 4.0
        options.mapper.init_min_num_inliers = 50
        options.mapper.abs_pose_min_num_inliers = 20
        # A lens that is bent by few points bends the whole model: few photos cannot tell it.
        options.ba_refine_extra_params = False
        options.mapper.abs_pose_refine_extra_params = False
    return options
