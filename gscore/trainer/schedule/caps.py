"""Caps of steps, splats and points by the number of photos, and dropout, against overfitting."""

from dataclasses import replace

from ...config import Stereo, TrainConfig
from ...datasets.points import RANDOM_POINTS
from ...events import Decision
from ...text_format import count_text, number

MOST_ADDED = 10_000
"""Most points that are added automatically."""
SPLATS_A_POINT = 5
"""Least splats per added point: densification needs room for splats where gradients are large."""
_AGREE = 0.5
"""Share of a subject's pixels with a depth by stereo from which photos agree: .68 and .84 for two
captures that gain from dropout, .34 and .39 for two that lose."""
_AGREE_WELL = 0.75
"""The same share from which several models of a subject are better than one: the capture of .84
gains; that of .68 loses, because a single model grows more splats than its share."""
_FEWEST_STEPS, _FEWEST_SPLATS = 1500, 300_000
"""Lower limits of the caps: the steps of the preset `preview`, because fewer leave too little time
to grow, and the splats of `normal`."""


def max_stereo_points(config: TrainConfig, given: int) -> int:
    """Most points that stereo may add to `given` points; 0: no room."""
    room = config.max_splats - given
    if config.stereo == Stereo.AUTO and room < config.max_splats // 2:
        return 0
    most = config.stereo_points or min(MOST_ADDED, config.max_splats // SPLATS_A_POINT)
    return max(min(most, room), 0)


def expected_points(config: TrainConfig, given: int) -> int:
    """Expected number of start points before stereo has run: `given` if there are any, else the
    most that stereo may add, or the random ones."""
    if given:
        return given
    return RANDOM_POINTS if config.stereo == Stereo.OFF else max_stereo_points(config, 0)


def drops_splats_of_subject(config: TrainConfig, *, mask_mode: str, known: float | None) -> bool:
    """Return whether dropout is used for a subject with `composite` masks.

    If photos agree it gains 0.2 dB in half the steps; otherwise it loses as much.

    Args:
        config: Uses `drop_rate`.
        mask_mode: Use of the masks, as `Dataset.mask_mode`.
        known: Share of the unmasked pixels with a depth by stereo; None: stereo has not run.
    """
    agrees = known is not None and known >= _AGREE
    return mask_mode == "composite" and config.drop_rate > 0 and agrees


def max_splats_per_model(config: TrainConfig, models: int) -> int:
    """Most splats of each of `models` trained in parallel."""
    return max(config.max_splats // models, 1)


def _splats_for(config: TrainConfig, photos: int) -> int:
    """Most splats of a model by the number of photos."""
    if not config.splats_a_photo:
        return config.max_splats
    return max(config.splats_a_photo * photos, _FEWEST_SPLATS)


def expected_model_count(config: TrainConfig, *, photos: int, points: int, subject: bool) -> int:
    """Return the expected number of models before stereo has run, if photos agree on less than
    `ensemble_below`. One for a subject; see `config_where_photos_agree`.

    Args:
        config: `ensemble`, and its condition `ensemble_below`; before or after `cap_by_photos`.
        photos: Number of training photos.
        points: Number of points of the capture; one model if there are too many for several models
            to grow.
        subject: Whether masks are opacity.
    """
    if config.start_splats is not None:
        return 1
    models = min(config.ensemble, config.max_splats)
    if not config.ensemble_below:
        return models
    each = min(max_splats_per_model(config, models), _splats_for(config, photos))
    roomy = 2 * points <= each
    return models if _runs_stereo(config, points) and roomy and not subject else 1


def _runs_stereo(config: TrainConfig, points: int) -> bool:
    """Return whether stereo runs for a capture with this number of points."""
    enabled = config.stereo != Stereo.OFF and (points == 0 or config.stereo != Stereo.MISSING)
    return enabled and max_stereo_points(config, points) > 0


def config_where_photos_agree(
    config: TrainConfig, *, photos: int, points: int
) -> tuple[TrainConfig, int] | None:
    """Return the capped options and the number of models for a subject with `composite` masks if
    photos agree well on it; None: no difference.

    Args:
        config: As `expected_model_count`.
        photos: As `expected_model_count`.
        points: As `expected_model_count`.
    """
    how = {"photos": photos, "points": points, "mask_mode": "composite", "known": 1.0}
    drops = drops_splats_of_subject(config, mask_mode="composite", known=1.0)
    if config.start_splats is not None or not drops or not _runs_stereo(config, points):
        return None
    return cap_by_photos(config, **how, compared=True)[0], model_count(config, **how)[0]


def model_count(
    config: TrainConfig, *, photos: int, points: int, mask_mode: str, known: float | None
) -> tuple[int, Decision | None]:
    """Decide the number of models that are trained in parallel for these photos.

    Args:
        config: As `expected_model_count`.
        photos: As `expected_model_count`.
        points: As `expected_model_count`.
        mask_mode: Use of the masks, as `Dataset.mask_mode`.
        known: As `drops_splats_of_subject`.

    Returns:
        The number, and the decision if the photos led to several models.
    """
    models = expected_model_count(config, photos=photos, points=points, subject=False)
    if models == 1 or not config.ensemble_below:
        return models, None
    if mask_mode == "composite":
        drops = drops_splats_of_subject(config, mask_mode=mask_mode, known=known)
        if known is None or known < _AGREE_WELL or not drops:
            return 1, None
        why = f"{known:.0%} of the subject's pixels"
    elif known is None or known >= config.ensemble_below:
        return 1, None
    else:
        why = f"{known:.0%} of their pixels, less than {config.ensemble_below:.0%}"
    return models, Decision(
        "ensemble",
        f"Photos agree on the depth of {why}, so {models} models that share the splats are trained "
        "in parallel and merged. That takes longer but improves views between the photos "
        "(`--ensemble 1` trains one).",
    )


def cap_by_photos(
    config: TrainConfig,
    *,
    photos: int,
    points: int = 0,
    mask_mode: str = "none",
    known: float | None = None,
    compared: bool = False,
    taken: int = 0,
) -> tuple[TrainConfig, Decision | None]:
    """Cap steps and splats by the number of photos, against overfitting.

    With `composite` masks splats are not capped, because all photos show the subject and no splats
    in front of or behind it can overfit a single photo; the step limit is doubled unless dropout is
    used. A time budget replaces the step limit. Models trained in parallel each fit all photos, so
    the limit of splats applies to each of them.

    Args:
        config: The options.
        photos: Number of training photos.
        points: As `expected_model_count`.
        mask_mode: Use of the masks, as `Dataset.mask_mode`.
        known: As `drops_splats_of_subject`.
        compared: Whether stereo has run, so that the number of models is known; else the expected
            number is used.
        taken: Steps that the run has already taken, a lower limit.

    Returns:
        The options, and the decision with one sentence per cap that applied; None without caps.
    """
    subject = mask_mode == "composite"
    reasons, of_photos = [], count_text(photos, "photo")
    drops = drops_splats_of_subject(config, mask_mode=mask_mode, known=known)
    each = config.steps_a_photo * (2 if subject and not drops else 1)
    given, steps = config.iterations, max(each * photos, _FEWEST_STEPS, taken)
    if config.steps_a_photo and not config.time_budget and steps < given:
        config = replace(config, iterations=steps)
        reasons.append(
            f"{number(steps)} of {number(given)} steps are taken: more do not improve unseen views "
            f"with {of_photos} (`--steps-a-photo 0` takes them all)."
        )
    if compared:
        models, _ = model_count(
            config, photos=photos, points=points, mask_mode=mask_mode, known=known
        )
    else:
        models = expected_model_count(config, photos=photos, points=points, subject=subject)
    most, splats = config.max_splats, models * _splats_for(config, photos)
    if not subject and splats < most:
        config = replace(config, max_splats=splats)
        reasons.append(
            f"The model grows to {number(splats)} of {number(most)} splats: more do not improve "
            f"unseen views with {of_photos} (`--splats-a-photo 0` allows them all)."
        )
    return config, Decision("enough", " ".join(reasons)) if reasons else None


_BACKDROP = 0.1
"""Share of pixels from which on photos show a backdrop of the background's colour."""


def drop_rate_of(
    config: TrainConfig, *, known: float | None, mask_mode: str
) -> tuple[float, Decision | None]:
    """Return the dropout rate of the last step for these photos.

    Args:
        config: `drop_rate`, and its condition `drop_below`.
        known: Share of the unmasked pixels with a depth by stereo; None: stereo has not run.
        mask_mode: Use of the masks, as `Dataset.mask_mode`.

    Returns:
        The rate in [0, 1), and the decision if a condition led to it.
    """
    rate = config.drop_rate
    if not (rate and config.drop_below):
        return rate, None
    if mask_mode == "composite":
        if not drops_splats_of_subject(config, mask_mode=mask_mode, known=known):
            return 0.0, None
        why = f"Photos agree on the depth of {known:.0%} of the subject's pixels"
    elif known is None or known >= config.drop_below:
        return 0.0, None
    else:
        why = f"Photos agree on the depth of {known:.0%} of their pixels"
    return rate, Decision(
        "drops",
        f"{why}, so steps drop up to {rate:.0%} of the splats, which improves unseen views "
        "(`--drop-rate 0` drops none).",
    )


def opaque_weight_of(config: TrainConfig, *, backdrop: float) -> tuple[float, Decision | None]:
    """Return the weight of transmittance for these photos.

    On a plain backdrop that has the background's colour, opaque splats of this colour may stand
    anywhere, also between the subject and other cameras: trainings diverged.

    Args:
        config: `opaque_weight`.
        backdrop: Share of the counted pixels that have the colour of the background.

    Returns:
        The weight, and the decision if the photos led to it.
    """
    weight = config.opaque_weight
    if not weight or backdrop < _BACKDROP:
        return weight, None
    return 0.0, Decision(
        "opacity",
        f"{backdrop:.0%} of the pixels have the background's colour and get no splats.",
    )


def drop_rate_at(rate: float, step: int, iterations: int) -> float:
    """Dropout rate of `step`: rises linearly to `rate` (Park et al. 2025, eq. 5)."""
    return rate * min(step / iterations, 1.0)
