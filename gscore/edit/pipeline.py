"""Edit pipeline: all steps of a request in order, and the number of splats each removed."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..errors import ConfigError
from ..formats.joined import joined
from ..importance import importance_of, most_important
from ..scene import Cameras
from ..splats import Splats, cut_degree, sigmoid
from ..text_format import count_words
from ..transforms import transform_splats
from .clusters import cluster_sizes
from .contribution import contributions
from .crop import box_matrix, in_frustum, in_unit_shape, sphere_matrix
from .isolation import isolation_of
from .limits import at_least_opaque, of_size
from .request import GAP, EditRequest
from .similarity import similarity_matrix

_TRIES = 8
"""Files that are written to find how many splats fit."""
_EXPONENT = 88.0
"""Whose exponential float32 still holds."""
_AIM, _ENOUGH = 0.998, 0.99
"""Shares of a file size: what is aimed at, and from where on it is near enough."""


@dataclass(frozen=True, kw_only=True)
class EditViews:
    """Cameras that look at the splats, and how these are drawn."""

    cameras: Cameras
    """All from which the splats may be seen: what none of them shows adds nothing."""
    antialias: bool = False
    near: float = 0.01
    """World units."""
    threads: int = 0


@dataclass(frozen=True, kw_only=True)
class Step:
    """Result of one step."""

    name: str
    removed: int
    """Splats."""
    left: int
    """Splats."""
    seconds: float


@dataclass(kw_only=True)
class Edited:
    """Splats on their way through the steps."""

    splats: Splats
    """As the last step left them."""
    joined: Splats
    """Before anything was removed."""
    cropped: Splats
    """After the crop: what cleaning and thinning are measured against."""
    kept: Splats
    """After the last step that removes anything, in the world of the cameras."""
    steps: list[Step] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """Sentences for the user."""


Told = Callable[[str], None]
"""Called with the name of a step before it."""


def apply_edits(
    parts: Sequence[Splats],
    request: EditRequest,
    *,
    views: EditViews | None = None,
    bytes_of: Callable[[Splats], int] | None = None,
    told: Told = lambda name: None,
) -> Edited:
    """Join, crop, clean up, thin out and place splats.

    Args:
        parts: Models of one world, one at least.
        request: The steps.
        views: Needed by `frustum` and `min_contribution`; what matters most is found with them
            where they are there.
        bytes_of: How large the file of some splats is; needed by `size`.
        told: Called before each step.

    Raises:
        ConfigError: a step that lacks its views, or leaves no splat.
        ShapeError: a matrix that is no similarity.
    """
    work = _Work(joined(parts), views, told)
    work.crop(request)
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
    """The splats as they are, and what was done to them."""

    def __init__(self, splats: Splats, views: EditViews | None, told: Told) -> None:
        self.splats = self.joined = splats
        self.steps: list[Step] = []
        self.notes: list[str] = []
        self._views, self._told = views, told
        self._added: np.ndarray | None = None
        """[N] contributions of `splats`, once they are known."""

    def crop(self, request: EditRequest) -> None:
        """Keep the splats inside all shapes, or outside."""
        if request.crops:
            self._keep("crop", lambda s: _inside(s.means, request, self._views) != request.outside)

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
                lambda s: (isolation_of(s.means, threads=self._threads) <= alone) | self._seen(r),
            )
        if (few := r.min_cluster) is not None:
            gap = GAP if r.gap is None else r.gap
            self._keep("clusters", lambda s: (cluster_sizes(s, gap) >= few) | self._seen(r))

    def narrow(self, request: EditRequest) -> None:
        """Take coefficients away, no splats."""
        if (degree := request.sh_degree) is None:
            return
        if degree >= self.splats.sh_degree:
            self.notes.append(
                f"The splats have SH degree {self.splats.sh_degree}, so none were taken away for "
                f"{degree}."
            )
        self._change("sh degree", lambda s: cut_degree(s, degree))

    def thin(self, request: EditRequest, bytes_of: Callable[[Splats], int] | None) -> None:
        """Keep as many splats as there may be, those that matter most."""
        if (count := request.count) is not None:
            self._keep("count", lambda _: most_important(self._importance(), count))
        if (size := request.size) is not None:
            if bytes_of is None:
                raise ConfigError("Nobody knows how large a file of these splats is.")
            self._keep("file size", lambda s: self._fitting(s, size * 1e6, bytes_of))

    def place(self, request: EditRequest) -> None:
        """Scale, turn and move."""
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
        self._told(name)
        began, before = time.perf_counter(), len(self.splats)
        after = change(self.splats)
        if not len(after):
            raise ConfigError(
                f"The step {name!r} would leave none of {count_words(before, 'splat')}; nothing "
                "was written. Ask for less."
            )
        seconds = time.perf_counter() - began
        removed = before - len(after)
        self.steps.append(Step(name=name, removed=removed, left=len(after), seconds=seconds))
        self.splats = after

    def _contributions(self) -> np.ndarray:
        """Taken once: what is taken out afterwards showed little, or is not missed."""
        if self._added is None:
            views = needed_views(self._views, "What splats add to pictures")
            self._added = contributions(
                self.splats,
                views.cameras,
                antialias=views.antialias,
                near=views.near,
                threads=views.threads,
                on_view=lambda n: self._told(f"contribution, view {n} of {len(views.cameras)}"),
            )
        return self._added

    def _seen(self, request: EditRequest) -> np.ndarray:
        """[N] bool: what is seen too well to be taken out for where it lies."""
        if request.seen_share is None:
            return np.zeros(len(self.splats), bool)
        cameras = needed_views(self._views, "What is seen").cameras
        pixels = int((cameras.widths * cameras.heights).min())
        return self._contributions() >= request.seen_share * pixels

    def _importance(self) -> np.ndarray:
        if self._views is not None:
            return self._contributions()
        self.notes.append(
            "No cameras are known, so the splats to keep were chosen by opacity and area, not by "
            "what they add to pictures; give a capture or a run with -s."
        )
        return importance_of(self.splats)

    def _fitting(
        self, splats: Splats, most: float, bytes_of: Callable[[Splats], int]
    ) -> np.ndarray:
        """[N] bool: as many of the most important splats as fit into `most` bytes, within one part
        in a hundred: codings are not exactly proportional."""
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
    """The views; ConfigError where there are none. `what` begins the sentence."""
    if views is None:
        raise ConfigError(
            f"{what} is only known with cameras: say with -s where they are, a capture, the folder "
            "of a run or a cameras.json."
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
        keep &= _seen(means, request.frustum, needed_views(views, "What a view shows"))
    return keep


def _seen(means: np.ndarray, indices: Sequence[int], views: EditViews) -> np.ndarray:
    cameras, seen = views.cameras, np.zeros(len(means), bool)
    for i in indices:
        width, height = int(cameras.widths[i]), int(cameras.heights[i])
        seen |= in_frustum(means, cameras.Ks[i], cameras.viewmats[i], width, height, views.near)
    return seen


def _exp(logs: np.ndarray) -> np.ndarray:
    return np.exp(np.minimum(logs, np.float32(_EXPONENT)))
