"""Cameras exported by other photogrammetry programs next to the photos."""

from .find import ProgramFile, find_program
from .read import read_program

__all__ = ["ProgramFile", "find_program", "read_program"]
