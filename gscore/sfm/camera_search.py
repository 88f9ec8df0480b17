"""Camera search: photos checked, attempts run, the best model published as a capture."""

import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from .._version import __version__
from ..control import Control
from ..errors import DatasetError
from ..events import SfmDone, SfmEstimated, Show, strict_json
from ..io.runs import MADE_OF
from ..quoting import first_few
from ..raster import native_library
from ..text_format import count_text
from . import database, masks, photos, pycolmap_stages
from .bundle_adjustment import AdjustedLens, adjust, is_stable
from .database import failure_reason
from .forecast import ADJUSTING, FEATURES, MATCHING, RECONSTRUCTION, Forecast
from .gps_scale import Gps, read_gps, to_metres
from .heic import conversion_hint
from .panorama import check_lens, possible_panoramas, refused_panoramas
from .photo_quality import PhotoQuality, blurred, exposure_jumps
from .photos import captures_inside, excluded_folders, other_cameras, photo_folder_warning, stamp
from .pycolmap_stages import Work
from .pycolmap_thread import check_space, colmap, log_messages, run_in_thread
from .search_progress import SearchProgress
from .search_request import ENOUGH, USUAL_LENS, Attempt, SearchRequest, attempts
from .search_result import (
    SearchResult,
    attempt_text,
    camera_facts,
    focal_text,
    gps_text,
    lens_text,
    model_names,
)
from .workspace import Workspace

CHOOSING = "choosing pairs"
"""A phase of some seconds, not in the forecast."""


def find_cameras(
    request: SearchRequest, *, on_event: Show = lambda event: None, control: Control | None = None
) -> SearchResult:
    """Camera search: find the camera poses and points of photos, and write a capture.

    After a stop or kill the intermediate results stay next to the output, and the next call with
    the same photos and options resumes from them.

    Args:
        request: Photos, output folder and options.
        on_event: Receiver of `SfmProgress`, `Warn` and the final `SfmDone`.
        control: Source of stop requests.

    Raises:
        Cancelled: `control` requested a stop.
        DatasetError: too few photos, unreadable photos, or no cameras found.
        ConfigError: the output is not empty, or an option has an invalid value.
        BackendError: pycolmap is missing or too old, or the native library is missing.
        GsError: the output cannot be written.
    """
    check_lens(request.camera_model)
    colmap()
    native_library.available_isas()  # raises where the library is missing, before any work
    search = _Search(request, on_event, control or Control())
    try:
        return search.run()
    except DatasetError:  # these photos give no model; other errors keep the intermediate files
        search.discard()
        raise
    finally:
        search.close()


