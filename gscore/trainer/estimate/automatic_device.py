"""Automatic device of a training: the faster of a graphics card and the CPU, found by a trial."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from ...config import TrainConfig
from ...datasets.dataset import Dataset
from ...engine.base import Engine
from ...engine.cpu.pace import COST, current_pace
from ...engine.gpu.engine import FEATURES
from ...engine.opening import engine_of
from ...engine.trial import step_seconds
from ...errors import BackendError
from ...events import Decision
from ...raster.gpu.absence import no_automatic_card
from ...raster.gpu.choice import CPU, Chosen, choose
from ...text_format import count_text
from ..schedule.caps import cap_by_photos, expected_points
from ..schedule.lacking_options import lacking_options
from ..schedule.plan import Plan
from .cost import Cost

TOPIC = "chosen_device"
_CARD = "gpu: "
"""Begin of the identity of a graphics card's bits."""
_DIGITS = 2
"""Significant digits of the sizes of trials, so that alike trainings share one."""


@dataclass(frozen=True, kw_only=True)
class RunSize:
    """Size of the steps of a training."""

    splats: int
    """Expected number at the end."""
    sh_degree: int
    width: int
    """Mean of the photos, px."""
    height: int
    """Likewise."""

    def __str__(self) -> str:
        """For people."""
        return f"{count_text(self.splats, 'splat')} at {self.width} x {self.height} px"


@dataclass(frozen=True, kw_only=True)
class AutomaticDevice:
    """The engine that `auto` chose."""

    engine: Engine[Any]
    decision: Decision | None
    """The choice with its reason; None: there was nothing to choose from."""
    warning: str = ""
    """A sentence where a card failed; empty: none did."""


def run_size(config: TrainConfig, photos: Dataset) -> RunSize:
    """Return the size of a training's steps; no photo is decoded."""
    cameras, points = photos.scene.cameras, photos.scene.points.given
    subject = photos.mask_mode == "composite"
    config, _ = cap_by_photos(
        config, photos=len(photos.train), points=points, mask_mode=photos.mask_mode
    )
    width, height = round(float(cameras.widths.mean())), round(float(cameras.heights.mean()))
    plan = Plan.of(
        config,
        extent=1.0,
        points=(start := expected_points(config, points)),
        side=int(min(cameras.widths.min(), cameras.heights.min())),
        pixels=width * height,
        subject=subject,
    )
    splats = Cost(plan).splats_at(plan.iterations, 0, min(start, plan.max_splats))
    return RunSize(
        splats=_rounded(config.max_splats if config.start_splats else splats),
        sh_degree=config.sh_degree,
        width=_rounded(width),
        height=_rounded(height),
    )


def open_automatic(
    config: TrainConfig,
    size: Callable[[], RunSize],
    *,
    earlier: str = "",
    report: Callable[[str], None],
    cancel: Callable[[], bool],
) -> AutomaticDevice:
    """Choose and open the device of a training.

    Args:
        config: The options.
        size: Returns the size of the steps; not called where there is no card to try.
        earlier: Identity of the bits of the run's earlier steps, whose device trains on; empty: it
            has none.
        report: Receives a sentence on a self-test while it runs.
        cancel: Returns whether a self-test is to stop.

    Raises:
        Cancelled: `cancel` returned True.
        GsError: `size` failed.
    """
    threads = config.threads
    if no_automatic_card() or (earlier and not earlier.startswith(_CARD)):
        return AutomaticDevice(engine=engine_of(CPU, threads=threads), decision=None)
    if lacking := lacking_options(config, FEATURES, frozenset()):
        text = f"The CPU trains: graphics cards do not compute {', '.join(lacking)}."
        return _cpu(text, threads=threads)
    chosen = choose("auto", report=report, cancel=cancel)
    if chosen.device is None:
        text = f"The CPU trains. {chosen.reason}".rstrip()
        return _cpu(text, threads=threads, warning=chosen.note)
    try:
        if earlier:
            engine = engine_of(chosen, threads=threads)
            text = f"{chosen.name} trains, as before."
            return AutomaticDevice(
                engine=engine, decision=Decision(TOPIC, text), warning=chosen.note
            )
        return _tried(chosen, size(), threads=threads)
    except BackendError as error:
        warning = f"The CPU trains, because {chosen.name} failed in a trial. {error}"
        return _cpu(warning, threads=threads, warning=warning)


def _tried(chosen: Chosen, size: RunSize, *, threads: int) -> AutomaticDevice:
    """The faster of a card and the CPU at some size."""
    card = _trial(chosen, size)
    there = size.splats, size.sh_degree, size.width * size.height
    cpu = current_pace(threads) * COST.seconds(*there)
    found = f"{_time(card)} a step with {size}, the CPU about {_time(cpu)}"
    if card >= cpu:
        text = f"The CPU trains: in a trial {chosen.name} took {found}."
        return _cpu(text, threads=threads, warning=chosen.note)
    engine = engine_of(chosen, threads=threads)
    engine.measured_pace = card / engine.info.cost.seconds(*there)
    text = f"{chosen.name} trains: in a trial it took {found}. Times on it are estimated."
    return AutomaticDevice(engine=engine, decision=Decision(TOPIC, text), warning=chosen.note)


_trials: dict[tuple[str, RunSize], float] = {}
"""Seconds of a step by the identity of a card's bits and the size."""


def _trial(chosen: Chosen, size: RunSize) -> float:
    """Seconds of a step on a card, measured once a process."""
    key = chosen.identity, size
    if key not in _trials:
        with closing(engine_of(chosen)) as engine:
            _trials[key] = step_seconds(
                engine,
                splats=size.splats,
                sh_degree=size.sh_degree,
                width=size.width,
                height=size.height,
            )
    return _trials[key]


def _cpu(text: str, *, threads: int, warning: str = "") -> AutomaticDevice:
    engine = engine_of(CPU, threads=threads)
    return AutomaticDevice(engine=engine, decision=Decision(TOPIC, text), warning=warning)


def _rounded(value: float) -> int:
    """A positive number with `_DIGITS` significant digits."""
    return max(int(float(f"{value:.{_DIGITS - 1}e}")), 1)


def _time(seconds: float) -> str:
    return f"{float(f'{1000 * seconds:.2g}'):g} ms"
