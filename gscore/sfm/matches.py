"""Features of photos compared with those of others, and the matches written into COLMAP's database.

COLMAP's own search on a processor is left out: the BLAS in its packages is called by several
threads at once and is not made for that, so that in 1 % of the searches with eight threads a photo
lost a tenth of its matches, without an error. Ours is exact, and no slower.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from ..raster.match import match_descriptors
from .pairs import Pair
from .watch import colmap

FARTHEST_MATCH, LARGEST_RATIO = 0.7 * 512, 0.8
"""Of features that match; COLMAP's own, whose descriptors have a length of 512."""


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
        database: With features; nothing else has it open.
        pairs: Aliases of photos.
        least: Matches below which a pair has none.
        threads: Pairs at a time.
        cancelled: Asked after each pair; what was matched until then is kept.

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

        def of(pair: tuple[int, int]) -> np.ndarray:
            first, second = (described[i] for i in pair)
            found = match_descriptors(
                first, second, max_distance=FARTHEST_MATCH, max_ratio=LARGEST_RATIO
            )
            return found if len(found) >= least else found[:0]

        with ThreadPoolExecutor(threads, thread_name_prefix="gscore-match") as pool:
            for found, pair in zip(pool.map(of, wanted), wanted, strict=True):
                link.write_matches(*pair, found)
                if cancelled():
                    pool.shutdown(cancel_futures=True)
                    return
