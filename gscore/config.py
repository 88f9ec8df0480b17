"""Options of a run as frozen dataclasses: the same objects behind command line, JSON and add-on."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from .errors import ConfigError

_MOST_THREADS = 1024
"""Most that the library takes."""
_LARGEST = 1e9
"""Of every number that is no count: products of several must not leave float32."""
_LARGEST_SEED = 2**63 - 1
"""Of generators of torch."""
_RAREST = 1000
"""Steps between two steps of the higher colour coefficients, whose rate grows by the root."""


def checked_threads(threads: int) -> int:
    """`threads` if so many may be asked for, 0: all cores; ConfigError otherwise."""
    if not isinstance(threads, int) or not 0 <= threads <= _MOST_THREADS:
        raise ConfigError(f"threads must be 0 (all cores) to {_MOST_THREADS}, got {threads}.")
    return threads


@dataclass(frozen=True, kw_only=True)
class DataConfig:
    """What to read of a capture and how to divide it."""

    source: Path
    """Folder with the COLMAP model or transforms.json."""
    images: str = "images"
    """Folder of the photos, relative to `source`; not used by transforms.json, which names them."""
    masks: str = ""
    """Folder of masks relative to `source`; empty: `masks/` where it exists, or the photos'
    alpha."""
    mask_mode: str = "auto"
    """`composite`: the mask is opacity, photos lie over the background; `ignore`: masked-out
    pixels do not count;
    `none`: masks are not read; `auto`: composite for photos with alpha and for masks
    that cut out a subject, ignore for masks that hide parts of a scene."""
    invert_masks: bool = False
    """Mask files are white where pixels do not count, instead of black; `auto` is `ignore` then.
    The photos' own alpha is never inverted."""
    depths: str = ""
    """Folder of inverse depth maps relative to `source`; empty: depth is not used."""
    depth_align: str = "auto"
    """How the maps get the scale of the capture. `official`: as depth_params.json says, which must
    be there, as for the 3DGS trainer; `robust`: RANSAC against the SfM points; `none`: they have it
    already; `auto`: as depth_params.json says where it is there and the points agree, else
    `robust`."""
    resolution: float = -1
    """-1: as is, but at most `max_width` wide; 1, 2, 4, 8: divided by that; larger: this many
    pixels wide."""
    max_width: int = 1600
    """With `resolution` -1: photos wider than this are scaled down to it, pixels. Presets lower
    it."""
    eval: bool = False
    """Hold test views out of the training."""
    test_every: int = 8
    """Every n-th view by sorted name is a test view, unless the capture states its own split."""
    test_offset: int | None = None
    """Of each `test_every` views the one at this place, from 0, is the test view, whatever split
    the capture states; None: the first one, and the capture's own split counts."""
    test_list: Path | None = None
    """Text file with the names of the test views, one a line; wins over the other rules."""
    test_last: int = 0
    """The last n views by sorted name are test views; 0: use `test_every`."""
    test_first: int = 0
    """The first n views by sorted name are test views; 0: use `test_every`."""
    frame: int | None = None
    """Of a multi-view video (PKU-DyMVHumans): number of the frame; None: the first one."""
    rig: Path | None = None
    """Another capture by the same cameras: they stand where that one says, in its world."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "source", Path(self.source))  # scripts pass strings


class Strategy(StrEnum):
    """How the number of splats changes during training."""

    DEFAULT = "default"
    """Clone, split, prune and reset by gradient: adaptive density control (Kerbl et al. 2023)."""
    MCMC = "mcmc"
    """Relocate dead splats, grow by 5 % up to the cap, add noise (Kheradmand et al. 2024)."""


class Background(StrEnum):
    """What lies behind the splats during training."""

    AUTO = "auto"
    """Another colour at each step for photos with opacity, black for all others."""
    BLACK = "black"
    WHITE = "white"
    RANDOM = "random"
    """Another colour at each step."""


class Switch(StrEnum):
    """Whether to do what not every capture has a use for."""

    AUTO = "auto"
    """Where the capture gives a reason to; a line says so."""
    ON = "on"
    OFF = "off"


class Skip(StrEnum):
    """Work that a training leaves out because the scene has no use for it. Each can be switched
    off (`TrainConfig.without`) to prove or to measure what it brings; `gscore bench skips`
    does. All but the last three leave every bit of the result as it is."""

    EXACT_CULL = "exact-cull"
    """Tiles and rows inside a splat's box that its ellipse does not reach."""
    OPACITY_EXTENT = "opacity-extent"
    """The rim that an opaque splat of the same shape would reach, but this one does not."""
    ROW_RANGE = "row-range"
    """Rows of a tile that the ellipse does not reach."""
    ZERO_TILE = "zero-tile"
    """The backward pass of tiles without an image gradient."""
    MASKED_TILE = "masked-tile"
    """Tiles that an `ignore` mask hides whole."""
    SH_BANDS = "sh-bands"
    """Storage and optimizer steps of SH degrees that are not in use yet."""
    UNSEEN_SH = "unseen-sh"
    """Optimizer steps of the higher SH coefficients of splats that a view does not show: made up
    for later, equal but for rounding."""
    RARE_SH = "rare-sh"
    """Optimizer steps of the higher SH coefficients: one for the gradients of several views, see
    `TrainConfig.shN_every`; another training, as good."""
    SMALL_PHOTOS = "small-photos"
    """Pixels of the first steps: photos start small, see `TrainConfig.coarse_factor`."""


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """How to train. A 0 that means "by itself" says so; `trainer.schedule.plan.Plan` holds what it
    became.

    Lengths are in units of the camera extent: 1.1 times the largest distance of a camera from
    their mean.
    """

    iterations: int = 10_000
    """Optimizer steps, one view each; with `time_budget` not used."""
    time_budget: float = 0.0
    """Seconds of training, without reading photos, measuring and writing; the number of steps and
    all schedules are fitted to it while training. 0: `iterations` steps. Such a run cannot be
    repeated bit by bit."""
    target_psnr: float = 0.0
    """The run ends when the held-out views (the training views, where none are held out) reach this
    mean PSNR, dB; 0: no target."""
    early_stop: bool = False
    """End when photos are at full size and the PSNR of those views no longer rises, after a short
    end phase in which learning rates take the rest of their course."""
    max_splats: int = 400_000
    """Never more splats than this."""
    strategy: Strategy = Strategy.DEFAULT
    """How the number of splats changes."""
    sh_degree: int = 3
    """Highest degree of the view-dependent colour, 0 to 3."""
    sh_every: int = 0
    """Steps between two SH degrees; 0: 1000, or fewer so that all are in use by half of the run."""
    seed: int = 0
    """Same seed, capture and options: same splats, bit for bit, with any number of threads."""
    threads: int = 0
    """CPU threads; 0: one per core this process may use."""
    background: Background = Background.AUTO
    """What lies behind the splats."""
    antialias: bool = False
    """Opacity compensation for the widening of small splats (Yu et al. 2024)."""
    near: float = 0.01
    """Splats nearer to a camera than this are not drawn; world units, as in `gscore.render`."""

    ssim_weight: float = 0.2
    """Loss = (1 - w) L1 + w (1 - SSIM)."""
    means_lr: float = 1.6e-4
    """Learning rate of positions at the first step, in extents."""
    means_lr_final: float = 1.6e-6
    """Learning rate of positions at the last step, in extents; exponential in between."""
    sh0_lr: float = 2.5e-3
    """Learning rate of the constant colour."""
    shN_lr: float = 1.25e-4
    """Learning rate of the view-dependent colour."""
    shN_every: int = 0
    """Steps between two of the view-dependent colour, whose gradients add up in between and whose
    learning rate rises by the root of this; 0: 8, fewer in runs under 1,000 steps; 1: each step."""
    opacities_lr: float = 0.0
    """Learning rate of logit opacities; 0: 0.025, with mcmc 0.05."""
    scales_lr: float = 5e-3
    """Learning rate of log scales."""
    quats_lr: float = 1e-3
    """Learning rate of quaternions."""
    lr_boost: float = 0.0
    """Learning rates are multiplied by this, those of positions and opacities by its root, and the
    last one of positions by its square; 0: 1 for 30,000 steps and more, up to 4 in short runs."""
    lr_final: float = 0.2
    """What is left of the learning rates, those of positions apart, at the last step: they fall
    exponentially over the last tenth of the run. 1: they stay as they are."""
    start_splats: Path | None = None
    """PLY to start from instead of the capture's points, in the capture's world."""
    start_opacity: float = 1.0
    """Opacities of `start_splats` are multiplied by this; those that photos ask for come back."""
    init_opacity: float = 0.0
    """Opacity of the first splats; 0: 0.1, with mcmc 0.5."""
    init_scale: float = 0.0
    """Size of the first splats in mean distances to their neighbours; 0: 1, with mcmc 0.1."""

    depth_mode: Switch = Switch.AUTO
    """Supervise inverse depth where `DataConfig.depths` gives maps; auto: not in dense captures."""
    depth_weight: float = -1.0
    """Weight of the depth loss at the first step, see `trainer.depth.loss` for its unit; -1: 1, and
    where more than 6 training views show a median point, 6 / their number."""
    depth_weight_final: float = -1.0
    """Weight of the depth loss at the last step, exponential in between; -1: that of the first."""
    depth_warmup: float = 0.02
    """Share of the run over which the depth loss fades in, from 0 to its full weight."""
    depth_pearson: float = 0.5
    """Weight of 1 - correlation for views whose map could not be aligned, as a share of
    `depth_weight`; 0: such views get no depth loss."""
    depth_points: int = -1
    """Points added at the start from aligned maps where SfM left holes, at most; -1: 10,000 where
    depth supervises, and a fifth of `max_splats`; 0: none."""
    drop_rate: float = 0.0
    """Share of splats left out of a step at random, rising from 0 to this at the last step (Park et
    al. 2025, DropGaussian), against overfitting to few views; 0: none."""
    alpha_weight: float = 0.0
    """Weight of the mean absolute difference between rendered opacity and mask, where masks are
    opacity (`composite`); 0: none."""

    coarse_factor: float = 0.0
    """Sides of the photos are divided by this at the first steps, and by less and less until
    `coarse_until`; 0: up to 8, so that 75 pixels are left, or 1 with `start_splats`; 1: full size
    from the first step."""
    coarse_until: float = 0.9
    """Share of the run after which photos are used at full size."""

    coarse_by_detail: bool = False
    """Photos stay at each size in proportion to the detail that it adds, which their frequencies
    tell; soft photos train faster. Else the number of pixels rises with the square of the step."""

    grow_with_photos: bool = True
    """`default`: the largest number of splats rises with the sides of the photos, from the number
    at the start to `max_splats` at full size, so that small photos do not grow what only large ones
    show; in runs of 1,000 steps and more whose photos start at less than about 0.4 of their sides.
    `mcmc` gains nothing by it."""

    without: tuple[Skip, ...] = ()
    """Skips that are switched off."""

    refine_start: int = 0
    """First step at which splats may be added or removed; 0: 500, sooner in short runs."""
    refine_stop: int = 0
    """Last such step; 0: half of the run, with `grow_with_photos` four fifths or a little after
    photos are at full size, with mcmc five sixths."""
    refine_every: int = 0
    """Steps between two refinements; 0: 100, fewer in short runs."""
    reset_every: int = 0
    """`default`: steps between two opacity resets, up to `refine_stop` or, where that is 0, half of
    the run; 0: 3,000, none in runs under 6,000 steps; -1: never."""
    grow_grad: float = 0.0
    """`default`: mean positional gradient in normalised image coordinates above which a splat is
    doubled; 0: 2e-4, down to 1e-4 in short runs."""
    grow_scale: float = 0.01
    """`default`: larger splats are split, smaller ones cloned; in extents."""
    prune_opacity: float = 0.005
    """Splats with a lower opacity are removed, with mcmc relocated."""
    prune_scale: float = 0.1
    """`default`: larger splats are removed after the first opacity reset; in extents."""
    prune_share: float = 0.0
    """Share of the splats that is removed when refinements are over (`refine_stop`): those that add
    least to any training photo. 0: none."""
    free_space: float = 0.4
    """Splats nearer to a training camera than this share of its distance from the tenth nearest
    SfM point are taken out at every `refine_every`-th step and at the last: they hide the scene
    from views between the photos. Captures of fewer than 500 points, or with more than a fifth of
    the splats there, are left as they are. 0: splats may stand anywhere."""
    hidden_share: float = 0.05
    """Where masks hide parts of a scene (`ignore`): splats of whose weight in the training photos
    less than this share stands where masks show it are taken out, a third and two thirds through
    the training. No photo says what these should look like, and they veil other views. 0: they
    stay."""
    mcmc_growth: float = 0.0
    """`mcmc`: splats added at each refinement, as a share of those there; 0: 0.05, more in runs
    that would not reach `max_splats` otherwise."""
    mcmc_noise: float = 5e5
    """`mcmc`: noise on positions, in units of their learning rate."""
    opacity_reg: float = 0.01
    """`mcmc`: weight of the mean opacity in the loss."""
    scale_reg: float = 0.01
    """`mcmc`: weight of the mean scale in the loss."""
    reg_final: float = 1.0
    """`mcmc`: what is left of `opacity_reg` and `scale_reg` at `refine_stop` and after it, as a
    share; they fall evenly. 1: all, 0: nothing."""

    test_iterations: tuple[int, ...] = ()
    """Steps after which the test views are measured; the end of a run always is."""
    save_iterations: tuple[int, ...] = ()
    """Steps after which the splats are written to `point_cloud/iteration_N/`; the end always is."""
    checkpoint_iterations: tuple[int, ...] = ()
    """Steps after which a checkpoint is written that is never cleaned up."""
    cache_mb: int = 0
    """Megabytes of decoded photos to keep in memory; the others are decoded again when their turn
    comes. 0: all, or as many as fit. The result is the same."""
    checkpoint_seconds: float = 300.0
    """Seconds of training between two checkpoints, of which the last two are kept, and at most two
    more that the watchdog may go back to; 0: only at the end."""
    preview_seconds: float = 0.0
    """Seconds between two pictures of one view; 0: none."""
    snapshot_every: int = 0
    """Steps between two PLY snapshots; 0: only on request."""
    lpips: Path | None = None
    """ONNX file of the LPIPS network; without it LPIPS is not measured."""
    watchdog: bool = True
    """Where a run diverges, go back to the last good checkpoint and on with lower learning rates,
    a few times; without periodic checkpoints (`checkpoint_seconds` 0) end with an error."""
    detect_anomaly: bool = False
    """Stop with an error at the first number that is not finite, and say where it came from;
    slow."""

    def __post_init__(self) -> None:
        _at_least(self, 1, "iterations", "max_splats")
        _at_least(
            self,
            0,
            "sh_every",
            "shN_every",
            "threads",
            "refine_start",
            "refine_stop",
            "refine_every",
        )
        _at_least(self, 0, "snapshot_every", "seed", "cache_mb")
        _at_least(self, -1, "reset_every")
        _at_least(
            self, 0.0, "near", "means_lr", "means_lr_final", "sh0_lr", "shN_lr", "opacities_lr"
        )
        _at_least(
            self, 0.0, "scales_lr", "quats_lr", "lr_boost", "init_scale", "grow_grad", "grow_scale"
        )
        _at_least(self, 0.0, "prune_scale", "mcmc_growth", "mcmc_noise", "opacity_reg", "scale_reg")
        _at_least(self, 0.0, "checkpoint_seconds", "preview_seconds", "time_budget", "target_psnr")
        _at_least(self, 0.0, "depth_pearson", "alpha_weight")
        for name in ("depth_weight", "depth_weight_final"):
            if not 0 <= getattr(self, name) <= _LARGEST and getattr(self, name) != -1:
                raise ConfigError(
                    f"{name} must be 0 to {_LARGEST:g}, or -1 for what suits, got "
                    f"{getattr(self, name)}."
                )
        for name, most in (
            ("threads", _MOST_THREADS),
            ("seed", _LARGEST_SEED),
            ("shN_every", _RAREST),
        ):
            if getattr(self, name) > most:
                raise ConfigError(f"{name} must be at most {most}, got {getattr(self, name)}.")
        _at_least(self, -1, "depth_points")
        if self.coarse_factor != 0:
            _at_least(self, 1.0, "coarse_factor")
        for name in ("coarse_until", "depth_warmup", "reg_final"):
            if not 0 <= getattr(self, name) <= 1:
                raise ConfigError(f"{name} must lie in [0, 1], got {getattr(self, name)}.")
        for name in ("drop_rate", "prune_share", "free_space", "hidden_share"):
            if not 0 <= getattr(self, name) < 1:
                raise ConfigError(f"{name} must lie in [0, 1), got {getattr(self, name)}.")
        for name in ("ssim_weight", "init_opacity", "prune_opacity"):
            value = getattr(self, name)
            if not 0 <= value <= (1 if name == "ssim_weight" else 0.99):
                raise ConfigError(f"{name} must lie in [0, 1) (ssim_weight up to 1), got {value}.")
        for name in ("start_opacity", "lr_final"):
            if not 0 < getattr(self, name) <= 1:
                raise ConfigError(f"{name} must lie in (0, 1], got {getattr(self, name)}.")
        if self.sh_degree not in range(4):
            raise ConfigError(f"sh_degree must be 0, 1, 2 or 3, got {self.sh_degree}.")
        for name in ("test_iterations", "save_iterations", "checkpoint_iterations"):
            if any(step < 1 for step in getattr(self, name)):
                raise ConfigError(f"{name} must be steps from 1 on, got {getattr(self, name)}.")


