"""State of the live display: on or off in this Blender session; no bpy."""

from dataclasses import dataclass


@dataclass
class Live:
    """State of the live display in the session."""

    there: bool = False
    """True with a window and a registered draw handler."""
    problem: str = ""
    """Error sentence if the GPU does not draw splats, which are shown as points then."""

    @property
    def works(self) -> bool:
        """True if views show the display mode Splats, as far as known."""
        return self.there and not self.problem


SESSION = Live()
