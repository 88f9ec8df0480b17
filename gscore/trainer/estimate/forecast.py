"""Forecast of a training before it starts: seconds and memory, without torch."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...config import Skip, TrainConfig
from ...engine.base import CostModel
from ...engine.cpu.pace import COST, machine_pace
from ...errors import GsError
from ...io.system_memory import available_memory_bytes, total_memory_bytes
from ...metrics.lpips import lpips_file, named_net
from ...splats import SH_REST_BY_DEGREE
from ...text_format import count_text, number, size_text
from ..model.nearest_points import few_queries
from ..schedule.caps import config_where_photos_agree, expected_model_count
from ..schedule.plan import Plan
from .cost import Cost, reading_seconds
from .device_memory import device_bytes

RUNTIME = 230_000_000
"""Bytes of Python with torch before a training starts."""
_BASE = 80_000_000
"""Bytes of everything else of constant size."""
_NUMBER = 16
"""Bytes per number of a splat in a step: value, gradient and two moments, float32."""
_STEP_PER_SPLAT = 420
"""Bytes per splat of rasterizer and strategy in a step: projection, tile lists, sums over tiles,
counters."""
_STEP_PER_PIXEL = 60
"""Bytes per pixel of the largest view in a step: image, its gradient and the loss."""
_SURFACE_PER_SPLAT, _SURFACE_PER_PIXEL = 450, 47
"""Further bytes per splat and per pixel of the largest view in a step with the surface term, whose
second picture has a quarter of the pixels."""
_EVAL_NUMBER = 4
"""Bytes per number of a splat in the evaluation, without moments and gradients."""
_EVAL_PER_SPLAT = 220
"""Bytes per splat of the rasterizer without gradients."""
_EVAL_PER_PIXEL = 300
"""Bytes per pixel of an evaluated image."""
_LPIPS, _LPIPS_PER_PIXEL = 80_000_000, 900
"""Bytes of the LPIPS network with its runtime, and per pixel of an image in it; the memory of other
metrics is free by then."""
_SMALLER_COPIES = 0.5
"""Bytes of scaled-down photos relative to the photos: the largest of them has half the pixels."""
_WORTH_DECODING = 0.05
"""Least share of the other memory that decoding photos again must save."""
_STEPS_A_PHOTO = 50
"""Steps per photo from which decoding it a few more times takes negligible time."""
_FEWEST_PHOTOS = 64_000_000
"""Least bytes of photos that are kept if not all fit."""
_POINT = 27
"""Bytes per SfM point during the whole run: float64 position and colour."""
_POINT_AT_START, _POINT_OF_MANY = 60, 45
"""Additional bytes per SfM point before the first step, for its training position and the k-d tree
of the neighbours; less where few splats come from many points."""
_DEPTH_BYTES = 11
"""Bytes per pixel while depth maps are read: value and confidence in float32, and the target."""


def training_bytes(
    *,
    splats: int,
    sh_degree: int,
    pixels: int,
    lpips: bool = False,
    joined: bool = False,
    surface: bool = False,
) -> int:
    """Peak bytes of a training, without photos, Python and torch.

    Args:
        splats: Largest number of splats.
        sh_degree: Highest SH degree.
        pixels: Number of pixels of the largest view.
        lpips: Whether LPIPS is evaluated at the end.
        joined: Whether several models are merged for rendering.
        surface: Whether steps have the surface term.
    """
    numbers = 11 + 3 * (1 + SH_REST_BY_DEGREE[sh_degree])
    step = splats * (_NUMBER * numbers + _STEP_PER_SPLAT) + pixels * _STEP_PER_PIXEL
    step += (splats * _SURFACE_PER_SPLAT + pixels * _SURFACE_PER_PIXEL) if surface else 0
    evaluation = splats * (_EVAL_NUMBER * numbers + _EVAL_PER_SPLAT)
    evaluation += _LPIPS + pixels * _LPIPS_PER_PIXEL if lpips else pixels * _EVAL_PER_PIXEL
    copy = splats * _EVAL_NUMBER * numbers if joined else 0
    return max(step, evaluation) + copy + _BASE


def photo_memory(photos: int, config: TrainConfig, *, decode_again: bool) -> int:
    """Bytes of photos that take `photos` bytes, with their scaled copies unless `decode_again` (see
    `decodes_again`)."""
    copies = _SMALLER_COPIES if _starts_small(config) and not decode_again else 0
    return round(photos * (1 + copies))


def decodes_again(config: TrainConfig, photos: int, *, views: int, rest: int) -> bool:
    """Return whether to free full-size photos while smaller ones are trained on, and decode them
    again for each size: if that saves much memory and takes little time relative to the run.

    Args:
        config: The options.
        photos: Bytes of all decoded photos.
        views: Number of photos.
        rest: Bytes of the training without photos.
    """
    saved = photos * _SMALLER_COPIES
    return (
        _starts_small(config)
        and saved > _WORTH_DECODING * rest
        and config.iterations >= _STEPS_A_PHOTO * views
    )


def _starts_small(config: TrainConfig) -> bool:
    """Return whether training starts with scaled-down photos."""
    full = config.coarse_factor == 1 or (config.coarse_factor == 0 and config.start_splats)
    return not full and Skip.SMALL_PHOTOS not in config.without


def point_bytes(points: int, *, splats: int) -> tuple[int, int]:
    """Bytes of SfM points during the whole run, and additional bytes before the first step, when
    there are no gradients yet.

    Args:
        points: Number of points of the capture.
        splats: Largest number of splats.
    """
    each = _POINT_OF_MANY if few_queries(points, splats) else _POINT_AT_START
    return _POINT * points, each * points + _BASE


def depth_bytes(pixels: int) -> int:
    """Bytes of depth maps with `pixels` in total."""
    return _DEPTH_BYTES * pixels


def free_memory() -> int | None:
    """Bytes that a training may use; None: unknown."""
    free, total = available_memory_bytes(), total_memory_bytes()
    if free is None and total is not None:
        free = int(0.8 * total)  # macOS reports no free memory; it swaps and compresses earlier
    return free


def cache_bytes(
    config: TrainConfig, photos: int, *, all_of_them: int, rest: int, free: int | None
) -> int | None:
    """Bytes of decoded photos to keep; None: all of them.

    Args:
        config: `cache_mb` sets the size unless it is 0.
        photos: Bytes of all decoded photos.
        all_of_them: Bytes of all photos in training, with their copies.
        rest: Bytes of the training without photos.
        free: Bytes available; None: unknown, assumed sufficient.
    """
    if config.cache_mb:
        limit = config.cache_mb * 1_000_000
        return None if photos <= limit else limit
    if free is None or all_of_them + rest <= free:
        return None
    return max(int(0.8 * (free - rest)), _FEWEST_PHOTOS)


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
    device: "DeviceEstimate | None" = None
    """Memory of the device that trains; None: it has none of its own."""

    @property
    def advice(self) -> str:
        """Advice if the memory is insufficient, else empty."""
        if self.fits:
            return ""
        return " or ".join([*_ways(self.fitting_splats, self.fitting_width), "close programs"])


@dataclass(frozen=True, kw_only=True)
class DeviceEstimate:
    """Predicted memory of a device."""

    peak_bytes: int
    """Most bytes in use, without photos that stay there where there is room."""
    free_bytes: int
    """Bytes that a training may take."""
    width: int
    """Width of the widest photo, px."""
    fitting_splats: int
    """Most splats that fit, see `Estimate`; 0 also where all fit."""
    fitting_width: int
    """Largest width of photos that fit, px, likewise."""


def _ways(splats: int, width: int) -> list[str]:
    """Ways to need less memory."""
    ways = [f"use `--max-splats {splats}`"] if splats else []
    return ways + ([f"use smaller photos (`--resolution {width}`)"] if width else [])


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
    cost: CostModel = COST,
    device_memory: int = 0,
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
        pace: Time of a step relative to `cost`; None: that of this machine's CPU, measured once by
            rendering a few images, within a tenth of a second.
        cost: Seconds of a step.
        device_memory: Bytes that the training may take on a device; 0: it has none of its own.

    Raises:
        BackendError: The native library is missing.
    """
    widths, heights = np.array(sizes, np.int64).reshape(-1, 2).T
    cloud = points if cloud is None else cloud
    # Whether photos agree is not known yet. Whole photos that agree are faster to train; a subject
    # may be faster or slower, so both cases are evaluated.
    count = len(sizes)
    expected = [
        (config, expected_model_count(config, photos=count, points=points, subject=subject))
    ]
    if subject and (agreed := config_where_photos_agree(config, photos=count, points=points)):
        expected.append(agreed)
    models = max(models for _, models in expected)
    memory = _memory(
        config,
        widths,
        heights,
        masks=masks,
        depths=depths,
        cloud=cloud,
        decoding=decoding,
        joined=models > 1,
        free=free_memory() if free is None else free,
    )

    def steps_seconds(config: TrainConfig, models: int, *, drops: bool) -> float:
        plan = Plan.of(
            config,
            extent=1.0,
            points=points,
            side=int(min(widths.min(initial=1 << 30), heights.min(initial=1 << 30))),
            pixels=int((widths * heights).mean()) if count else 1,
            subject=subject,
            drops=drops,
            models=models,
        )
        return Cost(plan, cost).seconds_after(0, models * min(points, plan.max_splats))

    reading_pace = machine_pace(config.threads) if pace is None or device_memory else pace
    pace = reading_pace if pace is None else pace
    stored = int((widths * heights).sum()) if stored is None else stored
    seconds = config.time_budget
    if not seconds:
        seconds = pace * max(steps_seconds(*case, drops=n > 0) for n, case in enumerate(expected))
    return Estimate(
        seconds=seconds,
        reading_seconds=reading_pace * reading_seconds(cloud, stored, config.threads),
        peak_bytes=RUNTIME + memory.rest + memory.photos,
        free_bytes=memory.free,
        photo_bytes=memory.photos,
        photos_kept=memory.keeps_all,
        decodes_again=memory.decodes_again and memory.keeps_all,
        fits=memory.fits,
        fitting_splats=memory.fitting[0],
        fitting_width=memory.fitting[1],
        device=_device_estimate(
            config,
            int((widths * heights).max(initial=1)),
            widest=int(widths.max(initial=1)),
            models=models,
            free=device_memory,
        ),
    )


