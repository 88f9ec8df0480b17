"""Training: from a capture and options to splats, with checkpoints, events and control.

Loaded when first used: an estimate needs no torch.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..control import Control, listen
    from .forecast import Estimate, estimate
    from .run import train
    from .session import TrainResult

_HOME = {
    "Control": "..control",
    "Estimate": ".forecast",
    "TrainResult": ".session",
    "estimate": ".forecast",
    "listen": "..control",
    "train": ".run",
}

__all__ = ["Control", "Estimate", "TrainResult", "estimate", "listen", "train"]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name], __name__), name)
