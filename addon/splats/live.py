"""Whether this Blender session draws splats live, for those who set displays; no bpy."""

from dataclasses import dataclass


@dataclass
class Live:
    """Of the session."""

    there: bool = False
    """Whether there is a window, and the drawing is registered."""
    problem: str = ""
    """Why the graphics card does not draw them, a sentence."""

    @property
    def works(self) -> bool:
        """Whether splats are drawn live, as far as is known."""
        return self.there and not self.problem


SESSION = Live()
