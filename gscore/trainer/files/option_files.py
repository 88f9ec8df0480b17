"""Files named in options: checked before anything slow begins."""

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
    """Read what the options name, as far as tells whether the training can.

    For a capture that is yet to be made, whose own files cannot be asked for.

    Args:
        config: How to train.
        data: What to train on, whose source has no cameras yet.
        names: Of its photos, some of which may be left without a camera; None: not known yet.
        start_checkpoint: What the training goes on from.

    Raises:
        GsError: a file is missing or is not what it should be, the network for LPIPS or its package
            is missing, no photo is left to train or to test, or depth maps are asked for, which
            need cameras.
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
    asked = f"--depths {data.depths}" if data.depths else depth_option_set(config)
    maps = Path(data.depths)
    if asked and not (maps.is_absolute() and maps.is_dir()):  # others lie in the capture
        raise ConfigError(
            f"{data.source} has no cameras yet, so no depth maps either. Leave {asked} out; then "
            "`gscore depth OUTPUT/capture` makes maps, and `gscore train OUTPUT/capture -d depths` "
            "uses them."
        )
