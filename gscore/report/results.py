"""Results writer: metrics.json and report.html of a training and of `gscore eval`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..config import DataConfig, TrainConfig
from ..config_command import depth_command, preset_text, train_command
from ..config_file import to_dict
from ..io.runs import CAPTURE
from ..metrics.summary import Metrics, write_metrics
from .cameras_plan import CamerasSection, made_of
from .depth import DepthSection
from .histograms import Histogram
from .html_parts import write_html
from .page import Report, report_html
from .pictures import ViewPictures


def write_results(
    folder: Path,
    metrics: Metrics,
    *,
    data: DataConfig,
    run: Path | None = None,
    trained: tuple[DataConfig, TrainConfig] | None = None,
    resolved: dict[str, Any] | None = None,
    views: Sequence[ViewPictures] = (),
    warnings: Sequence[str] = (),
    depth: DepthSection | None = None,
    cameras: CamerasSection | None = None,
    histograms: Sequence[Histogram] = (),
) -> dict[str, Any]:
    """Write both files, each completely or not at all.

    Args:
        folder: Folder of the files.
        metrics: The measurements.
        data: The measured capture.
        run: Folder of the training, for its command; None: not known.
        trained: Options of the training; None: not known.
        resolved: Values of automatic options; None: not known.
        views: Pictures for the report.
        warnings: Sentences for the report.
        depth: Depth section of the report.
        cameras: Camera section of the report.
        histograms: Histograms of the splats.

    Returns:
        Content of metrics.json.

    Raises:
        GsError: a file cannot be written.
    """
    content = metrics.content()
    config = {"data": to_dict(data)}
    if trained is not None:
        config["train"] = to_dict(trained[1])
    if resolved is not None:
        config["values of automatic options"] = resolved
    how = {}
    if trained is not None and run is not None:
        how = {"preset": preset_text(*trained)}
        how["command"] = train_command(*trained, run, requested=metrics.course.asked)
        how["depth_command"] = depth_command(trained[0])
    report = Report(
        title=_title(data.source, cameras),
        metrics=content,
        views=views,
        warnings=warnings,
        depth=depth,
        cameras=cameras,
        histograms=histograms,
        config=config,
        **how,
    )
    write_html(folder / "report.html", report_html(report))
    # The last file: its existence shows to a resumed run that all others exist.
    write_metrics(folder / "metrics.json", content)
    return content


def _title(source: Path, cameras: CamerasSection | None) -> str:
    """Name of the capture; for a capture made in a training, whose name is the same in every run,
    the name of its photos or video."""
    whole = source.resolve()
    if whole.name != CAPTURE or cameras is None:
        return whole.name
    origin = made_of(cameras)
    return whole.parent.name if origin is None else origin
