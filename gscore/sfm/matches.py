"""Feature matches between photos, computed and written to COLMAP's database.

COLMAP's own CPU matcher is not used: it calls the BLAS in its packages, which is not thread-safe,
from several threads, so in 1 % of the searches with eight threads a photo lost a tenth of its
matches, without an error. This one is exact, and no slower.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..datasets.dataset import map_threads
from ..raster.match import match_descriptors
from .pairs import Pair
from .pycolmap_thread import colmap

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
