"""Engine protocol: the interface of the trainer to the device that computes a training.

The trainer chooses views, rates, loss terms and edits of rows. An engine owns the models, the
photos of a step, and all memory for rendering and gradients. All arrays of the interface are numpy;
a column is one parameter or counter of all splats.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, StrEnum, auto
from types import MappingProxyType
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from ..choices import Skip
from ..raster.request import Frustum
from ..splats import PARAMETERS, SH_REST_BY_DEGREE

Columns = Mapping[str, np.ndarray]
"""Columns by name, [N, ...] float32."""
T = TypeVar("T")
Color = tuple[float, float, float]
"""RGB."""
DROPOUT_STREAM, NOISE_STREAM, STREAMS = 0, 1, 2
"""Streams of random numbers of a model, and their number, see `StepRequest.seed`."""
ENGINE_SKIPS = frozenset(
    {Skip.EXACT_CULL, Skip.OPACITY_EXTENT, Skip.ROW_RANGE, Skip.ZERO_TILE},
)
"""Optimisations inside an engine; the trainer disables the others."""
ABSURD_MSE = 1e4
"""Mean squared error that only runaway splats cause: colours of 100 where photos have 0 to 1."""


@dataclass(frozen=True, kw_only=True)
class RowEdit:
    """A change of a model's rows, decided from its columns.

    It is applied in the order of the fields; all row numbers are those before the edit.
    """

    rows: np.ndarray | None = None
    """[W] int64: rows that `values` overwrites; None: all."""
    values: Columns = field(default_factory=dict)
    """[W, ...] by name of a parameter or counter."""
    forget: tuple[str, ...] = ()
    """Parameters whose Adam moments are cleared in `rows`."""
    moved: np.ndarray | None = None
    """[M] int64: rows that become copies of `sources`, without moments, accumulated gradients and
    counts; None: none."""
    sources: np.ndarray | None = None
    """[M] int64."""
    keep: np.ndarray | None = None
    """[K] int64: rows that stay, in their new order; None: all."""
    morton: bool = False
    """True: the rows that stay may be sorted along a Morton curve through their means, so that
    neighbours are close in memory."""
    parents: np.ndarray | None = None
    """[A] int64: rows that are copied to the end, without moments and counts; None: none."""
    changes: Columns = field(default_factory=dict)
    """[A, ...] by name: parameters of the copies that differ from those of their parents."""

    @property
    def moves_rows(self) -> bool:
        """True if rows are copied, removed, added or reordered."""
        return not (self.moved is None and self.keep is None and self.parents is None)


_COUNTER_KEYS = {
    "grad2d": "pull",
    "views": "seen",
    "shN_visible": "shN_seen",
    "shN_pending": "shN_lag",
}
"""Names of counters in checkpoints, where they differ."""


def column_key(name: str) -> str:
    """Return the key of a parameter or counter in a checkpoint."""
    return f"param/{name}" if name in PARAMETERS else f"row/{_COUNTER_KEYS.get(name, name)}"


def counters_of(saved: Mapping[str, T]) -> dict[str, T]:
    """Return the counters of a checkpoint by their names."""
    names = {key: name for name, key in _COUNTER_KEYS.items()}
    rows = {key[4:]: value for key, value in saved.items() if key.startswith("row/")}
    return {names.get(key, key): value for key, value in rows.items()}


class EngineModel(Protocol):
    """N splats on the device of an engine: parameters, Adam moments and counters.

    Nothing else writes to them. Row numbers change in `edit` only. Methods with a body are for
    models that derive from this class and have no faster way.
    """

    adam_steps: dict[str, int]
    """Adam steps that each parameter has taken."""

    @property
    def sh_degree(self) -> int:
        """Degree of the SH coefficients stored, 0 to 3."""
        return math.isqrt(self.widths["shN"][0] + 1) - 1

    @property
    def widths(self) -> Mapping[str, tuple[int, ...]]:
        """Shape of a row of each column, by name: `PARAMETERS`, then counters."""
        ...

    def __len__(self) -> int: ...

    def column(self, name: str) -> np.ndarray:
        """Return a copy of a column, [N, ...]; the SH coefficients as after all pending steps."""
        ...

    def gather(self, name: str, rows: np.ndarray) -> np.ndarray:
        """Return some rows, [M] int64, of a column."""
        return self.column(name)[rows]

    def edit(self, edit: RowEdit) -> None:
        """Apply an edit to parameters, moments and counters."""
        ...

    def widen_sh(self, degree: int) -> None:
        """Extend the SH coefficients to at least `degree`; new ones and their moments are zero."""
        ...

    def clamp_runaways(self, extent: float) -> int:
        """Reset rows that are not finite or absurdly large, and clamp saturated parameters.

        Args:
            extent: Camera extent, training units.

        Returns:
            Number of rows that were reset.
        """
        ...

    def part(self, begin: int, end: int) -> Columns:
        """Return the raw parameters of the rows from `begin` to `end`, after all pending steps;
        valid until the next step."""
        return {name: self.column(name)[begin:end] for name in PARAMETERS}

    def finish(self) -> None:
        """Apply all pending steps and free what only further steps need; it can still be drawn."""

    def drop_moments(self) -> None:
        """Free the moments and gradients of a model that is about to be replaced."""

    def save(self) -> Columns:
        """Return all that the next step depends on but `adam_steps`; no copies.

        Names are those of checkpoints: `column_key` of a column, m1/ and m2/ before the name of a
        parameter, gathered/shN for `ShUpdate.ACCUMULATE`, and of an engine whose rows skip steps
        drift [256] float64 (factors of the pending steps of shN).
        """
        ...


class ShUpdate(Enum):
    """Update of shN in a training step."""

    STEP = auto()
    ACCUMULATE = auto()
    """Gradients accumulate for a later step."""
    OFF = auto()
    """The coefficients are not in use yet."""


@dataclass(frozen=True, kw_only=True)
class StepPhoto:
    """A photo at the size of a step."""

    image: np.ndarray
    """[H, W, 3] uint8."""
    mask: np.ndarray | None = None
    """[H, W] uint8; None: all pixels count."""
    mask_mode: str = "none"
    """Meaning of the mask: `composite` (opacity) or `ignore` (weight)."""
    tiles: np.ndarray | None = None
    """[ceil(H / 16), ceil(W / 16)] uint8, 0 for tiles that need not be drawn; None: all are."""
    counted: float = 1.0
    """Share of unmasked pixels: less than 1 only with an `ignore` mask."""
    version: int = 0
    """Another number if the mask of the photo at this size is another."""


class TermKind(Enum):
    """Loss terms of a step."""

    L1 = auto()
    """Mean absolute difference to the photo."""
    SSIM = auto()
    """1 - SSIM; its weight and that of L1 add up to 1 (Kerbl et al. 2023, eq. 7)."""
    MASK_ALPHA = auto()
    """Mean absolute difference of opacity and a `composite` mask."""
    SEE_THROUGH = auto()
    """Mean transmittance, weighted by the mask."""


class Feature(StrEnum):
    """Feature that an engine may lack, in the words of the message that refuses a training."""

    PICTURE_TERMS = "losses of depth maps and guide meshes (`--depths`, `--guide-surface`)"
    FROZEN = "frozen splats around a region (`--region`)"
    ANOMALIES = "the search for the first number that is not finite (`--detect-anomaly`)"
    MASKS = "masks (`--mask-mode none`, `--no-transient-masks`)"
    DROPOUT = "dropout of splats (`--set drop_rate=0`)"
    NOISE = "noise and regularisers of splats (`--strategy mcmc`)"
    GAINS = "exposure gains of photos (`--exposure off`)"
    POSES = "refined camera poses (`--set refine_poses=off`)"
    SURFACE = "splats on surfaces (`--surface-weight`)"
    BLUR = "blur of photos (`--no-photo-blur`)"
    CONTRIBUTIONS = "pruning by contribution (`--set prune_share=0`)"


class TermGradients(NamedTuple):
    """Value of a loss term, and its gradients in the picture."""

    value: float
    v_inverse_depth: np.ndarray | None
    """[H, W] float32; None: zero."""
    v_alpha: np.ndarray | None
    """[H, W] float32; None: zero."""


PictureTerm = Callable[[np.ndarray, np.ndarray], TermGradients]
"""Loss term computed by the trainer from inverse depth and alpha, [H, W] float32 each."""


@dataclass(frozen=True, kw_only=True)
class StepRequest:
    """A training step of one model: draw a view, compare it with its photo, update the splats.

    The order is: pending SH steps of the view, dropout, drawing, loss, check of the loss,
    gradients, screen-space gradient counts, regularisers, Adam, noise.
    """

    step: int
    """Number of the step, from 1."""
    photo: int
    """Key of the photo, see `Engine.put`."""
    view: Frustum
    others: tuple[Frustum, ...] = ()
    """Views of the same step on other ranks."""
    background: Color
    """Background colour, before the gain."""
    shown_background: Color
    """Background colour of a `composite` mask, after the gain."""
    gain: Color | None = None
    """Exposure gain of the photo (`gscore.photo_exposure`); None: 1, without gradients."""
    antialias: bool = False
    blur: Color | None = None
    """Covariance xx, xy, yy, px^2, of the Gaussian that blurs the picture before the gain
    (`raster.blur`), for which all tiles are drawn; None: none."""
    sh_degree: int
    """SH degree in use."""
    sh_update: ShUpdate
    rates: Mapping[str, float]
    """Learning rate of each parameter."""
    seed: int = 0
    """Key of the random numbers, 0 to 2^63 - 1: those of a row are Philox words of the counter
    (row, `step`, `STREAMS` * `place` + stream, 0), see `raster.reference.random_numbers`."""
    place: int = 0
    """Index of the model among those that are trained in parallel."""
    drop_rate: float = 0.0
    """Share of the splats that are not drawn: those whose block of rows, see
    `cpu.splat_terms.dropout_blocks`, has a smaller uniform number of `DROPOUT_STREAM`; the opacity
    o of the others is o / (1 - rate), at most 0.999 (Park et al. 2025)."""
    noise: float = 0.0
    """Weight of the noise that moves faint splats after Adam, by covariance @ normal numbers of
    `NOISE_STREAM` (Kheradmand et al. 2024), see `cpu.splat_terms.add_noise`; 0: none."""
    terms: tuple[tuple[TermKind, float], ...]
    """Loss terms with their weights."""
    picture_term: PictureTerm | None = None
    """A further loss term, which needs inverse depth; None: none."""
    surface: float = 0.0
    """Weight of the terms that make splats lie on surfaces, see `cpu.surface_term`; 0: none."""
    opacity_reg: float = 0.0
    """Weight of the mean opacity in the loss."""
    scale_reg: float = 0.0
    """Weight of the mean scale in the loss."""
    observe: tuple[str, ...] = ()
    """Counters of screen-space gradient sums (2 units per side), and of views; empty: none."""
    learn_gain: bool = False
    """The gradient in the gain is needed."""
    learn_pose: bool = False
    """The gradient in the camera pose is needed."""
    update_hidden: bool = False
    """True: splats that the view does not show take an Adam step too."""
    extent: float
    """Camera extent, training units, for `clamp_runaways` after an absurd loss."""
    disable: frozenset[Skip] = frozenset()
    """Those of `ENGINE_SKIPS` that are disabled, for tests and benchmarks."""
    check_finite: str = ""
    """Name of the view: raise an error at the first number that is not finite; empty: skip it."""
    compare: bool = False
    """Compare the model between ranks."""

    def tiles_of(self, photo: StepPhoto) -> np.ndarray | None:
        """Return which tiles to draw: those of `photo`; None, all, if a blur reaches beyond."""
        return photo.tiles if self.blur is None else None


class StepNumbers(NamedTuple):
    """Result of a step."""

    step: int
    """`StepRequest.step`."""
    loss: float
    mse: float
    """Mean squared error of the unmasked pixels, before the step."""
    slopes: np.ndarray = np.zeros((1, 19))
    """[P, 19] float64, per photo of the step: derivatives of the loss in ln gain of R, G, B, and in
    the 16 entries of the pose matrix; zeros where not requested."""
    bad_rows: int = 0
    """Splats with gradients that were not finite, which were ignored."""
    lost_rows: int = 0
    """Runaway splats that were reset."""
    skipped: bool = False
    """True: the update was skipped, because the loss was not finite or came from runaways."""
    seconds: Mapping[str, float] = MappingProxyType({})
    """Seconds by stage, in their order."""
    raster: Mapping[str, float] = MappingProxyType({})
    """Counts and milliseconds of the rasterizer (gs_stats)."""
    costs: tuple[float, ...] = ()
    """Rendering cost of each photo of the step, any unit; empty: one photo."""

    def result(self) -> "StepNumbers":
        """Return itself: a step that is done is its own `Pending`."""
        return self


@dataclass(frozen=True, kw_only=True)
class CostModel:
    """Seconds of a step on the machine for which `Engine.pace` is 1."""

    step: float
    """Per step and model."""
    pixel: float
    """Per drawn pixel."""
    splat: float
    """Per splat of a model."""
    number: float
    """Per number of a splat."""
    trust: float = 0.5
    """Weight of this model against measured steps, planned seconds: small, because steps soon
    replace it."""

    def seconds(self, splats: float, sh_degree: int, pixels: float, models: int = 1) -> float:
        """Seconds of a step.

        Args:
            splats: Number of splats of all models.
            sh_degree: SH degree in use.
            pixels: Drawn pixels of a model.
            models: Number of models.
        """
        numbers = 11 + 3 * (1 + SH_REST_BY_DEGREE[sh_degree])
        a_splat = self.splat + self.number * numbers
        return models * (self.step + self.pixel * pixels) + a_splat * splats


@dataclass(frozen=True, kw_only=True)
class EngineInfo:
    """Identity and capabilities of an engine; the trainer refuses by name what it lacks."""

    name: str
    """Name of the engine, for messages."""
    numerics: str
    """Identity of its arithmetic: equal for two engines that give the same bits; the instruction
    set of the CPU engine."""
    threads: int = 0
    """CPU threads of its kernels; 0: none."""
    is_card: bool = False
    """Whether it computes on a graphics card."""
    terms: frozenset[TermKind] = frozenset(TermKind)
    """Loss terms that it computes."""
    features: frozenset[Feature] = frozenset()
    """Features that it has; options that need others are refused."""
    skips: frozenset[Skip] = frozenset()
    """Those of `ENGINE_SKIPS` that it can disable."""
    memory: int = 0
    """Bytes of its own memory that a training may take; 0: it uses that of the process."""
    cost: CostModel


class Pending(Protocol):
    """A step that may still be running."""

    def result(self) -> StepNumbers:
        """Wait for the step and return its numbers; errors of the step are raised here."""
        ...


class DrawnPicture(NamedTuple):
    """A drawn view; valid until the engine's next call."""

    rgb: np.ndarray
    """[H, W, 3] float32, may be changed."""
    alpha: np.ndarray
    """[H, W] float32."""
    inverse_depth: np.ndarray | None = None
    """[H, W] float32, sum of weight / z, 1/training unit; None: not requested."""


