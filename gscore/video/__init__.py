"""Video frames: selection by sharpness and motion, written as photos."""

from .extract import Frames, extract_frames
from .request import VIDEO_ENDINGS, ExtractRequest, is_video