class _Search:
    """State of one camera search."""

    def __init__(self, request: SearchRequest, show: Show, control: Control) -> None:
        self._request, self._control = request, control
        self._progress = SearchProgress(show)
        self._began = time.monotonic()
        self._root = photos.photo_folder(request.photos)
        self._space = Workspace(request.output, self._root)
        self._lens = ""
        self._opened = False
        self._compared: set[Path] = set()
        self._stamps: list[list[Any]] = []

    def run(self) -> SearchResult:
        """Run the search and publish the capture."""
        names, unread = photos.list_photos(self._root, excluded_folders(self._request, self._root))
        photos.check_photo_count(self._root, names, unread)
        if sentence := captures_inside(self._root, names):
            raise DatasetError(sentence)
        if unread:
            self._progress.warn(
                f"{count_text(len(unread), 'photo')} of unsupported formats left out: "
                f"{first_few(unread, 3)}. To use them, {conversion_hint(unread)}."
            )
        self._stamps = [stamp(name, self._root / name) for name in names]  # before they are read
        read = photos.read_photos(
            self._root, names, on_photo=self._progress.counter("reading photos", len(names)),
            cancelled=self._stopping,
        )  # fmt: skip
        panoramas = {photo.name: photo.panorama for photo in read}
        if sentence := refused_panoramas(panoramas, self._request):
            raise DatasetError(sentence)
        possible = possible_panoramas(panoramas, self._request)
        read, sentences = photos.one_of_each(self._root, read)
        doubtful = photo_folder_warning(self._root, names, len(photos.by_camera(read)))
        for sentence in filter(
            None, (*sentences, possible, doubtful, other_cameras(self._request.photos))
        ):
            self._progress.warn(sentence)
        found = self._masks([photo.name for photo in read])
        resumed = self._space.open(self._state(found))
        self._opened = True
        self._space.link_photos(read, self._stamps)
        self._write_masks(found, read)
        work = Work(
            request=self._request,
            root=self._space.links,
            photos=read,
            masks=self._space.masks if found else None,
            folder=self._space.folder,
        )
        models, tried, last = self._attempts(work)
        if not models:
            raise DatasetError(self._why_none(work, last))
        return self._publish(work, models, tried, last, resumed)

    def close(self) -> None:
        """Release the workspace for the next search."""
        if self._opened:
            self._space.close()

    def discard(self) -> None:
        """Remove all intermediate files."""
        if self._opened:
            self._space.discard()

    def _attempts(self, work: Work) -> tuple[list[Any], int, Attempt]:
        """Run attempts; return the models of the best, the number of attempts and the last one."""
        best: list[Any] = []
        plan = attempts(self._request)
        for tried, attempt in enumerate(plan, 1):
            placed = best[0].num_reg_images() if best else 0
            if attempt.name:
                self._progress.warn(attempt_text(placed, len(work.photos), attempt.name))
            models = self._attempt(work, attempt)
            if models and models[0].num_reg_images() > placed:
                best = models
            if best and best[0].num_reg_images() >= ENOUGH * len(work.photos):
                return best, tried, attempt
        return best, len(plan), plan[-1]

    def _attempt(self, work: Work, attempt: Attempt) -> list[Any]:
        file, count = work.database(attempt), len(work.photos)
        earlier = self._progress.forecast
        forecast = work.forecast(attempt, pace=earlier.pace if earlier else 1.0)
        self._progress.forecast = forecast
        self._progress.report("entering photos", 0, count)
        check_space(work.folder, pycolmap_stages.space_needed(work, attempt))
        with log_messages(work.folder):
            pycolmap_stages.enter_photos(work, file)
        self._find_features(work, attempt, forecast)
        with log_messages(work.folder):
            lost, found = database.without_features(file), database.features(file)
        if lost:
            names = {photo.alias: photo.name for photo in work.photos}
            raise DatasetError(
                f"COLMAP cannot read {first_few([names[alias] for alias in lost])}. Save them as "
                "JPEG or PNG."
            )
        forecast.has_features(sum(found))
        self._compare(work, attempt, forecast)
        placed = [0]

        def on_photo() -> None:
            placed[0] += 1

        def place(token: Any) -> list[Any]:
            return pycolmap_stages.reconstruct(work, attempt, token, on_photo)

        return self._watch(
            place, RECONSTRUCTION, count, lambda: min(placed[0], count), lambda: count - placed[0]
        )

    def _find_features(self, work: Work, attempt: Attempt, forecast: Forecast) -> None:
        """Find features, first in a sample of photos that calibrates the forecast."""
        sample, *others = (
            (len(part), partial(pycolmap_stages.extract, work, attempt, part))
            for part in pycolmap_stages.feature_parts(work)
        )
        file, count = work.database(attempt), len(work.photos)
        space = pycolmap_stages.space_needed(work, attempt)
        with log_messages(work.folder):
            if not database.without_features(file):
                forecast.has(FEATURES)
        if file in self._compared:
            forecast.has(MATCHING)
        self._steps([sample], FEATURES, space, total=count)
        with log_messages(work.folder):
            found = [number for number in database.features(file) if number]
        if found:
            forecast.has_features(sum(found), len(found))
        self._progress.report(FEATURES, sample[0], count)  # the forecast learns the pace from it
        self._progress.show(SfmEstimated(photos=count, seconds=forecast.seconds))
        self._steps(others, FEATURES, space, before=sample[0], total=count)

    def _compare(self, work: Work, attempt: Attempt, forecast: Forecast) -> None:
        """Match the pairs from photo names, then those from retrieval and GPS."""
        file, parts = work.database(attempt), work.parts(attempt)
        if work.matches_similar(attempt):
            further = partial(pycolmap_stages.further, work, attempt)
            parts += self._watch(lambda token: further(), CHOOSING, 0, lambda: 0, lambda: 0)
            forecast.has_pairs(sum(map(len, parts)))
        matches = [
            (len(part), partial(pycolmap_stages.match, work, attempt, part)) for part in parts
        ]
        self._steps(matches, MATCHING, pycolmap_stages.space_needed(work, attempt))
        self._compared.add(file)
        with log_messages(work.folder):
            forecast.has_matches(database.matches(file))

    def _steps(
        self,
        parts: list[tuple[int, Callable[[Any], None]]],
        phase: str,
        space: int,
        *,
        before: int = 0,
        total: int = 0,
    ) -> None:
        """Run parts of a phase; each has its size, and may write `space` bytes.

        Args:
            parts: Sizes and functions, in order.
            phase: Name of the phase.
            space: Bytes on the disk.
            before: Size done earlier.
            total: Size of the phase; 0: the sum of these parts.
        """
        done, under_way = [before], [0]

        def work(token: Any) -> None:
            for size, part in parts:
                if self._stopping():
                    return
                under_way[0] = size
                check_space(self._space.folder, space)
                part(token)
                done[0] += size

        total = total or sum(size for size, _ in parts)
        self._watch(work, phase, total, lambda: done[0], lambda: under_way[0])

    def _watch(
        self,
        work: Callable[[Any], Any],
        phase: str,
        total: int,
        done: Callable[[], int],
        under_way: Callable[[], int],
    ) -> Any:
        progress = self._progress.counter(phase, total, done())
        self._progress.report(phase, done(), total)
        return run_in_thread(
            work,
            self._space.folder,
            tick=lambda: progress(done(), under_way()),
            cancelled=self._stopping,
        )

    def _masks(self, names: list[str]) -> dict[str, Path]:
        if not self._request.use_masks:
            return {}
        folder = photos.mask_folder(self._root, self._request.masks)
        return masks.find_masks(folder, self._root, names)

    def _write_masks(self, found: dict[str, Path], read: list[photos.Photo]) -> None:
        if not found:
            return
        for sentence in masks.write_masks(
            found, read, self._space.masks,
            inverted=self._request.invert_masks, cancelled=self._stopping,
        ):  # fmt: skip
            self._progress.warn(sentence)

    def _state(self, found: dict[str, Path]) -> dict[str, Any]:
        """Key of a resumable search: photos, masks and options that must be equal."""
        options = asdict(self._request)
        for name in ("output", "excluded", "threads", "mapper", "video"):
            del options[name]  # these change neither features nor matches
        return {
            "pycolmap": colmap().__version__,
            "options": {name: str(value) for name, value in options.items()},
            "photos": self._stamps,
            "masks": [stamp(name, path) for name, path in sorted(found.items())],
        }

    def _why_none(self, work: Work, attempt: Attempt) -> str:
        found = database.overlap(work.database(attempt), least=pycolmap_stages.LEAST_MATCHES)
        names = {photo.alias: photo.name for photo in work.photos}
        return failure_reason(found, names, masked=work.masks is not None)

    def _publish(
        self, work: Work, models: list[Any], tried: int, last: Attempt, resumed: bool
    ) -> SearchResult:
        names = {photo.alias: photo.name for photo in work.photos}
        model = models[0]
        self._adjust(model, database.focal_lengths(work.database(last)))
        if not is_stable(model):
            raise DatasetError(self._why_none(work, last))
        for sentence in self._space.check_photos():
            self._progress.warn(sentence)
        gps = self._by_gps(model, work.database(last), names)
        parts = tuple(model_names(each, names) for each in models)
        placed = {name for part in parts for name in part}
        cameras = camera_facts(model)
        found = SearchResult(
            output=self._request.output,
            photos=len(work.photos),
            registered=len(parts[0]),
            models=parts,
            alone=tuple(photo.name for photo in work.photos if photo.name not in placed),
            blurred=self._named(blurred, work.photos),
            jumps=self._named(exposure_jumps, work.photos),
            points=model.num_points3D(),
            reprojection_px=model.compute_mean_reprojection_error(),
            track_length=model.compute_mean_track_length(),
            cameras=cameras,
            lens=self._lens,
            in_metres=gps.metres is not None,
            up=None if gps.up is None else tuple(gps.up.tolist()),
            attempts=tried,
            seconds=round(time.monotonic() - self._began, 2),
            resumed=resumed,
            warnings=tuple(self._progress.warnings),
        )
        self._progress.report("writing the capture", 0, 0)
        made_of = (self._request.video or self._request.photos).absolute()
        record = {"gscore": __version__, MADE_OF: str(made_of)} | found.facts()
        record["photos_read"] = self._stamps
        self._space.publish(model, work.photos, strict_json(record), up=gps.up)
        self._progress.show(
            SfmDone(
                photos=found.photos,
                registered=found.registered,
                models=len(found.models),
                points=found.points,
                reprojection_px=found.reprojection_px,
                seconds=found.seconds,
                path=str(found.output),
            )
        )
        return found

    def _named(
        self, which: Callable[[list[PhotoQuality]], list[int]], read: list[photos.Photo]
    ) -> tuple[str, ...]:
        """Names of the photos that `which` selects."""
        measured = [(photo.name, photo.quality) for photo in read if photo.quality is not None]
        return tuple(measured[i][0] for i in which([quality for _, quality in measured]))

    def _adjust(self, model: Any, stated: dict[int, tuple[float, bool]]) -> None:
        may_free = self._request.camera_model == USUAL_LENS

        def work(token: Any) -> AdjustedLens:
            focal = {number: length for number, (length, _) in stated.items()}
            return adjust(model, may_free=may_free, expected=focal)

        found = self._watch(work, ADJUSTING, 0, lambda: 0, lambda: 1)
        if found.before is not None:
            self._lens = lens_text(found.before, found.after)
        if found.fixed:
            self._progress.warn(focal_text([stated[number] for number in model.cameras]))

    def _by_gps(self, model: Any, file: Path, names: dict[str, str]) -> Gps:
        """Scale the model to metres by the GPS positions in EXIF, if possible."""
        gps = read_gps(model, database.gps_places(file))
        to_metres(model, gps)
        for sentence in gps_text(gps, names):
            self._progress.warn(sentence)
        return gps

    def _stopping(self) -> bool:
        return self._control.stopping
