"""The native sources of this project."""

from pathlib import Path


def own_sources(csrc: Path) -> list[Path]:
    """C and C++ files below csrc, without those of others in its third_party."""
    found = (path for path in csrc.rglob("*") if path.suffix in {".cpp", ".h"})
    return sorted(path for path in found if "third_party" not in path.parts)
