"""Splat file formats: readers for every known format, writers for those with a public layout."""

from .registry import (
    FORMATS,
    SPLAT_ENDINGS,
    file_origin,
    files_of,
    format_to_write,
    is_antialiased,
    is_splat_file,
    read_decoded,
    read_splat_file,
    read_splat_parts,
    read_splats,
    write_splat_file,
)
from .splat_file import Decoded, SplatFile, WrittenFile