@dataclass(frozen=True, kw_only=True)
class _Memory:
    """Predicted memory of the process, bytes."""

    photos: int
    """Decoded photos that stay."""
    keeps_all: bool
    """Whether all photos stay."""
    decodes_again: bool
    """Whether photos are decoded again for each training resolution."""
    rest: int
    """Everything else, without Python and torch."""
    free: int | None
    """Available; None: unknown."""
    fitting: tuple[int, int]
    """Most splats and largest width of photos that fit, see `Estimate`; 0 also where all fit."""

    @property
    def fits(self) -> bool:
        """Whether the memory is sufficient."""
        return self.free is None or self.rest + self.photos <= self.free


def _memory(
    config: TrainConfig,
    widths: np.ndarray,
    heights: np.ndarray,
    *,
    masks: bool,
    depths: bool,
    cloud: int,
    decoding: int,
    joined: bool,
    free: int | None,
) -> _Memory:
    """Predict the memory of the process; arguments as for `estimate`, `joined` as for
    `training_bytes`."""
    pixels, widest = widths * heights, int(widths.max(initial=1))
    largest, total = int(pixels.max(initial=1)), int(pixels.sum())
    guides = (config.guide_surface is not None) + (config.guide_free is not None)
    maps = depth_bytes(total) * (depths + guides)
    network = lpips_file(config.lpips)
    lpips = bool(named_net(config.lpips)) or (network is not None and network.is_file())
    stay, at_start = point_bytes(cloud, splats=config.max_splats)

    def needed(splats: int, pixels: int) -> int:
        step = training_bytes(
            splats=splats,
            sh_degree=config.sh_degree,
            pixels=pixels,
            lpips=lpips,
            joined=joined,
            surface=config.surface_weight > 0,
        )
        return max(step, at_start)

    photos = total * (4 if masks else 3)
    rest = maps + stay + needed(config.max_splats, largest)
    decode_again = decodes_again(config, photos, views=len(widths), rest=rest)
    cached = photo_memory(photos, config, decode_again=decode_again)
    to_read = stay + decoding  # before everything else is there
    kept = cache_bytes(config, photos, all_of_them=cached, rest=max(rest, to_read), free=free)
    if kept is not None or decode_again:
        rest += decoding
    if kept is not None:
        kept = cache_bytes(config, photos, all_of_them=cached, rest=rest, free=free)
    memory = _Memory(
        photos=cached if kept is None else kept,
        keeps_all=kept is None,
        decodes_again=decode_again,
        rest=max(rest, to_read),
        free=free,
        fitting=(0, 0),
    )
    if memory.fits or free is None:
        return memory
    room = 0.9 * free - memory.photos - maps - stay - (0 if kept is None else decoding)

    def fit(splats: int, width: int) -> bool:
        # Photos beyond the cache are decoded repeatedly, so only the largest view must fit.
        return needed(splats, int(largest * (width / widest) ** 2)) <= room

    return replace(memory, fitting=_fitting(fit, config.max_splats, widest))


