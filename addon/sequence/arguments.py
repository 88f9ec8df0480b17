"""Sequence arguments: the add-on's settings as a command line of `gscore sequence`; no bpy."""

from pathlib import Path
from typing import Protocol

from ..training.options import Machine, Settings, new_run, resumed_run


class OwnSettings(Protocol):
    """Options of a sequence in addition to those of a training."""

    frames: str
    next_iterations: int
    warm_start: bool


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
