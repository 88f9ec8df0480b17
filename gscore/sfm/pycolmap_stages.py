"""Pycolmap stages on a database: import of photos, features, matches, reconstruction."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..config import checked_threads
from ..datasets.dataset import map_threads
from ..io.files import atomic_write
from ..raster.match import match_descriptors
from . import database, gps_scale
from .bundle_adjustment import may_be_stable
from .forecast import Forecast, working_cores
from .pairs import FURTHER_PAIRS, Pair, further_parts, in_parts, is_sequential
from .photos import LEAST, Photo, by_camera
from .pycolmap_thread import colmap
from .search_request import Attempt, SearchRequest

SEED = 0
"""Random seed of all stages."""
LEAST_MATCHES = 15
"""Minimum number of verified matches of a pair of photos; COLMAP's own."""
LARGEST_SIDE = 3200
"""Longer side to which photos are scaled for features, px."""
_FEW_PHOTOS = 40
"""Number of photos up to which each gets more features."""
_FEATURES, _FEATURES_OF_FEW, _RICH_FEATURES = 3072, 4096, 12288
_TRIALS = 1000
"""Maximum number of RANSAC samples per pair. COLMAP's 10,000 take three times as long, because of
pairs without overlap; fewer lose pairs of 15 or 16 matches, 0.3 % of all matches."""
USUAL_FOCAL = 0.9
"""Focal length relative to the longer side without EXIF: phones have 0.7 to 0.95, kit lenses 0.75
to 2."""
_RICH_PEAK = 0.5
"""Peak threshold of features in the rich attempt, relative to COLMAP's default."""
_PART = 8
"""Minimum number of photos per extraction call (two per core), after which the database has
them."""
_SAMPLE = 4
"""Minimum number of photos (one per core) that calibrate the forecast."""
_TRACKS = 200
"""Tracks per photo with which the global mapper starts; the others join once it has camera poses.
It solves for all in one thread: studio takes 7 CPU s instead of 26, with the same points and focal
length."""
_BYTES_OF_FEATURE, _DOUBLED, _COPIES = 152, 1.25, 2
"""Bytes of a feature in the database, features per kept one because some have two orientations, and
copies of each until SQLite merges its log."""
_MOST_EXHAUSTIVE = 400
"""Number of photos up to which the rich attempt matches all pairs."""


@dataclass(frozen=True, kw_only=True)
class Work:
    """Input of the stages."""

    request: SearchRequest
    root: Path
    """Folder of the photos under their aliases."""
    photos: list[Photo]
    masks: Path | None
    """Folder of masks in COLMAP's format; None: no masks."""
    folder: Path
    """Folder of databases and models."""

    @property
    def threads(self) -> int:
        """The number of threads in pycolmap's convention: -1 is one per core."""
        return checked_threads(self.request.threads) or -1

    def database(self, attempt: Attempt) -> Path:
        """File of the attempt's features and matches."""
        return self.folder / attempt.database

    def is_sequential(self, attempt: Attempt) -> bool:
        """Whether photos are matched in their order only."""
        few = attempt.more_features and len(self.photos) <= _MOST_EXHAUSTIVE
        by_order = is_sequential(self.request.matching, len(self.photos))
        return by_order and not (few and self.request.matching == "auto")

    def parts(self, attempt: Attempt) -> list[list[Pair]]:
        """Pairs of photos to match, in parts after which work can stop."""
        return in_parts(self.photos, sequential=self.is_sequential(attempt))

    def matches_similar(self, attempt: Attempt) -> bool:
        """Whether similar photos and photos near each other are matched too."""
        return self.request.matching == "auto" and self.is_sequential(attempt)

    def pairs_expected(self, attempt: Attempt) -> int:
        """Expected number of pairs to match, with those added by similarity."""
        further = FURTHER_PAIRS * len(self.photos) if self.matches_similar(attempt) else 0
        return sum(map(len, self.parts(attempt))) + further

    def forecast(self, attempt: Attempt, *, pace: float = 1.0) -> Forecast:
        """Forecast of an attempt; `pace` from an earlier forecast."""
        scales = [min(1.0, LARGEST_SIDE / max(p.width, p.height)) for p in self.photos]
        return Forecast(
            megapixels=[
                p.width * p.height * scale**2 / 1e6
                for p, scale in zip(self.photos, scales, strict=True)
            ],
            most=most_features(len(self.photos), more_features=attempt.more_features),
            pairs=self.pairs_expected(attempt),
            threads=self.request.threads,
            pace=pace,
        )


