"""Live views: the 3D views that show splats, with what each has drawn and what is pending."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gpu
import numpy as np

from ..cameras.render_camera import RenderCamera
from ..process.latest_request import Latest
from ..render import picture
from ..render.marks import reselected
from ..render.model import SplatCache, check_similar
from ..render.scene import Placed
from ..render.selections import Tinted, marks_of
from ..render.viewport import smaller
from . import atlas, order
from .card import Canvas, Card, Shot
from .clip import Cuts
from .depths import Depths
from .level import Level
from .uploads import Order, Texels
from .view_picture import ViewPicture

UPLOAD = 0.004
"""Seconds of a redraw after which nothing further is uploaded."""

_LIKE = 1.25
"""How many times more splats than are wanted an order has that is as good as the wanted one."""


@dataclass(frozen=True, kw_only=True)
class DrawRequest:
    """An order that is wanted."""

    placed: tuple[Placed, ...]
    eye: order.Eye
    count: int
    """Rows of the atlas to sort; beyond its end: all."""
    tinted: Tinted = Tinted.NONE
    """Of which objects what is selected is seen."""

    @property
    def parts(self) -> tuple[Any, ...]:
        """What the atlas depends on."""
        return tuple((p.part, p.frozen.fingerprint) for p in self.placed)

    @property
    def marks(self) -> tuple[Any, ...]:
        """What differs where other splats are selected or hidden: they need another order alone."""
        return (self.tinted, *((id(p.frozen.marks), p.edited) for p in self.placed))

    def same(self, other: "DrawRequest | None") -> bool:
        """Whether the other asks for nothing else."""
        return (
            other is not None
            and (self.parts, self.marks) == (other.parts, other.marks)
            and self.same_order(other)
        )

    def same_order(self, other: "DrawRequest") -> bool:
        """Whether the other has as many splats in the same order, if they are the same."""
        return (
            self.count == other.count
            and self.eye.orthographic == other.eye.orthographic
            and len(self.eye.viewmats) == len(other.eye.viewmats)
            and all(map(np.array_equal, self.eye.viewmats, other.eye.viewmats))
        )


@dataclass(frozen=True, kw_only=True)
class _Arranged:
    """What was made of a wish."""

    wish: DrawRequest
    atlas: atlas.Atlas
    marks: list[np.ndarray | None]
    """Of each object, [N] as `render.selections.marks_of`."""
    entries: np.ndarray
    """[M, 4], the order."""


class Arranger:
    """Sorts for one view, in a thread.

    While splats stay the same it keeps the atlas; where colours, opacities and what is selected are
    all that has changed, it goes over those of them alone.
    """

    def __init__(self, cache: SplatCache) -> None:
        self._cache = cache
        self._last: _Arranged | None = None

    def __call__(self, wish: DrawRequest) -> tuple[atlas.Atlas, np.ndarray]:
        """The atlas, and the entries of the order.

        Raises:
            ValueError: an object cannot be drawn; it is named.
        """
        built, repainted = self._laid_out(wish)
        marks = [marks_of(placed, wish.tinted) for placed in wish.placed]
        rows = None
        if self._last is not None and repainted is not None and wish.same_order(self._last.wish):
            rows = _recolored_rows(built, repainted, self._last.marks, marks)
        if rows is None:
            entries = order.arrange(built, wish.eye, wish.count, marks)
        else:
            entries = order.recolored(self._last.entries, built, wish.eye, rows, marks)
        self._last = _Arranged(wish=wish, atlas=built, marks=marks, entries=entries)
        return built, entries

    def _laid_out(self, wish: DrawRequest) -> tuple[atlas.Atlas, np.ndarray | None]:
        """The atlas, and which of its rows [N] have other colours or opacities than in the last;
        None where it has other splats."""
        last = self._last
        if last is not None and last.wish.parts == wish.parts:
            return last.atlas, np.zeros(len(last.atlas), bool)
        parts = self._cache.parts(list(wish.placed))
        found = None if last is None else atlas.repainted(last.atlas, parts)
        return (atlas.build(parts), None) if found is None else found


def _recolored_rows(
    built: atlas.Atlas,
    repainted: np.ndarray,
    before: list[np.ndarray | None],
    after: list[np.ndarray | None],
) -> np.ndarray | None:
    """[N] bool: which rows of an atlas have other colours, of those that were repainted [N], and of
    those that were selected or deselected; None where others show."""
    rows = repainted.copy()
    for number, (was, now) in enumerate(zip(before, after, strict=True)):
        if was is not now:
            differ = reselected(was, now, len(built.parts[number]))
            if differ is None:
                return None
            own = built.part == number
            rows[own] |= differ[built.index[own]]
    return rows


@dataclass(frozen=True, kw_only=True)
class _Upload:
    """An answer on its way to the card, or there."""

    wish: DrawRequest
    texels: Texels
    order: Order

    def step(self, card: Card) -> bool:
        """Upload some more; whether all is there."""
        if not self.texels.complete:
            self.texels.step(card.copy)
            return False
        return self.order.step()


class View:
    """One region of a 3D view; used where Blender draws."""

    def __init__(self, cache: SplatCache) -> None:
        self.sorter: Latest[DrawRequest, tuple[atlas.Atlas, np.ndarray]]
        self.sorter = Latest(Arranger(cache), "gscore-live")
        self.level = Level()
        self.drawn = 0
        """Splats of the last picture."""
        self.seconds = 0.0
        """What the last redraw took of Blender's own thread."""
        self.complete = False
        """Whether the last picture shows everything as it is now."""
        self._asked: DrawRequest | None = None
        self._answered: DrawRequest | None = None
        self._coming: _Upload | None = None
        self._shown: _Upload | None = None
        self._picture = ViewPicture()
        self.depths = Depths()

    @property
    def waits(self) -> bool:
        """Whether the picture will change although nobody touches anything."""
        coming = self._coming is not None or self.level.moving
        return self.sorter.busy or self.sorter.fresh or coming

    def stale(self, now: float) -> bool:
        """Whether a redraw would show something else, or go on with an upload."""
        rested = self.level.moving and self.level.rests_at <= now
        return self.sorter.fresh or self._coming is not None or rested

    def close(self) -> None:
        """End the thread."""
        self.sorter.close()

    def draw(
        self,
        card: Card,
        placed: list[Placed],
        camera: RenderCamera,
        window: np.ndarray,
        antialias: str,
        meshes: Callable[[], gpu.types.GPUTexture] | None,
        *,
        front: bool,
        cuts: Cuts,
        tinted: Tinted = Tinted.NONE,
        spare: float = 0.0,
    ) -> Canvas | None:
        """Draw what is there, and ask for what is missing.

        Args:
            card: What draws.
            placed: The objects.
            camera: Of the view.
            window: As in `Shot`.
            antialias: What the scene wishes.
            meshes: Reads depths of what may hide splats (`Depths`), which waits for the card: not
                while the view moves, if the card does without. None: nothing does.
            front: Whether some of it has no depth: then `meshes` is called in a moving view too.
            cuts: Where the view ends.
            tinted: Of which objects what is selected is seen.
            spare: Seconds that uploads may take besides `UPLOAD`.

        Returns:
            The picture; None where there is none.

        Raises:
            ValueError: the objects want to be drawn in different ways, or one cannot be drawn.
        """
        began = time.perf_counter()
        total = sum(len(p.frozen.vertices) for p in placed)
        viewmats = tuple(camera.viewmat @ p.matrix for p in placed)
        # A filter or a crop that is dragged wants a quick answer as much as a view that is turned.
        filters = b"".join(p.part[1] for p in placed)
        seen = b"".join(m.tobytes() for m in (camera.K, *viewmats)) + filters
        detail = self.level.look(time.monotonic(), seen, total)
        eye = order.Eye(viewmats=viewmats, orthographic=camera.orthographic)
        wish = DrawRequest(placed=tuple(placed), eye=eye, count=detail.count, tinted=tinted)
        self._take_in(card, UPLOAD + spare)
        self.complete = False
        for one in placed:  # the card would draw them at once, where it has their splats already
            check_similar(one)
        if not wish.same(self._asked):
            self._asked = wish
            self.sorter.ask(wish)
        if self.sorter.problem:
            raise ValueError(self.sorter.problem)
        if self._shown is None:
            return None
        shown = self._shown
        self.complete = shown.wish.same(wish) and not self.level.moving
        shot = Shot(
            camera=smaller(camera, detail.factor),
            viewmats=_viewmats(shown.wish, wish, camera),
            window=window,
            antialias=_antialias(placed, antialias),
            limit=detail.count,
            cuts=cuts,
        )
        # An order of many more splats than are wanted takes the time of those too.
        like = shown.wish.count <= _LIKE * detail.count
        took = self.level.took if self.level.measures and like else None
        nearness = meshes is not None and self.level.moving and card.nears and not front
        depths = None if meshes is None or nearness else meshes()
        canvas = self._picture.draw(
            *(card, shown.texels.texture, shown.order, shot, depths),
            nearness=nearness,
            exact=not self.level.moving,
            took=took,
        )
        self.drawn = min(detail.count, shown.wish.count)
        self.seconds = time.perf_counter() - began
        return canvas

    def _take_in(self, card: Card, seconds: float) -> None:
        """Upload answers that have come, bit by bit."""
        until = time.perf_counter() + seconds
        self.sorter.fresh = False
        answer = self.sorter.answer
        if self._coming is None and answer is not None and answer[0] is not self._answered:
            self._answered = answer[0]
            self._coming = self._upload(answer[0], *answer[1])
        while self._coming is not None and time.perf_counter() < until:
            if self._coming.step(card):
                self._shown, self._coming = self._coming, None

    def _upload(self, wish: DrawRequest, built: atlas.Atlas, entries: np.ndarray) -> _Upload:
        """Of an answer, without what the card has already."""
        shown = self._shown
        if shown is not None and shown.texels.values is built.texels:
            texels = shown.texels
        else:
            texels = Texels(built.texels)
        order_ = Order(entries, None if shown is None else shown.order)
        return _Upload(wish=wish, texels=texels, order=order_)


def _viewmats(
    shown: DrawRequest, wish: DrawRequest, camera: RenderCamera
) -> tuple[np.ndarray, ...]:
    """Of the objects that an order has, where they are by now."""
    if [p.part for p in shown.placed] == [p.part for p in wish.placed]:
        return wish.eye.viewmats
    places = {p.uid: p.matrix for p in wish.placed}
    return tuple(camera.viewmat @ places.get(p.uid, p.matrix) for p in shown.placed)


def _antialias(placed: list[Placed], wish: str) -> bool:
    return picture.compensates(
        wish,
        trained=tuple(p.name for p in placed if p.antialias),
        plain=tuple(p.name for p in placed if not p.antialias),
    )
