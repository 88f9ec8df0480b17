"""What can be handed to Blender bit by bit.

Apart, because `typing` remembers the classes that generic ones are made of until Python ends. If
one of them reached bpy through its module, bpy 4.5 would not be freed, and hang at the end.
"""

from typing import Protocol, TypeVar

import numpy as np


class Ready(Protocol):
    """Splats as Blender takes them."""

    @property
    def count(self) -> int:
        """How many."""
        ...

    @property
    def columns(self) -> tuple[tuple[str, str, np.ndarray], ...]:
        """As `attributes.columns`."""
        ...


ReadyT = TypeVar("ReadyT", bound=Ready)
