"""Forecast of a training before it starts: seconds and memory, without torch."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...config import TrainConfig
from ...engine.cpu.pace import machine_pace
from ...errors import GsError
from ...metrics.lpips import lpips_file, named_net
from ...text_format import count_text
from ..schedule.caps import config_where_photos_agree, expected_model_count
from ..schedule.plan import Plan
from .cost import Cost, reading_seconds
from .memory import (
    RUNTIME,
    cache_bytes,
    decodes_again,
    depth_bytes,
    free_memory,
    photo_memory,
    point_bytes,
    training_bytes,
)

_SMALLEST_WIDTH = 64
"""Least width of photos that is proposed, px."""
_FEWEST_SPLATS = 10_000
"""Least number of splats that is proposed."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Predicted time and memory of a training."""

    seconds: float
    """Time of training, without reading, evaluation and writing."""
    reading_seconds: float = 0.0
    """Time before the first step: reading points and photos, and the neighbours of points."""
    peak_bytes: int
    """Largest resident memory of the process."""
    free_bytes: int | None
    """Memory available now; None: unknown."""
    photo_bytes: int
    """Memory of decoded photos."""
    photos_kept: bool
    """True if all photos stay in memory; else some are decoded repeatedly."""
    decodes_again: bool = False
    """True if photos in memory are decoded again for each training resolution."""
    fits: bool
    """True if the memory is sufficient."""
    fitting_splats: int
    """Most splats that fit with these photos, in steps of 1000; 0: too few to be useful."""
    fitting_width: int
    """Width of the widest photo at which `max_splats` fit, px; 0: too small to be useful."""

    @property
    def advice(self) -> str:
        """Advice if the memory is insufficient, else empty."""
        if self.fits:
            return ""
        ways = [f"use `--max-splats {self.fitting_splats}`"] if self.fitting_splats else []
        if self.fitting_width:
            ways.append(f"use smaller photos (`--resolution {self.fitting_width}`)")
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
    stored: int | None = None,
    free: int | None = None,
    pace: float | None = None,
) -> Estimate:
    """Predict time and memory of a training without reading files.

    Args:
        config: The options.
        sizes: Width and height of each training photo, px, see `target_size`.
        points: Number of splats at the start.
        masks: Whether photos have masks.
        subject: Whether the masks are opacity, so that only a subject is trained.
        depths: Whether the photos have depth maps.
        cloud: Number of SfM points; None: `points`.
        decoding: Bytes used while photos are decoded, see `Dataset.decoding_bytes`.
        stored: Number of pixels of all photos as stored, in the time of JPEG
            (`Dataset.decoding_pixels`); None: as many as in `sizes`.
        free: Bytes of memory that may be used; None: those available now.
        pace: Time on this machine relative to the reference machine; None: measured once by
            rendering a few images, within a tenth of a second.

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
    # Whether photos agree is not known yet. Whole photos that agree are faster to train; a subject
    # may be faster or slower, so both cases are evaluated.
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
    decode_again = decodes_again(config, photos, views=len(sizes), rest=rest)
    cached = photo_memory(photos, config, decode_again=decode_again)
    to_read = stay + decoding  # before everything else is there
    kept = cache_bytes(config, photos, all_of_them=cached, rest=max(rest, to_read), free=free)
    if kept is not None or decode_again:
        rest += decoding
    if kept is not None:
        kept = cache_bytes(config, photos, all_of_them=cached, rest=rest, free=free)
    cached = cached if kept is None else kept
    rest = max(rest, to_read)
    fits = free is None or rest + cached <= free
    fitting_splats, fitting_width = 0, 0
    if not fits and free is not None:
        widest = int(widths.max(initial=1))
        room = 0.9 * free - cached - maps - stay - (0 if kept is None else decoding)

        def fit(splats: int, width: int) -> bool:
            # Photos beyond the cache are decoded repeatedly, so only the largest view must fit.
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

    pace = machine_pace(config.threads) if pace is None else pace
    reading = reading_seconds(
        points if cloud is None else cloud, total if stored is None else stored, config.threads
    )
    seconds = config.time_budget
    if not seconds:
        seconds = pace * max(paced(*case, drops=n > 0) for n, case in enumerate(expected))
    return Estimate(
        seconds=seconds,
        reading_seconds=pace * reading,
        peak_bytes=RUNTIME + rest + cached,
        free_bytes=free,
        photo_bytes=cached,
        photos_kept=kept is None,
        decodes_again=decode_again and kept is None,
        fits=fits,
        fitting_splats=fitting_splats,
        fitting_width=fitting_width,
    )


def _most(fits: Callable[[int], bool], high: int) -> int:
    """Largest number in 1 to `high` that fits, by bisection; 0: none."""
    low = 0
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if fits(middle) else (low, middle - 1)
    return low


def check_fits(found: Estimate, config: TrainConfig) -> None:
    """Raise GsError with advice if a training will not fit into memory."""
    if found.fits or found.free_bytes is None:
        return
    raise GsError(
        f"Training {count_text(config.max_splats, 'splat')} needs about "
        f"{(found.peak_bytes - RUNTIME) / 1e9:.1f} "
        f"GB of memory, but {found.free_bytes / 1e9:.1f} GB are free; {found.advice}."
    )
