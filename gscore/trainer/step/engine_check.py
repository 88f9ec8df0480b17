"""Engine check: whether an engine can compute what a training needs."""

from ...config import Strategy, TrainConfig
from ...engine.base import ENGINE_SKIPS, EngineInfo, Feature
from ...errors import ConfigError
from ..analysis.analysis import Analysis
from .loss_terms import LossTerms


def check_engine(
    info: EngineInfo,
    config: TrainConfig,
    analysis: Analysis,
    terms: LossTerms,
    *,
    drops: bool,
    frozen: bool,
) -> None:
    """Raise ConfigError, with the options, for what the engine cannot compute.

    Args:
        info: The engine.
        config: The options.
        analysis: The capture.
        terms: Loss terms of the training.
        drops: Whether splats are dropped out.
        frozen: Whether splats around a region are frozen.
    """
    needed = {
        Feature.PICTURE_TERMS: terms.needs_pictures,
        Feature.FROZEN: frozen,
        Feature.ANOMALIES: config.detect_anomaly,
        Feature.MASKS: analysis.photos.mask_mode != "none",
        Feature.DROPOUT: drops,
        Feature.NOISE: config.strategy is Strategy.MCMC,
        Feature.GAINS: analysis.gains is not None,
        Feature.POSES: analysis.pose_check.viewmats is not None,
        Feature.CONTRIBUTIONS: config.prune_share > 0,
    }
    lacking = [kind for kind, weight in terms.terms if weight and kind not in info.terms]
    skips = sorted(ENGINE_SKIPS.intersection(config.without) - info.skips)
    missing = [
        *(f"the loss term {kind.name.lower().replace('_', ' ')}" for kind in lacking),
        *(one for one in Feature if needed[one] and one not in info.features),
        *(f"steps without the skip {skip} (`--without {skip}`)" for skip in skips),
    ]
    if missing:
        raise ConfigError(
            f"The engine {info.name} cannot compute {', '.join(missing)}. Train without, or on "
            "the CPU."
        )
