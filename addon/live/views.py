"""Live views: the 3D views that show splats, with the drawn and the pending order of each."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gpu
import numpy as np

from ..cameras.render_camera import RenderCamera
from ..equality import same
from ..process.background_task import Latest
from ..render import picture
from ..render.mesh_copies import reselected
from ..render.model import SplatCache, check_similar
from ..render.scene import Placed
from ..render.selections import Tinted, marks_of
from ..render.viewport import smaller
from . import atlas, order
from .card import Canvas, Card, Shot, ViewPicture
from .clip import Cuts
from .depths import Depths
from .level import Level
from .texture_upload import Order, Texels

UPLOAD = 0.004
"""Seconds of a redraw after which uploading pauses."""

_LIKE = 1.25
"""Largest ratio of an order's splats to the requested number for which its time is used."""


@dataclass(frozen=True, kw_only=True)
class DrawRequest:
    """A requested order."""

    placed: tuple[Placed, ...]
    eye: order.Eye
    count: int
    """Rows of the atlas to sort; beyond its end: all."""
    tinted: Tinted = Tinted.NONE
    """Objects whose selection is shown."""

    @property
    def parts(self) -> tuple[Any, ...]:
        """Key of the atlas."""
        return tuple((p.part, p.frozen.fingerprint) for p in self.placed)

    @property
    def marks(self) -> tuple[Any, ...]:
        """Key of selection and visibility, which change the order but not the atlas."""
        return (self.tinted, *((id(p.frozen.marks), p.edited) for p in self.placed))

    def same(self, other: "DrawRequest | None") -> bool:
        """Whether both requests have the same result."""
        known = other is not None and (self.parts, self.marks) == (other.parts, other.marks)
        return known and self.same_order(other)

    def same_order(self, other: "DrawRequest") -> bool:
        """Whether both have the same number and order of splats, if the splats are the same."""
        return same((self.count, self.eye), (other.count, other.eye))


@dataclass(frozen=True, kw_only=True)
class _Arranged:
    """Result of a request."""

    request: DrawRequest
    atlas: atlas.Atlas
    marks: list[np.ndarray | None]
    """Marks of each object, [N] as `render.selections.marks_of`."""
    entries: np.ndarray
    """The order, [M, 4]."""


class Arranger:
    """Sorts the splats of one view, in a thread.

    It keeps the atlas while the splats stay the same. If only colours, opacities and selection have
    changed, it updates only those rows.
    """

    def __init__(self, cache: SplatCache) -> None:
        self._cache = cache
        self._last: _Arranged | None = None

    def __call__(self, request: DrawRequest) -> tuple[atlas.Atlas, np.ndarray]:
        """The atlas, and the entries of the order.

        Raises:
            ValueError: an object cannot be drawn; it is named.
        """
        built, repainted = self._laid_out(request)
        marks = [marks_of(placed, request.tinted) for placed in request.placed]
        rows, last = None, self._last
        if last is not None and repainted is not None and request.same_order(last.request):
            rows = _recolored_rows(built, repainted, last.marks, marks)
        if rows is None:
            entries = order.arrange(built, request.eye, request.count, marks)
        else:
            entries = order.recolored(last.entries, built, request.eye, rows, marks)
        self._last = _Arranged(request=request, atlas=built, marks=marks, entries=entries)
        return built, entries

    def _laid_out(self, request: DrawRequest) -> tuple[atlas.Atlas, np.ndarray | None]:
        """The atlas, and its rows [N] whose colours or opacities differ from the last one; None if
        it has other splats."""
        last = self._last
        if last is not None and last.request.parts == request.parts:
            return last.atlas, np.zeros(len(last.atlas), bool)
        parts = self._cache.parts(list(request.placed))
        found = None if last is None else atlas.repainted(last.atlas, parts)
        return (atlas.build(parts), None) if found is None else found


def _recolored_rows(
    built: atlas.Atlas,
    repainted: np.ndarray,
    before: list[np.ndarray | None],
    after: list[np.ndarray | None],
) -> np.ndarray | None:
    """Rows of an atlas whose colours differ, [N] bool: repainted [N], selected or deselected ones;
    None if visibility has changed."""
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
    """A result that is being uploaded, or has been."""

    request: DrawRequest
    texels: Texels
    order: Order

    def step(self, card: Card) -> bool:
        """Upload the next chunk; return whether the upload is complete."""
        if not self.texels.complete:
            self.texels.step(card.copy)
            return False
        return self.order.step()


