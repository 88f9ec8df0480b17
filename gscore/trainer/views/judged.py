"""What is found of the training photos before they are trained on: how exposed, where taken."""

from ...config import Switch, TrainConfig
from ...datasets import Dataset
from ...datasets.tracks import tracks_of
from .exposure import Exposure, prepare_exposure
from .placing import Placing, place_cameras


def judge_photos(config: TrainConfig, photos: Dataset) -> tuple[Exposure, Placing]:
    """Compare the photos by the points that structure from motion saw in them.

    Raises:
        DatasetError, FormatError: a photo or the capture's model cannot be read.
    """
    if config.exposure is config.refine_poses is Switch.OFF:
        return Exposure(), Placing()
    tracks = tracks_of(photos)
    return prepare_exposure(config, photos, tracks), place_cameras(config, photos, tracks)
