"""Edit pipeline: all steps of a request in order, and the change of the number of splats."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..errors import ConfigError
from ..formats.joined import joined
from ..importance import importance_of, most_important
from ..scene import Cameras
from ..splats import Splats, cut_degree, sigmoid
from ..text_format import count_text
from ..transforms import transform_splats
from .clusters import cluster_sizes
from .crop import box_matrix, in_frustum, in_unit_shape, sphere_matrix
from .heal import heal
from .measures import at_least_opaque, contributions, isolation_of, of_size, similarity_matrix
from .request import GAP, EditRequest

_TRIES = 8
"""Most trial files to find the number of splats for a file size."""
_EXPONENT = 88.0
"""Largest exponent for float32."""
_AIM, _ENOUGH = 0.998, 0.99
"""Target, and least share of the file size that is accepted."""


@dataclass(frozen=True, kw_only=True)
class EditViews:
    """Cameras and render settings for edits that need views."""

    cameras: Cameras
    """All relevant cameras: splats visible in none of them have no contribution."""
    antialias: bool = False
    near: float = 0.01
    """Near plane, world units."""
    threads: int = 0


@dataclass(frozen=True, kw_only=True)
class Step:
    """Result of one step."""

    name: str
    removed: int
    """Number of removed splats; negative: splats were added."""
    left: int
    """Number of remaining splats."""
    seconds: float


@dataclass(kw_only=True)
class Edited:
    """Results of the steps."""

    splats: Splats
    """Final result."""
    joined: Splats
    """Splats before any removal."""
    cropped: Splats
    """Splats after crop and healing: the reference for measuring cleaning and thinning."""
    kept: Splats
    """Splats after the last step that removes any, in the world of the cameras."""
    steps: list[Step] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """Messages for the user."""


OnStep = Callable[[str], None]
"""Called with the name of each step before it starts."""


def apply_edits(
    parts: Sequence[Splats],
    request: EditRequest,
    *,
    views: EditViews | None = None,
    bytes_of: Callable[[Splats], int] | None = None,
    on_step: OnStep = lambda name: None,
) -> Edited:
    """Join, crop, heal, clean, thin and transform splats.

    Args:
        parts: Models of one world, at least one.
        request: The steps.
        views: Needed by `frustum` and `min_contribution`; if given, `count` and `size` rank splats
            by contribution.
        bytes_of: Returns the file size of some splats; needed by `size`.
        on_step: Called before each step.

    Raises:
        ConfigError: a step lacks its views, leaves no splat, or finds no hole.
        ShapeError: a matrix is not a similarity.
    """
    work = _Work(joined(parts), views, on_step)
    work.crop(request)
    work.heal(request)
    cropped = work.splats
    work.clean(request)
    work.narrow(request)
    work.thin(request, bytes_of)
    kept = work.splats
    work.place(request)
    return Edited(
        splats=work.splats,
        joined=work.joined,
        cropped=cropped,
        kept=kept,
        steps=work.steps,
        notes=work.notes,
    )


class _Work:
    """Current splats and the steps so far."""

    def __init__(self, splats: Splats, views: EditViews | None, on_step: OnStep) -> None:
        self.splats = self.joined = splats
        self.steps: list[Step] = []
        self.notes: list[str] = []
        self._views, self._on_step = views, on_step
        self._added: np.ndarray | None = None
        """[N] contributions of `splats`; None: not yet computed."""

    def crop(self, request: EditRequest) -> None:
        """Keep the splats inside all shapes, or outside."""
        if request.crops:
            self._keep("crop", lambda s: _inside(s.means, request, self._views) != request.outside)

    def heal(self, request: EditRequest) -> None:
        """Fill a hole."""
        if request.heal is not None:
            x, y, z, radius = request.heal
            ball = np.diag([radius, radius, radius, 1.0])
            ball[:3, 3] = x, y, z
            self._change("heal", lambda s: joined([s, heal(s, ball).splats]))

    def clean(self, request: EditRequest) -> None:
        """Remove faint, large, non-contributing or isolated splats."""
        r = request
        if (least := r.min_opacity) is not None:
            self._keep("opacity", lambda s: at_least_opaque(sigmoid(s.opacities), least))
        if (most := r.max_size) is not None:
            self._keep("size", lambda s: of_size(_exp(s.scales), most=most))
        if (added := r.min_contribution) is not None:
            self._keep("contribution", lambda _: self._contributions() >= added)
        if (alone := r.max_isolation) is not None:
            self._keep(
                "isolation",
                lambda s: (
                    (isolation_of(s.means, threads=self._threads) <= alone) | self._visible(r)
                ),
            )
        if (few := r.min_cluster) is not None:
            gap = GAP if r.gap is None else r.gap
            self._keep("clusters", lambda s: (cluster_sizes(s, gap) >= few) | self._visible(r))

    def narrow(self, request: EditRequest) -> None:
        """Reduce the SH degree."""
        if (degree := request.sh_degree) is None:
            return
        if degree >= self.splats.sh_degree:
            self.notes.append(
                f"The splats have SH degree {self.splats.sh_degree}, so none were taken away for "
                f"{degree}."
            )
        self._change("sh degree", lambda s: cut_degree(s, degree))

    def thin(self, request: EditRequest, bytes_of: Callable[[Splats], int] | None) -> None:
        """Keep the most important splats, up to the requested number or file size."""
        if (count := request.count) is not None:
            self._keep("count", lambda _: most_important(self._importance(), count))
        if (size := request.size) is not None:
            if bytes_of is None:
                raise ConfigError(
                    "The file size of these splats cannot be computed; give the number to keep "
                    "instead."
                )
            self._keep("file size", lambda s: self._fitting(s, size * 1e6, bytes_of))

    def place(self, request: EditRequest) -> None:
        """Scale, rotate and translate."""
        if not request.moves:
            return
        matrix = request.matrix
        if matrix is None:
            none = (0.0, 0.0, 0.0)
            matrix = similarity_matrix(
                scale=request.scale or 1.0,
                degrees=request.rotate or none,
                move=request.move or none,
            )
        self._change("place", lambda s: transform_splats(s, matrix))

    @property
    def _threads(self) -> int:
        return self._views.threads if self._views else 0

    def _keep(self, name: str, chosen: Callable[[Splats], np.ndarray]) -> None:
        """Run a step that selects the splats to keep."""
        keep = np.ones(0, bool)

        def reduced(splats: Splats) -> Splats:
            nonlocal keep
            keep = chosen(splats)
            return splats if keep.all() else splats.subset(keep)

        self._change(name, reduced)
        if self._added is not None:
            self._added = self._added[keep]

    def _change(self, name: str, change: Callable[[Splats], Splats]) -> None:
        self._on_step(name)
        began, before = time.perf_counter(), len(self.splats)
        after = change(self.splats)
        if not len(after):
            raise ConfigError(
                f"The step {name!r} would leave none of {count_text(before, 'splat')}; nothing "
                "was written. Relax its limit."
            )
        seconds = time.perf_counter() - began
        removed = before - len(after)
        self.steps.append(Step(name=name, removed=removed, left=len(after), seconds=seconds))
        self.splats = after

    def _contributions(self) -> np.ndarray:
        """Contributions [N], computed once: later removals change them little."""
        if self._added is None:
            views = needed_views(self._views, "The contribution of splats")
            self._added = contributions(
                self.splats,
                views.cameras,
                antialias=views.antialias,
                near=views.near,
                threads=views.threads,
                on_view=lambda n: self._on_step(f"contribution, view {n} of {len(views.cameras)}"),
            )
        return self._added

    def _visible(self, request: EditRequest) -> np.ndarray:
        """Mask [N] bool of splats too visible to be removed because of their position."""
        if request.seen_share is None:
            return np.zeros(len(self.splats), bool)
        cameras = needed_views(self._views, "The visibility of splats").cameras
        pixels = int((cameras.widths * cameras.heights).min())
        return self._contributions() >= request.seen_share * pixels

    def _importance(self) -> np.ndarray:
        if self._views is not None:
            return self._contributions()
        self.notes.append(
            "Without cameras, the splats to keep were chosen by opacity and area, not by their "
            "contribution to pictures; give a capture or a run with -s."
        )
        return importance_of(self.splats)

    def _fitting(
        self, splats: Splats, most: float, bytes_of: Callable[[Splats], int]
    ) -> np.ndarray:
        """Mask [N] bool of the most important splats that fit into `most` bytes, within 1 %,
        because compressed sizes are not proportional."""
        every = np.ones(len(splats), bool)
        low, high = (0, 0), (len(splats), bytes_of(splats))
        if high[1] <= most:
            return every
        importance, keep = self._importance(), ~every
        for _ in range(_TRIES):
            share = (_AIM * most - low[1]) / (high[1] - low[1])
            count = low[0] + int(share * (high[0] - low[0]))
            if not low[0] < count < high[0]:
                break
            tried = most_important(importance, count)
            size = bytes_of(splats.subset(tried))
            if size > most:
                high = (count, size)
                continue
            low, keep = (count, size), tried
            if size >= _ENOUGH * most:
                break
        return keep


def needed_views(views: EditViews | None, what: str) -> EditViews:
    """Return the views; raise ConfigError without any. `what` is the subject of the message."""
    if views is None:
        raise ConfigError(
            f"{what} is only known with cameras: give them with -s, as a capture, the folder of a "
            "run or a cameras.json."
        )
    return views


def _inside(means: np.ndarray, request: EditRequest, views: EditViews | None) -> np.ndarray:
    keep = np.ones(len(means), bool)
    if (box := request.box) is not None:
        keep &= in_unit_shape(means, box_matrix(np.array(box[:3]), np.array(box[3:])))
    if (sphere := request.sphere) is not None:
        unit = sphere_matrix(np.array(sphere[:3]), sphere[3])
        keep &= in_unit_shape(means, unit, sphere=True)
    if request.frustum:
        keep &= _in_views(means, request.frustum, needed_views(views, "The content of a view"))
    return keep


def _in_views(means: np.ndarray, indices: Sequence[int], views: EditViews) -> np.ndarray:
    cameras, inside = views.cameras, np.zeros(len(means), bool)
    for i in indices:
        width, height = int(cameras.widths[i]), int(cameras.heights[i])
        inside |= in_frustum(means, cameras.Ks[i], cameras.viewmats[i], width, height, views.near)
    return inside


def _exp(logs: np.ndarray) -> np.ndarray:
    return np.exp(np.minimum(logs, np.float32(_EXPONENT)))
