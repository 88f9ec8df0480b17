"""Cameras exported by other photogrammetry programs next to the photos."""

from .read import ProgramFile, find_program, read_program
