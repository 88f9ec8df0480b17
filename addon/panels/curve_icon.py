"""The loss curve as an icon that a panel can show."""

import bpy
import bpy.utils.previews

from ..job.job import Job

_SIZE = 192


class CurveIcons:
    """An icon for each training, kept while Blender has room for icons."""

    def __init__(self) -> None:
        self._icons: bpy.utils.previews.ImagePreviewCollection | None = None
        self._drawn: dict[str, int] = {}
        """Last step that each job's icon shows."""

    def open(self) -> None:
        """Make room for icons."""
        self._icons = bpy.utils.previews.new()

    def close(self) -> None:
        """Give it back."""
        if self._icons is not None:
            bpy.utils.previews.remove(self._icons)
        self._icons = None
        self._drawn.clear()

    def update(self, job: Job) -> int:
        """The icon of a job's curve, drawn anew if there are more points; 0 without a window."""
        if self._icons is None:
            return 0
        icon = self._icons.get(job.id) or self._icons.new(job.id)
        curve = job.state.curve
        last = curve.steps[-1] if curve.steps else 0
        if self._drawn.get(job.id) != last:
            self._drawn[job.id] = last
            pixels = curve.picture(_SIZE, _SIZE, last_step=job.state.iterations)
            pixels[..., :3] *= pixels[..., 3:]  # Blender blends icons as premultiplied
            icon.image_size = (_SIZE, _SIZE)
            icon.image_pixels_float.foreach_set(pixels.ravel())
        return icon.icon_id


ICONS = CurveIcons()
on_register, on_unregister = ICONS.open, ICONS.close
