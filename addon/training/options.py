"""Training options: the add-on's settings as command lines of `gscore train` and others; no bpy."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ..capture.inspection import DEPTHS
from ..core import PRESETS, RunInfo, Switch

AS_PRESET, BY_WIDTH = "PRESET", "WIDTH"
"""Values of `resolution` other than the divisors 1, 2, 4 and 8."""


Settings = Any
"""Scene settings for the trainer: `properties.SceneSettings`, or an object with its attributes."""


@dataclass(frozen=True, kw_only=True)
class Machine:
    """Preferences for this computer."""

    threads: int = 0
    """CPU threads; 0: all."""
    device: str = "auto"
    """Device that trains: `cpu`, `auto`, or the UUID of a graphics card."""
    gpu_share: float = 1.0
    """Share of the time of a graphics card that the training may use."""
    lpips: Path | None = None
    """Network that measures LPIPS."""
    preview_seconds: float = 0.0
    """Training time between two pictures of a test view, seconds; 0: none."""


def new_run(
    settings: Settings,
    *,
    source: Path,
    output: Path,
    machine: Machine,
    overwrite: bool = False,
    depths: bool = False,
) -> list[str]:
    """Arguments that start a run: the preset, and the options that differ from it.

    Args:
        settings: Settings of the scene.
        source: Folder of the capture.
        output: Folder for the results.
        machine: Settings of the preferences.
        overwrite: Replace another run in `output`.
        depths: True if the capture has depth maps.
    """
    data, train = PRESETS[settings.preset](source)
    arguments = ["train", str(source), "-o", str(output), "--preset", settings.preset]
    for name in ("iterations", "max_splats", "sh_degree", "strategy", "background", "sky", "seed"):
        value = getattr(settings, name)
        if name == "iterations" and settings.time_budget:
            continue  # a time budget determines the number of steps
        if value != getattr(train, name):
            arguments += [_flag(name), str(value)]
    for name in ("time_budget", "target_psnr", "finest", "free_space"):
        value = getattr(settings, name)  # single precision
        if abs(value - getattr(train, name)) > 1e-5 * value:
            arguments += [_flag(name), f"{value:g}"]
    for name in ("antialias", "early_stop"):
        if getattr(settings, name) != getattr(train, name):
            arguments.append(_flag(name if getattr(settings, name) else f"no_{name}"))
    arguments.append("--eval" if settings.eval else "--no-eval")
    if settings.eval and settings.test_every != data.test_every:
        arguments += ["--hold-out", str(settings.test_every)]
    if settings.images != data.images:
        arguments += ["--images", settings.images]
    arguments += _masks(settings, data.mask_mode)
    if depths and settings.depth_mode != Switch.OFF:
        arguments += ["--depths", DEPTHS]
        if settings.depth_mode != train.depth_mode:
            arguments += ["--depth-mode", settings.depth_mode]
    if settings.resolution == BY_WIDTH:
        arguments += ["--resolution", str(settings.width)]
    elif settings.resolution != AS_PRESET:
        arguments += ["--resolution", settings.resolution]
    if overwrite:
        arguments.append("--overwrite")
    return arguments + _machine(machine)


def continuation(settings: Settings, info: RunInfo) -> dict[str, float]:
    """Options of a resumed run whose limits were raised since its start.

    Raises:
        ValueError: the run has no steps left; the message names the setting to raise.
    """
    budget = info.train.time_budget if info.train is not None else 0.0
    if budget:
        if settings.time_budget > budget:
            return {"time_budget": settings.time_budget}
        if info.finished:
            raise ValueError(
                f"The run has used its time budget of {budget:g} s; raise Time Budget to continue."
            )
        return {}
    iterations = info.iterations
    capped = info.train is not None and info.train.steps_a_photo > 0
    preset = PRESETS[settings.preset](Path())[1]
    if not capped or settings.iterations != preset.iterations:  # else the photos cap the preset's
        iterations = max(settings.iterations, iterations)
    if info.steps >= iterations:
        raise ValueError(
            f"The run has taken all of its {info.steps:,} steps; raise Steps to continue."
        )
    return {"iterations": iterations} if iterations != info.iterations else {}


def resumed_run(
    *,
    source: Path | None,
    output: Path,
    machine: Machine,
    changes: Mapping[str, float] = MappingProxyType({}),
) -> list[str]:
    """Arguments that resume the run in `output`, with its original options.

    Args:
        source: Current folder of the capture; None: unchanged.
        output: Folder of the run.
        machine: Settings of the preferences.
        changes: Changed options, see `continuation`.
    """
    arguments = ["train", *([str(source)] if source else []), "-o", str(output), "--resume"]
    for name, value in changes.items():
        arguments += [_flag(name), f"{value:g}" if isinstance(value, float) else str(value)]
    return arguments + _machine(machine)


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def depth_run(
    settings: Settings,
    *,
    source: Path,
    threads: int,
    model: Path | str | None = None,
    download: bool = False,
    overwrite: bool = False,
) -> list[str]:
    """Arguments that predict depth maps, or compare existing ones with the points.

    Args:
        settings: Settings of the scene.
        source: Folder of the capture.
        threads: CPU threads; 0: all.
        model: ONNX file or name of the network to predict with; None: compare, and write nothing.
        download: Download a named network if it is not on this computer.
        overwrite: Predict views that have a map.
    """
    data, _ = PRESETS[settings.preset](source)
    arguments = ["depth", str(source), "--depths", DEPTHS]
    arguments += ["--check"] if model is None else ["--model", str(model)]
    if download:
        arguments.append("--download")
    if overwrite:
        arguments.append("--overwrite")
    if settings.images != data.images:
        arguments += ["--images", settings.images]
    arguments += _masks(settings, data.mask_mode)
    return [*arguments, "--threads", str(threads), "--events", "jsonl"]


def search(settings: Settings, *, source: Path, capture: Path, threads: int) -> list[str]:
    """Arguments that find the cameras of photos or of a video.

    Args:
        settings: Settings of the scene.
        source: The photos or the video.
        capture: The capture to make.
        threads: CPU threads; 0: all.
    """
    arguments = ["sfm", str(source), "-o", str(capture)]
    if not settings.use_masks:
        arguments.append("--no-masks")
    elif settings.invert_masks:
        arguments.append("--invert-masks")
    return [*arguments, "--threads", str(threads), "--events", "jsonl"]


def _masks(settings: Settings, default: str) -> list[str]:
    """Options for the mask mode, if it is not the `default` mode."""
    mask_mode = settings.mask_mode if settings.use_masks else "none"
    arguments = [] if mask_mode == default else ["--mask-mode", mask_mode]
    if settings.use_masks and settings.invert_masks:
        arguments.append("--invert-masks")
    return arguments


def _machine(machine: Machine) -> list[str]:
    arguments = ["--threads", str(machine.threads), "--device", machine.device]
    if machine.gpu_share < 1:
        arguments += ["--gpu-share", f"{machine.gpu_share:g}"]
    if machine.lpips is not None:
        arguments += ["--lpips", str(machine.lpips)]
    return [*arguments, "--preview-seconds", f"{machine.preview_seconds:g}", "--events", "jsonl"]


OwnSettings = Any
"""Options of a sequence in addition to those of a training."""


def new_sequence(
    settings: Settings,
    own: OwnSettings,
    *,
    source: Path,
    output: Path,
    machine: Machine,
    overwrite: bool = False,
) -> list[str]:
    """Arguments that start a sequence: those of a training of each frame, and its own.

    Args:
        settings: Settings of the scene.
        own: Settings of the scene's sequence.
        source: Folder of the sequence.
        output: Folder for the results.
        machine: Settings of the preferences.
        overwrite: Replace another sequence in `output`.
    """
    arguments = new_run(
        settings, source=source, output=output, machine=machine, overwrite=overwrite
    )
    more = ["--frames", own.frames.strip()] if own.frames.strip() else []
    if own.next_iterations:
        more += ["--next-iterations", str(own.next_iterations)]
    if not own.warm_start:
        more.append("--no-warm-start")
    return ["sequence", *arguments[1:], *more]


def resumed_sequence(own: OwnSettings, *, output: Path, machine: Machine) -> list[str]:
    """Arguments that resume a sequence, with other frames if chosen.

    Args:
        own: Settings of the scene's sequence.
        output: Folder of the results.
        machine: Settings of the preferences.
    """
    arguments = resumed_run(source=None, output=output, machine=machine)
    more = ["--frames", own.frames.strip()] if own.frames.strip() else []
    return ["sequence", *arguments[1:], *more]
