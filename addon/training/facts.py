"""Cached facts about a scene's folders for panels; never waits for the disk."""

from collections.abc import Hashable
from typing import TypeVar

import bpy

from .. import preferences
from ..capture.inspection import ShownFacts
from ..core import Estimate
from ..interface.lookup import Lookup
from ..interface.option_labels import error_text
from ..paths import absolute, output_folder
from ..process import poll_timer
from . import forecast, lookups
from .existing_run import EarlierRun

KeyT = TypeVar("KeyT", bound=Hashable)
AnswerT = TypeVar("AnswerT")


def ask(lookup: Lookup[KeyT, AnswerT], key: KeyT) -> tuple[AnswerT | None, str]:
    """`Lookup.get`, whose answer is then collected by the poll timer."""
    answer = lookup.get(key)
    poll_timer.ensure()
    return answer


def capture(scene: bpy.types.Scene) -> tuple[ShownFacts | None, str]:
    """Facts of the scene's capture, and an error message; (None, "") while unknown."""
    settings = scene.gscore
    if not settings.capture_path.strip():
        return None, ""
    try:
        path = absolute(settings.capture_path, "Capture")
    except ValueError as error:
        return None, error_text(error)
    return ask(lookups.captures, (str(path), settings.images))


def refresh(scene: bpy.types.Scene) -> tuple[ShownFacts | None, str]:
    """Like `capture`, but reads the disk and waits; for scripts and before a training."""
    path = absolute(scene.gscore.capture_path, "Capture")
    return lookups.captures.wait((str(path), scene.gscore.images))


def forecast_of(scene: bpy.types.Scene) -> tuple[Estimate | None, str]:
    """Forecast of a training with the scene's settings; (None, "") while unknown."""
    found = capture(scene)[0]
    if found is None or not found.can_train:
        return None, ""
    question = forecast.question(scene.gscore, found, threads=preferences.get().threads)
    return ask(lookups.forecasts, question)


def run(scene: bpy.types.Scene) -> tuple[EarlierRun | None, str]:
    """The run in the scene's output folder; (None, "") for none or still unknown."""
    text = scene.gscore.capture_path
    try:
        chosen = absolute(text, "Capture") if text.strip() else None
        folder = output_folder(scene, preferences.get().output_folder)
    except ValueError:
        return None, ""  # the Capture panel reports what is missing
    return ask(lookups.runs, (folder, chosen))
