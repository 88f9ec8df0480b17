"""Files that options name, looked at before anything that takes long."""

from collections.abc import Callable
from pathlib import Path

from ...config import DataConfig, TrainConfig
from ...errors import ConfigError
from ...formats import is_antialiased
from ...io.files import read_bytes
from ...io.mesh.files import read_mesh
from ...io.region_file import read_region
from ...metrics.lpips import find_lpips


def check_named_files(config: TrainConfig, data: DataConfig) -> None:
    """Read what the options name, as far as tells whether the training can.

    For a capture that is yet to be made, whose own files cannot be asked for.

    Raises:
        GsError: a file is missing or is not what it should be, the network for LPIPS or its package
            is missing, or depth maps are asked for, which need cameras.
    """
    named: list[tuple[Path | None, Callable[[Path], object]]] = [
        (data.test_list, read_bytes),
        (config.start_splats, is_antialiased),
        (config.region, read_region),
        (config.guide_surface, read_mesh),
        (config.guide_free, read_mesh),
        (config.lpips, lambda path: find_lpips(path, threads=config.threads)),
    ]
    for path, read in named:
        if path is not None:
            read(path)
    if data.depths and not Path(data.depths).is_dir():
        raise ConfigError(
            f"{data.source} has no cameras yet, so no depth maps either ({data.depths}). Leave "
            "--depths out; then `gscore depth OUTPUT/capture` makes maps, and `gscore train "
            "OUTPUT/capture -d depths` uses them."
        )
