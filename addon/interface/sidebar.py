"""Sidebar and asset shelf of an editor: opens the add-on's tab, closes the shelf."""

from collections.abc import Callable

import bpy

TAB = "Train Splats"
_TRIES, _PAUSE = 10, 0.1
"""Attempts of a step, and seconds between them: a new editor has no tabs and no shelf before it is
drawn, and 4.3 crashes if a new window's sidebar is opened before that."""

Step = Callable[[bpy.types.Area], bool]
"""Step on an editor; returns True when done."""


def in_turn(area: bpy.types.Area, *steps: Step) -> None:
    """Run steps on an editor one after the other, each repeated until it is done."""
    pointer, waiting, left = area.as_pointer(), list(steps), _TRIES

    def attempt() -> float | None:
        nonlocal left
        for window in bpy.context.window_manager.windows:
            for current in window.screen.areas:
                if current.as_pointer() == pointer:
                    with bpy.context.temp_override(window=window, area=current):
                        done = waiting[0](current)
                    left -= 1
                    if done or not left:
                        left = _TRIES
                        waiting.pop(0)
                    return _PAUSE if waiting else None
        return None

    if not bpy.app.background:
        bpy.app.timers.register(attempt, first_interval=_PAUSE)


def open_sidebar(area: bpy.types.Area) -> bool:
    """Open the sidebar."""
    area.spaces.active.show_region_ui = True
    return True


def choose_tab(area: bpy.types.Area) -> bool:
    """Choose the add-on's tab in an open sidebar."""
    region = next((r for r in area.regions if r.type == "UI"), None)
    if region is None or not hasattr(region, "active_panel_category"):
        return True
    try:
        region.active_panel_category = TAB
    except AttributeError:  # read-only in older versions
        return True
    except TypeError:
        return False
    region.tag_redraw()
    return region.active_panel_category == TAB


def close_shelf(area: bpy.types.Area) -> bool:
    """Close the asset shelf, which newer versions draw over the picture."""
    space = area.spaces.active
    if not hasattr(space, "show_region_asset_shelf"):
        return True
    try:
        space.show_region_asset_shelf = False
    except AttributeError:  # there is no shelf yet
        return False
    return True