class Contribution(NamedTuple):
    """Blending weights of the splats in one view, summed over pixels, px."""

    kept: np.ndarray
    """[N] float32: weighted by an `ignore` mask."""
    whole: np.ndarray
    """[N] float32."""


Model = TypeVar("Model", bound=EngineModel)


class Engine(Protocol[Model]):
    """A device with models of one type in training. Methods with a body are for engines that
    derive from this class."""

    in_flight: int = 0
    """Steps that may be requested before the result of the first is read."""
    info: EngineInfo
    """Identity and capabilities."""
    measured_pace: float = 1.0
    """Time of a step relative to `EngineInfo.cost`, where it was measured before."""

    def pace(self) -> float:
        """Measure the time of a step relative to `EngineInfo.cost` under the current load, within a
        tenth of a second, or return `measured_pace`; 1: the first steps will show it."""
        return self.measured_pace

    def model(
        self, columns: Columns, *, counters: Sequence[str] = (), frozen: Columns | None = None
    ) -> Model:
        """Create a model.

        Args:
            columns: Raw parameters, as in `Splats`.
            counters: Names of float32 counters, which start at 0.
            frozen: Raw parameters of splats that are drawn with the model but never change; its
                SH degree may be lower. One model per engine may have them.
        """
        ...

    def load(self, saved: Columns, adam_steps: Mapping[str, int], like: Model) -> Model:
        """Create a model from `EngineModel.save`, with the frozen splats of `like`; takes ownership
        of the arrays."""
        ...

    def put(self, key: int, photo: StepPhoto) -> None:
        """Provide a photo for the next step that names it; one key, size and version have one
        content."""
        ...

    def step(self, model: Model, request: StepRequest) -> Pending:
        """Start a step."""
        ...

    def draw(
        self,
        models: Sequence[Model],
        view: Frustum,
        *,
        background: Color,
        antialias: bool,
        inverse_depth: bool = False,
        scaling: float = 1.0,
    ) -> DrawnPicture:
        """Draw the current models, by `merge_models` if several; changes no bit of the training.

        `scaling`: factor of all standard deviations.
        """
        ...

    def contributions(
        self, model: Model, views: Iterable[tuple[Frustum, StepPhoto]], *, antialias: bool
    ) -> Iterable[Contribution]:
        """Yield the contributions of a model's splats to each view, between two steps."""
        ...

    def pose_gradient(
        self,
        models: Sequence[Model],
        view: Frustum,
        photo: StepPhoto,
        *,
        background: Color,
        antialias: bool,
    ) -> np.ndarray:
        """Return the gradient of a view's photometric loss in its pose, [4, 4] float32."""
        ...

    def verify(self) -> None:
        """Repeat a small training, between two steps; BackendError if its result is not that of the
        first call."""

    def use_share(self, share: float) -> None:
        """Leave the device to other programs for the rest of the time, in pauses after short
        submissions; changes no bit. Nothing on the CPU, which the system shares.

        Args:
            share: Share of the time of the following steps, above 0, at most 1.
        """

    def shorten_submissions(self) -> None:
        """Use submissions short enough for the device to draw a window in between, from now on;
        changes no bit. Nothing on the CPU."""

    def keep_photos(self, room: int) -> None:
        """Let photos stay in the engine's own memory, up to `room` bytes of them."""

    def peak_memory(self) -> int:
        """Most bytes of its own memory in use so far; 0: it uses that of the process."""
        return 0

    def release(self) -> None:
        """Free the memory of steps, which the next one allocates again."""

    def close(self) -> None:
        """Free the device; nothing is called afterwards. Calls after the first do nothing."""
