"""Choices: enumerations of option values, with the meaning of each value."""

from enum import StrEnum


class Strategy(StrEnum):
    """How the number of splats changes during training."""

    DEFAULT = "default"
    """Double, prune and reset by gradient: adaptive density control (Kerbl et al. 2023)."""
    MCMC = "mcmc"
    """Relocate dead splats, grow by 5 % up to the cap, add noise (Kheradmand et al. 2024)."""


class Doubling(StrEnum):
    """What becomes of a splat that one is not enough for."""

    LONG_AXIS = "long-axis"
    """Two halves side by side along its longest axis (Deng et al. 2024)."""
    CLONE_SPLIT = "clone-split"
    """A small one gets a copy in its place, a large one makes room for two that are drawn from it,
    as in the paper of 3DGS (Kerbl et al. 2023)."""


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


class Stereo(StrEnum):
    """When photos are asked for points of the surfaces that they show."""

    AUTO = "auto"
    """Unless the capture's points are half of `max_splats` already."""
    MISSING = "missing"
    """Where the capture has no points."""
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
