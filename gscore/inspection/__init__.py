"""Inspection of a capture before a training: its content and its problems."""

from .capture_facts import CaptureFacts, Problem
from .inspect_capture import find_capture, inspect
