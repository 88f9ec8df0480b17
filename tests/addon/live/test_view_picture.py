"""The picture that a view keeps; oracle: how often the card is asked."""

from types import SimpleNamespace

import pytest

from addon.live.view_picture import ViewPicture


def test_a_picture_that_failed_is_not_kept() -> None:
    """Drivers raise anything; what was not drawn must not be shown as if it were."""
    calls: list[int] = []

    def draw(*_: object) -> None:
        calls.append(1)
        if len(calls) == 1:
            raise SystemError("out of memory")

    picture = ViewPicture()
    picture._target = SimpleNamespace(width=4, height=3, texture_color="texture")
    shot = SimpleNamespace(camera=SimpleNamespace(width=4, height=3), same=lambda other: True)
    given = SimpleNamespace(draw=draw), object(), object(), shot, None
    with pytest.raises(SystemError):
        picture.draw(*given)
    assert picture.draw(*given) == "texture" and len(calls) == 2
    assert picture.draw(*given) == "texture" and len(calls) == 2
