"""Fallback of Rendered shading: live splats until the engine's picture is ready."""

from collections.abc import Mapping

import bpy

from ..render.operators import changes_colors
from ..splats.live_display import SESSION
from . import photos
from .views import View


class LiveFallback:
    """Live drawing as a `render.viewport.LiveFallback`."""

    def __init__(self, views: Mapping[int, View]) -> None:
        """Keep the known views, by the pointer of their region."""
        self._views = views

    def draws_live(self, context: bpy.types.Context) -> bool:
        """Whether splats are drawn live there. Their colours must match the picture's, except with
        a photo behind them, which shows its own colours too."""
        wanted = SESSION.works and context.scene.gscore_render.live
        return wanted and (not changes_colors(context.scene) or self.stays(context))

    def moves(self, context: bpy.types.Context) -> bool:
        """Whether its view has just changed."""
        view = self._views.get(context.region.as_pointer())
        return view is not None and view.level.moving

    def stays(self, context: bpy.types.Context) -> bool:
        """Whether there is a photo behind the splats, which Blender would draw over a picture."""
        return photos.is_behind(context)

    def covers_photos(self, context: bpy.types.Context) -> bool:
        """Whether there are pictures behind the splats and none in front, which it would cover."""
        return SESSION.works and photos.are_behind(context)
