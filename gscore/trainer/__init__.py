"""Training: from a capture and options to splats, with checkpoints, events and control."""

from ..control import Control, listen
from .run import train
from .session import TrainResult

__all__ = ["Control", "TrainResult", "listen", "train"]
