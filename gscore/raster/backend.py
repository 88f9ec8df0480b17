"""What the native library is and can do here, for those who report it."""

from ._native import CancelFlag, available_isas, default_threads, isa, library_path, set_isa

__all__ = ["CancelFlag", "available_isas", "default_threads", "isa", "library_path", "set_isa"]
