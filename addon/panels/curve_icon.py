"""The loss curve as an icon that a panel can show."""

import bpy
import bpy.utils.previews

from ..job.job import Job

_SIZE = 192

_icons: bpy.utils.previews.ImagePreviewCollection | None = None
_drawn: dict[str, int] = {}
"""Last step that each job's icon shows."""


def update(job: Job) -> int:
    """The icon of a job's curve, drawn anew if there are more points; 0 without a window."""
    if _icons is None:
        return 0
    icon = _icons.get(job.id) or _icons.new(job.id)
    curve = job.state.curve
    last = curve.steps[-1] if curve.steps else 0
    if _drawn.get(job.id) != last:
        _drawn[job.id] = last
        pixels = curve.picture(_SIZE, _SIZE, last_step=job.state.iterations)
        pixels[..., :3] *= pixels[..., 3:]  # Blender blends icons as premultiplied
        icon.image_size = (_SIZE, _SIZE)
        icon.image_pixels_float.foreach_set(pixels.ravel())
    return icon.icon_id


def register() -> None:
    """Make room for icons."""
    global _icons
    _icons = bpy.utils.previews.new()


def unregister() -> None:
    """Give it back."""
    global _icons
    if _icons is not None:
        bpy.utils.previews.remove(_icons)
    _icons = None
    _drawn.clear()
