"""Files named in options: checked before anything slow starts."""

from collections.abc import Callable
from pathlib import Path

from ...config import DataConfig, TrainConfig
from ...datasets.split import split_views
from ...errors import ConfigError
from ...formats import is_antialiased
from ...io.files import read_bytes
from ...io.mesh.files import read_mesh
from ...io.region_file import read_region
from ...metrics.lpips import find_lpips
from ..depth.setup import depth_option_set
from . import checkpoint


def check_option_files(
    config: TrainConfig,
    data: DataConfig,
    *,
    names: list[str] | None,
    start_checkpoint: Path | None,
) -> None:
    """Check the files named in options, before the cameras of a capture are estimated.

    The files of the capture itself cannot be checked yet.

    Args:
        config: The options.
        data: The capture, without cameras.
        names: Names of its photos, some of which may end up without a camera; None: unknown.
        start_checkpoint: Checkpoint to start from.

    Raises:
        GsError: a file is missing or invalid, the LPIPS network or its package is missing, the
            training or the test split is empty, or options require depth maps, which need cameras.
    """
    named: list[tuple[Path | None, Callable[[Path], object]]] = [
        (data.test_list, read_bytes),
        (start_checkpoint, checkpoint.load),
        (config.start_splats, is_antialiased),
        (config.region, read_region),
        (config.guide_surface, read_mesh),
        (config.guide_free, read_mesh),
        (config.lpips, lambda path: find_lpips(path, threads=config.threads)),
    ]
    for path, read in named:
        if path is not None:
            read(path)
    if names:
        split_views(sorted(names), data)
    option = f"`--depths {data.depths}`" if data.depths else depth_option_set(config)
    maps = Path(data.depths)
    if option and not (maps.is_absolute() and maps.is_dir()):  # relative to the capture
        raise ConfigError(
            f"{data.source} has no cameras yet, so no depth maps either. Leave {option} out; then "
            "`gscore depth OUTPUT/capture` writes maps, and `gscore train OUTPUT/capture -d depths`"
            " uses them."
        )