class View:
    """One region of a 3D view; used in draw handlers."""

    def __init__(self, cache: SplatCache) -> None:
        self.sorter: Latest[DrawRequest, tuple[atlas.Atlas, np.ndarray]]
        self.sorter = Latest(Arranger(cache), "gscore-live")
        self.level = Level()
        self.drawn = 0
        """Splats of the last picture."""
        self.seconds = 0.0
        """Time of the last redraw on Blender's main thread."""
        self.complete = False
        """Whether the last picture shows the current state completely."""
        self._requested: DrawRequest | None = None
        self._answered: DrawRequest | None = None
        self._coming: _Upload | None = None
        self._shown: _Upload | None = None
        self._picture = ViewPicture()
        self.depths = Depths()

    @property
    def waits(self) -> bool:
        """Whether the picture will change without further input."""
        coming = self._coming is not None or self.level.moving
        return self.sorter.busy or self.sorter.fresh or coming

    def stale(self, now: float) -> bool:
        """Whether a redraw would show a new picture or continue an upload."""
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
        """Draw the last uploaded order, and request the current one.

        Args:
            card: The graphics card.
            placed: The objects.
            camera: The view's camera.
            window: As in `Shot`.
            antialias: Anti-aliasing setting of the scene.
            meshes: Reads depths of objects that may hide splats (`Depths`), which waits for the
                card; not called for moving views if the card supports nearness. None: none.
            front: Whether some objects have no depth; `meshes` is then called for moving views too.
            cuts: Clipping of the view.
            tinted: Objects whose selection is shown.
            spare: Seconds for uploads in addition to `UPLOAD`.

        Returns:
            The picture; None: there is none yet.

        Raises:
            ValueError: the objects were trained with and without anti-aliasing, or one cannot be
                drawn.
        """
        began = time.perf_counter()
        total = sum(len(p.frozen.vertices) for p in placed)
        viewmats = tuple(camera.viewmat @ p.matrix for p in placed)
        # Dragging a filter or a crop needs quick redraws just as moving the view does.
        filters = b"".join(p.part[1] for p in placed)
        key = b"".join(m.tobytes() for m in (camera.K, *viewmats)) + filters
        detail = self.level.detail(time.monotonic(), key, total)
        eye = order.Eye(viewmats=viewmats, orthographic=camera.orthographic)
        request = DrawRequest(placed=tuple(placed), eye=eye, count=detail.count, tinted=tinted)
        self._take_in(card, UPLOAD + spare)
        self.complete = False
        for one in placed:  # the card draws known splats before the sorter checks them
            check_similar(one)
        if not request.same(self._requested):
            self._requested = request
            self.sorter.submit(request)
        if self.sorter.problem:
            raise ValueError(self.sorter.problem)
        if self._shown is None:
            return None
        shown = self._shown
        self.complete = shown.request.same(request) and not self.level.moving
        shot = Shot(
            camera=smaller(camera, detail.factor),
            viewmats=_viewmats(shown.request, request, camera),
            window=window,
            antialias=picture.compensates(
                antialias,
                trained=tuple(p.name for p in placed if p.antialias),
                plain=tuple(p.name for p in placed if not p.antialias),
            ),
            limit=detail.count,
            cuts=cuts,
        )
        # An order of many more splats than requested takes longer.
        like = shown.request.count <= _LIKE * detail.count
        took = self.level.took if self.level.measures and like else None
        nearness = meshes is not None and self.level.moving and card.nears and not front
        depths = None if meshes is None or nearness else meshes()
        canvas = self._picture.draw(
            *(card, shown.texels.texture, shown.order, shot, depths),
            nearness=nearness,
            exact=not self.level.moving,
            took=took,
        )
        self.drawn = min(detail.count, shown.request.count)
        self.seconds = time.perf_counter() - began
        return canvas

    def _take_in(self, card: Card, seconds: float) -> None:
        """Upload finished results in chunks."""
        until = time.perf_counter() + seconds
        self.sorter.fresh = False
        answer = self.sorter.answer
        if self._coming is None and answer is not None and answer[0] is not self._answered:
            self._answered = answer[0]
            self._coming = self._upload(answer[0], *answer[1])
        while self._coming is not None and time.perf_counter() < until:
            if self._coming.step(card):
                self._shown, self._coming = self._coming, None

    def _upload(self, request: DrawRequest, built: atlas.Atlas, entries: np.ndarray) -> _Upload:
        """The upload of a result, without data that are already on the card."""
        shown = self._shown
        if shown is not None and shown.texels.values is built.texels:
            texels = shown.texels
        else:
            texels = Texels(built.texels)
        order_ = Order(entries, None if shown is None else shown.order)
        return _Upload(request=request, texels=texels, order=order_)


def _viewmats(
    shown: DrawRequest, request: DrawRequest, camera: RenderCamera
) -> tuple[np.ndarray, ...]:
    """View matrices of the shown objects at their current places."""
    if [p.part for p in shown.placed] == [p.part for p in request.placed]:
        return request.eye.viewmats
    places = {p.uid: p.matrix for p in request.placed}
    return tuple(camera.viewmat @ places.get(p.uid, p.matrix) for p in shown.placed)