def _device_estimate(
    config: TrainConfig, pixels: int, *, widest: int, models: int, free: int
) -> DeviceEstimate | None:
    """Predict the memory of a device of which `free` bytes may be taken; 0: it has none."""
    if not free:
        return None

    def needed(splats: int, width: int) -> int:
        view = int(pixels * (width / widest) ** 2)
        degree = config.sh_degree
        return device_bytes(splats=splats, sh_degree=degree, pixels=view, models=models)

    peak = needed(config.max_splats, widest)
    splats = width = 0
    if peak > free:
        splats, width = _fitting(lambda n, w: needed(n, w) <= free, config.max_splats, widest)
    return DeviceEstimate(
        peak_bytes=peak, free_bytes=free, width=widest, fitting_splats=splats, fitting_width=width
    )


def _fitting(fits: Callable[[int, int], bool], splats: int, width: int) -> tuple[int, int]:
    """Most splats, in steps of 1000, that fit with photos of this width, and the largest width with
    which `splats` fit; 0 where that is too little to be useful."""
    found = 1000 * _most(lambda k: fits(1000 * k, width), splats // 1000)
    side = _most(lambda w: fits(splats, w), width)
    return found if found >= _FEWEST_SPLATS else 0, side if side >= _SMALLEST_WIDTH else 0


def _most(fits: Callable[[int], bool], high: int) -> int:
    """Largest number in 1 to `high` that fits, by bisection; 0: none."""
    low = 0
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if fits(middle) else (low, middle - 1)
    return low


def check_fits(found: Estimate, config: TrainConfig, device: str = "") -> None:
    """Raise GsError with advice if a training will not fit into memory.

    `device`: name of the device that trains; DeviceMemoryError if it does not fit into its memory.
    """
    if (there := found.device) and there.peak_bytes > there.free_bytes:
        from ...raster.gpu.library import DeviceMemoryError  # not where the CPU trains

        ways = _ways(there.fitting_splats, there.fitting_width)
        ways += ["close programs that use the graphics card", "use `--device cpu`"]
        raise DeviceMemoryError(
            f"Training {count_text(config.max_splats, 'splat')} with photos of up to "
            f"{number(there.width)} px needs about {size_text(there.peak_bytes)} of the memory of "
            f"{device}, which has {size_text(there.free_bytes)} free; {' or '.join(ways)}."
        )
    if found.fits or found.free_bytes is None:
        return
    raise GsError(
        f"Training {count_text(config.max_splats, 'splat')} needs about "
        f"{(found.peak_bytes - RUNTIME) / 1e9:.1f} "
        f"GB of memory, but {found.free_bytes / 1e9:.1f} GB are free; {found.advice}."
    )
