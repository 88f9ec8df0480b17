"""Forecast of a training: time and memory for a scene's settings; no bpy."""

from dataclasses import dataclass, replace
from pathlib import Path

from ..core import (
    PRESETS,
    CaptureFacts,
    Estimate,
    Strategy,
    TrainConfig,
    cap_by_photos,
    estimate,
    expected_points,
    target_size,
)
from .options import AS_PRESET, BY_WIDTH, Settings


@dataclass(frozen=True, kw_only=True)
class Question:
    """Input of a forecast; equal inputs have equal results while the free memory is the same."""

    train: TrainConfig
    sizes: tuple[tuple[tuple[int, int], int], ...]
    """Training sizes of photos, width and height in pixels, and the number of photos of each."""
    points: int
    cloud: int
    """Number of SfM points."""
    stored: int
    """Number of pixels of all photos as stored, in the time of JPEG."""
    masks: bool
    subject: bool
    """True if masks are opacity, as far as known without decoding a photo."""
    depths: bool


def question(settings: Settings, facts: CaptureFacts, *, threads: int) -> Question:
    """The forecast input for the scene's settings and capture."""
    data, train = PRESETS[settings.preset](Path())
    resolution = data.resolution
    if settings.resolution == BY_WIDTH:
        resolution = settings.width
    elif settings.resolution != AS_PRESET:
        resolution = float(settings.resolution)
    train = replace(
        train,
        iterations=settings.iterations,
        max_splats=settings.max_splats,
        sh_degree=settings.sh_degree,
        strategy=Strategy(settings.strategy),
        time_budget=settings.time_budget,
        threads=threads,
        # A number set by the user is not capped, as in `gscore train`.
        steps_a_photo=train.steps_a_photo if settings.iterations == train.iterations else 0,
        splats_a_photo=train.splats_a_photo if settings.max_splats == train.max_splats else 0,
    )
    # Alpha is most often a matte, which takes more steps; photos are not decoded here.
    subject = settings.use_masks and bool(facts.alphas)
    photos = sum(facts.sizes.values())
    if settings.eval:
        photos -= -(-photos // settings.test_every)
    sizes: dict[tuple[int, int], int] = {}
    for (width, height), count in facts.sizes.items():
        size = target_size(width, height, resolution, max_width=data.max_width)
        sizes[size] = sizes.get(size, 0) + count
    return Question(
        train=cap_by_photos(
            train,
            photos=photos,
            points=facts.points,
            mask_mode="composite" if subject else "none",
        )[0],
        sizes=tuple(sorted(sizes.items())),
        points=expected_points(train, facts.points),
        cloud=facts.points,
        stored=facts.decoding_pixels,
        masks=settings.use_masks and bool(facts.masks or facts.alphas),
        subject=subject,
        depths=bool(facts.depths) and settings.depth_mode != "off",
    )


def answer(inputs: Question) -> Estimate:
    """The forecast. The first one of a session renders some pictures to time this machine.

    Raises:
        GsError: the native library is missing.
    """
    sizes = [size for size, count in inputs.sizes for _ in range(count)]
    facts = {name: value for name, value in vars(inputs).items() if name not in ("train", "sizes")}
    return estimate(inputs.train, sizes, **facts)


def words(found: Estimate) -> str:
    """Sentences with time and memory."""
    text = f"About {duration(found.seconds)} of training"
    if found.reading_seconds > max(1.0, 0.1 * found.seconds):
        text += f" after {duration(found.reading_seconds)} of reading"
    text += f" and {memory(found.peak_bytes)} of memory."
    return text if found.photos_kept else text + " Photos are read repeatedly to save memory."


def warning(found: Estimate) -> str:
    """Sentences on missing memory and settings that would fit; empty if the training fits."""
    if found.fits or found.free_bytes is None:
        return ""
    ways = []
    if found.fitting_splats:
        ways.append(f"at most {found.fitting_splats:,} splats")
    if found.fitting_width:
        ways.append(f"photos {found.fitting_width} px wide")
    fits = " or ".join(ways) + " would fit; else close" if ways else "Close"
    return (
        f"Too large for this computer: it needs {memory(found.peak_bytes)}, "
        f"{memory(found.free_bytes)} are free. {fits[0].upper()}{fits[1:]} other programs."
    )


def duration(seconds: float) -> str:
    """Seconds, minutes or hours, rounded coarsely."""
    if seconds < 90:
        return f"{max(5 * round(seconds / 5), 5)} s"
    if seconds < 90 * 60:
        return f"{round(seconds / 60)} min"
    return f"{seconds / 3600:.1f} h"


def memory(size: int) -> str:
    """Megabytes or gigabytes."""
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{round(size / 1e7) * 10} MB"