def preview(source: Path) -> tuple[DataConfig, TrainConfig]:
    """A first look, in about a quarter of a minute on two cores."""
    train = TrainConfig(iterations=1500, max_splats=50_000, sh_degree=1)
    return DataConfig(source=source, max_width=400), train


def draft(source: Path) -> tuple[DataConfig, TrainConfig]:
    """Good enough to judge a capture, in about a minute and a quarter on two cores."""
    train = TrainConfig(iterations=4000, max_splats=150_000, sh_degree=2)
    return DataConfig(source=source, max_width=640), train


def normal(source: Path) -> tuple[DataConfig, TrainConfig]:
    """The everyday choice, in about five minutes on two cores."""
    train = TrainConfig(iterations=7000, max_splats=300_000)
    return DataConfig(source=source, max_width=1000), train


def high(source: Path) -> tuple[DataConfig, TrainConfig]:
    """Everything the method gives, ten minutes to half an hour on two cores."""
    train = TrainConfig(iterations=15_000, max_splats=600_000)
    return DataConfig(source=source, max_width=1600), train


PRESETS: dict[str, Callable[[Path], tuple[DataConfig, TrainConfig]]] = {
    f.__name__: f for f in (preview, draft, normal, high)
}


def flag_of(name: str) -> str:
    """How the command line calls an option."""
    return {"resolution": "-r"}.get(name, "--" + name.replace("_", "-"))


def _at_least(config: TrainConfig, low: float, *names: str) -> None:
    for name in names:
        value = getattr(config, name)
        if not low <= value:
            raise ConfigError(f"{name} must be at least {low:g}, got {value}.")
        # Integers may be as large as they like: a step that never comes is one.
        if isinstance(value, float) and value > _LARGEST:
            raise ConfigError(f"{name} must be {low:g} to {_LARGEST:g}, got {value}.")
