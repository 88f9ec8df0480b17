"""Models of splats as files: every format in, every one with a public layout out."""

from .registry import (
    ENDINGS,
    FORMATS,
    format_to_write,
    is_antialiased,
    is_splat_file,
    read_splat_file,
    read_splats,
    write_splat_file,
)
from .splat_file import SplatFile, WrittenFile

__all__ = [
    "ENDINGS",
    "FORMATS",
    "SplatFile",
    "WrittenFile",
    "format_to_write",
    "is_antialiased",
    "is_splat_file",
    "read_splat_file",
    "read_splats",
    "write_splat_file",
]
