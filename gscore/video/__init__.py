"""Frames of a video, chosen by sharpness and motion and written as photos."""

from .extract import Frames, extract_frames
from .request import VIDEO_ENDINGS, ExtractRequest, is_video

__all__ = ["VIDEO_ENDINGS", "ExtractRequest", "Frames", "extract_frames", "is_video"]
