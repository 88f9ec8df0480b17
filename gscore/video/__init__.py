"""Video frames: selection by sharpness and motion, written as photos."""

from ..io.missing_path import VIDEO_ENDINGS
from .extract import Frames, extract_frames
from .request import ExtractRequest, is_video
