"""A capture looked into before a training: what it holds, and what a training will say of it."""

from .capture_facts import CaptureFacts, Problem
from .find_capture import find_capture
from .inspect_capture import inspect

__all__ = ["CaptureFacts", "Problem", "find_capture", "inspect"]
