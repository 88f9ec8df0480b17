"""Native library: instruction sets, threads, path and constants, for code outside this package."""

from ._native import available_isas, default_threads, isa, library_path, set_isa
from .header import NO_EXACT_CULL, NO_OPACITY_EXTENT, NO_ROW_RANGE, NO_ZERO_TILE, TILE
from .request import CancelFlag
