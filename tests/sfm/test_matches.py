"""Feature matches; oracles: COLMAP's exhaustive search in one thread, the twin."""

import itertools
import shutil
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from gscore.sfm.pycolmap_stages import FARTHEST_MATCH, LARGEST_RATIO, match_pairs
from tests.raster.twins.match import match_descriptors as twin

LEAST = 15


@pytest.fixture(scope="module")
def features(photos: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A database with features of the photos, without matches."""
    file = tmp_path_factory.mktemp("features") / "database.db"
    options = pycolmap.FeatureExtractionOptions()
    options.sift.max_num_features = 400
    pycolmap.extract_features(file, photos, extraction_options=options, device=pycolmap.Device.cpu)
    return file


@pytest.fixture
def database(features: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(features, tmp_path))


def pairs_of(file: Path) -> list[tuple[str, str]]:
    with pycolmap.Database.open(file) as link:
        names = sorted(image.name for image in link.read_all_images())
    return list(itertools.combinations(names, 2))


def compared(file: Path) -> int:
    """Compared pairs, including those without a match."""
    with pycolmap.Database.open(file) as link:
        numbers = [image.image_id for image in link.read_all_images()]
        return sum(itertools.starmap(link.exists_matches, itertools.combinations(numbers, 2)))


def matches_of(file: Path) -> dict[int, np.ndarray]:
    """Matches by the number of the pair, where there are any."""
    with pycolmap.Database.open(file) as link:
        return dict(zip(*link.read_all_matches(), strict=True))


def never() -> bool:
    return False


def test_matches_are_colmaps(database: Path, tmp_path: Path) -> None:
    """Oracle: COLMAP's exhaustive search, which measures angles instead of lengths: 98 % are
    equal."""
    theirs = Path(shutil.copy(database, tmp_path / "theirs.db"))
    match_pairs(database, pairs_of(database), least=LEAST, threads=2, cancelled=never)
    options = pycolmap.FeatureMatchingOptions(num_threads=1, skip_geometric_verification=True)
    options.sift.cpu_brute_force_matcher = True
    pycolmap.match_exhaustive(theirs, options, device=pycolmap.Device.cpu)
    ours, wanted = matches_of(database), matches_of(theirs)
    assert ours.keys() == wanted.keys() and sum(map(len, wanted.values())) > 1000
    same = sum(
        len(set(map(tuple, ours[n].tolist())) & set(map(tuple, wanted[n].tolist()))) for n in wanted
    )
    assert same > 0.98 * max(sum(map(len, ours.values())), sum(map(len, wanted.values())))


def test_matches_are_those_of_the_twin(database: Path) -> None:
    """Oracle: all distances in float64; no matches of a pair with fewer than the minimum."""
    a, b = pairs_of(database)[0]
    match_pairs(database, [(a, b)], least=LEAST, threads=1, cancelled=never)
    with pycolmap.Database.open(database) as link:
        numbers = {image.name: image.image_id for image in link.read_all_images()}
        first, second = (link.read_descriptors(numbers[name]).data for name in (a, b))
    wanted = twin(first, second, max_distance=FARTHEST_MATCH, max_ratio=LARGEST_RATIO)
    (found,) = matches_of(database).values()
    if numbers[a] > numbers[b]:  # COLMAP keeps pairs by their numbers
        found = found[:, ::-1]
    np.testing.assert_array_equal(found[found[:, 0].argsort()], wanted)
    other = pairs_of(database)[1]
    match_pairs(database, [other], least=10**6, threads=1, cancelled=never)
    assert compared(database) == 2 and len(matches_of(database)) == 1


def test_compared_pairs_are_kept(database: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the count of compared pairs, none of them twice; none is kept after a stop."""
    seen: list[int] = []

    def counted(first: np.ndarray, second: np.ndarray, **limits: float) -> np.ndarray:
        seen.append(1)
        return twin(first[:20], second[:20], **limits)

    monkeypatch.setattr("gscore.sfm.pycolmap_stages.match_descriptors", counted)
    pairs = pairs_of(database)
    match_pairs(database, pairs[:10], least=1, threads=1, cancelled=never)
    assert len(seen) == compared(database) == 10
    match_pairs(database, pairs[:15], least=1, threads=1, cancelled=lambda: True)
    assert compared(database) == 11
    match_pairs(database, pairs, least=1, threads=2, cancelled=never)
    assert compared(database) == len(pairs)


def test_a_photo_without_features_is_left_out(database: Path) -> None:
    """Oracle: pairs of the other photos alone."""
    pairs = pairs_of(database)
    with pycolmap.Database.open(database) as link:
        image = pycolmap.Image(name="black.jpg", camera_id=1)
        link.write_image(image)
    match_pairs(
        database, [*pairs[:2], (pairs[0][0], "black.jpg")], least=1, threads=2, cancelled=never
    )
    assert compared(database) == 2
