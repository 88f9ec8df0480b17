"""COLMAP database: its contents, read while nothing writes to it.

Access is through pycolmap only: a second SQLite in the process, such as Python's own, would release
the locks of the first when it closes the file, and the database would be corrupted. Its matches
give the reason of a failure.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..quoting import first_few
from ..text_format import count_text
from .pycolmap_thread import colmap


@dataclass(frozen=True)
class Overlap:
    """Match statistics of the photos in a database."""

    features: np.ndarray
    """[n] int64, number of features of each photo."""
    pairs: int
    """Number of pairs of photos with enough verified matches."""
    flat: int
    """Number of these pairs that a rotation, a plane or no motion explains."""
    still: int
    """Number of these pairs with most matches at equal pixels."""
    alone: tuple[str, ...]
    """Aliases of the photos in none of these pairs."""


_STILL = 1.0
"""Pixels up to which the median match of a pair is at the same place in both photos."""


def overlap(database: Path, *, least: int) -> Overlap:
    """Read the match statistics.

    Args:
        database: Filled by feature extraction and matching.
        least: Minimum number of verified matches of a pair.
    """
    p = colmap()
    kinds = p.TwoViewGeometryConfiguration
    flat = (kinds.PLANAR, kinds.PANORAMIC, kinds.PLANAR_OR_PANORAMIC)
    with p.Database.open(database) as link:
        names = {image.image_id: image.name for image in link.read_all_images()}
        features = [link.num_keypoints_for_image(i) for i in names]
        places = {i: np.asarray(link.read_keypoints(i))[:, :2] for i in names}
        numbers, geometries = link.read_two_view_geometries()
    found = [
        (p.pair_id_to_image_pair(number), geometry)
        for number, geometry in zip(numbers, geometries, strict=True)
        if len(geometry.inlier_matches) >= least
    ]
    moved = [
        places[one][geometry.inlier_matches[:, 0]] - places[other][geometry.inlier_matches[:, 1]]
        for (one, other), geometry in found
    ]
    still = [float(np.median(abs(shift).max(axis=1))) < _STILL for shift in moved]
    joined = {i for pair, _ in found for i in pair}
    return Overlap(
        features=np.array(features, np.int64),
        pairs=len(found),
        flat=sum(
            is_still or geometry.config in flat
            for (_, geometry), is_still in zip(found, still, strict=True)
        ),
        still=sum(still),
        alone=tuple(name for i, name in names.items() if i not in joined),
    )


def without_features(database: Path) -> list[str]:
    """Aliases of the photos that COLMAP could not read, sorted."""
    with colmap().Database.open(database) as link:
        images = link.read_all_images()
        return sorted(image.name for image in images if not link.exists_keypoints(image.image_id))


def features(database: Path) -> list[int]:
    """Number of features of each photo."""
    with colmap().Database.open(database) as link:
        return [link.num_keypoints_for_image(image.image_id) for image in link.read_all_images()]


def descriptors(database: Path) -> dict[str, np.ndarray]:
    """Descriptors of the features of each photo, [m, 128] uint8, by alias."""
    with colmap().Database.open(database) as link:
        images = sorted(link.read_all_images(), key=lambda image: image.name)
        return {image.name: link.read_descriptors(image.image_id).data for image in images}


def matches(database: Path) -> int:
    """Number of verified matches over all pairs."""
    with colmap().Database.open(database) as link:
        return link.num_inlier_matches()


def focal_lengths(database: Path) -> dict[int, tuple[float, bool]]:
    """Initial focal length of each camera in px, and whether it is from EXIF or the user, by camera
    id."""
    with colmap().Database.open(database) as link:
        cameras = link.read_all_cameras()
    return {c.camera_id: (c.mean_focal_length(), c.has_prior_focal_length) for c in cameras}


def gps_places(database: Path) -> dict[int, np.ndarray]:
    """GPS positions from EXIF: latitude and longitude in degrees, height in metres, [3] float64 by
    image id. COLMAP stores no position without a height."""
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
    """Aliases of the photos by image id."""
    with colmap().Database.open(database) as link:
        return {image.image_id: image.name for image in link.read_all_images()}


_FEW_FEATURES = 100
"""Number of features of the median photo below which missing texture is the reason."""
_MOSTLY_FLAT = 0.8
"""Share of pairs without parallax from which missing parallax is the reason."""
_MOSTLY_STILL = 0.5
"""Share of pairs with matches at equal pixels from which a still background is the reason."""


def failure_reason(found: Overlap, names: dict[str, str], *, masked: bool = False) -> str:
    """Message for photos that gave no model.

    Args:
        found: Match statistics of the photos.
        names: Names of the photos by alias.
        masked: Whether masks hide parts of the photos.
    """
    photos = count_text(len(found.features), "photo")
    median = int(np.median(found.features))
    if median < _FEW_FEATURES:
        return (
            f"No cameras found: the photos show too little texture. Half of the {photos} have "
            f"{f'{median} or fewer features' if median else 'no features'}, at least "
            f"{_FEW_FEATURES} are needed. Take sharp photos of textured surfaces"
            f"{', or leave masks out with `--no-masks`' if masked else ''}."
        )
    if not found.pairs:
        return (
            f"No cameras found: no two of the {photos} overlap. Take more photos, so that each "
            "overlaps most of the previous one."
        )
    if found.still >= _MOSTLY_STILL * found.pairs:
        return (
            f"No cameras found: in {found.still} of the {count_text(found.pairs, 'pair')} of "
            "photos that overlap most of the matches are at the same pixels: the camera did not "
            "move, or the subject turned in front of a still background. Walk around the subject, "
            "or hide the background by masks."
        )
    if found.flat >= _MOSTLY_FLAT * found.pairs:
        return (
            f"No cameras found: {found.flat} of the {count_text(found.pairs, 'pair')} of photos "
            "that overlap show no parallax: the camera turned on the spot, faced a flat wall, or "
            "did not move. Walk around the subject and take photos from different places."
        )
    alone = f" {count_text(len(found.alone), 'photo matches', 'photos match')} no other: "
    alone = (
        f"{alone}{first_few([names[alias] for alias in found.alone], 3)}." if found.alone else ""
    )
    return (
        f"No cameras found: the photos overlap too little. Of the {photos}, "
        f"{count_text(found.pairs, 'pair matches', 'pairs match')}, which is not enough for a "
        f"model.{alone} Take more photos between the existing ones."
    )
