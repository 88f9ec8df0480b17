"""Options of a run as frozen dataclasses: the same objects behind command line, JSON and add-on."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from .choices import Background, Doubling, Skip, Stereo, Strategy, Switch
from .errors import ConfigError
from .options import LARGEST, Range, check_options, option
from .quoting import quoted

MOST_THREADS = 1024
"""Limit of the native library."""
_MOST = 10**9
"""Largest number of steps and splats, far beyond any machine: forecasts iterate over the
refinements of a run, and much larger numbers overflow floats."""
_LARGEST_SEED = 2**63 - 1
"""Limit of torch generators."""
_RAREST = 1000
"""Largest `shN_every`: the learning rate rises by its root."""
_MASK_MODES = ("auto", "composite", "ignore", "none")
_DEPTH_ALIGNMENTS = ("auto", "official", "robust", "none")

_capture_option = partial(option, group="capture")
_depth_option = partial(option, group="depth", when="depth")
_run_option = partial(option, group="run")
_colour_option = partial(option, group="colour")
_loss_option = partial(option, group="loss")
_rate_option = partial(option, group="learning rates")
_start_option = partial(option, group="start")
_guide_option = partial(option, group="guides")
_pose_option = partial(option, group="poses", when="poses")
_photo_option = partial(option, group="photos")
_refinement_option = partial(option, group="refinement")
_mcmc_option = partial(option, group="mcmc", when="mcmc")
_result_option = partial(option, group="results", free=True)
"""`option` for the headings of the option list."""


def checked_threads(threads: int) -> int:
    """`threads` if valid (0: all cores), else ConfigError."""
    if not isinstance(threads, int) or not 0 <= threads <= MOST_THREADS:
        raise ConfigError(
            f"threads must be 0 (all cores) to {MOST_THREADS}, got {quoted(threads)}."
        )
    return threads


@dataclass(frozen=True, kw_only=True)
class DataConfig:
    """Input of a run: files of the capture, and the split into training and test views."""

    source: Path
    """Folder with the COLMAP model or transforms.json."""
    images: str = _capture_option(
        "images",
        "Folder of the photos inside the capture. Not used by transforms.json, which names them.",
        metavar="DIR",
        short="i",
        basic=True,
    )
    masks: str = _capture_option(
        "",
        "Mask folder inside the capture. Empty: `masks/` if it exists, else the alpha of the "
        "photos.",
        metavar="DIR",
        basic=True,
        when="masks",
    )
    mask_mode: str = _capture_option(
        "auto",
        "Meaning of masks. `ignore`: black pixels do not count; `composite`: opacity of the "
        "subject; `none`: not read; `auto`: `composite` for transparent photos and cut-out "
        "subjects, else `ignore`.",
        choices=_MASK_MODES,
        basic=True,
    )
    invert_masks: bool = _capture_option(
        False,
        "Mask files are white where pixels do not count, instead of black. `auto` is then "
        "`ignore`. The alpha of photos is never inverted.",
        when="masks",
    )
    depths: str = _depth_option(
        "",
        "Folder of depth maps inside the capture, as gscore depth writes them. Inverse depth; "
        "empty: no depth.",
        metavar="DIR",
        short="d",
        basic=True,
        when="depth_on",
    )
    depth_align: str = _depth_option(
        "auto",
        "Alignment of depth maps. `official`: from depth_params.json; `robust`: RANSAC against "
        "the SfM points; `none`: already aligned; `auto`: depth_params.json if it agrees with "
        "the points, else `robust`.",
        choices=_DEPTH_ALIGNMENTS,
    )
    resolution: float = _capture_option(
        -1,
        "Photo size: divisor 1, 2, 4 or 8, or width in pixels; `auto`: full size up to a limit. "
        "The limit is the width of the preset or run, else 1600.",
        auto=-1,
        range=None,  # `datasets.resolution` checks it
        metavar="N",
        short="r",
        basic=True,
    )
    max_width: int = 1600
    """Width limit of photos with `resolution` -1, pixels. Set by presets, not by a command-line
    option."""
    eval: bool = _capture_option(
        False,
        "Hold out test views and measure on them. Default: every 8th view, unless `hold_out` or"
        " the capture selects others.",
        basic=True,
    )
    test_every: int = 8
    """Every n-th view by sorted name is a test view, unless the capture states its own split."""
    test_offset: int | None = None
    """Index of the test view in each group of `test_every`, from 0, overriding the split of the
    capture; None: the first, unless the capture has a split."""
    test_list: Path | None = None
    """Text file with the names of the test views, one a line; wins over the other rules."""
    test_last: int = 0
    """The last n views by sorted name are test views; 0: use `test_every`."""
    test_first: int = 0
    """The first n views by sorted name are test views; 0: use `test_every`."""
    frame: int | None = _capture_option(
        None,
        "Frame number to read from a multi-view video; default: the first.",
        range=None,
        basic=True,
    )
    rig: Path | None = _capture_option(
        None,
        "Capture of the same fixed cameras whose poses and world are used.",
        metavar="DIR",
        basic=True,
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "source", Path(self.source))  # scripts pass strings
        check_options(self)


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Training options. Where `auto`, None or a number that stands for it selects a value, the
    field has that number, and `trainer.schedule.plan.Plan` contains the selected value.

    Lengths are in units of the camera extent: 1.1 times the largest distance of a camera from
    their mean.
    """

    iterations: int = _run_option(
        10_000,
        "Training steps, each on one photo. Not used with `time_budget`. With `ensemble`, each "
        "model takes a photo per step.",
        range=Range(low=1, high=_MOST),
        unit="steps",
        basic=True,
        free=True,
    )
    time_budget: float = _run_option(
        0.0,
        "Training time that replaces `iterations`; 0: off. Excludes reading, measuring and "
        "writing. Schedules adapt to the time, so the run is not reproducible bit for bit.",
        unit="s",
        basic=True,
        free=True,
    )
    target_psnr: float = _run_option(
        0.0,
        "Stop when the mean PSNR of the held-out photos (else of the training photos) reaches "
        "this; 0: off.",
        unit="dB",
        basic=True,
        free=True,
    )
    early_stop: bool = _run_option(
        False,
        "Stop when the PSNR of the held-out photos (else of the training photos) no longer "
        "rises. Waits for full-size photos; a short phase then completes the decay of the "
        "learning rates.",
        basic=True,
        free=True,
    )
    steps_a_photo: int = _run_option(
        0,
        "Limit of steps per training photo, against overfitting; at least 1,500 in all. 0: no "
        "limit. Off with `time_budget`, an explicit `--iterations` or `gscore sequence`; in "
        "Python set 0.",
        range=Range(high=_MOST),
        unit="steps",
        free=True,
    )
    splats_a_photo: int = _run_option(
        0,
        "Limit of splats per training photo and model; at least 300,000 in all. 0: no limit. Off "
        "with `composite` masks, an explicit `--max-splats` or `gscore sequence`; in Python set "
        "0.",
        range=Range(high=_MOST),
        unit="splats",
        free=True,
    )
    max_splats: int = _run_option(
        400_000,
        "Limit of the number of splats. Memory and time grow with it.",
        range=Range(low=1, high=_MOST),
        unit="splats",
        basic=True,
    )
    ensemble: int = _run_option(
        1,
        "Number of models that are trained and merged into one; `max_splats` is divided among "
        "them. Reduces artefacts between the photos, but also fine detail; two take 1.4 times as "
        "long.",
        range=Range(low=1, high=8),
        unit="models",
        when="one_model",
    )
    ensemble_below: float = _run_option(
        0.0,
        "Train several models only if `stereo` matches less than this share of the pixels; "
        "masked subjects: docs/budgets.md. 0, or an explicit `--ensemble`: always.",
        range=Range(high=1),
        when="ensemble",
    )
    strategy: Strategy = _run_option(
        Strategy.DEFAULT,
        "Densification: how splats are added and removed. `mcmc` relocates dead splats: good in "
        "long runs, much worse than `default` in a few hundred steps.",
        basic=True,
    )
    sh_degree: int = _run_option(
        3,
        "Degree of view-dependent colour, 0 to 3; 0: no view dependence.",
        range=Range(high=3),
        basic=True,
    )
    sh_every: int = _colour_option(
        0,
        "Steps between two SH degrees; `auto`: 1000, or fewer so that all are active by half of "
        "the run.",
        auto=0,
        unit="steps",
        when="bands",
    )
    seed: int = _run_option(
        0,
        "Random seed; the same seed gives the same bits. For the same capture and options, with "
        "any number of threads.",
        range=Range(high=_LARGEST_SEED),
        basic=True,
    )
    threads: int = _run_option(
        0,
        "CPU threads; `auto`: one per core that this process may use.",
        auto=0,
        range=Range(high=MOST_THREADS),
        basic=True,
        free=True,
    )
    device: str = _run_option(
        "auto",
        "`cpu`; `gpu`: a graphics card; `auto`: the faster one, by a trial; or a number of `gscore "
        "doctor`.",
        metavar="DEVICE",
        basic=True,
        free=True,
    )
    gpu_share: float = _run_option(
        1.0,
        "Share of the time of a graphics card that training may use; the rest is for programs that "
        "draw, in pauses after short submissions. No bit depends on it.",
        range=Range(high=1, above=True),
        free=True,
    )
    background: Background = _run_option(
        Background.AUTO,
        "Background colour. `auto`: random at each step for photos with opacity, else black.",
        basic=True,
    )
    antialias: bool = _run_option(
        False,
        "Draw splats smaller than a pixel fainter. Opacity compensation of the screen-space "
        "dilation (Mip-Splatting, Yu et al. 2024).",
        basic=True,
    )
    near: float = _run_option(
        0.01,
        "Near plane: closer splats are not drawn; world units, as in `gscore.render`.",
        unit="world units",
    )
    ssim_weight: float = _loss_option(0.2, "Loss = (1 - w) L1 + w (1 - SSIM).", range=Range(high=1))
    means_lr: float = _rate_option(
        1.6e-4, "Learning rate of positions at the first step, in extents.", unit="extents"
    )
    means_lr_final: float = _rate_option(
        1.6e-6,
        "Learning rate of positions at the last step, in extents; exponential in between.",
        unit="extents",
    )
    sh0_lr: float = _rate_option(2.5e-3, "Learning rate of the constant colour.")
    shN_lr: float = _rate_option(
        1.25e-4, "Learning rate of the view-dependent colour.", when="bands"
    )
    shN_every: int = _rate_option(
        0,
        "Steps between two updates of the view-dependent colour; gradients accumulate, and its "
        "learning rate rises by the root of this. `auto`: 8, fewer in runs under 1,000 steps; "
        "1: each step.",
        auto=0,
        range=Range(high=_RAREST),
        unit="steps",
        when="bands",
    )
    opacities_lr: float = _rate_option(
        0.0, "Learning rate of logit opacities; `auto`: 0.025, with mcmc 0.05.", auto=0
    )
    scales_lr: float = _rate_option(5e-3, "Learning rate of log scales.")
    quats_lr: float = _rate_option(1e-3, "Learning rate of quaternions.")
    lr_boost: float = _rate_option(
        0.0,
        "Factor of the learning rates: its root for positions and opacities, its square for the"
        " final rate of positions. `auto`: 1 from 30,000 steps, up to 4 in shorter runs.",
        auto=0,
    )
    lr_final: float = _rate_option(
        0.2,
        "Final factor of the learning rates except positions: exponential decay over the last "
        "tenth of the run. 1: no decay.",
        range=Range(high=1, above=True),
    )
    start_splats: Path | None = _start_option(
        None,
        "Initial splats, a PLY in the capture's world, instead of SfM points.",
        metavar="FILE.ply",
        basic=True,
        free=True,
    )
    start_opacity: float = _start_option(
        1.0,
        "Factor of the opacities of `start_splats`; the training restores those that photos need.",
        range=Range(high=1, above=True),
        when="start_splats",
    )
    region: Path | None = _start_option(
        None,
        "Train only inside the box of this file. Splats of `start_splats` outside are frozen; "
        "without `start_splats` only pixels and photos that show the box count. See "
        "docs/steer.md.",
        metavar="FILE.json",
        free=True,
    )
    init_opacity: float = _start_option(
        0.0,
        "Opacity of the initial splats; `auto`: 0.1, with mcmc 0.5.",
        auto=0,
        range=Range(high=0.99),
        when="points",
    )
    init_scale: float = _start_option(
        0.0,
        "Size of the initial splats in mean distances to their neighbours; `auto`: 1, with mcmc "
        "0.1.",
        auto=0,
        when="points",
    )
    sky: Switch = _start_option(
        Switch.AUTO,
        "Add distant splats for the sky: `auto`: where photos show it; `on`: all around, which "
        "hides the scene from outside. Opacity resets then need an explicit `reset_every`.",
        when="points",
    )
    stereo: Stereo = _start_option(
        Stereo.MISSING,
        "Add initial points by multi-view stereo. `auto`: unless SfM points reach half of "
        "`max_splats`; `missing`: only for captures without points, which otherwise start from "
        "random ones.",
        when="points",
    )
    stereo_points: int = _start_option(
        0,
        "Limit of the points that `stereo` adds; `auto`: 10,000 plus a fifth of `max_splats`.",
        auto=0,
        range=Range(high=_MOST),
        unit="points",
        when="stereo",
    )
    depth_mode: Switch = _depth_option(
        Switch.AUTO,
        "Depth loss from the depth maps in `depths`; `auto`: for few photos.",
        basic=True,
        when="depth_maps",
    )
    depth_weight: float = _depth_option(
        -1.0,
        "Initial weight of the depth loss, unit in docs/depth-method.md; `auto`: 1, or 6 / the "
        "number of training views that show a median point, where more than 6 do.",
        auto=-1,
        range=Range(high=LARGEST, also=-1),
    )
    depth_weight_final: float = _depth_option(
        -1.0,
        "Final weight of the depth loss, exponential in between; `auto`: the initial weight.",
        auto=-1,
        range=Range(high=LARGEST, also=-1),
    )
    depth_warmup: float = _depth_option(
        0.02,
        "Share of the run over which the depth loss rises from 0 to its full weight.",
        range=Range(high=1),
        unit="share of the run",
    )
    depth_pearson: float = _depth_option(
        0.5,
        "Weight of 1 - Pearson correlation for views with an unaligned map, as a share of "
        "`depth_weight`; 0: no depth loss for them.",
    )
    depth_points: int = _depth_option(
        -1,
        "Limit of the initial points from aligned depth maps in gaps of the SfM points; `auto`: "
        "10,000 plus a fifth of `max_splats` if depth is used; 0: none.",
        auto=-1,
        range=Range(low=-1),
        unit="points",
    )
    guide_surface: Path | None = _guide_option(
        None,
        "Surface mesh that splats should lie on, PLY or OBJ in the capture's world. Inactive "
        "where SfM points are in front of it. See docs/steer.md.",
        metavar="FILE",
        free=True,
    )
    guide_free: Path | None = _guide_option(
        None,
        "Free-space mesh, PLY or OBJ in the capture's world: splats between it and a training "
        "camera are removed at every `refine_every`-th and the last step. See docs/steer.md.",
        metavar="FILE",
        free=True,
    )
    guide_weight: float = _guide_option(
        1.0,
        "Weight of the `guide_surface` loss, in the unit of the depth loss.",
        when="guide_surface",
    )
    exposure: Switch = _colour_option(
        Switch.AUTO,
        "Exposure compensation: optimise brightness and white balance of each photo; `auto`: of 2 "
        "or more. Held-out views get that of neighbours, new views the mean.",
        basic=True,
    )
    exposure_lr: float = _rate_option(
        0.01, "Initial learning rate of the exposure gains (logarithmic).", when="exposure"
    )
    exposure_lr_final: float = _rate_option(
        1e-3, "Final learning rate of the exposure gains; exponential decay.", when="exposure"
    )
    refine_poses: Switch = _pose_option(
        Switch.AUTO,
        "Pose refinement: optimise the training camera poses; `auto`: if the points of the "
        "capture contradict them. Held-out cameras stay.",
        when="",
    )
    pose_lr: float = _pose_option(
        1e-3, "Initial learning rate of poses, in radians and shares of the extent."
    )
    pose_lr_final: float = _pose_option(1e-5, "Final learning rate of poses; exponential decay.")
    photo_blur: bool = _colour_option(
        True,
        "Photo blur: compare photos that are much more blurred than the others with renders "
        "blurred alike, so that splats stay sharp. From 8 photos on, with one process.",
    )
    transient_masks: bool = _colour_option(
        True,
        "Transient masks: leave out parts of photos that others contradict (transients): people, "
        "cars, the photographer's shadow. From 8 photos on, with one process.",
    )
    drop_rate: float = _loss_option(
        0.0,
        "Dropout: share of splats left out of a step at random, rising from 0 to this at the "
        "last step (DropGaussian, Park et al. 2025). Against overfitting to few views; 0: off.",
        range=Range(high=1, below=True),
    )
    drop_below: float = _loss_option(
        0.0,
        "Use dropout only if `stereo` matches less than this share of the unmasked pixels; "
        "masked subjects: docs/budgets.md. 0, or an explicit `--drop-rate`: always.",
        range=Range(high=1),
        when="dropping",
    )
    opaque_weight: float = _loss_option(
        0.0,
        "Weight of the mean transmittance at counted pixels, unless masks are `composite`. "
        "Prevents holes in dark areas that appear over a brighter background; 0: off.",
    )
    surface_weight: float = _loss_option(
        0.0,
        "Weight of terms that make splats flat and lie on surfaces, for `gscore mesh`; 1 is a good "
        "value. CPU only. 0: off.",
    )
    surface_from: float = _loss_option(
        0.7,
        "Share of the run after which splats are made to lie on surfaces.",
        range=Range(high=1),
        unit="share of the run",
        when="surface",
    )
    alpha_weight: float = _loss_option(
        0.0,
        "Weight of the mean absolute difference between rendered opacity and mask, for "
        "`composite` masks; 0: off.",
    )
    coarse_factor: float = _photo_option(
        0.0,
        "Initial downscaling of the photos, decreasing until `coarse_until`. `auto`: up to 8, "
        "leaving at least 75 pixels, or 1 with `start_splats`; 1: full size from the first step.",
        auto=0,
        range=Range(low=1, high=LARGEST, also=0),
        when="small_photos",
    )
    coarse_until: float = _photo_option(
        0.9,
        "Share of the run after which photos have their full size.",
        range=Range(high=1),
        unit="share of the run",
        when="small_photos",
    )
    grow_with_photos: bool = _refinement_option(
        True,
        "`default`: raise the splat limit to `max_splats` with the photo size. Applies to runs "
        "of at least 1,000 steps with photos that start below about 0.4 of the size.",
        when="default",
    )
    without: tuple[Skip, ...] = _run_option(
        (), "Disable optimisations (skips) by name, to verify or measure them.", metavar="SKIP"
    )
    refine_start: int = _refinement_option(
        0,
        "First step that may add or remove splats; `auto`: 500, earlier in short runs.",
        auto=0,
        unit="steps",
    )
    refine_stop: int = _refinement_option(
        0,
        "Last step that may add or remove splats; `auto`: half of the run; 4/5 or shortly after "
        "full-size photos with `grow_with_photos`; 5/6 with mcmc.",
        auto=0,
        unit="steps",
    )
    refine_every: int = _refinement_option(
        0,
        "Steps between two refinements; `auto`: 100, fewer in short runs.",
        auto=0,
        unit="steps",
    )
    reset_every: int = _refinement_option(
        0,
        "`default`: steps between two opacity resets, up to `refine_stop` (`auto`: half of the "
        "run). `auto`: 3,000, none in runs under 6,000 steps or with `sky`; -1: never.",
        auto=0,
        range=Range(low=-1),
        unit="steps",
        when="default",
    )
    grow_grad: float = _refinement_option(
        0.0,
        "`default`: mean screen-space gradient (normalised coordinates) above which a splat is "
        "doubled. `auto`: 2e-4, down to 1e-4 in short runs; 5e-5 for `composite` masks with "
        "dropout or from 10,000 steps.",
        auto=0,
        when="default",
    )
    doubling: Doubling = _refinement_option(
        Doubling.LONG_AXIS,
        "`default`: operation that doubles a splat. `long-axis`: split into halves along the "
        "longest axis; `clone-split`: clone small ones, replace large ones by two samples (3DGS"
        " paper).",
        when="default",
    )
    prune_opacity: float = _refinement_option(
        0.005,
        "Opacity below which splats are removed, with mcmc relocated.",
        range=Range(high=0.99),
    )
    prune_scale: float = _refinement_option(
        0.1,
        "`default`: size above which splats are removed after the first opacity reset; in extents.",
        unit="extents",
        when="default",
    )
    finest: float = _refinement_option(
        0.0,
        "3D filter (Mip-Splatting): minimum scale of a splat in pixels of its nearest training "
        "photo, at every `refine_every`-th and the last step; the paper uses 0.45. 0: off.",
        unit="px",
        range=Range(high=10),
    )
    prune_share: float = _refinement_option(
        0.0,
        "Share of the splats with the least contribution to the training photos, removed at "
        "`refine_stop`. 0: none.",
        range=Range(high=1, below=True),
    )
    free_space: float = _refinement_option(
        0.4,
        "Remove splats closer to a camera than this share of its distance to the 10th nearest "
        "SfM point, and those between cameras that no photo nearby shows. 0, or fewer than 500 "
        "points: no removal.",
        range=Range(high=1, below=True),
    )
    hidden_share: float = _refinement_option(
        0.05,
        "`ignore` masks: remove splats with less than this share of their weight in unmasked "
        "pixels, after 1/3 and 2/3 of the training. 0: off.",
        range=Range(high=1, below=True),
        when="hiding_masks",
    )
    mcmc_growth: float = _mcmc_option(
        0.0,
        "`mcmc`: splats added per refinement, as a share of the current number; `auto`: 0.05, more "
        "in runs that would not reach `max_splats`.",
        auto=0,
    )
    mcmc_noise: float = _mcmc_option(
        5e5, "`mcmc`: noise on positions, in units of their learning rate."
    )
    opacity_reg: float = _mcmc_option(0.01, "`mcmc`: weight of the mean opacity in the loss.")
    scale_reg: float = _mcmc_option(0.01, "`mcmc`: weight of the mean scale in the loss.")
    test_iterations: tuple[int, ...] = _result_option(
        (),
        "Steps at which the test views are measured; always also at the end.",
        range=Range(low=1),
        unit="steps",
        metavar="STEP",
        when="steps",
    )
    save_iterations: tuple[int, ...] = _result_option(
        (),
        "Steps at which splats are written to `point_cloud/iteration_N/`; always also at the end.",
        range=Range(low=1),
        unit="steps",
        metavar="STEP",
        when="steps",
    )
    checkpoint_iterations: tuple[int, ...] = _result_option(
        (),
        "Steps at which a permanent checkpoint is written.",
        range=Range(low=1),
        unit="steps",
        metavar="STEP",
        when="steps",
    )
    cache_mb: int = _result_option(
        0,
        "Memory for decoded photos in megabytes; photos beyond it are decoded again at each "
        "use. `auto`: all, or what fits. The result is the same.",
        auto=0,
        unit="MB",
    )
    checkpoint_seconds: float = _result_option(
        300.0,
        "Training time between two checkpoints; 0: only at the end. The last two are kept, and "
        "up to two more for the watchdog.",
        unit="s",
    )
    preview_seconds: float = _result_option(
        0.0,
        "Training time between two pictures of one view in OUT/previews; 0: none.",
        unit="s",
    )
    snapshot_every: int = _result_option(
        0,
        "Steps between two PLYs in OUT/snapshots, the last two are kept; 0: only on request.",
        unit="steps",
    )
    lpips: Path | None = _result_option(
        None,
        "LPIPS network (perceptual metric): an ONNX file, or alex, vgg or squeeze of the "
        "package lpips. Default: not measured.",
        metavar="NETWORK",
        basic=True,
    )
    watchdog: bool = _result_option(
        True,
        "On divergence, return to the last good checkpoint with lower learning rates, a few "
        "times. Without periodic checkpoints (`checkpoint_seconds` 0): stop with an error.",
    )
    detect_anomaly: bool = _result_option(
        False,
        "Stop with an error at the first non-finite number, with its origin; slow.",
    )

    def __post_init__(self) -> None:
        check_options(self)


LIFTED_BY = {
    "iterations": "steps_a_photo",
    "max_splats": "splats_a_photo",
    "drop_rate": "drop_below",
    "ensemble": "ensemble_below",
}
"""Limits derived from the photos, by the option that disables them when given explicitly."""


def unlimited(train: TrainConfig, requested: Mapping[str, int]) -> TrainConfig:
    """Options without the limits derived from the photos, which will be applied again.

    Args:
        train: Options of a run.
        requested: Requested value of each option that was limited.
    """
    was = {
        option: requested[option]
        for option, limit in LIFTED_BY.items()
        if getattr(train, option) < requested.get(option, 0) and getattr(train, limit)
    }
    return replace(train, **was)


def limited_as(train: TrainConfig, requested: Mapping[str, int], run: TrainConfig) -> TrainConfig:
    """The options with the limited values of a `run`, where the same values were requested.

    Args:
        train: Options given again.
        requested: As in `unlimited`, of the run.
        run: Options of the run.
    """
    same = {
        option: getattr(run, option)
        for option, limit in LIFTED_BY.items()
        if getattr(train, option) == requested.get(option) and getattr(train, limit)
    }
    return replace(train, **same)
