"""Forecast of a training before it starts: seconds and memory. Needs no torch."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from ...config import TrainConfig
from ...errors import GsError
from ...metrics.lpips import lpips_file, named_net
from ...raster.api import render
from ...splats import Splats
from ...text_format import count_words
from ..schedule.caps import config_where_photos_agree, expected_model_count
from ..schedule.plan import Plan
from .cost import Cost
from .memory import (
    RUNTIME,
    cache_bytes,
    decoded_anew,
    depth_bytes,
    free_memory,
    photo_memory,
    point_bytes,
    training_bytes,
)

_REFERENCE_MS = 2.61
"""Milliseconds of `_picture` on the machine whose step times `cost` holds."""
_SPLATS, _WIDTH, _HEIGHT = 20_000, 320, 240
_TRIES = 10
_WARMING_UP = 2
"""Pictures of them that also begin threads and fill caches."""
_SMALLEST_WIDTH = 64
"""Pixels; no narrower photos are proposed."""
_FEWEST_SPLATS = 10_000
"""No fewer are proposed."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """What a training will take."""

    seconds: float
    """Of training, without reading photos, measuring and writing."""
    peak_bytes: int
    """Largest resident memory of the process."""
    free_bytes: int | None
    """Memory that is free now; None: the system does not tell."""
    photo_bytes: int
    """Memory of decoded photos."""
    photos_kept: bool
    """Whether all photos stay in memory; else some are decoded again and again."""
    photos_anew: bool = False
    """Whether those that are kept are decoded once for each size they are trained at."""
    fits: bool
    """Whether the memory will do."""
    fitting_splats: int
    """Most splats that fit with these photos, in thousands; 0: too few to be of use."""
    fitting_width: int
    """Width in pixels, of the widest photo, at which `max_splats` fit; 0: none is wide enough."""

    @property
    def advice(self) -> str:
        """What to do where it does not fit; empty where it does."""
        if self.fits:
            return ""
        ways = [f"use --max-splats {self.fitting_splats}"] if self.fitting_splats else []
        if self.fitting_width:
            ways.append(f"use smaller photos (-r {self.fitting_width})")
        return " or ".join([*ways, "close programs"])


def estimate(
    config: TrainConfig,
    sizes: Sequence[tuple[int, int]],
    *,
    points: int,
    masks: bool = False,
    subject: bool = False,
    depths: bool = False,
    cloud: int | None = None,
    decoding: int = 0,
    free: int | None = None,
    pace: float | None = None,
) -> Estimate:
    """Predict time and memory of a training; no file is read.

    Args:
        config: The options.
        sizes: Width and height of each photo as trained on, pixels: see `target_size`.
        points: Splats at the start.
        masks: Whether photos have masks.
        subject: Whether these are opacity, so that nothing but a subject is trained.
        depths: Whether there are depth maps for them.
        cloud: Points of structure from motion; None: as many as `points`.
        decoding: Bytes that photos take while they are decoded, see `Dataset.decoding_bytes`.
        free: Bytes of memory that may be used; None: what is free now.
        pace: How many times as long this machine takes as the one the model was measured on;
            None: found out by drawing some pictures, once, within a tenth of a second.

    Raises:
        BackendError: The native library is missing.
    """
    widths, heights = np.array(sizes, np.int64).reshape(-1, 2).T
    pixels = widths * heights
    free = free_memory() if free is None else free
    largest, total = int(pixels.max(initial=1)), int(pixels.sum())
    guides = (config.guide_surface is not None) + (config.guide_free is not None)
    maps = depth_bytes(total) * (depths + guides)
    photos = total * (4 if masks else 3)
    network = lpips_file(config.lpips)
    lpips = bool(named_net(config.lpips)) or (network is not None and network.is_file())
    # Whether photos agree is not known yet: of whole photos where they do it is sooner done, of a
    # subject sooner or later.
    count = len(sizes)
    expected = [
        (config, expected_model_count(config, photos=count, points=points, subject=subject))
    ]
    if subject and (agreed := config_where_photos_agree(config, photos=count, points=points)):
        expected.append(agreed)
    models = max(models for _, models in expected)

    def needed(splats: int, pixels: int) -> int:
        return training_bytes(
            splats=splats,
            sh_degree=config.sh_degree,
            pixels=pixels,
            lpips=lpips,
            joined=models > 1,
        )

    stay, at_start = point_bytes(points if cloud is None else cloud, splats=config.max_splats)
    rest = maps + stay + max(needed(config.max_splats, largest), at_start)
    anew = decoded_anew(config, photos, views=len(sizes), rest=rest)
    held = photo_memory(photos, config, anew=anew)
    reading = stay + decoding  # before everything else is there
    kept = cache_bytes(config, photos, all_of_them=held, rest=max(rest, reading), free=free)
    if kept is not None or anew:
        rest += decoding
    if kept is not None:
        kept = cache_bytes(config, photos, all_of_them=held, rest=rest, free=free)
    held = held if kept is None else kept
    rest = max(rest, reading)
    fits = free is None or rest + held <= free
    fitting_splats, fitting_width = 0, 0
    if not fits and free is not None:
        widest = int(widths.max(initial=1))
        room = 0.9 * free - held - maps - stay - (0 if kept is None else decoding)

        def fit(splats: int, width: int) -> bool:
            # Photos that do not fit are decoded again and again: what must fit is the largest view.
            view = largest * (width / widest) ** 2
            return max(needed(splats, int(view)), at_start) <= room

        fitting_splats = 1000 * _most(lambda k: fit(1000 * k, widest), config.max_splats // 1000)
        fitting_splats = fitting_splats if fitting_splats >= _FEWEST_SPLATS else 0
        fitting_width = _most(lambda width: fit(config.max_splats, width), widest)
        fitting_width = fitting_width if fitting_width >= _SMALLEST_WIDTH else 0

    def paced(config: TrainConfig, models: int, *, drops: bool) -> float:
        plan = Plan.of(
            config,
            extent=1.0,
            points=points,
            side=int(min(widths.min(initial=1 << 30), heights.min(initial=1 << 30))),
            pixels=int(pixels.mean()) if len(pixels) else 1,
            subject=subject,
            drops=drops,
            models=models,
        )
        return Cost(plan).seconds_after(0, models * min(points, plan.max_splats))

    seconds = config.time_budget
    if not seconds:
        pace = machine_pace(config.threads) if pace is None else pace
        seconds = pace * max(paced(*case, drops=n > 0) for n, case in enumerate(expected))
    return Estimate(
        seconds=seconds,
        peak_bytes=RUNTIME + rest + held,
        free_bytes=free,
        photo_bytes=held,
        photos_kept=kept is None,
        photos_anew=anew and kept is None,
        fits=fits,
        fitting_splats=fitting_splats,
        fitting_width=fitting_width,
    )


def _most(fits: Callable[[int], bool], high: int) -> int:
    """The largest of 1 to `high` that fits, where smaller ones do too; 0: none."""
    low = 0
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if fits(middle) else (low, middle - 1)
    return low


def check_fits(found: Estimate, config: TrainConfig) -> None:
    """Raise GsError, with what would fit, if a training will not fit into memory."""
    if found.fits or found.free_bytes is None:
        return
    raise GsError(
        f"Training {count_words(config.max_splats, 'splat')} needs about "
        f"{(found.peak_bytes - RUNTIME) / 1e9:.1f} "
        f"GB of memory, but {found.free_bytes / 1e9:.1f} GB are free; {found.advice}."
    )


@cache
def machine_pace(threads: int = 0) -> float:
    """How many times as long this machine takes for a picture as the one of the model.

    Measured once in a process, in a few dozen milliseconds: the fastest of some pictures, which
    other programs at work disturb least.

    Args:
        threads: 0: all cores.

    Raises:
        BackendError: The native library is missing.
    """
    return min(_paces(threads))


def pace_now(threads: int = 0) -> float:
    """As `machine_pace`, with all that other programs take away at this moment: for a run that
    begins now, not for what the machine could do.

    Args:
        threads: 0: all cores.

    Raises:
        BackendError: The native library is missing.
    """
    found = _paces(threads)[_WARMING_UP:]
    return sum(found) / len(found)


def _paces(threads: int) -> list[float]:
    """What each of some pictures took, as shares of what it takes on the machine of the model."""
    splats, K, viewmat = _picture()
    found = []
    for _ in range(_TRIES):
        began = time.perf_counter()
        render(splats, K, viewmat, _WIDTH, _HEIGHT, depths=False, threads=threads)
        found.append(1000 * (time.perf_counter() - began) / _REFERENCE_MS)
    return found


def _picture() -> tuple[Splats, np.ndarray, np.ndarray]:
    """A ball of splats about as large on the screen as those of a capture."""
    rng = np.random.default_rng(0)
    splats = Splats(
        means=rng.normal(size=(_SPLATS, 3)).astype(np.float32),
        quats=rng.normal(size=(_SPLATS, 4)).astype(np.float32),
        scales=rng.normal(-3.5, 0.5, (_SPLATS, 3)).astype(np.float32),
        opacities=rng.normal(size=_SPLATS).astype(np.float32),
        sh0=rng.normal(size=(_SPLATS, 1, 3)).astype(np.float32),
        shN=np.zeros((_SPLATS, 0, 3), np.float32),
    )
    K = np.array([[300.0, 0, _WIDTH / 2], [0, 300.0, _HEIGHT / 2], [0, 0, 1]])
    viewmat = np.eye(4)
    viewmat[2, 3] = 4.0
    return splats, K, viewmat
