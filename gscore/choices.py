"""Choices: enumerations of option values, with the meaning of each value."""

from enum import StrEnum


class Strategy(StrEnum):
    """Densification: how splats are added and removed."""

    DEFAULT = "default"
    """Double, prune and reset by gradient: adaptive density control (Kerbl et al. 2023)."""
    MCMC = "mcmc"
    """Relocate dead splats, grow by 5 % up to the cap, add noise (Kheradmand et al. 2024)."""


class Doubling(StrEnum):
    """Operation that doubles a splat."""

    LONG_AXIS = "long-axis"
    """Two halves side by side along its longest axis (Deng et al. 2024)."""
    CLONE_SPLIT = "clone-split"
    """Small splats are cloned, large ones replaced by two samples (Kerbl et al. 2023)."""


class Background(StrEnum):
    """Background colour during training."""

    AUTO = "auto"
    """Random at each step for photos with opacity, else black."""
    BLACK = "black"
    WHITE = "white"
    RANDOM = "random"
    """Random at each step."""


class Switch(StrEnum):
    """State of a feature that only some captures need."""

    AUTO = "auto"
    """`on` if the capture needs it, which a message reports; else `off`."""
    ON = "on"
    OFF = "off"


class Stereo(StrEnum):
    """Condition for initial points by multi-view stereo."""

    AUTO = "auto"
    """Unless the points of the capture reach half of `max_splats`."""
    MISSING = "missing"
    """Only if the capture has no points."""
    ON = "on"
    OFF = "off"


class Skip(StrEnum):
    """Optimisations that skip needless work. `TrainConfig.without` disables them
    for verification and measurement, as `gscore bench skips` does. All but the last three keep
    every bit of the result."""

    EXACT_CULL = "exact-cull"
    """Tiles and rows of a splat's bounding box outside its ellipse."""
    OPACITY_EXTENT = "opacity-extent"
    """The margin that only an opaque splat of the same shape covers."""
    ROW_RANGE = "row-range"
    """Rows of a tile outside the ellipse."""
    ZERO_TILE = "zero-tile"
    """The backward pass of tiles without an image gradient."""
    MASKED_TILE = "masked-tile"
    """Tiles that an `ignore` mask covers completely."""
    SH_BANDS = "sh-bands"
    """Storage and optimizer steps of SH degrees that are not active yet."""
    UNSEEN_SH = "unseen-sh"
    """Optimizer steps of the higher SH coefficients of splats outside the view: applied later
    (lazy Adam), equal up to rounding."""
    RARE_SH = "rare-sh"
    """Optimizer steps of the higher SH coefficients: one per several views, with accumulated
    gradients, see `TrainConfig.shN_every`; different bits, equal quality."""
    SMALL_PHOTOS = "small-photos"
    """Pixels of the first steps: photos start downscaled, see `TrainConfig.coarse_factor`."""
