"""Session of a run from first step to report: the training loop and the work between steps."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ..config import DataConfig
from ..config_file import to_dict
from ..control import Control
from ..errors import DatasetError, FormatError, GsError
from ..events import Decision, Eval, Event, Preview, Saved, Snapshot, Started, Warn, headline_psnr
from ..io.images.pixels import as_uint8
from ..io.runs import checkpoints_in
from ..live.viewer_clients import ViewerClients
from ..live.viewer_protocol import FrameRequest
from ..metrics import Evaluation, Lpips, LpipsNet
from ..quoting import quoted
from ..raster.gpu.library import DEVICE_ERRORS
from ..report import PictureCollector
from ..text_format import count_text, number
from .depth.report import DepthReport, measure_depth
from .distributed.straggler_monitor import StragglerMonitor
from .evaluation import Evaluator
from .files import checkpoint
from .files.run_folder import RunFolder
from .files.run_outputs import RunOutputs
from .files.run_result import TrainResult
from .model.checkpoint_schema import as_records, as_str_dict, as_str_list
from .prepare import Prepared
from .step.step_result import StepResult
from .stopping.controller import StoppingController
from .stopping.progress_meter import ProgressMeter
from .stopping.watchdog import Watchdog

_WARN_ROWS = (1, 100, 10_000)
"""Numbers of bad and of lost splats at which the user is warned."""
_CHECKPOINTS_KEPT = 2
_PAUSE = 0.02
"""Seconds between polls of the viewer clients after the last step."""
_CROWDED = (
    "Many splats are closer to a camera, or to a place between two, than the points of the capture "
    "suggest. They are kept, as with `--free-space 0`."
)
_CLOUDED = (
    "More than a fifth of the splats are in front of what seems to be the sky, so they are kept. "
    "If the photos show no sky there, train with `--sky off`."
)
_FILLED = (
    "More than a fifth of the splats are in front of the mesh of `--guide-free`, so they are kept. "
    "The mesh may be in the wrong place, or behind objects that should stay; `--guide-surface` "
    "keeps splats in front of a mesh."
)
_EMPTY = (
    "No splats are left: all were transparent, or in a space that was found to be free. Check that "
    "photos, masks and cameras match."
)
_MANY_CLEARED = 0.02
"""Number of splats removed in front of cameras, relative to the final number, above which the user
is warned. Trainings of real captures remove up to 0.005 in total."""


class Session:
    """A run of a trainer: training loop, events, and all files of the run folder."""

    def __init__(
        self,
        prepared: Prepared,
        folder: RunFolder,
        data: DataConfig,
        *,
        emit: Callable[[Event], None],
        control: Control,
        lpips: Lpips | LpipsNet | None,
        lpips_reason: str,
        viewers: ViewerClients | None = None,
    ) -> None:
        """Create the session of a prepared trainer, in `folder`."""
        self._prepared = prepared
        self._trainer = trainer = prepared.trainer
        self._config = trainer.config
        self._folder = folder
        self._data = data
        self._emit = emit
        self._control = control
        self._evaluator = Evaluator(trainer, lpips=lpips, lpips_reason=lpips_reason)
        self._results = RunOutputs(trainer, folder)
        self._viewers = viewers or ViewerClients()
        self._earlier: list[Decision] = []
        self._meter = ProgressMeter(
            trainer.plan,
            splats=trainer.splat_count,
            pace=trainer.engine.pace(),
            budget=self._config.time_budget or math.inf,
            cost=trainer.engine.info.cost,
        )
        self._steering = StoppingController(trainer, self._meter, self._evaluator)
        self._watchdog = Watchdog(trainer.plan)
        self._evals: list[dict[str, Any]] = []
        self._warnings: list[str] = []
        self._last_checkpoint = 0.0
        self._last_preview = 0.0
        self._unrecorded = 0.0
        """Seconds of steps whose results were not read."""
        self._has_diverged = False
        self._waits = StragglerMonitor(trainer.group.hosts) if trainer.group else None

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the clock and the history of a checkpoint.

        Raises:
            ValueError, KeyError, TypeError: `state` has invalid values.
        """
        self._meter.restore(state["meter"])
        self._evals = as_records("evals", state["evals"])
        self._warnings = as_str_list("warnings", state["warnings"])
        self._steering.restore(state.get("steering"))
        decided = as_str_dict("decided", state.get("decided", {}))
        self._earlier = [Decision(topic, text) for topic, text in decided.items()]
        self._last_checkpoint = self._last_preview = self._meter.train_seconds
        if "watchdog" in state:
            self._watchdog.restore(state["watchdog"])
        self._trainer.rate_factor = self._watchdog.rate_factor

    def warn(self, message: str, code: str = "") -> None:
        """Emit a warning, and keep it for the report."""
        if message not in self._warnings:
            self._warnings.append(message)
        self._emit(Warn(message=message, code=code))

    def run(self) -> TrainResult:
        """Train until the last step or a stop request, then write the results."""
        self._results.write_inputs(self._data)
        self._trainer.engine.verify()
        self._started()
        trainer, control = self._trainer, self._control
        self._start_watchdog()
        self._steer()
        while not (self._steering.reason or control.stopping):
            if self._is_paused:
                self._pause()
                continue
            with self._checkpoint_on_error():
                if may_step := self._compared_photos():
                    self._observe(trainer.advance)
            if self._has_diverged:
                self._rescue()
                continue
            if not may_step:
                continue
            with self._checkpoint_on_error():
                self._steer()
                self._between_steps()
        result = self._finish()
        while self._viewers.stay and not control.stopping:
            self._serve_viewers(idle=True)
            time.sleep(_PAUSE)
        return result

    @property
    def _is_paused(self) -> bool:
        return self._control.paused or self._viewers.has_pausing_viewer

    def _pause(self) -> None:
        """Wait until training may continue or must end, or another request was executed."""
        self._emit(self._meter.progress(phase="paused"))
        self._control.wait_while_paused(
            is_paused=lambda: self._viewers.has_pausing_viewer,
            meanwhile=lambda: self._serve_viewers(idle=True),
        )
        self._run_control_commands()

    def _compared_photos(self) -> bool:
        """Compare the photos with the models if that is due; False: training was stopped or has
        diverged before the end, and no step may follow."""
        trainer, control = self._trainer, self._control
        if not trainer.compares_photos:
            return True
        self._observe(trainer.read_all)
        if self._has_diverged:
            return False
        began = time.perf_counter()
        for _ in trainer.compare_photos():
            self._meter.add(time.perf_counter() - began)
            if self._meter.due():
                self._emit(self._meter.progress(phase="comparing photos"))
            self._run_control_commands()
            self._serve_viewers()
            while self._is_paused and not control.stopping:
                self._pause()
            if control.stopping:
                return False
            began = time.perf_counter()
        self._meter.add(time.perf_counter() - began)
        return True

    def _observe(self, read: Callable[[], list[StepResult]]) -> None:
        """Record the results that `read` returns, in their order; its time is theirs."""
        began = time.perf_counter()
        results = read()
        self._unrecorded += time.perf_counter() - began
        share = self._unrecorded / max(len(results), 1)
        for i, result in enumerate(results):
            self._unrecorded = 0.0
            self._meter.update(
                step=result.step,
                loss=result.loss,
                mse=result.mse,
                splats=self._trainer.splat_count,
                seconds=share,
                photos=result.photos,
                photo_factor=self._trainer.view_batcher.factor,
            )
            if self._meter.due():
                self._emit(self._meter.progress())
            self._warn_of_step(result, results[i + 1 :])
            self._has_diverged |= self._diverged(result)

    def _serve_viewers(self, *, idle: bool = False) -> None:
        """Render the frame requests of the viewer clients."""
        self._viewers.answer(self._render, idle=idle)

    def _render(self, request: FrameRequest) -> bytes:
        """Render a frame request to RGB bytes."""
        self._trainer.engine.shorten_submissions()  # a viewer draws on the same device
        picture = self._trainer.renderer.render_request(request)
        return as_uint8(picture).tobytes()

    @contextmanager
    def _checkpoint_on_error(self) -> Iterator[None]:
        """Write a checkpoint if a photo can no longer be read or the device has failed, unless its
        results are wrong, and name the last one in the error."""
        try:
            yield
        except DEVICE_ERRORS as error:
            kept = self._keep_taken_steps()
            if self._config.device == "auto":  # the CPU continues
                raise
            raise type(error)(f"{error} {kept}") from error
        except (DatasetError, FormatError) as error:
            self._checkpoint(keep=_CHECKPOINTS_KEPT)
            raise type(error)(
                f"{error} Step {self._trainer.steps} is kept in {self._folder.path}; restore the "
                f"original photos and continue with `--resume`."
            ) from error

    def _keep_taken_steps(self) -> str:
        """Write a checkpoint of the steps that were taken before the device failed, if it can still
        be read; returns a sentence on the last checkpoint."""
        with suppress(GsError):
            self._observe(self._trainer.abandon)
            self._checkpoint(keep=_CHECKPOINTS_KEPT)
        steps = checkpoints_in(self._folder.path)
        if not steps:
            return "There is no checkpoint yet."
        last = number(max(steps))
        return f"Step {last} is kept in {self._folder.path}; continue with `--resume`."

    def _steer(self) -> None:
        psnr = self._steering.steer()
        if psnr is not None:
            entry = self._note(psnr)
            split = self._evaluator.split
            key = "psnr_masked" if self._trainer.photos.mask_mode == "ignore" else "psnr"
            self._emit(Eval(step=entry["step"], split=split, metrics={key: psnr}))

    def _note(self, psnr: float | None) -> dict[str, Any]:
        """Record a measurement for the report."""
        step = self._trainer.steps
        entry = {"step": step, "elapsed_s": self._meter.train_seconds, "psnr": psnr}
        self._evals = [e for e in self._evals if e["step"] != step] + [entry]
        return entry

    def _decisions(self) -> list[Decision]:
        return self._prepared.decisions(self._earlier)

    def _started(self) -> None:
        photos, cameras = self._trainer.photos, self._trainer.photos.scene.cameras
        viewer = self._viewers.decision
        self._emit(
            Started(
                source=str(self._data.source),
                output=str(self._folder.path),
                iterations=self._trainer.plan.iterations,
                step=self._trainer.steps,
                train_views=len(photos.train),
                test_views=len(photos.test),
                splats=self._trainer.splat_count,
                width=int(cameras.widths.max()),
                height=int(cameras.heights.max()),
                isa=self._trainer.engine.info.numerics,
                threads=self._trainer.engine.info.threads,
                device=self._trainer.engine.info.name,
                models=len(self._trainer.models.members),
                left_s=self._meter.progress().eta_s,
                mask_mode=self._prepared.mask_mode,
                decisions=self._decisions() + ([viewer] if viewer else []),
                config={"data": to_dict(self._data), "train": to_dict(self._config)},
            )
        )

    def _warn_of_step(self, result: StepResult, later: list[StepResult]) -> None:
        """Emit warnings about a step: losses, gradients, slow ranks, free space, no splats,
        runaways; `later`: results that were read with it."""
        step, counts, pruner = result.step, self._trainer.counts, self._trainer.pruner
        if result.skipped:
            self.warn(f"Step {step}: the loss was not usable; the step was skipped.", "non_finite")
        bad = counts.bad_rows - sum(one.bad_rows for one in later)
        if any(bad - result.bad_rows < limit <= bad for limit in _WARN_ROWS):
            message = "gradients of splats that were not finite were ignored"
            self.warn(f"Step {step}: {message}, {bad} so far.", "non_finite")
        group = self._trainer.group
        if group and self._waits and (slow := self._waits.straggler_message(group.accounts[:, 1])):
            self.warn(slow, "slow_rank")
        crowds = (
            (pruner.around, _CROWDED),
            (pruner.path, _CROWDED),
            (pruner.sky, _CLOUDED),
            (pruner.guided, _FILLED),
        )
        for emptied, text in crowds:
            if emptied.crowded and text not in self._warnings:
                self.warn(text, "crowded")
        if not self._trainer.models.trained_count and _EMPTY not in self._warnings:
            self.warn(_EMPTY, "no_splats")
        lost = counts.lost_rows - sum(one.lost_rows for one in later)
        if any(lost - result.lost_rows < limit <= lost for limit in _WARN_ROWS):
            message = "splats with runaway values were reset"
            self.warn(f"Step {step}: {message}, {lost} so far.", "lost_splats")

    @property
    def _guarded(self) -> bool:
        """True if checkpoints are kept for the watchdog."""
        return self._config.watchdog and self._config.checkpoint_seconds > 0

    def _start_watchdog(self) -> None:
        """Start the watchdog, unless a resumed run already has its state."""
        good = self._watchdog.good
        has_checkpoint = bool(good) and self._folder.checkpoint(good[-1]).is_file()
        if not self._config.watchdog or has_checkpoint:
            return
        self._watchdog.start(self._trainer.error())
        if self._guarded:
            self._watchdog.keep(self._trainer.steps)
            self._write_checkpoint()

    def _diverged(self, result: StepResult) -> bool:
        self._watchdog.plan = self._trainer.plan
        diverged = self._watchdog.observe(
            result.step,
            result.mse,
            skipped=result.skipped,
            lost=result.lost_rows / max(self._trainer.models.trained_count, 1),
        )
        return self._config.watchdog and diverged

    def _rescue(self) -> None:
        """Restore a good checkpoint and continue at lower rates; GsError if there is none."""
        trainer, step = self._trainer, self._trainer.steps
        back = self._watchdog.rescue(step)
        self._has_diverged = False
        trainer.release()
        found = checkpoint.load(self._folder.checkpoint(back))
        trainer.restore(found.trainer, found.tensors)
        trainer.rate_factor = self._watchdog.rate_factor
        self._meter.rewind(back, splats=trainer.splat_count)
        self._steering.restore(found.session.get("steering"))
        self._evals = [entry for entry in self._evals if entry["step"] <= back]
        # A resume must not find checkpoints of the diverged steps.
        self._folder.drop_checkpoints_after(back)
        self.warn(
            f"Step {step}: training diverged. It continues from step {back} with all learning "
            f"rates times {trainer.rate_factor:.3g}.",
            "diverged",
        )

    def _run_control_commands(self) -> None:
        """Run control commands other than pause and stop."""
        for line in self._control.unknown():
            self.warn(f"There is no control command {quoted(line)}.", "control")
        if self._control.take_snapshot():
            path = self._results.write_snapshot()
            trainer = self._trainer
            self._emit(Snapshot(step=trainer.steps, path=str(path), splats=trainer.splat_count))

    def _between_steps(self) -> None:
        config, step, clock = self._config, self._trainer.steps, self._meter.train_seconds
        last = bool(self._steering.reason)
        if config.snapshot_every and step % config.snapshot_every == 0:
            self._control.snapshot()
        self._run_control_commands()
        self._serve_viewers()
        if config.preview_seconds and clock - self._last_preview >= config.preview_seconds:
            self._last_preview = clock
            self._preview()
        if step in config.save_iterations:
            path = self._folder.saved(step)
            self._results.write_splats(path)
            self._emit(Saved(step=step, path=str(path)))
        if step in config.test_iterations and not last:
            self._evaluate(None)
        period = config.checkpoint_seconds
        overdue = period > 0 and clock - self._last_checkpoint >= period
        good = self._guarded and self._watchdog.worth_keeping(step)
        if not last and (overdue or good or step in config.checkpoint_iterations):
            if good:
                self._watchdog.keep(step)
            self._checkpoint(keep=_CHECKPOINTS_KEPT)

    def _preview(self) -> None:
        self._trainer.engine.release()
        view = self._evaluator.indices[0]
        path = self._results.write_preview(self._evaluator.picture(view))
        name = self._trainer.photos.scene.cameras.names[view]
        self._emit(Preview(step=self._trainer.steps, view=name, path=str(path)))

    def _checkpoint(self, *, keep: int, finished: bool = False) -> None:
        path = self._write_checkpoint()
        good = () if finished else self._watchdog.good
        protected = (*self._config.checkpoint_iterations, *good)
        self._folder.drop_checkpoints(keep=keep, protected=protected)
        self._emit(Saved(step=self._trainer.steps, path=str(path)))

    def _write_checkpoint(self) -> Path:
        self._observe(self._trainer.read_all)
        self._trainer.engine.verify()
        path = self._folder.checkpoint(self._trainer.steps)
        self._last_checkpoint = self._meter.train_seconds
        state = {
            "meter": self._meter.state(),
            "evals": self._evals,
            "warnings": self._warnings,
            "steering": self._steering.state(),
            "watchdog": self._watchdog.state(),
            "stereo": self._prepared.stereo.added > 0,
            "decided": {one.topic: one.text for one in self._decisions()},
            "asked": self._prepared.requested,
        }
        self._trainer.collect()
        checkpoint.save(path, self._trainer, state)
        return path

    def _evaluate(self, collector: PictureCollector | None) -> Evaluation | None:
        self._observe(self._trainer.read_all)
        self._emit(self._meter.progress(phase="measuring"))
        self._trainer.engine.release()
        found = self._evaluator.measure(collector, interrupted=lambda: self._control.stopping)
        if found is None:
            return None
        entry = self._note(headline_psnr(found.mean))
        split = self._evaluator.split
        self._emit(Eval(step=entry["step"], split=split, metrics=found.mean))
        return found

    def _depth_report(self) -> DepthReport | None:
        """Compare rendered depth with the depth maps, if any."""
        trainer = self._trainer
        return measure_depth(
            trainer.photos,
            self._prepared.depth,
            trainer.renderer.inverse_depth,
            interrupted=lambda: self._control.stopping,
        )

    def _warn_of_result(self) -> None:
        """Emit warnings about the training as a whole: splats removed near cameras, outliers."""
        trainer = self._trainer
        cleared = trainer.pruner.around.count
        if cleared > _MANY_CLEARED * trainer.models.trained_count:
            self.warn(
                f"{count_text(cleared, 'splat was', 'splats were')} removed, closer to a camera "
                f"than {self._config.free_space:g} of its distance from the nearest points. If "
                "there are objects so close, train with `--free-space 0`.",
                "cleared",
            )
        names, blurs = trainer.photos.scene.cameras.names, trainer.photo_parameters.blurs
        for decision in trainer.photo_parameters.decisions(names):
            self.warn(decision.text, decision.topic)
        # Blurred photos have less detail and smaller errors: no measure for the sharp ones.
        blurred_photos = blurs.blurred if blurs else {}
        sharp = [index for index in trainer.photos.train if index not in blurred_photos]
        if worse := trainer.photo_errors.outliers(names, sharp, trainer.steps):
            self.warn(worse, "photos")

    def _finish(self) -> TrainResult:
        """Write the results and evaluate; returns the result of the run."""
        with self._checkpoint_on_error():
            self._observe(self._trainer.read_all)
        if self._has_diverged:
            self._rescue()
        trainer, reason = self._trainer, self._steering.reason
        if trainer.group:
            trainer.collect()
            if reason:  # workers of a stopped run receive its exit code later
                trainer.group.shutdown()
        finished, reason = bool(reason), reason or self._control.stop_reason
        self._run_control_commands()  # a snapshot requested just before the stop
        self._warn_of_result()
        with self._checkpoint_on_error():
            self._checkpoint(keep=1 if finished else _CHECKPOINTS_KEPT, finished=finished)
        splats = trainer.finish()
        poses = self._prepared.pose_check.decision
        exposure = self._prepared.exposure.numbers
        if exposure is not None:  # the decision of a resumed run still applies
            texts = {one.topic: one.text for one in self._decisions()}
            exposure = exposure | {"why": texts["exposure"]}
        photo_parameters = self._results.write_photo_parameters(
            exposure, poses.text if poses else ""
        )
        self._results.write_splats(self._folder.point_cloud)
        self._emit(Saved(step=trainer.steps, path=str(self._folder.point_cloud)))
        collector = PictureCollector(count=len(self._evaluator.indices))
        evaluation = None if self._control.stopping else self._evaluate(collector)
        if evaluation and not self._control.stopping:
            self._evaluator.state_reach(evaluation, splats)
        metrics = self._results.write_summary(
            self._data,
            evaluation,
            evaluator=self._evaluator,
            collector=collector,
            meter=self._meter,
            evals=self._evals,
            warnings=self._warnings,
            depth=self._depth_report() if evaluation else None,
            photo_parameters=photo_parameters,
            decisions=self._decisions(),
            requested=self._prepared.requested,
            reason=reason,
        )
        result = TrainResult(
            reason=reason,
            steps=trainer.steps,
            splats=splats,
            train_seconds=self._meter.train_seconds,
            metrics=metrics,
            output=self._folder.path,
        )
        self._emit(result.event())
        return result
