"""State of the live display: on or off in this Blender session; no bpy."""

from dataclasses import dataclass


@dataclass
class Live:
    """State of the live display in the session."""

    there: bool = False
    """True with a window and a registered draw handler."""
    problem: str = ""
    """Error sentence if the GPU does not draw splats."""
    by_engine: bool = False
    """True if views show pictures of the render engine as a fallback."""

    @property
    def works(self) -> bool:
        """True if views show the display mode Splats, as far as known."""
        return self.there and not self.as_points

    @property
    def as_points(self) -> bool:
        """True if splats are shown as points as a fallback."""
        return bool(self.problem) and not self.by_engine


SESSION = Live()
