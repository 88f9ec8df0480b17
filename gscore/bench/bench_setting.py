"""Bench setting: the machine and versions that a measured speed refers to."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class BenchSetting:
    """The library, the splats and the views of a measurement."""

    isa: str
    """Instruction set of the kernels."""
    threads: int
    splats: int
    views: int
    width: int
    """Width of the first view, px."""
    height: int
    """Height of the first view, px."""
