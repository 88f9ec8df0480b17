"""Engine protocol: the model in training on a device, and edits of its rows.

At this border all arrays are numpy, and a column is one parameter or counter of all splats.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ..raster.request import Frustum
from ..splats import PARAMETERS

Columns = Mapping[str, np.ndarray]
"""Columns by name, [N, ...] float32."""


@dataclass(frozen=True, kw_only=True)
class RowEdit:
    """A change of a model's rows, decided from its columns.

    It is applied in the order of the fields; all row numbers are those before the edit.
    """

    rows: np.ndarray | None = None
    """[W] int64: rows that `values` overwrites; None: all."""
    values: Columns = field(default_factory=dict)
    """[W, ...] by name of a parameter or counter."""
    forget: tuple[str, ...] = ()
    """Parameters whose Adam moments are cleared in `rows`."""
    moved: np.ndarray | None = None
    """[M] int64: rows that become copies of `sources`, without moments, accumulated gradients and
    counts; None: none."""
    sources: np.ndarray | None = None
    """[M] int64."""
    keep: np.ndarray | None = None
    """[K] int64: rows that stay, in their new order; None: all."""
    morton: bool = False
    """True: the rows that stay are sorted along a Morton curve through their means instead."""
    parents: np.ndarray | None = None
    """[A] int64: rows that are copied to the end, without moments and counts; None: none."""
    changes: Columns = field(default_factory=dict)
    """[A, ...] by name: parameters of the copies that differ from those of their parents."""

    @property
    def moves_rows(self) -> bool:
        """True if rows are copied, removed, added or reordered."""
        return not (self.moved is None and self.keep is None and self.parents is None)


class EngineModel(Protocol):
    """N splats on the device of an engine: parameters, Adam moments and counters.

    Nothing else writes to them. Row numbers change in `edit` only.
    """

    @property
    def sh_degree(self) -> int:
        """Degree of the SH coefficients stored, 0 to 3."""
        ...

    @property
    def widths(self) -> Mapping[str, tuple[int, ...]]:
        """Shape of a row of each column, by name: `PARAMETERS`, then counters."""
        ...

    def __len__(self) -> int: ...

    def column(self, name: str) -> np.ndarray:
        """Return a copy of a column, [N, ...]; the SH coefficients as after all pending steps."""
        ...

    def gather(self, name: str, rows: np.ndarray) -> np.ndarray:
        """Return some rows, [M] int64, of a column."""
        ...

    def edit(self, edit: RowEdit) -> None:
        """Apply an edit to parameters, moments and counters."""
        ...

    def widen_sh(self, degree: int) -> None:
        """Extend the SH coefficients to at least `degree`; new ones and their moments are zero."""
        ...

    def clamp_runaways(self, extent: float) -> int:
        """Reset rows that are not finite or absurdly large, and clamp saturated parameters.

        Args:
            extent: Camera extent, training units.

        Returns:
            Number of rows that were reset.
        """
        ...

    def apply_min_scale(self, views: Iterable[Frustum], pixels: float) -> None:
        """Raise scales to at least `pixels` (standard deviation) of the nearest of `views` that has
        the splat in its frame (Yu et al. 2024, Mip-Splatting, section 4.2)."""
        ...


__all__ = ["PARAMETERS", "Columns", "EngineModel", "RowEdit"]
