"""A capture looked into before a training: what it holds, and what a training will say of it."""

from .facts import CaptureFacts, Problem
from .find import find_capture
from .look import inspect

__all__ = ["CaptureFacts", "Problem", "find_capture", "inspect"]