def enter_photos(work: Work, database: Path) -> None:
    """Create the database with a row for each photo and one camera per group; an existing one is
    kept, because it gets its final name only once it is complete."""
    if database.is_file():
        return
    p = colmap()
    unfinished = database.with_suffix(".new")
    for old in (unfinished, *(Path(f"{unfinished}-{end}") for end in ("wal", "shm"))):
        old.unlink(missing_ok=True)
    p.Database.open(unfinished).close()
    options = p.ImageReaderOptions(
        camera_model=work.request.camera_model, default_focal_length_factor=USUAL_FOCAL
    )
    for group in by_camera(work.photos):
        names = [photo.alias for photo in group]
        p.import_images(unfinished, work.root, p.CameraMode.SINGLE, names, options)
    if work.request.focal_length:
        _state_focal(unfinished, work.request.focal_length)
    unfinished.replace(database)


def _state_focal(database: Path, focal: float) -> None:
    with colmap().Database.open(database) as link:
        for camera in link.read_all_cameras():
            params = camera.params
            params[list(camera.focal_length_idxs())] = focal
            camera.params, camera.has_prior_focal_length = params, True
            link.update_camera(camera)


def feature_parts(work: Work) -> list[list[str]]:
    """Aliases of the photos of each extraction call; the first is a sample spread over all photos,
    which calibrates the forecast."""
    cores = working_cores(checked_threads(work.request.threads))
    names = [photo.alias for photo in work.photos]
    sample = names[:: -(-len(names) // max(_SAMPLE, cores))]
    others = [name for name in names if name not in set(sample)]
    size = max(_PART, 2 * cores)
    return [sample, *(others[i : i + size] for i in range(0, len(others), size))]


def most_features(photos: int, *, more_features: bool) -> int:
    """Maximum number of features per photo, not counting second orientations."""
    if more_features:
        return _RICH_FEATURES
    return _FEATURES_OF_FEW if photos <= _FEW_PHOTOS else _FEATURES


def space_needed(work: Work, attempt: Attempt) -> int:
    """Maximum number of bytes that a part of an attempt writes: features in the database and its
    log."""
    most = _DOUBLED * most_features(len(work.photos), more_features=attempt.more_features)
    photos = max(map(len, feature_parts(work)))
    return int(_COPIES * photos * most * _BYTES_OF_FEATURE)


def extract(work: Work, attempt: Attempt, names: list[str], token: Any) -> None:
    """Extract features of those photos that have none in the database yet."""
    p = colmap()
    p.set_random_seed(SEED)
    reading = p.ImageReaderOptions(camera_model=work.request.camera_model)
    if work.masks is not None:
        reading.mask_path = work.masks
    options = p.FeatureExtractionOptions()
    options.num_threads = work.threads
    options.max_image_size = LARGEST_SIDE
    options.sift.max_num_features = most_features(
        len(work.photos), more_features=attempt.more_features
    )
    if attempt.more_features:
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


def further(work: Work, attempt: Attempt) -> list[list[Pair]]:
    """Pairs in addition to those from names, after feature extraction, in parts."""
    file = work.database(attempt)
    known = [pair for part in work.parts(attempt) for pair in part]
    return further_parts(known, database.descriptors(file), gps_scale.places_in_metres(file))


def match(work: Work, attempt: Attempt, pairs: list[Pair], token: Any) -> None:
    """Match those pairs that have no matches in the database yet."""
    match_pairs(
        work.database(attempt),
        pairs,
        least=LEAST_MATCHES,
        threads=work.request.threads,
        cancelled=lambda: token.is_cancelled,
    )
    _fit_geometries(work, attempt, pairs, token)


def _fit_geometries(work: Work, attempt: Attempt, pairs: list[Pair], token: Any) -> None:
    """Verify the matches of those pairs that have no two-view geometry yet."""
    p = colmap()
    p.set_random_seed(SEED)
    options, checks = p.FeatureMatchingOptions(), p.TwoViewGeometryOptions()
    options.num_threads = work.threads
    checks.ransac.random_seed = SEED
    checks.ransac.max_num_trials = _TRIALS
    listed = work.folder / "pairs.txt"
    atomic_write(listed, "".join(f"{a} {b}\n" for a, b in pairs).encode())
    pairing = p.ImportedPairingOptions(match_list_path=listed, block_size=len(pairs))
    p.match_image_pairs(work.database(attempt), options, pairing, checks, p.Device.cpu, token)


def reconstruct(work: Work, attempt: Attempt, token: Any, on_photo: Any) -> list[Any]:
    """Models from the matches, as pycolmap Reconstructions, the largest first.

    `on_photo` is called for each registered photo, by the incremental mapper only.
    """
    p = colmap()
    p.set_random_seed(SEED)
    models = work.folder / "models"
    models.mkdir(exist_ok=True)
    if attempt.mapper == "global":
        options = p.GlobalPipelineOptions(min_model_size=LEAST, num_threads=work.threads)
        options.random_seed = SEED
        options.mapper.track_required_tracks_per_view = _TRACKS
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
    kept = [m for m in found.values() if m.num_reg_images() >= LEAST and may_be_stable(m)]
    return sorted(kept, key=lambda model: (-model.num_reg_images(), -model.num_points3D()))


def _incremental_options(work: Work, *, lenient: bool) -> Any:
    options = colmap().IncrementalPipelineOptions(min_model_size=LEAST, num_threads=work.threads)
    options.random_seed = SEED
    if lenient:
        options.mapper.init_max_forward_motion = 1.0
        options.mapper.init_min_tri_angle = 4.0
        options.mapper.init_min_num_inliers = 50
        options.mapper.abs_pose_min_num_inliers = 20
        # Few photos do not constrain the distortion, and a wrong one distorts the whole model.
        options.ba_refine_extra_params = False
        options.mapper.abs_pose_refine_extra_params = False
    return options


FARTHEST_MATCH, LARGEST_RATIO = 0.7 * 512, 0.8
"""Maximum distance and ratio of a match; COLMAP's own, whose descriptors have a norm of 512."""


def match_pairs(
    database: Path,
    pairs: list[Pair],
    *,
    least: int,
    threads: int,
    cancelled: Callable[[], bool],
) -> None:
    """Match the features of pairs of photos that have not been matched yet.

    Args:
        database: With features; not open elsewhere.
        pairs: Aliases of photos.
        least: Minimum number of matches; a pair with fewer gets none.
        threads: Pairs at a time; 0: one per core.
        cancelled: Called after each pair; finished pairs are kept.

    Raises:
        BackendError: the native library is missing.
    """
    with colmap().Database.open(database) as link:
        numbers = {image.name: image.image_id for image in link.read_all_images()}
        wanted = [(numbers[a], numbers[b]) for a, b in pairs]
        wanted = [pair for pair in wanted if not link.exists_matches(*pair)]
        described = {
            i: link.read_descriptors(i).data
            for i in {i for pair in wanted for i in pair}
            if link.exists_descriptors(i)
        }
        wanted = [(a, b) for a, b in wanted if a in described and b in described]

        def found(k: int) -> np.ndarray:
            first, second = (described[i] for i in wanted[k])
            matches = match_descriptors(
                first, second, max_distance=FARTHEST_MATCH, max_ratio=LARGEST_RATIO
            )
            return matches if len(matches) >= least else matches[:0]

        results = map_threads(found, [*range(len(wanted))], threads=threads)
        for pair, matches in zip(wanted, results, strict=True):
            link.write_matches(*pair, matches)
            if cancelled():
                return
