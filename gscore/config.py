"""Options of a run as frozen dataclasses: the same objects behind command line, JSON and add-on."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from .choices import Background, Doubling, Skip, Stereo, Strategy, Switch
from .errors import ConfigError
from .options import LARGEST, Range, check_options, option
from .quoting import quoted

_MOST_THREADS = 1024
"""Most that the library takes."""
_MOST = 10**9
"""Steps and splats. Far beyond what machines do; forecasts walk through all refinements of a run,
and much larger numbers are no floats."""
_LARGEST_SEED = 2**63 - 1
"""Of generators of torch."""
_RAREST = 1000
"""Steps between two steps of the higher colour coefficients, whose rate grows by the root."""
_MASK_MODES = ("auto", "composite", "ignore", "none")
_DEPTH_ALIGNMENTS = ("auto", "official", "robust", "none")


def checked_threads(threads: int) -> int:
    """`threads` if so many may be asked for, 0: all cores; ConfigError otherwise."""
    if not isinstance(threads, int) or not 0 <= threads <= _MOST_THREADS:
        raise ConfigError(
            f"threads must be 0 (all cores) to {_MOST_THREADS}, got {quoted(threads)}."
        )
    return threads


@dataclass(frozen=True, kw_only=True)
class DataConfig:
    """What to read of a capture and how to divide it."""

    source: Path
    """Folder with the COLMAP model or transforms.json."""
    images: str = option(
        "images",
        "Folder of the photos inside the capture. Not used by transforms.json, which names them.",
        group="capture",
        metavar="DIR",
        short="i",
        basic=True,
    )
    masks: str = option(
        "",
        "Folder of masks inside the capture. Empty: `masks/` where it exists, or the photos' "
        "alpha.",
        group="capture",
        metavar="DIR",
        basic=True,
        when="masks",
    )
    mask_mode: str = option(
        "auto",
        "What masks mean: `ignore`: pixels where the mask is black do not count; `composite`: "
        "the mask is the opacity of the subject, photos lie over the background, and nothing "
        "else is trained; `none`: masks are not read; `auto`: `composite` for photos with "
        "transparency and masks that cut out a subject, else `ignore`.",
        group="capture",
        choices=_MASK_MODES,
        basic=True,
    )
    invert_masks: bool = option(
        False,
        "Mask files are white where pixels do not count, instead of black. `auto` is `ignore` "
        "then. The photos' own alpha is never inverted.",
        group="capture",
        basic=True,
        when="masks",
    )
    depths: str = option(
        "",
        "Folder of depth maps inside the capture; gscore depth makes and checks them. Inverse "
        "depth; empty: depth is not used.",
        group="depth",
        metavar="DIR",
        short="d",
        basic=True,
        when="depth_on",
    )
    depth_align: str = option(
        "auto",
        "How depth maps get the scale of the capture: `official`: as depth_params.json says, "
        "which must be there, as for the 3DGS trainer; `robust`: by RANSAC against the points "
        "that COLMAP found; `none`: they have it already; `auto`: as depth_params.json says "
        "where it is there and agrees with the points, else `robust`.",
        group="depth",
        choices=_DEPTH_ALIGNMENTS,
        when="depth",
    )
    resolution: float = option(
        -1,
        "Size of the photos: 1, 2, 4, 8 divide it; a larger number is the width in pixels; -1: "
        "as they are, at most as wide as the preset or the run says, else 1600.",
        group="capture",
        range=None,  # `datasets.resolution` checks it
        metavar="N",
        short="r",
        basic=True,
    )
    max_width: int = 1600
    """With `resolution` -1: photos wider than this are scaled down to it, pixels. Presets lower
    it; no option of the command line gives it."""
    eval: bool = option(
        False,
        "Hold test views out of the training and measure on them. Every 8th, unless `hold_out` or "
        "the capture says which.",
        group="capture",
        basic=True,
    )
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
    frame: int | None = option(
        None,
        "Of a multi-view video: number of the frame to read; without it the first one.",
        group="capture",
        metavar="N",
        basic=True,
    )
    rig: Path | None = option(
        None,
        "Another capture by the same cameras, which stand where that one says, in its world.",
        group="capture",
        metavar="DIR",
        basic=True,
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "source", Path(self.source))  # scripts pass strings
        check_options(self)


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """How to train. A 0 that means "by itself" says so; `trainer.schedule.plan.Plan` holds what it
    became.

    Lengths are in units of the camera extent: 1.1 times the largest distance of a camera from
    their mean.
    """

    iterations: int = option(
        10_000,
        "Training steps, each of one photo for each of the models (`ensemble`). With "
        "`time_budget` not used.",
        group="run",
        range=Range(low=1, high=_MOST),
        unit="steps",
        metavar="N",
        basic=True,
        free=True,
    )
    time_budget: float = option(
        0.0,
        "As many steps as fit into so much training time, instead of `iterations`; 0: no "
        "budget. Reading photos, measuring and writing come on top; all schedules are fitted to "
        "the time while training. Such a run cannot be repeated bit by bit.",
        group="run",
        unit="s",
        metavar="SECONDS",
        basic=True,
        free=True,
    )
    target_psnr: float = option(
        0.0,
        "End when the held-out photos (else the others) are matched with this mean PSNR, a "
        "likeness of which more is better; 0: none.",
        group="run",
        unit="dB",
        metavar="DB",
        basic=True,
        free=True,
    )
    early_stop: bool = option(
        False,
        "End when the PSNR of the held-out photos (else the others) no longer rises. Photos "
        "are at full size then, and a short end phase follows in which learning rates "
        "take the rest of their course.",
        group="run",
        basic=True,
        free=True,
    )
    steps_a_photo: int = option(
        0,
        "Never more steps than this for each training photo: more fit the photos, and no new view "
        "gains; twice as many where masks are opacity, unless splats are left out. 1,500 are "
        "always taken, and all of them under `time_budget`, where `--iterations` is given by "
        "itself, or in `gscore sequence`; 0: no limit, which Python has to say beside "
        "`iterations`.",
        group="run",
        range=Range(high=_MOST),
        unit="steps",
        metavar="N",
        free=True,
    )
    splats_a_photo: int = option(
        0,
        "Never more splats than this for each training photo, of each model where `ensemble` "
        "trains several: more fit the photos, and no new view gains. 300,000 are always allowed, "
        "and as many as `max_splats` where masks are opacity, "
        "where `--max-splats` is given by itself, or in `gscore sequence`; 0: no limit, which "
        "Python has to say beside `max_splats`.",
        group="run",
        range=Range(high=_MOST),
        unit="splats",
        metavar="N",
        free=True,
    )
    max_splats: int = option(
        400_000,
        "Never more splats than this; memory and time grow with it.",
        group="run",
        range=Range(low=1, high=_MOST),
        unit="splats",
        metavar="N",
        basic=True,
    )
    ensemble: int = option(
        1,
        "Models that are trained side by side, each with its share of max_splats, and shown as "
        "one: what each of them makes up between the photos differs, and fades, and so does some "
        "of the finest detail. Each takes all steps, so that two take about 1.4 times as long as "
        "one. Later frames of a sequence go on as one.",
        group="run",
        range=Range(low=1, high=8),
        unit="models",
        when="one_model",
    )
    ensemble_below: float = option(
        0.0,
        "There is more than one model only where stereo, asked for points, finds the depth of less "
        "than this share of the pixels: where photos agree in more, one model with all splats "
        "shows finer detail. Where masks are opacity there are several where it finds three "
        "quarters of the pixels that these leave and more, and splats are left out (`drop_rate`). "
        "0: always, as where `--ensemble` is given by itself.",
        group="run",
        range=Range(high=1),
        when="ensemble",
    )
    strategy: Strategy = option(
        Strategy.DEFAULT,
        "How splats are added and removed; `mcmc`, Markov chain Monte Carlo, moves useless ones "
        "instead: for long runs, in a few hundred steps it is far behind.",
        group="run",
        basic=True,
    )
    sh_degree: int = option(
        3,
        "Degree of view-dependent colour, 0 to 3; 0: matt.",
        group="run",
        range=Range(high=3),
        metavar="N",
        basic=True,
    )
    sh_every: int = option(
        0,
        "Steps between two SH degrees; 0: 1000, or fewer so that all are in use by half of the "
        "run.",
        group="colour",
        range=Range(),
        unit="steps",
        when="bands",
    )
    seed: int = option(
        0,
        "Same seed, same result, bit for bit. For the same capture and options, with any number "
        "of threads.",
        group="run",
        range=Range(high=_LARGEST_SEED),
        metavar="N",
        basic=True,
    )
    threads: int = option(
        0,
        "CPU threads; 0: one per core that this process may use.",
        group="run",
        range=Range(high=_MOST_THREADS),
        metavar="N",
        basic=True,
        free=True,
    )
    background: Background = option(
        Background.AUTO,
        "What lies behind the splats. `auto`: another colour at each step for photos with "
        "opacity, black for all others.",
        group="run",
        basic=True,
    )
    antialias: bool = option(
        False,
        "Draw splats below the size of a pixel fainter. Opacity compensation for the widening "
        "of small splats (Yu et al. 2024).",
        group="run",
        basic=True,
    )
    near: float = option(
        0.01,
        "Splats nearer to a camera than this are not drawn; world units, as in `gscore.render`.",
        group="run",
        unit="world units",
    )
    ssim_weight: float = option(
        0.2,
        "Loss = (1 - w) L1 + w (1 - SSIM).",
        group="loss",
        range=Range(high=1),
    )
    means_lr: float = option(
        1.6e-4,
        "Learning rate of positions at the first step, in extents.",
        group="learning rates",
        unit="extents",
    )
    means_lr_final: float = option(
        1.6e-6,
        "Learning rate of positions at the last step, in extents; exponential in between.",
        group="learning rates",
        unit="extents",
    )
    sh0_lr: float = option(
        2.5e-3,
        "Learning rate of the constant colour.",
        group="learning rates",
    )
    shN_lr: float = option(
        1.25e-4,
        "Learning rate of the view-dependent colour.",
        group="learning rates",
        when="bands",
    )
    shN_every: int = option(
        0,
        "Steps between two of the view-dependent colour, whose gradients add up in between and "
        "whose learning rate rises by the root of this; 0: 8, fewer in runs under 1,000 steps; "
        "1: each step.",
        group="learning rates",
        range=Range(high=_RAREST),
        unit="steps",
        when="bands",
    )
    opacities_lr: float = option(
        0.0,
        "Learning rate of logit opacities; 0: 0.025, with mcmc 0.05.",
        group="learning rates",
    )
    scales_lr: float = option(
        5e-3,
        "Learning rate of log scales.",
        group="learning rates",
    )
    quats_lr: float = option(
        1e-3,
        "Learning rate of quaternions.",
        group="learning rates",
    )
    lr_boost: float = option(
        0.0,
        "Learning rates are multiplied by this, those of positions and opacities by its root, "
        "and the last one of positions by its square; 0: 1 for 30,000 steps and more, up to 4 "
        "in short runs.",
        group="learning rates",
    )
    lr_final: float = option(
        0.2,
        "What is left of the learning rates, those of positions apart, at the last step: they "
        "fall exponentially over the last tenth of the run. 1: they stay as they are.",
        group="learning rates",
        range=Range(high=1, above=True),
    )
    start_splats: Path | None = option(
        None,
        "Start from these splats, a PLY in the capture's world, instead of its points.",
        group="start",
        metavar="FILE.ply",
        basic=True,
        free=True,
    )
    start_opacity: float = option(
        1.0,
        "Opacities of `start_splats` are multiplied by this; those that photos ask for come back.",
        group="start",
        range=Range(high=1, above=True),
        when="start_splats",
    )
    region: Path | None = option(
        None,
        "Train what lies in the box of this file. Of `start_splats` those in it are trained; all "
        "others stand still, are drawn, and come out bit for bit as they were. Without them only "
        "pixels that look at the box count. Photos that do not see it are left out; docs/steer.md "
        "has the file.",
        group="start",
        metavar="FILE.json",
        free=True,
    )
    init_opacity: float = option(
        0.0,
        "Opacity of the first splats; 0: 0.1, with mcmc 0.5.",
        group="start",
        range=Range(high=0.99),
        when="points",
    )
    init_scale: float = option(
        0.0,
        "Size of the first splats in mean distances to their neighbours; 0: 1, with mcmc 0.1.",
        group="start",
        when="points",
    )
    sky: bool = option(
        False,
        "Start with a far sphere of splats around all else too, in the colours that photos have "
        "there: outdoors, parts of the background that no photo shows are then not black. From "
        "outside the sphere hides the scene. Opacities are then reset only where `reset_every` "
        "says so.",
        group="start",
        when="points",
    )
    stereo: Stereo = option(
        Stereo.MISSING,
        "Start from more points than SfM found: those whose depth the photos agree on. Found in "
        "the training photos alone, in some seconds; `auto`: unless SfM's points are half of "
        "`max_splats` already; `missing`: where the capture has none. Else a capture without "
        "points starts from random ones.",
        group="start",
        when="points",
    )
    stereo_points: int = option(
        0,
        "How many points `stereo` adds at most; 0: 10,000, and a fifth of `max_splats`.",
        group="start",
        range=Range(high=_MOST),
        unit="points",
        when="stereo",
    )
    depth_mode: Switch = option(
        Switch.AUTO,
        "Let depth maps guide the training; `auto`: where photos are few. They are those of "
        "`depths`.",
        group="depth",
        basic=True,
        when="depth_maps",
    )
    depth_weight: float = option(
        -1.0,
        "Weight of the depth loss at the first step, see docs/depth-method.md for its unit; -1: "
        "1, and where more than 6 training views show a median point, 6 / their number.",
        group="depth",
        range=Range(high=LARGEST, also=-1),
        when="depth",
    )
    depth_weight_final: float = option(
        -1.0,
        "Weight of the depth loss at the last step, exponential in between; -1: that of the first.",
        group="depth",
        range=Range(high=LARGEST, also=-1),
        when="depth",
    )
    depth_warmup: float = option(
        0.02,
        "Share of the run over which the depth loss fades in, from 0 to its full weight.",
        group="depth",
        range=Range(high=1),
        unit="share of the run",
        when="depth",
    )
    depth_pearson: float = option(
        0.5,
        "Weight of 1 - correlation for views whose map could not be aligned, as a share of "
        "`depth_weight`; 0: such views get no depth loss.",
        group="depth",
        when="depth",
    )
    depth_points: int = option(
        -1,
        "Points added at the start from aligned maps where SfM left holes, at most; -1: 10,000 "
        "where depth supervises, and a fifth of `max_splats`; 0: none.",
        group="depth",
        range=Range(low=-1),
        unit="points",
        when="depth",
    )
    guide_surface: Path | None = option(
        None,
        "Mesh on which splats are to lie, PLY or OBJ, in the capture's world: a wall, a floor, a "
        "scan. It counts where no point that a photo sees says otherwise: what stands before it "
        "is left there. `gscore sequence` fills in the number of each frame for {frame:06d}. "
        "docs/steer.md says what it brings.",
        group="guides",
        metavar="FILE",
        free=True,
    )
    guide_free: Path | None = option(
        None,
        "Mesh before which nothing stands, PLY or OBJ, in the capture's world: splats between a "
        "training camera and it are taken out, at every `refine_every`-th step and at the last. "
        "Where that would be more than a fifth of all, none are. `gscore sequence` fills in the "
        "number of each frame for {frame:06d}.",
        group="guides",
        metavar="FILE",
        free=True,
    )
    guide_weight: float = option(
        1.0,
        "Weight of the loss of `guide_surface`, in the unit of the depth loss.",
        group="guides",
        when="guide_surface",
    )
    exposure: Switch = option(
        Switch.AUTO,
        "Learn how bright each photo is, and its white balance, apart from the scene; `auto`: "
        "where photos differ. New and held-out views get the mean of the photos.",
        group="colour",
        basic=True,
    )
    exposure_lr: float = option(
        0.01,
        "Learning rate of photos' exposures at the first step, of the logarithm of their gain.",
        group="learning rates",
        when="exposure",
    )
    exposure_lr_final: float = option(
        1e-3,
        "The same at the last step, exponential in between.",
        group="learning rates",
        when="exposure",
    )
    refine_poses: Switch = option(
        Switch.AUTO,
        "Move training cameras to where their photos were taken; `auto`: where the points of the "
        "capture say that they stand elsewhere. Held-out cameras stay.",
        group="poses",
    )
    pose_lr: float = option(
        1e-3,
        "Learning rate of poses at the first step at which they are learnt, radians, and shares "
        "of the extent.",
        group="poses",
        when="poses",
    )
    pose_lr_final: float = option(
        1e-5,
        "The same at the last such step, exponential in between.",
        group="poses",
        when="poses",
    )
    pose_start: float = option(
        0.1,
        "Share of the run after which poses are learnt.",
        group="poses",
        range=Range(high=1),
        unit="share of the run",
        when="poses",
    )
    pose_stop: float = option(
        0.8,
        "Share of the run after which poses stay.",
        group="poses",
        range=Range(high=1),
        unit="share of the run",
        when="poses",
    )
    drop_rate: float = option(
        0.0,
        "Share of splats left out of a step at random, rising from 0 to this at the last step "
        "(Park et al. 2025, DropGaussian), against overfitting to few views; 0: none.",
        group="loss",
        range=Range(high=1, below=True),
    )
    drop_below: float = option(
        0.0,
        "Splats are left out only where stereo, asked for points, finds the depth of less than "
        "this share of the pixels that masks leave: where photos agree in more, it costs fine "
        "detail. Where masks are opacity they are where it finds half of these and more. 0: "
        "always, as where `--drop-rate` is given by itself.",
        group="loss",
        range=Range(high=1),
        when="dropping",
    )
    opaque_weight: float = option(
        0.0,
        "Weight of the mean share of light that passes between splats where the pixels of a photo "
        "count, unless masks are opacity: black on a black background needs no splats, but would "
        "be a hole over another one; 0: none.",
        group="loss",
    )
    alpha_weight: float = option(
        0.0,
        "Weight of the mean absolute difference between rendered opacity and mask, where masks "
        "are opacity (`composite`); 0: none.",
        group="loss",
    )
    coarse_factor: float = option(
        0.0,
        "Sides of the photos are divided by this at the first steps, and by less and less until "
        "`coarse_until`; 0: up to 8, so that 75 pixels are left, or 1 with `start_splats`; 1: "
        "full size from the first step.",
        group="photos",
        range=Range(low=1, high=LARGEST, also=0),
        when="small_photos",
    )
    coarse_until: float = option(
        0.9,
        "Share of the run after which photos are used at full size.",
        group="photos",
        range=Range(high=1),
        unit="share of the run",
        when="small_photos",
    )
    grow_with_photos: bool = option(
        True,
        "`default`: the largest number of splats rises with the sides of the photos, from the "
        "number at the start to `max_splats` at full size, so that small photos do not grow "
        "what only large ones show; in runs of 1,000 steps and more whose photos start at less "
        "than about 0.4 of their sides. `mcmc` gains nothing by it.",
        group="refinement",
        when="default",
    )
    without: tuple[Skip, ...] = option(
        (),
        "Do work that is skipped as needless, to prove or measure that: names of skips.",
        group="run",
        metavar="SKIP",
    )
    refine_start: int = option(
        0,
        "First step at which splats may be added or removed; 0: 500, sooner in short runs.",
        group="refinement",
        range=Range(),
        unit="steps",
    )
    refine_stop: int = option(
        0,
        "Last such step; 0: half of the run, with `grow_with_photos` four fifths or a little "
        "after photos are at full size, with mcmc five sixths.",
        group="refinement",
        range=Range(),
        unit="steps",
    )
    refine_every: int = option(
        0,
        "Steps between two refinements; 0: 100, fewer in short runs.",
        group="refinement",
        range=Range(),
        unit="steps",
    )
    reset_every: int = option(
        0,
        "`default`: steps between two opacity resets, up to `refine_stop` or, where that is 0, "
        "half of the run; 0: 3,000, none in runs under 6,000 steps or with `sky`; -1: never.",
        group="refinement",
        range=Range(low=-1),
        unit="steps",
        when="default",
    )
    grow_grad: float = option(
        0.0,
        "`default`: mean positional gradient in normalised image coordinates above which a "
        "splat is doubled; 0: 2e-4, down to 1e-4 in short runs. Where masks are opacity, 5e-5 in "
        "runs of 10,000 steps and more, and where splats are left out.",
        group="refinement",
        when="default",
    )
    doubling: Doubling = option(
        Doubling.LONG_AXIS,
        "`default`: how a splat is doubled: `long-axis`: into two halves along its longest axis; "
        "`clone-split`: small ones are copied, large ones replaced by two that are drawn from "
        "them, as in the paper of 3DGS.",
        group="refinement",
        when="default",
    )
    grow_scale: float = option(
        0.01,
        "`clone-split`: larger splats are split, smaller ones cloned; in extents.",
        group="refinement",
        unit="extents",
        when="clone_split",
    )
    prune_opacity: float = option(
        0.005,
        "Splats with a lower opacity are removed, with mcmc relocated.",
        group="refinement",
        range=Range(high=0.99),
    )
    prune_scale: float = option(
        0.1,
        "`default`: larger splats are removed after the first opacity reset; in extents.",
        group="refinement",
        unit="extents",
        when="default",
    )
    finest: float = option(
        0.0,
        "No axis of a splat is shorter than so many pixels, as a standard deviation, of the "
        "training photo that is nearest to it: finer detail is in no photo, but shows in pictures "
        "from nearer. 0: axes may have any length. That happens at every `refine_every`-th step "
        "and at the last. In the manner of the 3D filter of Yu et al. 2024 (Mip-Splatting), whose "
        "width is 0.45; PLY files need nothing more.",
        group="refinement",
        unit="px",
        range=Range(high=10),
    )
    prune_share: float = option(
        0.0,
        "Share of the splats that is removed when refinements are over (`refine_stop`): those "
        "that add least to any training photo. 0: none.",
        group="refinement",
        range=Range(high=1, below=True),
    )
    free_space: float = option(
        0.4,
        "Splats nearer to a training camera than this share of its distance from the tenth "
        "nearest SfM point are taken out, for they hide the scene from views between the photos; "
        "0: splats may stand anywhere. That happens at every `refine_every`-th step and at the "
        "last. Captures of fewer than 500 points, or with more than a fifth of the splats there, "
        "are left as they are.",
        group="refinement",
        range=Range(high=1, below=True),
    )
    hidden_share: float = option(
        0.05,
        "Where masks hide parts of a scene (`ignore`): splats of whose weight in the training "
        "photos less than this share stands where masks show it are taken out, a third and two "
        "thirds through the training. No photo says what these should look like, and they veil "
        "other views. 0: they stay.",
        group="refinement",
        range=Range(high=1, below=True),
        when="hiding_masks",
    )
    mcmc_growth: float = option(
        0.0,
        "`mcmc`: splats added at each refinement, as a share of those there; 0: 0.05, more in "
        "runs that would not reach `max_splats` otherwise.",
        group="mcmc",
        when="mcmc",
    )
    mcmc_noise: float = option(
        5e5,
        "`mcmc`: noise on positions, in units of their learning rate.",
        group="mcmc",
        when="mcmc",
    )
    opacity_reg: float = option(
        0.01,
        "`mcmc`: weight of the mean opacity in the loss.",
        group="mcmc",
        when="mcmc",
    )
    scale_reg: float = option(
        0.01,
        "`mcmc`: weight of the mean scale in the loss.",
        group="mcmc",
        when="mcmc",
    )
    test_iterations: tuple[int, ...] = option(
        (),
        "Steps after which the test views are measured; the end of a run always is.",
        group="results",
        range=Range(low=1),
        unit="steps",
        metavar="STEP",
        when="steps",
        free=True,
    )
    save_iterations: tuple[int, ...] = option(
        (),
        "Steps after which the splats are written to `point_cloud/iteration_N/`; the end always "
        "is.",
        group="results",
        range=Range(low=1),
        unit="steps",
        metavar="STEP",
        when="steps",
        free=True,
    )
    checkpoint_iterations: tuple[int, ...] = option(
        (),
        "Steps after which a checkpoint is written that is never cleaned up.",
        group="results",
        range=Range(low=1),
        unit="steps",
        metavar="STEP",
        when="steps",
        free=True,
    )
    cache_mb: int = option(
        0,
        "Megabytes of decoded photos to keep in memory; the others are decoded again when their "
        "turn comes. 0: all, or as many as fit. The result is the same.",
        group="results",
        range=Range(),
        unit="MB",
        metavar="MB",
        free=True,
    )
    checkpoint_seconds: float = option(
        300.0,
        "Seconds of training between two checkpoints, of which the last two are kept, and at "
        "most two more that the watchdog may go back to; 0: only at the end.",
        group="results",
        unit="s",
        metavar="SECONDS",
        free=True,
    )
    preview_seconds: float = option(
        0.0,
        "Seconds of training between two pictures of one view in OUT/previews; 0: none.",
        group="results",
        unit="s",
        metavar="SECONDS",
        free=True,
    )
    snapshot_every: int = option(
        0,
        "Steps between two PLYs in OUT/snapshots, of which two are kept; 0: only on request.",
        group="results",
        range=Range(),
        unit="steps",
        free=True,
    )
    lpips: Path | None = option(
        None,
        "Network of LPIPS, a measure of likeness as people see it: an ONNX file, or alex, vgg or "
        "squeeze of the package lpips; without it, not measured.",
        group="results",
        metavar="NETWORK",
        basic=True,
        free=True,
    )
    watchdog: bool = option(
        True,
        "Where a run diverges, go back to the last good checkpoint and on with lower learning "
        "rates, a few times; without periodic checkpoints (`checkpoint_seconds` 0) end with an "
        "error.",
        group="results",
        free=True,
    )
    detect_anomaly: bool = option(
        False,
        "Stop with an error at the first number that is not finite, and say where it came from; "
        "slow.",
        group="results",
        free=True,
    )

    def __post_init__(self) -> None:
        check_options(self)


LIFTED_BY = {
    "iterations": "steps_a_photo",
    "max_splats": "splats_a_photo",
    "drop_rate": "drop_below",
    "ensemble": "ensemble_below",
}
"""Limits by what the photos are like, by the option that lifts them where it is given by itself."""


def unlimited(train: TrainConfig, asked: Mapping[str, int]) -> TrainConfig:
    """The options before photos limited them, which limit them again alike.

    Args:
        train: Options of a run.
        asked: Value by option, of those that photos limited, before they did.
    """
    was = {
        option: asked[option]
        for option, limit in LIFTED_BY.items()
        if getattr(train, option) < asked.get(option, 0) and getattr(train, limit)
    }
    return replace(train, **was)


def limited_as(train: TrainConfig, asked: Mapping[str, int], run: TrainConfig) -> TrainConfig:
    """The options with those values of a `run` that photos limited, where the same was asked for.

    Args:
        train: Options that were given anew.
        asked: As `unlimited`, of the run.
        run: Options of the run.
    """
    same = {
        option: getattr(run, option)
        for option, limit in LIFTED_BY.items()
        if getattr(train, option) == asked.get(option) and getattr(train, limit)
    }
    return replace(train, **same)
