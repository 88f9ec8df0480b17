"""Photo analysis before training: exposure and camera poses of the training photos."""

from ...config import Switch, TrainConfig
from ...datasets import Dataset
from ...datasets.tracks import tracks_of
from .exposure import Exposure, prepare_exposure
from .pose_check import PoseCheck, check_poses


def analyze_photos(config: TrainConfig, photos: Dataset) -> tuple[Exposure, PoseCheck]:
    """Analyze exposure and camera poses of the training photos by their tracks.

    Raises:
        DatasetError, FormatError: a photo or the capture's model cannot be read.
    """
    if config.exposure is config.refine_poses is Switch.OFF:
        return Exposure(), PoseCheck()
    tracks = tracks_of(photos)
    return prepare_exposure(config, photos, tracks), check_poses(config, photos, tracks)
