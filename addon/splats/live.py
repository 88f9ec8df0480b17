"""State of the live display: on or off in this Blender session; no bpy."""

from dataclasses import dataclass


@dataclass
class Live:
    """Of the session."""

    there: bool = False
    """Whether there is a window, and the drawing is registered."""
    problem: str = ""
    """Why the graphics card does not draw them, a sentence."""
    by_engine: bool = False
    """Whether views show pictures of the render engine where it does not."""

    @property
    def works(self) -> bool:
        """Whether views show splats that are displayed as such, as far as is known."""
        return self.there and not self.as_points

    @property
    def as_points(self) -> bool:
        """Whether they are shown as points, for want of anything better."""
        return bool(self.problem) and not self.by_engine


SESSION = Live()
