"""Run: `train` prepares and checks a training, then runs its session."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ..config import DataConfig, TrainConfig
from ..config_file import load_config, to_dict
from ..control import Control
from ..datasets import load_dataset
from ..engine.base import Engine
from ..engine.opening import open_engine
from ..errors import ConfigError, GsError
from ..events import ENDED, Decision, Event, Warn
from ..io.runs import AGENT, checkpoints_in
from ..live.viewer_clients import ViewerClients
from ..metrics import find_lpips, lpips_warnings
from ..raster.gpu.choice import once_a_device
from ..raster.gpu.library import DEVICE_ERRORS
from .distributed.consistency import all_ready, check_equal
from .distributed.process_group import BEGIN, ProcessGroup, RankLostError
from .estimate.automatic_device import open_automatic, run_size
from .files.run_folder import RunFolder, open_folder
from .files.run_result import TrainResult
from .host.isolated_state import isolated_torch_state, mmap_large_blocks
from .preflight import check_training
from .prepare import prepare, readable_memory_errors
from .run_start import RunStart
from .session import Session

DEVICE = "device"
"""Code of warnings about the device."""


def train(
    config: TrainConfig,
    data: DataConfig,
    output: Path,
    on_event: Callable[[Event], None] | None = None,
    control: Control | None = None,
    *,
    resume: bool = False,
    overwrite: bool = False,
    start_checkpoint: Path | None = None,
    viewers: ViewerClients | None = None,
    group: ProcessGroup | None = None,
    agent: str = "",
    on_card: tuple[DataConfig, TrainConfig] | None = None,
) -> TrainResult:
    """Train splats from a capture and write them, their metrics and a report into a folder.

    The folder is not modified until the options, the capture and the memory have been checked.

    Args:
        config: Training options.
        data: Capture options.
        output: Folder for the results; created if missing.
        on_event: Called with each event, in the thread that called `train`.
        control: Requests of other threads to stop, pause or save.
        resume: Resume from the last checkpoint in `output`.
        overwrite: Replace another run in `output`; files that no training writes stay.
        start_checkpoint: Resume from this checkpoint of another folder.
        viewers: Viewer clients, whose frame requests are rendered between steps.
        group: Process group of a distributed training, where this process is rank 0; the others
            call `run_worker`.
        agent: Identifier of the torchrun that restarts lost processes; kept in the folder until
            the run has ended, so that a restart resumes the run.
        on_card: The options in place of `data` and `config` where a graphics card trains; None: the
            same.

    Returns:
        The result of the run. A stop by `control` is not an error.

    If the device fails and was chosen automatically, the CPU continues from the last checkpoint.

    Raises:
        GsError: bad input, a folder in use, too little memory, a full disk or a diverged training.
        Cancelled: stopped by `control` while the photos were read; nothing was written.
    """
    emit, control = on_event or (lambda event: None), control or Control()
    mmap_large_blocks()
    run = partial(
        _train,
        emit=emit,
        control=control,
        viewers=viewers,
        group=group,
        agent=agent,
    )
    if resume and on_card is not None and _width_of(output) == on_card[0].max_width:
        data, config = on_card  # the CPU may have taken over from a card that is gone
    before = set(_checkpoints(output))
    start = {"resume": resume, "overwrite": overwrite, "start_checkpoint": start_checkpoint}
    try:
        return run(config, data, output, **start, on_card=on_card)
    except DEVICE_ERRORS as error:
        if config.device != "auto":
            raise
        # Not the checkpoints of a run that is overwritten.
        continues = resume or bool(set(_checkpoints(output)) - before)
        how = "continues from the last checkpoint" if continues else "trains from the start"
        emit(Warn(message=f"The CPU {how}, because the device failed: {error}", code=DEVICE))
        if continues:
            start = {"resume": True, "overwrite": False, "start_checkpoint": None}
            data, config = on_card or (data, config)
        else:
            start["overwrite"] = True
        return run(replace(config, device="cpu"), data, output, **start)


def _width_of(output: Path) -> int | None:
    """The width limit of the run in a folder, by which the presets of CPU and cards differ; None:
    no config.json can be read."""
    try:
        return load_config(output / "config.json")[0].max_width
    except GsError:
        return None


def _checkpoints(output: Path) -> Iterator[tuple[Path, int]]:
    """The checkpoints in a folder, with the times of their last change."""
    with suppress(OSError):
        for path in checkpoints_in(output).values():
            yield path, path.stat().st_mtime_ns


def _train(
    config: TrainConfig,
    data: DataConfig,
    output: Path,
    *,
    emit: Callable[[Event], None],
    control: Control,
    resume: bool,
    overwrite: bool,
    start_checkpoint: Path | None,
    viewers: ViewerClients | None,
    group: ProcessGroup | None,
    agent: str,
    on_card: tuple[DataConfig, TrainConfig] | None = None,
) -> TrainResult:
    """`train` on the device of `config`."""
    opened = open_folder(output, resume=resume, overwrite=overwrite, data=data)
    with opened as folder, isolated_torch_state(), ExitStack() as stack:
        run_start = RunStart(folder, config, data, resume=resume, start_checkpoint=start_checkpoint)
        if run_start.ended is not None:
            emit(run_start.ended.event())
            return run_start.ended
        lpips, lpips_reason = find_lpips(config.lpips, threads=config.threads)
        if group:
            options = {"config": to_dict(run_start.config), "data": to_dict(data)}
            group.broadcast({"do": BEGIN, "facts": run_start.state.facts(), **options})
        with all_ready(group):
            engine, decision = None, None
            if group is None:
                engine, decision = _open_engine(run_start, data, emit=emit, control=control)
                stack.enter_context(closing(engine))
                if on_card is not None and engine.info.is_card:
                    data, config = on_card
                    how = {"resume": resume, "start_checkpoint": start_checkpoint}
                    run_start = RunStart(folder, config, data, **how)
                    if run_start.ended is not None:
                        emit(run_start.ended.event())
                        return run_start.ended
            else:
                _check_cpu(run_start.config.device)
            found = prepare(
                run_start.config,
                data,
                run_start.state,
                engine=engine,
                check=run_start.check,
                emit=emit,
                control=control,
                group=group,
            )
            found.device = decision
        if group:
            check_equal(group, found.facts())
        with readable_memory_errors(), closing(found.trainer.engine):
            session = Session(
                found,
                folder,
                data,
                emit=emit,
                control=control,
                lpips=lpips,
                lpips_reason=lpips_reason,
                viewers=viewers,
            )
            run_start.resume(found.trainer, session)
            warnings = {
                "capture": (*found.warnings, *check_training(found.trainer)),
                "evaluation": lpips_warnings(lpips_reason),
                "depth": found.depth.warnings,
                "guide": found.guide.warnings,
                "stereo": found.stereo.warnings_of(config),
            }
            if overwrite:
                folder.clear()
            for code, messages in warnings.items():
                for message in messages:
                    session.warn(message, code)
            with _kept_for(agent, folder) as end:
                result = session.run()
                if group and result.reason in ENDED:
                    group.note_end()
                end(result)
                return result


def _check_cpu(device: str) -> None:
    """Raise ConfigError if the ranks of torchrun are to train on one device that is not the CPU."""
    if device not in ("cpu", "auto"):
        raise ConfigError(
            f"torchrun trains one capture on CPUs alone; leave out `--device {device}`, train "
            "without torchrun, or give blocks (`gscore split`), which ranks train in turn."
        )


def _open_engine(
    start: RunStart, data: DataConfig, *, emit: Callable[[Event], None], control: Control
) -> tuple[Engine[Any], Decision | None]:
    """Open the engine of a training; with the decision, if the options leave the choice.

    Raises:
        ConfigError: there is no such device.
        BackendError: the device cannot be used.
        GsError: the device is to be chosen, and the capture cannot be read.
    """
    config = start.config
    how = {
        "report": once_a_device(lambda text: emit(Warn(message=f"{text}.", code=DEVICE))),
        "cancel": lambda: control.stopping,
    }
    if config.device != "auto":
        engine, note = open_engine(config.device, threads=config.threads, **how)
        decision = None
    else:
        found = open_automatic(
            config,
            lambda: run_size(config, load_dataset(data, cancelled=how["cancel"])),
            earlier=start.isa,
            **how,
        )
        engine, decision, note = found.engine, found.decision, found.warning
    if note:
        emit(Warn(message=note, code=DEVICE))
    engine.use_share(config.gpu_share)
    return engine, decision


@contextmanager
def _kept_for(agent: str, folder: RunFolder) -> Iterator[Callable[[TrainResult], None]]:
    """Keep the torchrun identifier in the folder until the run has ended or failed."""
    ended = False

    def end(result: TrainResult) -> None:
        nonlocal ended
        ended = result.reason in ENDED

    if agent:
        folder.write_text(AGENT, agent)
    try:
        yield end
    except RankLostError:
        raise
    except GsError:
        ended = True
        raise
    finally:
        if agent and ended:
            (folder.path / AGENT).unlink(missing_ok=True)
