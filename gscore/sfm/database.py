"""COLMAP database: its contents, read while nothing writes to it.

Through pycolmap alone: a second SQLite in the process, as Python's own is, would let go of the
locks of the first when it closes the file, and the database would be torn.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .pycolmap_thread import colmap


@dataclass(frozen=True)
class Overlap:
    """How the photos of a database hang together."""

    features: np.ndarray
    """[n] int64, features of each photo."""
    pairs: int
    """Pairs of photos with enough matches that fit one geometry."""
    flat: int
    """Of them, pairs that a rotation or a plane explains."""
    alone: tuple[str, ...]
    """Photos in none of these pairs."""


def overlap(database: Path, *, least: int) -> Overlap:
    """Read how the photos hang together.

    Args:
        database: Filled by feature extraction and matching.
        least: Matches of a pair that counts.
    """
    p = colmap()
    kinds = p.TwoViewGeometryConfiguration
    flat = (kinds.PLANAR, kinds.PANORAMIC, kinds.PLANAR_OR_PANORAMIC)
    with p.Database.open(database) as link:
        names = {image.image_id: image.name for image in link.read_all_images()}
        features = [link.num_keypoints_for_image(i) for i in names]
        numbers, geometries = link.read_two_view_geometries()
    found = [
        (p.pair_id_to_image_pair(number), geometry.config)
        for number, geometry in zip(numbers, geometries, strict=True)
        if len(geometry.inlier_matches) >= least
    ]
    joined = {i for pair, _ in found for i in pair}
    return Overlap(
        features=np.array(features, np.int64),
        pairs=len(found),
        flat=sum(kind in flat for _, kind in found),
        alone=tuple(name for i, name in names.items() if i not in joined),
    )


def without_features(database: Path) -> list[str]:
    """Photos that extraction has left out: COLMAP could not read them."""
    with colmap().Database.open(database) as link:
        images = link.read_all_images()
        return sorted(image.name for image in images if not link.exists_keypoints(image.image_id))


def features(database: Path) -> list[int]:
    """Features of each photo."""
    with colmap().Database.open(database) as link:
        return [link.num_keypoints_for_image(image.image_id) for image in link.read_all_images()]


def descriptors(database: Path) -> dict[str, np.ndarray]:
    """Of the features of each photo, [m, 128] uint8, by its alias."""
    with colmap().Database.open(database) as link:
        images = sorted(link.read_all_images(), key=lambda image: image.name)
        return {image.name: link.read_descriptors(image.image_id).data for image in images}


def matches(database: Path) -> int:
    """Matches that fit one geometry, of all pairs of photos."""
    with colmap().Database.open(database) as link:
        return link.num_inlier_matches()


def focal_lengths(database: Path) -> dict[int, tuple[float, bool]]:
    """What was expected of each camera before it was looked for: its focal length in px, and
    whether EXIF or the user has stated it."""
    with colmap().Database.open(database) as link:
        cameras = link.read_all_cameras()
    return {c.camera_id: (c.mean_focal_length(), c.has_prior_focal_length) for c in cameras}


def gps_places(database: Path) -> dict[int, np.ndarray]:
    """Where EXIF says that photos were taken: latitude and longitude in degrees, height in metres,
    [3] float64 by number of the image. COLMAP takes no place without a height."""
    p = colmap()
    geodetic = p.PosePriorCoordinateSystem.WGS84
    with p.Database.open(database) as link:
        priors = link.read_all_pose_priors()
    return {
        prior.corr_data_id.id: np.asarray(prior.position, np.float64)
        for prior in priors
        if prior.coordinate_system == geodetic and np.isfinite(prior.position).all()
    }


def aliases(database: Path) -> dict[int, str]:
    """Names of the photos by number of the image."""
    with colmap().Database.open(database) as link:
        return {image.image_id: image.name for image in link.read_all_images()}
