"""Inspection of a capture before a training: its content and its problems."""

from .capture_facts import CaptureFacts, Problem
from .find_capture import find_capture
from .inspect_capture import inspect

__all__ = ["CaptureFacts", "Problem", "find_capture", "inspect"]
