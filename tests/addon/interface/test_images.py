"""Oracle: Blender's own zoom of an image editor."""

from collections.abc import Iterator

import bpy
import pytest

from addon.interface.images import editor_of


@pytest.fixture
def area(scene: bpy.types.Scene) -> Iterator[bpy.types.Area]:
    """The largest area, turned into an image editor."""
    found = max(bpy.context.window.screen.areas, key=lambda a: a.width * a.height)
    kind, found.type = found.type, "IMAGE_EDITOR"
    yield found
    found.type = kind


def test_the_whole_image_is_seen(area: bpy.types.Area) -> None:
    """Large ones are zoomed out, small ones are not magnified; the user's own zoom is kept."""
    wide = bpy.data.images.new("wide", 10 * area.width, 10)
    assert editor_of(bpy.context, wide) == area
    space = area.spaces.active
    assert space.image == wide
    assert 0.8 * area.width < wide.size[0] * space.zoom_percentage / 100 < area.width
    space.zoom_percentage = 300
    editor_of(bpy.context, wide)
    assert space.zoom_percentage == pytest.approx(300)
    editor_of(bpy.context, bpy.data.images.new("small", 10, 10))
    assert space.zoom_percentage == pytest.approx(100)
