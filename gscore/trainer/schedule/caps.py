"""Caps of steps, splats and points by the number of photos, against overfitting."""

from dataclasses import replace

from ...config import Stereo, TrainConfig
from ...datasets.points import RANDOM_POINTS
from ...text_format import count_words, number

MOST_ADDED = 10_000
"""Most points that are added where the option leaves it open."""
SPLATS_A_POINT = 5
"""And at most one of so many splats: growth needs room to put them where photos ask for them."""
_AGREE = 0.5
"""Share of a subject's pixels whose depth stereo finds where photos agree: .68 and .84 of two, .34
and .39 of two others."""
_AGREE_WELL = 0.75
"""And from where on several models of a subject are better than one: .84 of the one that gains;
that of .68 loses, for one model alone grows more splats than its share."""
_FEWEST_STEPS, _FEWEST_SPLATS = 1500, 300_000
"""What is always allowed if it was asked for: the steps of the preset `preview`, for fewer leave
too little time to grow, and the splats of `normal`."""


def max_stereo_points(config: TrainConfig, given: int) -> int:
    """How many points stereo may add, where it is asked, to those that are `given`; 0: there is no
    room."""
    room = config.max_splats - given
    if config.stereo == Stereo.AUTO and room < config.max_splats // 2:
        return 0
    most = config.stereo_points or min(MOST_ADDED, config.max_splats // SPLATS_A_POINT)
    return max(min(most, room), 0)


def expected_points(config: TrainConfig, given: int) -> int:
    """How many points a run starts from, before photos are compared: those that are `given`; if
    there are none, as many as stereo may add, or random ones."""
    if given:
        return given
    return RANDOM_POINTS if config.stereo == Stereo.OFF else max_stereo_points(config, 0)


def drops_splats_of_subject(config: TrainConfig, *, mask_mode: str, known: float | None) -> bool:
    """Whether a subject that masks cut out grows many splats, of which each step leaves some out.

    That takes half the steps for 0.2 dB more where photos agree, and loses as much where they do
    not.

    Args:
        config: `drop_rate`.
        mask_mode: What masks are for, as `Dataset.mask_mode`.
        known: Share of the pixels that masks leave whose depth stereo found; None: nobody looked.
    """
    agrees = known is not None and known >= _AGREE
    return mask_mode == "composite" and config.drop_rate > 0 and agrees


def max_splats_per_model(config: TrainConfig, models: int) -> int:
    """Most splats of each of so many models that are trained side by side."""
    return max(config.max_splats // models, 1)


def _splats_for(config: TrainConfig, photos: int) -> int:
    """Most splats of a model that so many photos are good for."""
    if not config.splats_a_photo:
        return config.max_splats
    return max(config.splats_a_photo * photos, _FEWEST_SPLATS)


def expected_model_count(config: TrainConfig, *, photos: int, points: int, subject: bool) -> int:
    """How many models a run trains side by side, unless photos agree in more than
    `ensemble_below`, which is not known before they are compared. Of a subject one is expected; see
    `config_where_photos_agree`.

    Args:
        config: `ensemble`, and `ensemble_below`, its condition; before or after
            `cap_by_photos`.
        photos: Number of training photos.
        points: Of the capture; those of which a model would have no room to grow leave one.
        subject: Whether masks are opacity.
    """
    if config.start_splats is not None:
        return 1
    models = min(config.ensemble, config.max_splats)
    if not config.ensemble_below:
        return models
    each = min(max_splats_per_model(config, models), _splats_for(config, photos))
    roomy = 2 * points <= each
    return models if _compared(config, points) and roomy and not subject else 1


def _compared(config: TrainConfig, points: int) -> bool:
    """Whether photos are compared for points beside so many."""
    asked = config.stereo != Stereo.OFF and (points == 0 or config.stereo != Stereo.MISSING)
    return asked and max_stereo_points(config, points) > 0


def config_where_photos_agree(
    config: TrainConfig, *, photos: int, points: int
) -> tuple[TrainConfig, int] | None:
    """What becomes of a subject that masks cut out where photos agree well on it: the options with
    the steps that are taken then, and how many models take them; None: nothing else.

    Args:
        config: As `expected_model_count`.
        photos: As `expected_model_count`.
        points: As `expected_model_count`.
    """
    how = {"photos": photos, "points": points, "mask_mode": "composite", "known": 1.0}
    thinned = drops_splats_of_subject(config, mask_mode="composite", known=1.0)
    if config.start_splats is not None or not thinned or not _compared(config, points):
        return None
    return cap_by_photos(config, **how, compared=True)[0], model_count(config, **how)[0]


def model_count(
    config: TrainConfig, *, photos: int, points: int, mask_mode: str, known: float | None
) -> tuple[int, str]:
    """How many models are trained side by side for these photos.

    Args:
        config: As `expected_model_count`.
        photos: As `expected_model_count`.
        points: As `expected_model_count`.
        mask_mode: What masks are for, as `Dataset.mask_mode`.
        known: As `drops_splats_of_subject`.

    Returns:
        The number, and a sentence where photos decide that there are several; empty: they do not.
    """
    models = expected_model_count(config, photos=photos, points=points, subject=False)
    if models == 1 or not config.ensemble_below:
        return models, ""
    if mask_mode == "composite":
        thins = drops_splats_of_subject(config, mask_mode=mask_mode, known=known)
        if known is None or known < _AGREE_WELL or not thins:
            return 1, ""
        why = f"{known:.0%} of the subject's pixels"
    elif known is None or known >= config.ensemble_below:
        return 1, ""
    else:
        why = f"{known:.0%} of their pixels, less than {config.ensemble_below:.0%}"
    return models, (
        f"Photos agree on the depth of {why}: {models} models, each with its share of the splats, "
        "are trained side by side and shown as one. That takes longer, and views between the "
        "photos are better (--ensemble 1 trains one)."
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
) -> tuple[TrainConfig, str]:
    """The options with no more steps and splats than so many photos are good for.

    Where masks are opacity (`composite`), all splats are taken: a subject alone is seen from all
    sides, and there is nothing before or behind it that one photo alone could explain. Twice as
    many steps are, unless splats are left out of them. Under a time budget steps are
    found otherwise. Models that are trained side by side learn the photos each by itself, so each
    may have as many splats as one alone.

    Args:
        config: How to train.
        photos: Number of training photos.
        points: As `expected_model_count`.
        mask_mode: What masks are for, as `Dataset.mask_mode`.
        known: As `drops_splats_of_subject`.
        compared: Whether photos were compared, so that the number of models is known; else it is
            the one to expect.
        taken: Steps that a run has taken already, which nothing takes back.

    Returns:
        The options, and a sentence for each thing that was left out; empty where nothing was.
    """
    subject = mask_mode == "composite"
    words, of_photos = [], count_words(photos, "photo")
    thinned = drops_splats_of_subject(config, mask_mode=mask_mode, known=known)
    each = config.steps_a_photo * (2 if subject and not thinned else 1)
    asked, steps = config.iterations, max(each * photos, _FEWEST_STEPS, taken)
    if config.steps_a_photo and not config.time_budget and steps < asked:
        config = replace(config, iterations=steps)
        words.append(
            f"{number(steps)} of {number(asked)} steps are taken: more do not make unseen views of "
            f"{of_photos} better (--steps-a-photo 0 takes them all)."
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
        words.append(
            f"At most {number(splats)} of {number(most)} splats grow: more do not make unseen "
            f"views of {of_photos} better (--splats-a-photo 0 allows them all)."
        )
    return config, " ".join(words)
