"""Sidebar and asset shelf of an editor: the add-on's tab, and the choice of brushes."""

from collections.abc import Callable

import bpy

TAB = "Train Splats"
_TRIES, _PAUSE = 10, 0.1
"""How often a step is tried, and seconds between: an editor that was just opened has no tabs and no
shelf before it is drawn, and 4.3 crashes where a new window's sidebar is opened before that."""

Step = Callable[[bpy.types.Area], bool]
"""Step on an editor; returns True when done."""


def in_turn(area: bpy.types.Area, *steps: Step) -> None:
    """Run steps on an editor one after the other, each repeated until it is done."""
    wanted, waiting, left = area.as_pointer(), list(steps), _TRIES

    def attempt() -> float | None:
        nonlocal left
        for window in bpy.context.window_manager.windows:
            for found in window.screen.areas:
                if found.as_pointer() == wanted:
                    with bpy.context.temp_override(window=window, area=found):
                        done = waiting[0](found)
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
    """Choose the add-on's tab in a sidebar that is open."""
    region = next((r for r in area.regions if r.type == "UI"), None)
    if region is None or not hasattr(region, "active_panel_category"):
        return True
    try:
        region.active_panel_category = TAB
    except AttributeError:  # older Blenders only tell it
        return True
    except TypeError:
        return False
    region.tag_redraw()
    return region.active_panel_category == TAB


def close_shelf(area: bpy.types.Area) -> bool:
    """Close the shelf of assets at the foot, which newer Blenders lay over the picture."""
    space = area.spaces.active
    if not hasattr(space, "show_region_asset_shelf"):
        return True
    try:
        space.show_region_asset_shelf = False
    except AttributeError:  # as long as there is none
        return False
    return True
