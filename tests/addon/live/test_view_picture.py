"""Kept picture of a view; oracle: the number of draws by the card."""

from types import SimpleNamespace

import pytest

from addon.live.card import ViewPicture

SHOT = SimpleNamespace(camera=SimpleNamespace(width=4, height=3), same=lambda other: True)


def with_canvas() -> tuple[ViewPicture, SimpleNamespace]:
    """A picture with a canvas, and the canvas."""
    picture = ViewPicture()
    picture._canvas = SimpleNamespace(kind=(4, 3, False, False))
    return picture, picture._canvas


def test_a_picture_that_failed_is_not_kept() -> None:
    """Drivers raise anything; a picture that was not drawn must not be shown."""
    calls: list[int] = []

    def draw(*_: object) -> None:
        calls.append(1)
        if len(calls) == 1:
            raise SystemError("out of memory")

    picture, canvas = with_canvas()
    given = SimpleNamespace(draw=draw), object(), object(), SHOT, None
    with pytest.raises(SystemError):
        picture.draw(*given)
    assert picture.draw(*given) is canvas and len(calls) == 2
    assert picture.draw(*given) is canvas and len(calls) == 2


def test_a_picture_is_kept_while_depths_are_the_same() -> None:
    """With other depths, or none, it is drawn again."""
    calls: list[object] = []
    card = SimpleNamespace(draw=lambda *given: calls.append(given[-1]))
    picture, _ = with_canvas()
    atlas, order, wall, plate = object(), object(), object(), object()
    for meshes in (wall, wall, wall, plate, plate, None, None, wall):
        picture.draw(card, atlas, order, SHOT, meshes)
    assert calls == [wall, plate, None, wall]
